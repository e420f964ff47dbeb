"""The TUM trajectory format: `stamp x y z qx qy qz qw` per line, seconds and metres, six decimals of the stamp."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.wire.atomic_file import write_whole

SECONDS_MOST = 9e9  # the year 2255; ns beyond it are no 64-bit integer


def write_tum(path: Path, stamps: NDArray[np.float64], poses: NDArray[np.float64]) -> None:
    """Write stamps (N,) in seconds with planar poses (N, 3) of (x, y, yaw), atomically."""
    half = 0.5 * poses[:, 2]
    lines = [
        f"{t:.6f} {x:.6f} {y:.6f} 0.000000 0.000000 0.000000 {s:.9f} {c:.9f}\n"
        for t, (x, y), s, c in zip(
            stamps.tolist(), poses[:, :2].tolist(), np.sin(half).tolist(), np.cos(half).tolist(), strict=True
        )
    ]
    write_whole(path, "".join(lines))


def read_tum(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read stamps (N,) and planar poses (N, 3) of (x, y, yaw); raises BadInputError naming the line.

    Spatial poses are projected on the plane: x, y and the heading of the body's x axis.
    """
    rows = [row for _, row in tum_rows(path)]
    table = np.array(rows, np.float64).reshape(len(rows), 8)
    x, y, z, w = table[:, 4:].T
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return table[:, 0].copy(), np.column_stack((table[:, 1:3], yaw))


def tum_rows(path: Path) -> Iterator[tuple[int, list[float]]]:
    """Yield each pose's stamp in ns, exact where it is written as a decimal, and its eight numbers, the quaternion of length one; raises BadInputError naming the line."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}") from error
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(w) for w in words]
        except ValueError as error:
            raise BadInputError(f"{path}:{number}: {error}") from error
        if len(row) != 8:
            raise BadInputError(f"{path}:{number}: a pose has 8 numbers, found {len(row)}")
        length = math.hypot(*row[4:])
        if not all(map(math.isfinite, row)) or length < 1e-3:
            raise BadInputError(f"{path}:{number}: a number is not finite, or the quaternion is zero")
        if abs(row[0]) >= SECONDS_MOST:
            raise BadInputError(
                f"{path}:{number}: the stamp {words[0]} is no time in seconds, with which a line begins (is it in ns, µs or ms?)"
            )
        seconds, _, decimals = words[0].partition(".")
        is_exact = seconds.isdecimal() and decimals.isdecimal()
        stamp_ns = int(seconds) * 10**9 + int(decimals[:9].ljust(9, "0")) if is_exact else round(row[0] * 1e9)
        yield stamp_ns, row[:4] + [q / length for q in row[4:]]
