"""Clouds of points in files: PCD (text, binary, compressed), PLY, BIN as KITTI, nuScenes and Boreas have it, and TXT as KITTI's raw drives; read (also gzipped) and, as
PCD or PLY, written.

A cloud is a table whose columns have the drivers' names (`wire.cloud_columns`): x, y, z and what else there is.
"""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.wire.atomic_file import write_whole
from ambler.wire.mesh_files import PLY_ORDERS, PLY_TYPES

Table = NDArray[np.void]
CLOUD_SUFFIX = ".cloud.pcd"
"""Of a cloud beside the map that was made with it."""
KINDS = (".pcd", ".ply", ".bin")
TEXT = ".txt"  # a point a line; times and measurements are lines of numbers, too, so that only who knows what is in them may take them for clouds
_PCD_KINDS = {("F", 4): "<f4", ("F", 8): "<f8"} | {
    (letter, size): f"<{letter.lower()}{size}" for letter in "IU" for size in (1, 2, 4, 8)
}
_BIN = [(name, "<f4") for name in ("x", "y", "z", "intensity", "ring", "time")]
RING_MOST = 255


def kind_of(path: Path) -> str | None:
    """Return `.pcd`, `.ply` or `.bin` by a file's name, with or without `.gz`; None for others."""
    name = path.name.lower().removesuffix(".gz")
    return next((kind for kind in KINDS if name.endswith(kind)), None)


def is_text(path: Path) -> bool:
    """Say whether a file is a table of numbers by its name, with or without `.gz`."""
    return path.name.lower().removesuffix(".gz").endswith(TEXT)


def read_cloud(path: Path) -> Table:
    """Return the points of a file as a table with at least x, y and z; raises BadInputError that names the file and what is wrong."""
    kind = TEXT if is_text(path) else kind_of(path)
    if kind is None:
        raise BadInputError(f"{path}: clouds are read from .pcd, .ply, .bin and .txt files only (also .gz)")
    try:
        data = path.read_bytes()
        if path.suffix.lower() == ".gz":
            data = gzip.decompress(data)
        table = {".pcd": _read_pcd, ".ply": _read_ply, ".bin": _read_bin, TEXT: _read_text}[kind](data)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise BadInputError(f"{path}: is no gzip file, or cut off: {error}") from error
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, IndexError, KeyError, OverflowError, struct.error, TypeError) as error:
        raise BadInputError(f"{path}: is no cloud, or cut off: {error}") from error
    missing = [axis for axis in "xyz" if axis not in (table.dtype.names or ())]
    if missing:
        raise BadInputError(f"{path}: has no column {', '.join(missing)}")
    return table


def write_cloud(path: Path, points: NDArray[np.float32], intensity: NDArray[np.float32] | None = None) -> None:
    """Write points (N, 3), and their intensities (N,) if given, as binary PCD or PLY by the name of the file, atomically."""
    names = ["x", "y", "z"] + ([] if intensity is None else ["intensity"])
    columns = [points] + ([] if intensity is None else [intensity[:, None]])
    body = np.ascontiguousarray(np.hstack(columns), "<f4").tobytes()
    if path.suffix.lower() == ".ply":
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
        header = "\n".join([*lines, *(f"property float {name}" for name in names), "end_header", ""])
    elif path.suffix.lower() == ".pcd":
        each = len(names)
        header = (
            f"# .PCD v0.7\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE {' '.join(['4'] * each)}\n"
            f"TYPE {' '.join(['F'] * each)}\nCOUNT {' '.join(['1'] * each)}\nWIDTH {len(points)}\nHEIGHT 1\n"
            f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
        )
    else:
        raise BadInputError(f"{path}: clouds are written as .pcd and .ply only")
    write_whole(path, header.encode("ascii") + body)


def _read_bin(data: bytes) -> Table:
    """KITTI's layout, x, y, z and reflectance as float32; with the ring behind them as nuScenes has it, or ring and seconds as Boreas: a fifth column of whole numbers."""
    for columns in (6, 5):
        if data and len(data) % (4 * columns) == 0:
            ring = np.frombuffer(data, "<f4").reshape(-1, columns)[:, 4]
            if ((ring >= 0.0) & (ring <= RING_MOST) & (ring == np.floor(ring))).all() and np.ptp(ring) > 0.0:
                return np.frombuffer(data, np.dtype(_BIN[:columns]))
    layout = np.dtype(_BIN[:4])
    if len(data) % layout.itemsize:
        raise ValueError(f"{len(data)} bytes are no multiple of {layout.itemsize} (x, y, z, intensity as float32)")
    return np.frombuffer(data, layout)


def _read_text(data: bytes) -> Table:
    """KITTI's layout of raw drives that are not synchronized: x, y, z and reflectance in a line."""
    layout = np.dtype(_BIN[:4])
    if not data.strip():
        return np.zeros(0, layout)
    values = np.loadtxt(io.BytesIO(data), np.float32, ndmin=2)
    if values.shape[1] != 4:
        raise ValueError(f"{values.shape[1]} numbers in a line, not x, y, z and intensity")
    return np.ascontiguousarray(values).view(layout)[:, 0]


def _read_pcd(data: bytes) -> Table:
    entries, start = _pcd_header(data)
    names, counts = entries["FIELDS"], [int(c) for c in entries.get("COUNT", ["1"] * len(entries["FIELDS"]))]
    formats = [_PCD_KINDS[kind, int(size)] for kind, size in zip(entries["TYPE"], entries["SIZE"], strict=True)]
    columns = [
        (name if name != "_" else f"_{k}", form, (count,)) if count > 1 else (name if name != "_" else f"_{k}", form)
        for k, (name, form, count) in enumerate(zip(names, formats, counts, strict=True))
    ]
    layout: np.dtype[Any] = np.dtype(columns)
    number = int(entries["POINTS"][0]) if "POINTS" in entries else int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
    kind = entries["DATA"][0]
    if kind == "binary":
        if len(data) - start < number * layout.itemsize:
            raise ValueError(f"{number} points are announced, {(len(data) - start) // layout.itemsize} are there")
        return np.frombuffer(data, layout, number, start)
    if kind == "binary_compressed":
        packed, unpacked = struct.unpack_from("<II", data, start)
        body = data[start + 8 : start + 8 + packed]
        if len(body) < packed or unpacked < number * layout.itemsize:
            raise ValueError("the compressed points are not all there")
        return _by_columns(_unpack_lzf(body, unpacked), layout, number)
    if kind != "ascii":
        raise ValueError(f"DATA {kind} is not known")
    if number == 0:
        return np.zeros(0, layout)
    values = np.loadtxt(io.BytesIO(data[start:]), ndmin=2, max_rows=number)
    if len(values) < number:
        raise ValueError(f"{number} points are announced, {len(values)} are there")
    table = np.zeros(number, layout)
    at = 0
    for name, count in zip(layout.names or (), counts, strict=True):
        table[name] = values[:, at] if count == 1 else values[:, at : at + count]
        at += count
    return table


def _pcd_header(data: bytes) -> tuple[dict[str, list[str]], int]:
    """Return the header's words by their first, and where the points begin."""
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = data.index(b"\n", start)
        words = data[start:end].decode("ascii", errors="replace").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
        if start > 10_000:
            raise ValueError("its header has no end")
    return entries, start


def _by_columns(body: bytes, layout: np.dtype[Any], number: int) -> Table:
    """The compressed layout holds column after column."""
    table = np.zeros(number, layout)
    at = 0
    for name in layout.names or ():
        part = layout[name]
        table[name] = np.frombuffer(body, part.base, number * int(np.prod(part.shape)), at).reshape(number, *part.shape)
        at += number * part.itemsize
    return table


def _unpack_lzf(packed: bytes, size: int) -> bytes:
    """Expand LZF: a control byte below 32 is a run of literals, else a copy of what came before."""
    out = bytearray()
    at = 0
    while at < len(packed):
        control = packed[at]
        at += 1
        if control < 32:
            out += packed[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[at]
            at += 1
        begin = len(out) - ((control & 31) << 8) - packed[at] - 1
        at += 1
        if begin < 0:
            raise ValueError("the compressed points are damaged")
        for k in range(length + 2):
            out.append(out[begin + k])
    if len(out) != size:
        raise ValueError("the compressed points are damaged")
    return bytes(out)


def _read_ply(data: bytes) -> Table:
    """The element `vertex`, which must come first and have no lists."""
    end = data.index(b"end_header")
    start = data.index(b"\n", end) + 1
    order, count, columns, element = "", -1, list[tuple[str, str]](), ""
    for words in (line.split() for line in data[:end].decode("ascii", errors="replace").splitlines()):
        if words[:1] == ["format"]:
            order = PLY_ORDERS[words[1]]
        elif words[:1] == ["element"]:
            element = words[1]
            if count < 0 and element != "vertex":
                raise ValueError("its first element is no vertex")
            count = int(words[2]) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            columns.append((words[2].removeprefix("scalar_"), PLY_TYPES[words[1]]))
    if count < 0 or not order:
        raise ValueError("its header lacks the format or the vertices")
    if order == "=":
        if count == 0:
            return np.zeros(0, np.dtype(columns))
        values = np.loadtxt(io.BytesIO(data[start:]), ndmin=2, max_rows=count)
        if len(values) < count:
            raise ValueError(f"{count} points are announced, {len(values)} are there")
        table = np.zeros(count, np.dtype(columns))
        for k, (name, _) in enumerate(columns):
            table[name] = values[:, k]
        return table
    layout = np.dtype([(name, order + form) for name, form in columns])
    if len(data) - start < count * layout.itemsize:
        raise ValueError(f"{count} points are announced, {(len(data) - start) // layout.itemsize} are there")
    return np.frombuffer(data, layout, count, start)
