"""A visibility graph as a file: nodes, edges with their votes and the floors it was seen on, without loss.

Twelve bytes of name and version, the SHA-256 of what follows, then a NumPy archive (zip, no pickles) of named arrays. A file that was cut or changed does not match its hash
and is refused.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.wire.atomic_file import write_whole

MAGIC = b"ambler.vg 2\n"
SUFFIX = ".vgraph"


def graph_file(stem: Path) -> Path:
    """Return the file of a graph beside the map of a stem."""
    return stem.with_name(stem.name + SUFFIX)


def save_graph(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write named arrays of plain numbers to `path`; the file appears at once or not at all. Raises NotWrittenError."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
        for name in sorted(arrays):
            with io.BytesIO() as one:
                np.lib.format.write_array(one, np.ascontiguousarray(arrays[name]), allow_pickle=False)
                archive.writestr(zipfile.ZipInfo(name + ".npy", (1980, 1, 1, 0, 0, 0)), one.getvalue())
    content = buffer.getvalue()
    write_whole(path, MAGIC + hashlib.sha256(content).digest() + content)


def load_graph(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file; raises BadInputError that names the file and what is wrong."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from error
    if not raw.startswith(MAGIC):
        raise BadInputError(f"{path}: is no visibility graph of Ambler")
    content = raw[len(MAGIC) + 32 :]
    if hashlib.sha256(content).digest() != raw[len(MAGIC) : len(MAGIC) + 32]:
        raise BadInputError(f"{path}: is cut or damaged")
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
