"""The cheap mode: the base follows the wanted velocity exactly, and stops where its footprint would enter a solid.

Needs no MuJoCo. Knows a flat floor and upright solids only: worlds with terrain or meshes are refused. Collisions are judged in the plane: separating axes of convex polygons, distance of a circle to a polygon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.sim.base import Carriage, Touch
from ambler.sim.drive import after_strafe_loss, drive_of
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Shape, Solid, WorldSpec

F64 = NDArray[np.float64]


class FootprintCollider:
    """Finds the solids that a footprint at a pose would overlap."""

    def __init__(self, world: WorldSpec, robot: SimRobot) -> None:
        low, high = robot.body_bottom, robot.model.body_height
        self._solids = [s for s in world.solids if s.z_min < high and s.z_max > low]
        self._corners = [s.corners() for s in self._solids]
        self._footprint = robot.model.footprint
        self._reach = robot.model.circumscribed_radius
        lows = [c.min(axis=0) for c in self._corners] or [np.full(2, np.inf)]
        highs = [c.max(axis=0) for c in self._corners] or [np.full(2, np.inf)]
        self._low, self._high = np.array(lows), np.array(highs)

    def overlapping(self, map_from_base: SE2) -> tuple[Solid, ...]:
        """Return the solids that the footprint overlaps at a pose."""
        x, y = map_from_base.x, map_from_base.y
        near = np.nonzero(
            (self._low[:, 0] < x + self._reach)
            & (self._high[:, 0] > x - self._reach)
            & (self._low[:, 1] < y + self._reach)
            & (self._high[:, 1] > y - self._reach)
        )[0]
        if not len(near):
            return ()
        polygon = map_from_base.transform(self._footprint)
        return tuple(self._solids[int(k)] for k in near if self._overlaps(int(k), polygon))

    def _overlaps(self, k: int, polygon: F64) -> bool:
        solid = self._solids[k]
        if solid.shape is Shape.BOX:
            return polygons_overlap(polygon, self._corners[k])
        center = np.array([solid.map_from_solid.x, solid.map_from_solid.y])
        return circle_overlaps(center, 0.5 * solid.size_x, polygon)


def polygons_overlap(a: F64, b: F64) -> bool:
    """Tell whether two convex polygons (N, 2) overlap: no edge normal separates them."""
    edges = np.concatenate([np.roll(a, -1, axis=0) - a, np.roll(b, -1, axis=0) - b])
    normals = np.stack([-edges[:, 1], edges[:, 0]])
    pa, pb = a @ normals, b @ normals
    return bool(np.all((pa.max(axis=0) > pb.min(axis=0)) & (pb.max(axis=0) > pa.min(axis=0))))


def circle_overlaps(center: F64, radius: float, polygon: F64) -> bool:
    """Tell whether a circle overlaps a convex, counter-clockwise polygon (N, 2)."""
    edge, to = np.roll(polygon, -1, axis=0) - polygon, center - polygon
    if np.all(edge[:, 0] * to[:, 1] - edge[:, 1] * to[:, 0] >= 0):
        return True
    along = np.clip(np.sum(edge * to, axis=1) / np.sum(edge * edge, axis=1), 0.0, 1.0)
    gap = to - along[:, None] * edge
    return bool(np.min(np.hypot(gap[:, 0], gap[:, 1])) < radius)


class KinematicPhysics:
    """One robot in one world, in the map frame, starting at the origin; see `sim.base.Physics`."""

    def __init__(self, world: WorldSpec, robot: SimRobot, dt: float, movers: Sequence[Solid] = ()) -> None:
        if not world.is_flat:
            raise BadInputError(
                f"world {world.name}: terrain and meshes need contact physics, kinematic physics is for flat floors"
            )
        self._robot = robot
        self._collider = FootprintCollider(world, robot)
        self._movers = tuple(movers)
        self._dt = dt
        self._pose = SE2()
        self._drive = drive_of(robot)
        self._travel = [0.0] * self._drive.parts
        self._touches: tuple[Touch, ...] = ()

    def step(self, target: BodyVelocity) -> None:
        """Move by one step, unless a solid is in the way."""
        dt = self._dt
        self._count(target)
        self._touches = ()
        if target == BodyVelocity():
            return
        moved = after_strafe_loss(self._robot, target)
        new = self._pose @ SE2.exp(np.array([moved.vx * dt, moved.vy * dt, moved.wz * dt]))
        hit = self._collider.overlapping(new) + self._overlapping_movers(new)
        if not hit:
            self._pose = new
            return
        speed = math.hypot(target.vx, target.vy) + abs(target.wz) * self._robot.model.circumscribed_radius
        self._touches = tuple(Touch("body", s.name, (new.x, new.y, 0.0), speed, 0.0) for s in hit)

    def move(self, movers: Sequence[Solid]) -> None:
        """Put everything that moves by itself to where it is now; somebody who walks into the robot touches it."""
        self._movers = tuple(movers)

    def _overlapping_movers(self, pose: SE2) -> tuple[Solid, ...]:
        polygon, reach = None, self._robot.model.circumscribed_radius
        found = []
        for solid in self._movers:
            place = solid.map_from_solid
            if math.hypot(place.x - pose.x, place.y - pose.y) > reach + max(solid.size_x, solid.size_y):
                continue
            polygon = pose.transform(self._robot.model.footprint) if polygon is None else polygon
            if solid.shape is Shape.BOX:
                is_hit = polygons_overlap(polygon, solid.corners())
            else:
                is_hit = circle_overlaps(np.array([place.x, place.y]), 0.5 * solid.size_x, polygon)
            if is_hit:
                found.append(solid)
        return tuple(found)

    @property
    def carriage(self) -> Carriage:
        half = 0.5 * self._pose.yaw
        return Carriage((self._pose.x, self._pose.y, 0.0), (math.cos(half), 0.0, 0.0, math.sin(half)))

    @property
    def travel(self) -> tuple[float, ...]:
        return tuple(self._travel)

    def touches(self) -> tuple[Touch, ...]:
        return self._touches

    def _count(self, velocity: BodyVelocity) -> None:
        for k, rate in enumerate(self._drive.rates(velocity)):
            self._travel[k] += rate * self._dt
