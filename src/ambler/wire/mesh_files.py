"""Triangle meshes in files: Wavefront OBJ, STL (text and binary) and PLY (text and binary).

Only places and faces are read; faces with more than three corners become fans. Nothing is repaired, so a broken file is refused.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
Mesh = tuple[F64, I32]
Property = tuple[str, str, str | None]
"""Name, numpy type, and of a list the numpy type of its length."""

PLY_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2"},
    **{"uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
PLY_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
INDICES = ("vertex_indices", "vertex_index")


def read_mesh(path: Path) -> Mesh:
    """Return vertices float64 (N, 3) in the file's own unit, and triangles int32 (M, 3).

    Raises BadInputError with one sentence that names the file.
    """
    readers: dict[str, Callable[[bytes], Mesh]] = {".obj": _read_obj, ".stl": _read_stl, ".ply": _read_ply}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise BadInputError(f"{path}: meshes are read from .obj, .stl and .ply files only")
    try:
        vertices, triangles = reader(path.read_bytes())
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, IndexError, KeyError, OverflowError, struct.error) as error:
        raise BadInputError(f"{path}: is no mesh, or cut off: {error}") from error
    if len(triangles) == 0:
        raise BadInputError(f"{path}: the mesh has no faces")
    return vertices, triangles


def _mesh(vertices: Sequence[Sequence[float]] | F64, triangles: Sequence[tuple[int, int, int]] | I32) -> Mesh:
    points, numbers = np.array(vertices, np.float64).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise ValueError("a vertex is no point")
    if len(numbers) and (numbers.min() < 0 or numbers.max() >= len(points)):
        raise ValueError("a face names a vertex that is not there")
    return points, numbers.astype(np.int32)


def _fan(face: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    if len(face) < 3:
        raise ValueError(f"a face has {len(face)} corners")
    for k in range(1, len(face) - 1):
        yield face[0], face[k], face[k + 1]


def _read_obj(data: bytes) -> Mesh:
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for line in data.decode("utf-8").splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(words[0]), float(words[1]), float(words[2])])
        elif kind == "f":
            numbers = [int(w.partition("/")[0]) for w in words]
            triangles += _fan([n - 1 if n > 0 else len(vertices) + n if n < 0 else -1 for n in numbers])
    return _mesh(vertices, triangles)


def _read_stl(data: bytes) -> Mesh:
    """Corners at one place become one vertex."""
    if len(data) >= 84 and len(data) == 84 + 50 * int(struct.unpack_from("<I", data, 80)[0]):
        rows = np.frombuffer(data, np.dtype([("v", "<f4", 12), ("n", "<u2")]), offset=84)
        corners = rows["v"][:, 3:].reshape(-1, 3).astype(np.float64)
    elif data.lstrip()[:5] == b"solid":
        lines = (line.split() for line in data.decode("ascii").splitlines())
        corners = np.array([[float(w) for w in words[1:4]] for words in lines if words[:1] == ["vertex"]])
        if not data.rstrip().splitlines()[-1].strip().startswith(b"endsolid"):
            raise ValueError("endsolid is missing")
    else:
        raise ValueError("its length does not fit its number of triangles")
    vertices, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return _mesh(vertices, numbers.reshape(-1, 3).astype(np.int32))


def _read_ply(data: bytes) -> Mesh:
    elements, order, start = _ply_header(data)
    words = iter(data[start:].split()) if order == "=" else None
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for name, count, properties in elements:
        for _ in range(count):
            row: dict[str, list[float]] = {}
            for key, kind, length_kind in properties:
                length = 1
                if length_kind is not None:
                    (first,), start = _take(data, start, words, order + length_kind, 1)
                    length = int(first)
                row[key], start = _take(data, start, words, order + kind, length)
            if name == "vertex":
                vertices.append([row["x"][0], row["y"][0], row["z"][0]])
            elif name == "face":
                face = row[next(k for k in INDICES if k in row)] if any(k in row for k in INDICES) else []
                triangles += _fan([int(v) for v in face])
    return _mesh(vertices, triangles)


def _take(data: bytes, start: int, words: Iterator[bytes] | None, kind: str, count: int) -> tuple[list[float], int]:
    """Return the next numbers, and where the ones after them begin."""
    if count < 0:
        raise ValueError("a list has a negative length")
    if words is not None:
        found = [float(w) for _, w in zip(range(count), words, strict=False)]
        if len(found) < count:
            raise ValueError("numbers are missing at its end")
        return found, start
    kind_ = np.dtype(kind)
    return np.frombuffer(data, kind_, count, start).tolist(), start + count * kind_.itemsize


def _ply_header(data: bytes) -> tuple[list[tuple[str, int, list[Property]]], str, int]:
    """Return the elements (name, count, properties), the byte order, and where the numbers begin."""
    end = data.index(b"end_header")
    start = data.index(b"\n", end) + 1
    lines = [line.split() for line in data[:end].decode("ascii").splitlines()]
    if lines[0] != ["ply"]:
        raise ValueError("it does not begin with ply")
    order, elements = "", list[tuple[str, int, list[Property]]]()
    for words in lines[1:]:
        if words[:1] == ["format"]:
            order = PLY_ORDERS[words[1]]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1][2].append((words[4], PLY_TYPES[words[3]], PLY_TYPES[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1][2].append((words[2], PLY_TYPES[words[1]], None))
    if not order:
        raise ValueError("its format is missing")
    return elements, order, start
