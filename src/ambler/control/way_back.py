"""The way that a base has just come: where it fitted a moment ago it fits again, also where straight back there is no room."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2, wrap_angle

STEP, TURN = 0.04, 0.1  # metres and rad between the poses that are remembered
LENGTH = 75  # poses, 3 m
JUMP = 0.5  # metres that a base was moved while nobody looked: the way before leads nowhere
LEVER = 0.15  # metres that a radian counts
AHEAD = 0.12  # metres to the pose that is headed for
TURN_RATE = 0.5  # rad/s


class WayBack:
    """Poses of the base in the odom frame, the newest last. `add` while it drives, `target` while it goes back: what lies between the newest and where it is now is forgotten, also where it came
    there by another way."""

    def __init__(self) -> None:
        self._poses: deque[SE2] = deque(maxlen=LENGTH)

    def __len__(self) -> int:
        return len(self._poses)

    def add(self, odom_from_base: SE2) -> None:
        """Remember where the base is."""
        if self._poses:
            last = self._poses[-1]
            way = last.distance_to(odom_from_base)
            if way > JUMP:
                self._poses.clear()
            elif way < STEP and abs(wrap_angle(odom_from_base.yaw - last.yaw)) < TURN:
                return
        self._poses.append(odom_from_base)

    def target(self, odom_from_base: SE2) -> SE2 | None:
        """Return the pose to head for on the way back; None when the way has come to its beginning."""
        gaps = [_apart(pose, odom_from_base) for pose in self._poses]
        nearest = min(range(len(gaps)), key=gaps.__getitem__, default=0)
        while len(self._poses) > nearest + 1 or (self._poses and _apart(self._poses[-1], odom_from_base) < AHEAD):
            self._poses.pop()
        return self._poses[-1] if self._poses else None


def towards(odom_from_base: SE2, target: SE2, speed: float, limits: VelocityLimits, *, sideways: bool) -> BodyVelocity:
    """Return the velocity that leads a base to a pose near by: straight there where it can move `sideways`, else on an arc, or turning where the pose is no farther than that."""
    rel = odom_from_base.inverse() @ target
    way = math.hypot(rel.x, rel.y)
    time = max(way / speed, abs(rel.yaw) / TURN_RATE, 1e-3)
    if sideways:
        wanted = np.array([rel.x, rel.y, rel.yaw]) / time
    elif way < 0.5 * STEP:
        wanted = np.array([0.0, 0.0, rel.yaw / time])
    else:
        along = math.copysign(way, rel.x)
        wanted = np.array([along, 0.0, 2.0 * along * rel.y / way**2]) / time
    return _limited(wanted, limits)


def _limited(wanted: NDArray[np.float64], limits: VelocityLimits) -> BodyVelocity:
    """Slow a velocity down as a whole until no component is beyond its limit."""
    vx, vy, wz = wanted.tolist()
    most = (limits.vx_max if vx > 0.0 else -limits.vx_min, limits.vy_max, limits.wz_max)
    share = min((limit / abs(v) for v, limit in zip((vx, vy, wz), most, strict=True) if abs(v) > limit), default=1.0)
    return BodyVelocity(share * vx, share * vy, share * wz)


def _apart(a: SE2, b: SE2) -> float:
    return a.distance_to(b) + LEVER * abs(wrap_angle(a.yaw - b.yaw))
