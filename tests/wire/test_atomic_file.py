"""A file is replaced whole or stays as it was."""

import os
import threading
from pathlib import Path

import pytest

from ambler.core.errors import NotWrittenError
from ambler.wire.atomic_file import write_whole


def test_text_and_bytes_replace_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    write_whole(path, "größer\n")
    assert path.read_bytes() == "größer\n".encode()
    write_whole(path, b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    assert list(tmp_path.iterdir()) == [path], "nothing else is left behind"


def test_a_write_that_fails_leaves_the_old_file_and_no_rest(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.mkdir()
    (path / "inside").write_text("kept")
    with pytest.raises(NotWrittenError, match="cannot be written: Is a directory"):
        write_whole(path, "new")
    assert (path / "inside").read_text() == "kept"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_one_to_the_new_file(tmp_path: Path) -> None:
    target, link = tmp_path / "disk" / "a.yaml", tmp_path / "a.yaml"
    target.parent.mkdir()
    for old in ("", "old"):  # of a file that is not there yet, too
        if old:
            target.write_text(old)
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        write_whole(link, "new")
        assert link.is_symlink()
        assert target.read_text() == "new"
        assert list(target.parent.iterdir()) == [target]


def test_a_pipe_and_a_device_are_written_to_and_stay(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write_whole(pipe, "told")
    reader.join(10.0)
    assert read == [b"told"]
    assert pipe.is_fifo()
    write_whole(Path("/dev/null"), "nobody")
    assert Path("/dev/null").is_char_device()
    with pytest.raises(NotWrittenError, match="No space left"):
        write_whole(Path("/dev/full"), "too much")
    assert Path("/dev/full").is_char_device()
