"""Simulated drives: true poses, ideal or noisy scans, odometry with chosen faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.slam2d.config import Slam2dConfig
from ambler.slam2d.slam import Slam2d, Slam2dResult
from tests.registration.room import WALLS, loop_of, scan_at

F64 = NDArray[np.float64]
PERIOD_NS = 100_000_000

# A ring of corridors, 2 m wide and 16 m x 11 m along their middle, with a few pillars so that its sides differ.
RING: F64 = np.array(
    [
        *loop_of((-9.03, -6.52), (9.02, -6.52), (9.02, 6.54), (-9.03, 6.54)),
        *loop_of((-7.01, -4.53), (7.03, -4.53), (7.03, 4.51), (-7.01, 4.51)),
        *loop_of((-5.0, -6.52), (-4.4, -6.52), (-4.4, -6.1), (-5.0, -6.1)),
        *loop_of((-9.03, -2.2), (-8.5, -2.2), (-8.5, -1.6), (-9.03, -1.6)),
        *loop_of((7.03, 1.0), (7.4, 1.0), (7.4, 2.2), (7.03, 2.2)),
    ]
)


@dataclass(frozen=True, slots=True)
class Drive:
    """True poses (room_from_base), one per period, and the odometry's motion between them."""

    truth: list[SE2]
    odometry: list[SE2]
    walls: F64
    range_max: float


def oval(laps: float = 1.0, scans_per_lap: int = 160) -> list[SE2]:
    """Return poses along an oval in the room, about 10 m a lap."""
    out = []
    for k in range(round(laps * scans_per_lap) + 1):
        a = 2.0 * math.pi * k / scans_per_lap + 0.5
        out.append(
            SE2(0.2 + 1.9 * math.cos(a), -0.1 + 1.2 * math.sin(a), math.atan2(1.2 * math.cos(a), -1.9 * math.sin(a)))
        )
    return out


def around_the_ring(step: float = 0.1, overlap: float = 4.0) -> list[SE2]:
    """Return poses counter-clockwise around the ring, from the lower left on, and `overlap` metres farther; corners are rounded."""
    radius = 0.8
    straight, pose, out = (16.0 - 2 * radius, 11.0 - 2 * radius), SE2(-7.2, -5.5, 0.0), []
    length, total = 0.0, 2 * sum(straight) + 2 * math.pi * radius + overlap
    side, done, is_turning = 0, 0.0, False
    while length < total:
        out.append(pose)
        here = 0.5 * math.pi * radius if is_turning else straight[side % 2]
        move = min(step, here - done)
        pose = pose @ SE2.exp(np.array([move, 0.0, move / radius if is_turning else 0.0]))
        length, done = length + move, done + move
        if done >= here - 1e-9:
            side, done, is_turning = side + is_turning, 0.0, not is_turning
    return out


def drive(
    truth: list[SE2],
    slip: Callable[[SE2, SE2], SE2] | None = None,
    walls: F64 = WALLS,
    range_max: float = 30.0,
) -> Drive:
    """Return a drive; `slip(pose, motion)` gives what the odometry measures of a motion, default the truth."""
    odom = [SE2(3.0, -1.0, 2.0)]
    for a, b in pairwise(truth):
        motion = a.inverse() @ b
        odom.append(odom[-1] @ (slip(a, motion) if slip else motion))
    return Drive(truth, odom, walls, range_max)


def run(
    slam: Slam2d,
    course: Drive,
    *,
    with_odometry: bool,
    with_heading: bool = False,
    rng: np.random.Generator | None = None,
    first: int = 0,
    last: int | None = None,
    with_background: bool = True,
) -> list[Slam2dResult]:
    """Feed the scans `first` ... `last` of a drive, and the odometry's heading by itself, too, as robots do; background jobs run inline."""
    results = []
    for k in range(first, len(course.truth) if last is None else last):
        stamp_ns = (k + 1) * PERIOD_NS
        if with_odometry:
            slam.add_odometry(stamp_ns, course.odometry[k])
        if with_heading:
            slam.add_heading(stamp_ns, course.odometry[k].yaw)
        results.append(slam.update(scan_at(course.truth[k], stamp_ns, course.walls, rng, range_max=course.range_max)))
        work = slam.take_background_work() if with_background else None
        if work is not None:
            slam.commit(work())
    return results


def errors(truth: list[SE2], estimates: list[SE2]) -> F64:
    """Return float64 (N, 2): distance (m) and angle (rad) between poses relative to the first one of each."""
    out = []
    for t, e in zip(truth, estimates, strict=True):
        d = (truth[0].inverse() @ t).inverse() @ (estimates[0].inverse() @ e)
        out.append((math.hypot(d.x, d.y), abs(wrap_angle(d.yaw))))
    return np.array(out)


def short_submaps(scans: int = 30) -> Slam2dConfig:
    """Return the shipped configuration with smaller submaps, so that short drives finish some."""
    config = Slam2dConfig()
    return replace(config, front_end=replace(config.front_end, scans_per_submap=scans))
