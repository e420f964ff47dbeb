"""Files that appear whole or not at all: whoever reads them, or starts after a crash, never meets half of one."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from ambler.core.errors import NotWrittenError


def write_whole(path: Path, data: bytes | str) -> None:
    """Write bytes, or text as UTF-8, beside `path`, bring them to the disk, and only then put them in its place; raises NotWrittenError.

    When it returns, the name is on the disk, too: the folder is synchronized after the file. A link stays one, to the new file; a pipe or a device is
    written to and never replaced.
    """
    bytes_ = data.encode("utf-8") if isinstance(data, str) else data
    try:
        target = path.resolve() if path.is_symlink() else path
        if target.exists() and not (target.is_file() or target.is_dir()):
            with target.open("wb") as stream:
                stream.write(bytes_)
            return
        _replace(target, bytes_)
    except OSError as error:
        raise NotWrittenError(f"{path}: cannot be written: {error.strerror or error}") from error
    _bring_to_disk(target.parent)


def _replace(path: Path, data: bytes) -> None:
    """Put bytes in the place of a file; raises OSError, and then nothing is left behind."""
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def _bring_to_disk(folder: Path) -> None:
    """Synchronize a folder, where its file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
