"""Files that appear whole or not at all: whoever reads them, or starts after a crash, never meets half of one."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from ambler.core.errors import NotWrittenError


def write_whole(path: Path, data: bytes | str) -> None:
    """Write bytes, or text as UTF-8, beside `path`, bring them to the disk, and only then put them in its place; raises NotWrittenError.

    When it returns, the name is on the disk, too: the folder is synchronized after the file.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(data.encode("utf-8") if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise NotWrittenError(f"{path}: cannot be written: {error.strerror or error}") from error
    _bring_to_disk(path.parent)


def _bring_to_disk(folder: Path) -> None:
    """Synchronize a folder, where its file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
