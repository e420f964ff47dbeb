"""A permission to come near one dock: its outline, where it is, how far in, how fast, and until when.

The protective field keeps a margin from every point; a robot that docks must touch one thing. While a permit holds, points inside the
dock's outline are left out of the field; everything else, a foot before the dock included, still stops the robot. In return
the robot is slow and stays in a corridor: a funnel about the dock's line, narrow at the dock, with its heading along it, no deeper
than the overrun. Outside of the corridor the permit is void. It ends by itself, by time and by the way driven; renewing it cannot
make the dock wander, nor last for ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels.footprint import footprint_edges
from ambler.safety.field import braking_time, safe_scale
from ambler.safety.limits import scaled

F64 = NDArray[np.float64]

LONGEST = 2.0  # seconds that a permit may last; whoever docks renews it
AREA_MOST = 1.5  # square metres; a larger outline would hide more than a dock
SIDE_MOST = 2.0  # metres
FARTHEST = 2.0  # metres between the robot and the docked pose
OVERRUN_MOST = 0.05
SPEED = 0.3  # m/s
TURN = 0.5  # rad/s
WAY = 0.4  # metres after which a permit ends
SIDE, FLARE = 0.05, 0.2  # metres beside the dock's line at the docked pose, and more per metre before it
ASKEW = 0.2  # rad between the heading and the dock's line
WANDER = (0.1, 0.1)  # metres and rad by which a renewed permit may move the dock
SERIES = 60.0  # seconds during which one permit may be renewed
SKIN = 0.03  # metres by which noise may carry a point of the dock out of its outline


@dataclass(frozen=True, slots=True, eq=False)
class ApproachPermit:
    """`odom_from_dock`: where the base will stand. `outline` float64 (N, 2) in that frame: convex, counter-clockwise. `overrun`: how far the
    base may go beyond (m). `expires_ns`: when it ends at the latest."""

    odom_from_dock: SE2
    outline: F64
    overrun: float
    expires_ns: int


def refusal(permit: ApproachPermit, odom_from_base: SE2, now_ns: int) -> str | None:
    """Say why a permit cannot be given; None when it can."""
    values = np.concatenate((permit.odom_from_dock.as_array(), np.ravel(permit.outline), [permit.overrun]))
    if not np.isfinite(values).all():
        return "the permit holds values that are no numbers"
    if permit.expires_ns - now_ns > LONGEST * 1e9:
        return f"a permit lasts at most {LONGEST:g} s"
    if permit.outline.ndim != 2 or permit.outline.shape[1] != 2:
        return "the outline must be points (N, 2)"
    try:
        footprint_edges(permit.outline, 0.0)
    except ValueError:
        return "the outline must be convex and counter-clockwise"
    x, y = permit.outline.T
    if float(x.min()) <= 0.0:
        return "the outline must lie before the docked robot"
    area = 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    if area > AREA_MOST or float(np.ptp(permit.outline, axis=0).max()) > SIDE_MOST:
        return "the outline is larger than a dock"
    if abs(permit.overrun) > OVERRUN_MOST:
        return f"the robot may go at most {OVERRUN_MOST:g} m beyond the docked pose"
    if odom_from_base.distance_to(permit.odom_from_dock) > FARTHEST:
        return f"the robot is more than {FARTHEST:g} m from the docked pose"
    return None


class ApproachField:
    """What a permit changes: which points count, and which velocities pass."""

    def __init__(self, limits: VelocityLimits, reaction_time: float) -> None:
        self._limits = limits
        self._reaction_time = reaction_time
        self._permit: ApproachPermit | None = None
        self._given_at = SE2()
        self._first: tuple[int, SE2] | None = None
        self._normals, self._offsets = np.empty((0, 2)), np.empty(0)

    def permit(self, permit: ApproachPermit, odom_from_base: SE2, now_ns: int) -> tuple[bool, str]:
        """Take a permit, in place of an earlier one; a bad one is refused, with the reason, and ends the earlier one too."""
        is_renewal = self._permit is not None and now_ns <= self._permit.expires_ns
        first = self._first if is_renewal else None
        self.revoke()
        reason = refusal(permit, odom_from_base, now_ns) or _refused_renewal(permit, first, now_ns)
        if reason is not None:
            return False, reason
        self._permit, self._given_at = permit, odom_from_base
        self._first = first if first is not None else (now_ns, permit.odom_from_dock)
        self._normals, self._offsets = footprint_edges(permit.outline, SKIN)
        return True, "the dock may be approached"

    def revoke(self) -> None:
        """End the permit."""
        self._permit = self._first = None

    def is_valid(self, odom_from_base: SE2, now_ns: int) -> bool:
        """Say whether a permit holds here and now: it has not expired, and the robot has not left the corridor nor driven far."""
        permit = self._permit
        if permit is None or now_ns >= permit.expires_ns or self._given_at.distance_to(odom_from_base) > WAY:
            return False
        base = permit.odom_from_dock.inverse() @ odom_from_base
        return abs(base.y) <= _half_width(base.x) and abs(wrap_angle(base.yaw)) <= ASKEW

    def remaining(self, points_base: F64, odom_from_base: SE2, now_ns: int) -> F64:
        """Return the points (N, 2) that still count: without those inside the dock's outline while the permit holds."""
        permit = self._permit
        if permit is None or len(points_base) == 0 or not self.is_valid(odom_from_base, now_ns):
            return points_base
        points = (permit.odom_from_dock.inverse() @ odom_from_base).transform(points_base)
        outside = reduce(np.maximum, (points @ self._normals.T - self._offsets).T)  # faster than along short rows
        return np.ascontiguousarray(points_base[outside > 0.0])

    def limited(self, velocity: BodyVelocity, odom_from_base: SE2, now_ns: int) -> BodyVelocity:
        """Return the velocity on the same arc at a permitted speed, so slow that the robot can stop at every side of the corridor."""
        permit = self._permit
        if permit is None or not self.is_valid(odom_from_base, now_ns):
            return velocity
        speed, turn = math.hypot(velocity.vx, velocity.vy), abs(velocity.wz)
        slow = scaled(velocity, min([1.0, *(most / v for v, most in ((speed, SPEED), (turn, TURN)) if v > most)]))
        end = time_in_corridor(permit.odom_from_dock.inverse() @ odom_from_base, slow, permit.overrun)
        return scaled(slow, safe_scale(end, self._reaction_time, braking_time(slow, self._limits)))


def time_in_corridor(dock_from_base: SE2, velocity: BodyVelocity, overrun: float) -> float:
    """Return the seconds until the base leaves the corridor, with its present velocity in the dock's frame; inf if never."""
    yaw, x = wrap_angle(dock_from_base.yaw), dock_from_base.x
    inwards = math.cos(yaw) * velocity.vx - math.sin(yaw) * velocity.vy
    left = math.sin(yaw) * velocity.vx + math.cos(yaw) * velocity.vy
    narrowing = FLARE * inwards if x < 0.0 else 0.0
    width = _half_width(x)
    sides = (
        (overrun - x, inwards),
        (width - dock_from_base.y, narrowing + left),
        (width + dock_from_base.y, narrowing - left),
        (ASKEW - yaw, velocity.wz),
        (ASKEW + yaw, -velocity.wz),
    )
    return min((max(0.0, gap) / closing for gap, closing in sides if closing > 0.0), default=math.inf)


def _half_width(x: float) -> float:
    return SIDE + FLARE * max(0.0, -x)


def _refused_renewal(permit: ApproachPermit, first: tuple[int, SE2] | None, now_ns: int) -> str | None:
    """Say why a permit cannot follow the `first` one of its series (instant, pose of the dock); None when it can."""
    if first is None:
        return None
    begun_ns, dock = first
    turn = abs(wrap_angle(permit.odom_from_dock.yaw - dock.yaw))
    if dock.distance_to(permit.odom_from_dock) > WANDER[0] or turn > WANDER[1]:
        return "the dock has wandered since it was first permitted"
    if now_ns - begun_ns > SERIES * 1e9:
        return f"a permit is renewed for at most {SERIES:g} s"
    return None
