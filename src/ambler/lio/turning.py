"""How much something that is carried turned, and about how many axes: what tells where a LiDAR sits on an IMU."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig
from ambler.lio.health import LioResult

WINDOW_NS = 3_000_000_000


def least_turn(stamps_ns: NDArray[np.int64], poses: Sequence[SE3]) -> float:
    """Return the RMS of the turns (rad) within 3 s about the axis of the body about which it turned least; 0 if it was not followed for so long.

    The rotations of two sensors on one plate tell how they sit beside each other only if their axes differ (Tsai and Lenz 1989): of a robot on a floor, which
    turns about the vertical, the lean of the IMU's own axes looks like one of the LiDAR's.
    """
    after = np.searchsorted(stamps_ns, stamps_ns + WINDOW_NS)
    is_near = after < len(poses)
    is_near[is_near] = stamps_ns[after[is_near]] - stamps_ns[is_near] < 1.2 * WINDOW_NS  # no hole in between
    rows = np.flatnonzero(is_near)
    if len(rows) == 0:
        return 0.0
    turns = np.array(
        [(poses[k].inverse() @ poses[j]).rotation for k, j in zip(rows.tolist(), after[rows].tolist(), strict=True)]
    )
    turns *= np.where(turns[:, :1] < 0.0, -1.0, 1.0)
    sines = np.linalg.norm(turns[:, 1:], axis=1)
    vectors = turns[:, 1:] * (2.0 * np.arctan2(sines, turns[:, 0]) / np.maximum(sines, 1e-12))[:, None]
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[0])))


def is_turned(results: Sequence[LioResult], config: LioConfig) -> bool:
    """Whether what was followed without being lost turned about all axes, so that what the filter learned of the mount is believed."""
    followed = [r for r in results if not r.health.is_lost]
    stamps_ns = np.array([r.stamp_ns for r in followed], np.int64)
    return least_turn(stamps_ns, [r.map_from_imu for r in followed]) >= config.refined_turn


def believed_mount(results: Sequence[LioResult], told: SE3, asked: LioConfig) -> SE3:
    """Return the mount that holds for all poses of a recording: what the filter knew at the end, if it was `asked` for that or the recording turned
    about all axes; else `told`."""
    return results[-1].imu_from_lidar if asked.estimates_mount or is_turned(results, asked) else told
