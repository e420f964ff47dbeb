"""Trajectories in space as text: TUM (stamp, place, quaternion) and KITTI (the upper three rows of a matrix)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.wire.atomic_file import write_whole

I64 = NDArray[np.int64]


def write_tum_3d(path: Path, stamps_ns: Sequence[int] | I64, poses: Sequence[SE3]) -> None:
    """Write `stamp x y z qx qy qz qw`, seconds with nine decimals, atomically."""
    lines = []
    for stamp, pose in zip(stamps_ns, poses, strict=True):
        w, *xyz = pose.rotation
        seconds, rest = divmod(int(stamp), 1_000_000_000)
        lines.append(f"{seconds}.{rest:09d} " + " ".join(f"{v:.9f}" for v in (*pose.translation, *xyz, w)) + "\n")
    write_whole(path, "".join(lines))


def write_kitti(path: Path, poses: Sequence[SE3]) -> None:
    """Write a line of twelve numbers per pose, atomically."""
    rows = (pose.matrix()[:3].ravel().tolist() for pose in poses)
    write_whole(path, "".join(" ".join(f"{v:.9e}" for v in row) + "\n" for row in rows))


def read_tum_3d(path: Path) -> tuple[I64, list[SE3]]:
    """Read stamps (ns) and poses; raises BadInputError that names the line."""
    stamps: list[int] = []
    poses: list[SE3] = []
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
        if len(row) != 8 or not np.isfinite(row).all():
            raise BadInputError(f"{path}:{number}: a pose has 8 finite numbers, found {len(row)}")
        length = float(np.linalg.norm(row[4:]))
        if length < 1e-3:
            raise BadInputError(f"{path}:{number}: the quaternion is zero")
        x, y, z, w = (v / length for v in row[4:])
        seconds, _, decimals = words[0].partition(".")
        exact = seconds.isdecimal() and decimals.isdecimal()
        stamps.append(int(seconds) * 10**9 + int(decimals[:9].ljust(9, "0")) if exact else round(row[0] * 1e9))
        poses.append(SE3((row[1], row[2], row[3]), (w, x, y, z)))
    if not poses:
        raise BadInputError(f"{path}: holds no poses")
    return np.array(stamps, np.int64), poses
