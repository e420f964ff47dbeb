"""Trajectories in space as text: TUM (stamp, place, quaternion) and KITTI (the upper three rows of a matrix)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.wire.atomic_file import write_whole
from ambler.wire.tum import tum_rows

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
    """Read stamps (ns) and poses, in the order of time; raises BadInputError that names the line."""
    rows = sorted(tum_rows(path), key=lambda row: row[0])
    if not rows:
        raise BadInputError(f"{path}: holds no poses")
    poses = [SE3((x, y, z), (qw, qx, qy, qz)) for _, (_, x, y, z, qx, qy, qz, qw) in rows]
    return np.array([stamp for stamp, _ in rows], np.int64), poses
