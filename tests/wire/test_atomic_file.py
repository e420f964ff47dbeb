"""A file is replaced whole or stays as it was."""

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
