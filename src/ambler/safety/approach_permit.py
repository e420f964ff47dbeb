"""A permission to come near one dock: its outline, where it is, how far in, how fast, and until when.

The protective field keeps a margin from every point; a robot that docks must touch one thing. While a permit is valid, points inside the
dock's outline are left out of the field; everything else, a foot before the dock included, still stops the robot. In return
the robot is slow, and the permit bounds how far it may push in. A permit ends by itself, and nothing can make it last long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2
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
SKIN = 0.03  # metres by which noise may carry a point of the dock out of its outline


@dataclass(frozen=True, slots=True, eq=False)
class ApproachPermit:
    """`odom_from_dock`: where the base will stand. `outline` float64 (N, 2) in that frame: convex, counter-clockwise. `overrun`: how far the
    base may go beyond (m). `expires_ns`: when it ends."""

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
        self._normals, self._offsets = np.empty((0, 2)), np.empty(0)

    def permit(self, permit: ApproachPermit, odom_from_base: SE2, now_ns: int) -> tuple[bool, str]:
        """Take a permit, in place of an earlier one; a bad one is refused, with the reason, and ends the earlier one too."""
        self.revoke()
        reason = refusal(permit, odom_from_base, now_ns)
        if reason is not None:
            return False, reason
        self._permit = permit
        self._normals, self._offsets = footprint_edges(permit.outline, SKIN)
        return True, "the dock may be approached"

    def revoke(self) -> None:
        """End the permit."""
        self._permit = None

    def is_valid(self, now_ns: int) -> bool:
        """Say whether there is a permit that has not expired."""
        return self._permit is not None and now_ns < self._permit.expires_ns

    def remaining(self, points_base: F64, odom_from_base: SE2, now_ns: int) -> F64:
        """Return the points (N, 2) that still count: without those inside the dock's outline while the permit is valid."""
        permit = self._permit
        if permit is None or not self.is_valid(now_ns) or len(points_base) == 0:
            return points_base
        points = (permit.odom_from_dock.inverse() @ odom_from_base).transform(points_base)
        outside = (points @ self._normals.T - self._offsets).max(axis=1)
        return np.ascontiguousarray(points_base[outside > 0.0])

    def limited(self, velocity: BodyVelocity, odom_from_base: SE2, now_ns: int) -> BodyVelocity:
        """Return the velocity on the same arc at a permitted speed, so slow inwards that the robot can stop at the overrun."""
        permit = self._permit
        if permit is None or not self.is_valid(now_ns):
            return velocity
        speed, turn = math.hypot(velocity.vx, velocity.vy), abs(velocity.wz)
        slow = scaled(velocity, min([1.0, *(most / v for v, most in ((speed, SPEED), (turn, TURN)) if v > most)]))
        dock_from_base = permit.odom_from_dock.inverse() @ odom_from_base
        inwards = math.cos(dock_from_base.yaw) * slow.vx - math.sin(dock_from_base.yaw) * slow.vy
        if inwards <= 0.0:
            return slow
        contact = max(0.0, permit.overrun - dock_from_base.x) / inwards
        return scaled(slow, safe_scale(contact, self._reaction_time, braking_time(slow, self._limits)))
