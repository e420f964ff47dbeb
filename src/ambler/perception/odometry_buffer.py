"""The recent past of the base in the odom frame, with constant-twist interpolation between its knots."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import StaleInputError
from ambler.core.messages import Odometry
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OdometryKnots:
    """Motion about one instant: `times` (K,) seconds after it, `poses` (K, 3) reference_from_base at them, `twists` (K, 3) of
    the base from each knot to the next (the last one continues)."""

    times: F64
    poses: F64
    twists: F64


class OdometryBuffer:
    """Keeps `span` seconds of odometry; answers up to `max_extrapolation` seconds beyond its newest pose."""

    def __init__(self, span: float = 2.0, max_extrapolation: float = 0.1) -> None:
        self._span_ns = round(span * 1e9)
        self._max_extrapolation_ns = round(max_extrapolation * 1e9)
        self._times: deque[int] = deque()
        self._poses: deque[SE2] = deque()
        self._twists: deque[F64] = deque()

    def add(self, odometry: Odometry) -> None:
        """Take a message of the odometry topic; see `add_pose`."""
        self.add_pose(odometry.stamp_ns, odometry.pose.to_se2())

    def add_pose(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Append a pose. A repeated stamp is ignored; a stamp that runs backwards starts a new track."""
        if self._times and stamp_ns <= self._times[-1]:
            if stamp_ns == self._times[-1]:
                return
            self.reset()
        if self._times:
            seconds = (stamp_ns - self._times[-1]) * 1e-9
            self._twists.append((self._poses[-1].inverse() @ odom_from_base).log() / seconds)
        self._times.append(stamp_ns)
        self._poses.append(odom_from_base)
        while stamp_ns - self._times[0] > self._span_ns and len(self._times) > 2:
            self._times.popleft()
            self._poses.popleft()
            self._twists.popleft()

    def reset(self) -> None:
        """Forget everything."""
        self._times.clear()
        self._poses.clear()
        self._twists.clear()

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest pose, or None."""
        return self._times[-1] if self._times else None

    @property
    def oldest_ns(self) -> int | None:
        """Stamp of the oldest pose kept, or None."""
        return self._times[0] if self._times else None

    def covers(self, begin_ns: int, end_ns: int) -> bool:
        """Say whether the motion is known over the whole interval."""
        return (
            len(self._times) >= 2
            and begin_ns >= self._times[0]
            and end_ns <= self._times[-1] + self._max_extrapolation_ns
        )

    def pose_at(self, stamp_ns: int) -> SE2:
        """Return odom_from_base at an instant; raises StaleInputError outside of what `covers` allows."""
        if not self.covers(stamp_ns, stamp_ns):
            raise StaleInputError(self._describe_gap(stamp_ns))
        k = min(max(bisect_right(self._times, stamp_ns) - 1, 0), len(self._times) - 2)
        seconds = (stamp_ns - self._times[k]) * 1e-9
        return self._poses[k] @ SE2.exp(self._twists[k] * seconds)

    def twist(self) -> F64:
        """Return the newest velocity (vx, vy, wz) of the base, float64 (3,); zero before there are two poses."""
        return self._twists[-1].copy() if self._twists else np.zeros(3)

    def knots(self, begin_ns: int, end_ns: int, reference_ns: int) -> OdometryKnots:
        """Return the knots that cover an interval, relative to an instant; raises StaleInputError when they do not."""
        for stamp_ns in (begin_ns, end_ns):
            if not self.covers(stamp_ns, stamp_ns):
                raise StaleInputError(self._describe_gap(stamp_ns))
        first = max(bisect_right(self._times, begin_ns) - 1, 0)
        last = min(bisect_right(self._times, end_ns), len(self._times) - 1)
        first = min(first, last - 1)
        times = np.array(list(islice(self._times, first, last + 1)), np.int64)
        reference_from_odom = self.pose_at(reference_ns).inverse()
        poses = np.array([(reference_from_odom @ p).as_array() for p in islice(self._poses, first, last + 1)])
        twists = list(islice(self._twists, first, last + 1))
        if len(twists) < len(times):
            twists.append(twists[-1])
        return OdometryKnots((times - reference_ns).astype(np.float64) * 1e-9, poses, np.array(twists))

    def _describe_gap(self, stamp_ns: int) -> str:
        if len(self._times) < 2:
            return "no odometry yet"
        if stamp_ns < self._times[0]:
            return f"odometry begins {(self._times[0] - stamp_ns) * 1e-9:.3f} s after the wanted time"
        return f"odometry ends {(stamp_ns - self._times[-1]) * 1e-9:.3f} s before the wanted time"
