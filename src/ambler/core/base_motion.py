"""Where was the base at t: its recent poses in the odom frame, with a constant twist in the plane between them.

Height and lean (roll and pitch of a legged body) are blended linearly; the plane is what moves fast.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import StaleInputError
from ambler.core.messages import Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3, Quaternion, quaternion_multiply

F64 = NDArray[np.float64]

LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)
SWEEP_STEP = 0.02  # seconds between two poses of a sweep: a base that turns ever faster (2.5 rad/s²) is off by 0.1 mrad in between
STILL: F64 = np.zeros(3)
STILL.flags.writeable = False


@dataclass(frozen=True, slots=True)
class MotionKnots:
    """Motion about one instant: `times` (K,) seconds after it, `poses` (K, 3) reference_from_base at them, `twists` (K, 3) of
    the base from each knot to the next (the last one continues)."""

    times: F64
    poses: F64
    twists: F64


def steady_sweep(twist: F64, seconds: float) -> F64:
    """Return the sweep (`BaseMotion.sweep`) of a base that moves with a constant twist (vx, vy, wz) in its own frame."""
    rows = [(t, SE2.exp(np.asarray(twist) * t)) for t in _sweep_times(seconds)]
    return np.array([(t, p.x, p.y, p.yaw) for t, p in rows])


def _sweep_times(seconds: float) -> list[float]:
    """Even steps from 0 to the end of a sweep, at least one."""
    steps = max(1, math.ceil(seconds / SWEEP_STEP))
    step = max(seconds, SWEEP_STEP) / steps
    return [k * step for k in range(steps + 1)]


class _Knot:
    """A pose that was told. What is asked of few of the many poses is worked out when it is asked for."""

    __slots__ = ("pose", "stamp_ns", "tilt", "told", "twist")

    def __init__(self, stamp_ns: int, told: SE3 | SE2) -> None:
        self.stamp_ns, self.told = stamp_ns, told
        self.pose: SE2 | None = told if isinstance(told, SE2) else None
        self.tilt: tuple[float, Quaternion] | None = None
        self.twist: F64 | None = None

    def planar(self) -> SE2:
        """The pose in the plane."""
        if self.pose is None:
            self.pose = self.told.to_se2() if isinstance(self.told, SE3) else self.told
        return self.pose

    def lean(self) -> tuple[float, Quaternion]:
        """Height, and the lean of the body."""
        if self.tilt is None:
            told = self.told
            self.tilt = (told.translation[2], lean_of(told)) if isinstance(told, SE3) else (0.0, LEVEL)
        return self.tilt

    def twist_to(self, after: _Knot) -> F64:
        """The constant twist that leads to the knot after this one."""
        if self.twist is None:
            seconds = (after.stamp_ns - self.stamp_ns) * 1e-9
            self.twist = (self.planar().inverse() @ after.planar()).log() / seconds
        return self.twist


class BaseMotion:
    """Keeps `span` seconds of poses; answers up to `max_extrapolation` seconds beyond the newest, where the last twist goes on."""

    def __init__(self, span: float = 2.0, max_extrapolation: float = 0.25) -> None:
        self._span_ns = round(span * 1e9)
        self._max_extrapolation_ns = round(max_extrapolation * 1e9)
        self._times: deque[int] = deque()
        self._knots: deque[_Knot] = deque()

    def add(self, odometry: Odometry) -> None:
        """Take a message of the odometry topic; see `add_pose`."""
        self.add_pose(odometry.stamp_ns, odometry.pose)

    def add_pose(self, stamp_ns: int, odom_from_base: SE3 | SE2) -> None:
        """Append a pose. A repeated stamp is ignored; a stamp that runs backwards starts a new track."""
        if self._times and stamp_ns <= self._times[-1]:
            if stamp_ns == self._times[-1]:
                return
            self.reset()
        self._times.append(stamp_ns)
        self._knots.append(_Knot(stamp_ns, odom_from_base))
        while stamp_ns - self._times[0] > self._span_ns and len(self._times) > 2:
            self._times.popleft()
            self._knots.popleft()

    def reset(self) -> None:
        """Forget everything."""
        self._times.clear()
        self._knots.clear()

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest pose, or None."""
        return self._times[-1] if self._times else None

    @property
    def oldest_ns(self) -> int | None:
        """Stamp of the oldest pose kept, or None."""
        return self._times[0] if self._times else None

    @property
    def newest(self) -> SE2 | None:
        """The newest pose, or None."""
        return self._knots[-1].planar() if self._knots else None

    def covers(self, begin_ns: int, end_ns: int) -> bool:
        """Say whether the motion is known over the whole interval."""
        times = self._times
        return bool(times) and begin_ns >= times[0] and end_ns <= times[-1] + self._max_extrapolation_ns

    def is_level(self, begin_ns: int, end_ns: int) -> bool:
        """Say whether no pose that an interval is blended from leans; True, too, where none is known."""
        first = max(0, bisect_right(self._times, begin_ns) - 1)
        return all(
            knot.lean()[1] == LEVEL for knot in islice(self._knots, first, bisect_right(self._times, end_ns) + 1)
        )

    def planar_at(self, stamp_ns: int) -> SE2:
        """Return odom_from_base in the plane at an instant; raises StaleInputError outside of what `covers` allows."""
        k = self._segment(stamp_ns)
        seconds = (stamp_ns - self._times[k]) * 1e-9
        pose = self._knots[k].planar()
        return pose if seconds == 0.0 else pose @ SE2.exp(self._twist_from(k) * seconds)

    def pose_at(self, stamp_ns: int) -> SE3:
        """Return odom_from_base with height and lean at an instant; raises StaleInputError like `planar_at`."""
        planar = self.planar_at(stamp_ns)
        k = self._segment(stamp_ns)
        (z, lean), after = self._knots[k].lean(), min(k + 1, len(self._times) - 1)
        if after > k:
            ratio = min(1.0, (stamp_ns - self._times[k]) / (self._times[after] - self._times[k]))
            next_z, next_lean = self._knots[after].lean()
            z += ratio * (next_z - z)
            lean = _blend(lean, next_lean, ratio)
        level = SE3.from_se2(planar, z)
        return level if lean == LEVEL else level @ SE3((0.0, 0.0, 0.0), lean)

    def twist_at(self, stamp_ns: int) -> F64:
        """Return the twist (vx, vy, wz) of the base at an instant, float64 (3,); raises StaleInputError like `planar_at`."""
        return self._twist_from(self._segment(stamp_ns)).copy()

    def twist_over(self, begin_ns: int, end_ns: int) -> F64:
        """Return the mean twist (vx, vy, wz) over an interval that is not empty, float64 (3,); raises StaleInputError like `planar_at`."""
        motion = self.planar_at(begin_ns).inverse() @ self.planar_at(end_ns)
        return motion.log() / ((end_ns - begin_ns) * 1e-9)

    def sweep(self, stamp_ns: int, seconds: float, otherwise: F64) -> F64:
        """Return where the base was during a sweep from an instant on, float64 (K, 4) of (s after it, x, y, yaw) in the base frame of that instant; where
        that is not known, what it moved with the twist `otherwise`."""
        times = _sweep_times(seconds)
        if not self.covers(stamp_ns, stamp_ns + round(times[-1] * 1e9)):
            return steady_sweep(otherwise, seconds)
        begin_from_odom = self.planar_at(stamp_ns).inverse()
        rows = [(t, begin_from_odom @ self.planar_at(stamp_ns + round(t * 1e9))) for t in times]
        return np.array([(t, p.x, p.y, p.yaw) for t, p in rows])

    def twist(self) -> F64:
        """Return the newest twist (vx, vy, wz) of the base, float64 (3,); zero before there are two poses."""
        return self._twist_from(len(self._knots) - 1).copy()

    def knots(self, begin_ns: int, end_ns: int, reference_ns: int) -> MotionKnots:
        """Return the knots that cover an interval, relative to an instant; raises StaleInputError when they do not."""
        first = self._segment(begin_ns)
        self._segment(end_ns)
        last = min(bisect_right(self._times, end_ns), len(self._times) - 1)
        first = max(0, min(first, last - 1))
        times = np.array(list(islice(self._times, first, last + 1)), np.int64)
        reference_from_odom = self.planar_at(reference_ns).inverse()
        between = islice(self._knots, first, last + 1)
        poses = np.array([(reference_from_odom @ knot.planar()).as_array() for knot in between])
        twists = np.array([self._twist_from(k) for k in range(first, last + 1)])
        return MotionKnots((times - reference_ns).astype(np.float64) * 1e-9, poses, twists)

    def _segment(self, stamp_ns: int) -> int:
        """Return the number of the last pose that is not after an instant."""
        if not self.covers(stamp_ns, stamp_ns):
            raise StaleInputError(self._describe_gap(stamp_ns))
        return bisect_right(self._times, stamp_ns) - 1

    def _twist_from(self, k: int) -> F64:
        """Return the twist from a knot to the next; the last one continues."""
        first = min(k, len(self._knots) - 2)
        return self._knots[first].twist_to(self._knots[first + 1]) if first >= 0 else STILL

    def _describe_gap(self, stamp_ns: int) -> str:
        if not self._times:
            return "no odometry yet"
        if stamp_ns < self._times[0]:
            return f"odometry begins {(self._times[0] - stamp_ns) * 1e-9:.3f} s after the wanted time"
        return f"odometry ends {(stamp_ns - self._times[-1]) * 1e-9:.3f} s before the wanted time"


def lean_of(pose: SE3) -> Quaternion:
    """Return the rotation that remains of a pose when its heading is taken away: `from_se2(to_se2()) @ lean` turns as the pose does."""
    w, x, y, z = pose.rotation
    if x == 0.0 and y == 0.0:
        return LEVEL
    half = 0.5 * math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return quaternion_multiply((math.cos(half), 0.0, 0.0, -math.sin(half)), pose.rotation)


def _blend(a: Quaternion, b: Quaternion, ratio: float) -> Quaternion:
    """Blend two leans, which are never far apart."""
    if a == b:
        return a
    sign = -1.0 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0.0 else 1.0
    w, x, y, z = (p + ratio * (sign * q - p) for p, q in zip(a, b, strict=True))
    n = math.sqrt(w * w + x * x + y * y + z * z)
    return (w / n, x / n, y / n, z / n)
