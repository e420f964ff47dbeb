"""Predicts the next pose: odometry and gyroscope where present, else constant velocity (Cartographer's pose extrapolator)."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle

_HISTORY_NS = 3_000_000_000
_LONGEST_NS = 600_000_000_000
_MAX_AHEAD_NS = 300_000_000
_MAX_BEFORE_NS = 100_000_000

SAME_INSTANT_NS = 1_000_000
"""Scans that lie no farther apart were taken at one instant: logs move the second of two equal stamps behind the first."""
# What odometry may tell between two of its poses: metres and m/s, rad and rad/s. More no robot moves; its zero was set anew, or a pose is wrong. Logs with
# one scan per metre and without a clock stay far below.
_LEAP_WAY = (5.0, 10.0)
_LEAP_TURN = (2.0, 6.0)
_LEAP_HEADING = (0.3, 6.0)  # of a gyroscope, which comes often


class _Track:
    """Poses over a short time, and since `needed_since_ns` for up to ten minutes, interpolated and shortly extrapolated; nothing from before a leap."""

    def __init__(self, leap_turn: tuple[float, float] = _LEAP_TURN) -> None:
        self.stamps: deque[int] = deque()
        self.poses: deque[SE2] = deque()
        self.needed_since_ns: int | None = None
        self.leaps = 0
        self._leap_turn = leap_turn

    def add(self, stamp_ns: int, pose: SE2) -> None:
        if self.stamps and stamp_ns <= self.stamps[-1]:
            return
        if self.stamps and self._is_leap(self.poses[-1], pose, (stamp_ns - self.stamps[-1]) * 1e-9):
            self.forget()
            self.leaps += 1
        self.stamps.append(stamp_ns)
        self.poses.append(pose)
        oldest_ns = stamp_ns - _HISTORY_NS
        if self.needed_since_ns is not None:
            oldest_ns = max(min(oldest_ns, self.needed_since_ns), stamp_ns - _LONGEST_NS)
        while len(self.stamps) > 2 and self.stamps[1] < oldest_ns:
            self.stamps.popleft()
            self.poses.popleft()

    def forget(self) -> None:
        """Begin anew."""
        self.stamps.clear()
        self.poses.clear()

    def at(self, stamp_ns: int) -> SE2 | None:
        """Return the pose at an instant, None when the track is empty, ended too long ago or begins later."""
        if not self.stamps or stamp_ns > self.stamps[-1] + _MAX_AHEAD_NS:
            return None
        if len(self.stamps) == 1:
            return self.poses[0] if stamp_ns >= self.stamps[0] else None
        if stamp_ns <= self.stamps[0]:
            is_near = self.leaps == 0 and stamp_ns >= self.stamps[0] - _MAX_BEFORE_NS
            return self.poses[0] if is_near or stamp_ns == self.stamps[0] else None
        k = min(bisect_right(self.stamps, stamp_ns), len(self.stamps) - 1)
        t0, t1 = self.stamps[k - 1], self.stamps[k]
        return self.poses[k - 1].interpolate(self.poses[k], (stamp_ns - t0) / (t1 - t0))

    def _is_leap(self, before: SE2, after: SE2, seconds: float) -> bool:
        """Whether no robot gets from one pose to the other in that time."""
        (way, speed), (turn, rate) = _LEAP_WAY, self._leap_turn
        turned = abs(wrap_angle(after.yaw - before.yaw))
        return before.distance_to(after) > way + speed * seconds or turned > turn + rate * seconds


@dataclass(frozen=True, slots=True)
class Prediction:
    """Where the next scan should be. `local_from_base` follows odometry when `is_measured`, else it equals `steady_pose`, which continues
    the last matched velocity; `motion` is the motion since the last scan."""

    local_from_base: SE2
    steady_pose: SE2
    motion: SE2
    is_measured: bool


class PoseExtrapolator:
    """Keeps recent odometry, gyroscope and matched poses."""

    def __init__(self) -> None:
        self._odometry = _Track()
        self._gyro = _Track(_LEAP_HEADING)
        self._matched = _Track()
        self._middles = _Track()
        self._swept: tuple[int, int, SE2] | None = None
        self._gyro_yaw = 0.0

    def add_odometry(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Take one odometry pose; stamps that do not increase are ignored. After a leap that no robot makes odometry begins anew: of the motion across it
        nothing is known, nor of headings by the same odometry."""
        leaps = self._odometry.leaps
        self._odometry.add(stamp_ns, odom_from_base)
        if self._odometry.leaps > leaps:
            self._gyro.forget()

    def add_imu(self, stamp_ns: int, wz: float) -> None:
        """Take one yaw rate (rad/s) in the base frame."""
        if self._gyro.stamps:
            dt = (stamp_ns - self._gyro.stamps[-1]) * 1e-9
            if dt <= 0.0:
                return
            self._gyro_yaw += wz * dt
        self.add_heading(stamp_ns, self._gyro_yaw)

    def add_heading(self, stamp_ns: int, yaw: float) -> None:
        """Take one heading (rad, from any zero) by a gyroscope, as odometry has it that is fused with one: it holds also where the way of
        the wheels is not believed. Instead of `add_imu`, not beside it."""
        self._gyro.add(stamp_ns, SE2(0.0, 0.0, wrap_angle(yaw)))

    def add_matched(self, stamp_ns: int, local_from_base: SE2, needed_since_ns: int | None = None) -> None:
        """Take the pose that the scan matcher found. Odometry is kept from here on, as the next scan may be long in coming, or from an earlier instant
        from which on its motion will be asked for."""
        self._matched.add(stamp_ns, local_from_base)
        self._middles.add(*self._in_the_middle(stamp_ns, local_from_base))
        since_ns = stamp_ns if needed_since_ns is None else min(stamp_ns, needed_since_ns)
        self._odometry.needed_since_ns = self._gyro.needed_since_ns = since_ns

    def odom_from_base(self, stamp_ns: int) -> SE2 | None:
        """Return the odometry at an instant, or None without recent odometry."""
        return self._odometry.at(stamp_ns)

    def predict(self, stamp_ns: int) -> Prediction:
        """Predict the pose of a scan."""
        if not self._matched.stamps:
            return Prediction(SE2(), SE2(), SE2(), is_measured=False)
        last_ns, last = self._matched.stamps[-1], self._matched.poses[-1]
        motion = self.odometry_motion(last_ns, stamp_ns)
        middle_ns, middle = self._middles.stamps[-1], self._middles.poses[-1]
        steady_pose = middle @ self._steady_motion(middle_ns, stamp_ns)
        if motion is None:
            return Prediction(steady_pose, steady_pose, last.inverse() @ steady_pose, is_measured=False)
        return Prediction(last @ motion, steady_pose, motion, is_measured=True)

    def odometry_motion(self, from_ns: int, to_ns: int) -> SE2 | None:
        """Return base(from)_from_base(to) by odometry, its rotation by the gyroscope if there is one; None without odometry,
        before its first pose and across a leap."""
        start, end = self._odometry.at(from_ns), self._odometry.at(to_ns)
        if start is None or end is None:
            return None
        return self._turned(start.inverse() @ end, from_ns, to_ns)

    def _steady_motion(self, from_ns: int, to_ns: int) -> SE2:
        """Continue the last matched motion; its duration counts at most twofold, because stamps of real devices jitter. Two scanners that look at one instant
        show none between them."""
        stamps, poses = self._middles.stamps, self._middles.poses
        motion = SE2()
        before = next((k for k in reversed(range(len(stamps))) if stamps[-1] - stamps[k] > SAME_INSTANT_NS), None)
        if before is not None:
            ratio = (to_ns - from_ns) / (stamps[-1] - stamps[before])
            if ratio < 10.0:
                motion = SE2.exp((poses[before].inverse() @ poses[-1]).log() * min(ratio, 2.0))
        return self._turned(motion, from_ns, to_ns)

    def _turned(self, motion: SE2, from_ns: int, to_ns: int) -> SE2:
        yaw0, yaw1 = self._gyro.at(from_ns), self._gyro.at(to_ns)
        if yaw0 is None or yaw1 is None or len(self._gyro.stamps) < 3:
            return motion
        return SE2(motion.x, motion.y, wrap_angle(yaw1.yaw - yaw0.yaw))

    def twist(self, stamp_ns: int, duration: float) -> NDArray[np.float64]:
        """Return the mean body twist (vx, vy, wz) from an instant on over `duration` seconds, for motion compensation."""
        span = max(duration, 0.02)
        end_ns = stamp_ns + int(span * 1e9)
        motion = self.odometry_motion(stamp_ns, end_ns)
        twist = (self._steady_motion(stamp_ns, end_ns) if motion is None else motion).log() / span
        if motion is None:
            self._swept = stamp_ns, round(0.5e9 * duration), SE2.exp(0.5 * duration * twist)
        return twist

    def _in_the_middle(self, stamp_ns: int, local_from_base: SE2) -> tuple[int, SE2]:
        """Return the middle of the sweep of a matched scan, and the pose there. A scan that was straightened with a wrong velocity fits where its middle beams are right;
        at its first beam the pose errs by the way of half a sweep, and velocities between such poses would alternate from scan to scan for ever. With odometry the pose is right all over."""
        if self._swept is None or self._swept[0] != stamp_ns:
            return stamp_ns, local_from_base
        _, half_ns, first_from_middle = self._swept
        return stamp_ns + half_ns, local_from_base @ first_from_middle
