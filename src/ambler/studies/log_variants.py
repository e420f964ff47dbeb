"""Variants of a recorded log that should not matter to SLAM: the same way through the same place, told by another robot.

Mirrored, driven backwards in time, begun later, with scans left out, with fewer beams, with a scanner that sees less far, with other wheels, or thinned to
one scan per 0.4 to 1 m with invented stamps, as published collections of key frames have them. Or with scans that are stamped late. What is drawn is drawn from a seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.recordings.log_scans import LogScan

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

KEYFRAME_STEPS = 0.4, 1.0  # m between two key frames, drawn; turns count by METRES_PER_RADIAN
METRES_PER_RADIAN = 1.0
KEYFRAME_GAP_NS = 500_000_000  # of invented stamps
LATER = 0.1, 0.4  # share of the log that is not driven
CLIPPED = 0.5, 0.9  # quantile of the returns beyond which nothing comes back
LEAST_RANGE = 8.0  # m that every scanner sees
LAG = 0.05, 0.6  # s by which scans are stamped later than the odometry, drawn
ODOMETRY_SCALE = 0.03, 0.05  # standard deviations of the wheels' scale, of way and of rotation
ODOMETRY_BIAS = math.radians(0.5)  # rad/m, standard deviation
ODOMETRY_NOISE = 0.03, math.radians(0.5)  # per root metre of way: m and rad


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    """`scans` in the order in which they are mapped, `rows` (N,) which of the log's scans each is, `is_mirrored` whether left and right are swapped, and
    `lag` the seconds by which its scans are stamped later than those of the log."""

    scans: tuple[LogScan, ...]
    rows: I64
    is_mirrored: bool = False
    lag: float = 0.0


def as_recorded(log: Variant, _: np.random.Generator) -> Variant:
    """Change nothing."""
    return log


def keyframes(log: Variant, rng: np.random.Generator) -> Variant:
    """Keep one scan per drawn way, and invent stamps."""
    step, kept, last = rng.uniform(*KEYFRAME_STEPS), [], None
    for k, scan in enumerate(log.scans):
        pose = odometry_of(scan)
        if last is None or last.distance_to(pose) + METRES_PER_RADIAN * abs(wrap_angle(pose.yaw - last.yaw)) >= step:
            kept.append(k)
            last = pose
    first_ns = log.scans[0].stamp_ns
    scans = [_stamped(log.scans[k], first_ns + n * KEYFRAME_GAP_NS) for n, k in enumerate(kept)]
    return replace(log, scans=tuple(scans), rows=log.rows[kept])


def mirrored(log: Variant, _: np.random.Generator) -> Variant:
    """Swap left and right."""
    return replace(log, scans=tuple(_mirrored_scan(s) for s in log.scans), is_mirrored=not log.is_mirrored)


def backwards(log: Variant, _: np.random.Generator) -> Variant:
    """Let time run backwards."""
    ends = log.scans[0].stamp_ns + log.scans[-1].stamp_ns
    scans = [_stamped(s, ends - s.stamp_ns) for s in reversed(log.scans)]
    return replace(log, scans=tuple(scans), rows=log.rows[::-1].copy())


def later(log: Variant, rng: np.random.Generator) -> Variant:
    """Begin at a later scan."""
    first = int(rng.uniform(*LATER) * len(log.scans))
    return replace(log, scans=log.scans[first:], rows=log.rows[first:])


def dropped(log: Variant, rng: np.random.Generator) -> Variant:
    """Leave out every third to sixth scan."""
    every = int(rng.integers(3, 7))
    kept = np.flatnonzero(np.arange(len(log.scans)) % every != rng.integers(every))
    return replace(log, scans=tuple(log.scans[k] for k in kept), rows=log.rows[kept])


def thinned(log: Variant, rng: np.random.Generator) -> Variant:
    """Keep every second beam."""
    first = int(rng.integers(2))
    scans = [
        replace(
            s,
            ranges=np.ascontiguousarray(s.ranges[first::2]),
            beam=np.array([s.beam[0] + first * s.beam[1], 2.0 * s.beam[1], 2.0 * s.beam[2]]),
        )
        for s in log.scans
    ]
    return replace(log, scans=tuple(scans))


def clipped(log: Variant, rng: np.random.Generator) -> Variant:
    """Let nothing come back from beyond a quantile of the returns."""
    ranges = np.concatenate([s.ranges[s.ranges < s.limits[1]] for s in log.scans])
    far = max(LEAST_RANGE, float(np.quantile(ranges, rng.uniform(*CLIPPED))))
    scans = [replace(s, limits=np.minimum(s.limits, [math.inf, far, far])) for s in log.scans]
    return replace(log, scans=tuple(scans))


def other_wheels(log: Variant, rng: np.random.Generator) -> Variant:
    """Give odometry a wrong scale of way and of rotation, a drift to one side, and noise, beside what it has already."""
    way_scale, turn_scale = 1.0 + rng.normal(0.0, ODOMETRY_SCALE)
    bias = rng.normal(0.0, ODOMETRY_BIAS)
    noise = rng.normal(size=(len(log.scans), 3))
    scans, before, pose = [], odometry_of(log.scans[0]), odometry_of(log.scans[0])
    for scan, (x, y, yaw) in zip(log.scans, noise, strict=True):
        motion, before = before.inverse() @ odometry_of(scan), odometry_of(scan)
        way = math.hypot(motion.x, motion.y)
        linear, angular = (sigma * math.sqrt(way) for sigma in ODOMETRY_NOISE)
        turn = turn_scale * motion.yaw + bias * way + angular * yaw
        pose = pose @ SE2(way_scale * motion.x + linear * x, way_scale * motion.y + linear * y, turn)
        scans.append(replace(scan, odometry=((scan.stamp_ns, pose),)))
    return replace(log, scans=tuple(scans))


def late(log: Variant, rng: np.random.Generator) -> Variant:
    """Give each scan the odometry of a drawn time later: it is stamped when it is that old."""
    lag = float(rng.uniform(*LAG))
    times = np.array([s.stamp_ns for s in log.scans], np.float64)
    odometry = [odometry_of(s) for s in log.scans]
    scans = []
    for scan in log.scans:
        k = min(int(np.searchsorted(times, scan.stamp_ns + lag * 1e9)), len(times) - 1)
        share = min(1.0, (scan.stamp_ns + lag * 1e9 - times[k - 1]) / (times[k] - times[k - 1])) if k else 0.0
        told = odometry[max(0, k - 1)].interpolate(odometry[k], share)
        scans.append(replace(scan, odometry=((scan.stamp_ns, told),)))
    return replace(log, scans=tuple(scans), lag=lag)


KINDS: dict[str, Callable[[Variant, np.random.Generator], Variant]] = {
    "as_recorded": as_recorded,
    "mirrored": mirrored,
    "backwards": backwards,
    "later": later,
    "dropped": dropped,
    "thinned": thinned,
    "clipped": clipped,
    "other_wheels": other_wheels,
    "late": late,
}
OF_DENSE_LOGS = ("late",)
"""Kinds that say something only where scans follow one another closely: between key frames nobody knows what odometry would have told."""
NOTHING_DRAWN = "as_recorded", "mirrored", "backwards"


def varied(scans: Sequence[LogScan], kind: str, seed: int, *, is_keyframed: bool = False) -> Variant:
    """Return one variant of a log, each of whose scans has its own odometry; `is_keyframed` thins it to key frames first."""
    log = Variant(tuple(scans), np.arange(len(scans)))
    if is_keyframed:
        log = keyframes(log, np.random.default_rng([seed, 0]))
    return KINDS[kind](log, np.random.default_rng([seed, 1]))


def poses_of_log(log: Sequence[LogScan], variant: Variant, poses: F64) -> tuple[I64, F64]:
    """Return the log's scans between the first and the last of a variant (K,), and their poses (K, 3) by those of the variant (N, 3): scans that were left
    out are carried by the log's own odometry from the one before and the one after."""
    order = np.argsort(variant.rows)
    rows, poses = variant.rows[order], poses[order]
    if variant.is_mirrored:
        poses = poses * [1.0, -1.0, -1.0]
    every = np.arange(rows[0], rows[-1] + 1)
    out = np.empty((len(every), 3))
    for n, k in enumerate(every):
        after = min(int(np.searchsorted(rows, k)), len(rows) - 1)
        before = after if rows[after] == k else after - 1
        a, b = (SE2.from_array(poses[i]) @ _moved(log[rows[i]], log[k]) for i in (before, after))
        share = 0.0 if before == after else (k - rows[before]) / (rows[after] - rows[before])
        out[n] = a.interpolate(b, float(share)).as_array()
    return every, out


def odometry_of(scan: LogScan) -> SE2:
    """Return the odometry's pose of a scan."""
    return scan.odometry[-1][1]


def _moved(from_scan: LogScan, to_scan: LogScan) -> SE2:
    return odometry_of(from_scan).inverse() @ odometry_of(to_scan)


def _stamped(scan: LogScan, stamp_ns: int) -> LogScan:
    return replace(scan, stamp_ns=stamp_ns, odometry=((stamp_ns, odometry_of(scan)),))


def _mirrored_scan(scan: LogScan) -> LogScan:
    """Mirror a scan about the x axis of the base, whose scanner is mounted level."""
    first, step, time = scan.beam
    flip = np.array([[1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0], [1.0, 1.0, 1.0, 1.0]])
    pose = odometry_of(scan)
    return replace(
        scan,
        ranges=np.ascontiguousarray(scan.ranges[::-1]),
        beam=np.array([-(first + (len(scan.ranges) - 1) * step), step, time]),
        base_from_laser=scan.base_from_laser * flip,
        odometry=((scan.stamp_ns, SE2(pose.x, -pose.y, -pose.yaw)),),
    )
