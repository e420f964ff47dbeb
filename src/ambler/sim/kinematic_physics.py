"""The cheap mode: the base follows the wanted velocity exactly, and stops where its footprint would enter a solid.

Needs no MuJoCo. Where the ground is not flat the base lies on the plane through what is under its footprint and goes along it; it
neither slides nor tips over. Ground that rises by a step within a tick, or that is too steep, stops it like a solid. Collisions are
judged in the plane: separating axes of convex polygons, distance of a circle to a polygon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.base import Carriage, PlacedRobot, Touch
from ambler.sim.drive import Drive, after_strafe_loss, drive_of
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.surface_contact import ground_under_base, pose_on

F64 = NDArray[np.float64]
STEP = 0.02  # metres that the ground may rise or fall under the outline within a tick, beside the way gone: beyond that it is a kerb
STEEPEST = math.radians(35.0)


class FootprintCollider:
    """Finds the solids that a footprint at a pose would overlap."""

    def __init__(self, world: WorldSpec, robot: SimRobot) -> None:
        low, high = robot.body_bottom, robot.model.body_height
        self._solids = [s for s in world.solids if not world.is_flat or (s.z_min < high and s.z_max > low)]
        self._z_min, self._z_max = (np.array([getattr(s, end) for s in self._solids]) for end in ("z_min", "z_max"))
        self._low, self._high = low, high
        self._corners = [s.corners() for s in self._solids]
        self._footprint = robot.model.footprint
        self._reach = robot.model.circumscribed_radius
        lows = [c.min(axis=0) for c in self._corners] or [np.full(2, np.inf)]
        highs = [c.max(axis=0) for c in self._corners] or [np.full(2, np.inf)]
        self._least, self._most = np.array(lows), np.array(highs)

    def overlapping(self, world_from_base: SE2, height: float = 0.0) -> tuple[Solid, ...]:
        """Return the solids that the footprint overlaps at a pose, its base at a height (m)."""
        x, y = world_from_base.x, world_from_base.y
        near = np.nonzero(
            (self._least[:, 0] < x + self._reach)
            & (self._most[:, 0] > x - self._reach)
            & (self._least[:, 1] < y + self._reach)
            & (self._most[:, 1] > y - self._reach)
        )[0]
        if len(near):
            low, high = height + self._low, height + self._high
            near = near[(self._z_min[near] < high) & (self._z_max[near] > low)]
        if not len(near):
            return ()
        polygon = world_from_base.transform(self._footprint)
        return tuple(self._solids[int(k)] for k in near if self._overlaps(int(k), polygon))

    def _overlaps(self, k: int, polygon: F64) -> bool:
        solid = self._solids[k]
        if solid.shape is Shape.BOX:
            return polygons_overlap(polygon, self._corners[k])
        center = np.array([solid.world_from_solid.x, solid.world_from_solid.y])
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


@dataclass(slots=True)
class _Body:
    """One robot: where it is, what its drive has counted, what it touched in the last step."""

    placed: PlacedRobot
    collider: FootprintCollider
    drive: Drive
    pose: SE2
    travel: list[float]
    heights: F64
    carriage: SE3
    touches: list[Touch] = field(default_factory=list)

    @property
    def model(self) -> RobotModel:
        return self.placed.robot.model

    def has_height_of(self, other: _Body) -> bool:
        """Tell whether the two bodies share a height."""
        a, b = self.placed.robot, other.placed.robot
        over = self.carriage.translation[2] - other.carriage.translation[2]
        return over + a.body_bottom < b.model.body_height and b.body_bottom < over + a.model.body_height


class KinematicPhysics:
    """Robots in one world; each stands in the others' way. See `sim.base.Physics`."""

    def __init__(
        self,
        world: WorldSpec,
        robots: Sequence[PlacedRobot],
        dt: float,
        movers: Sequence[Solid] = (),
        masses: Sequence[float] = (),
    ) -> None:
        """The first of the `movers` are people of so many kg; nobody pushes anybody here, so only their number matters."""
        self._world = world
        self._bodies = []
        for placed in robots:
            drive, start, footprint = drive_of(placed.robot), placed.start, placed.robot.model.footprint
            collider = FootprintCollider(world, placed.robot)
            heights = np.zeros(1) if world.is_flat else ground_under_base(world, start, footprint)
            carriage = SE3.from_se2(start) if world.is_flat else pose_on(heights, start, footprint)
            self._bodies.append(_Body(placed, collider, drive, start, [0.0] * drive.parts, heights, carriage))
        self._movers = list(movers)
        self._people = len(masses)
        self._walked_into: list[tuple[_Body, Solid]] = []
        self._dt = dt

    def step(self, targets: Sequence[BodyVelocity]) -> None:
        """Move every robot by one step, unless something is in its way."""
        for body in self._bodies:
            body.touches.clear()
        for body, person in self._walked_into:
            body.touches.append(_touch_of(body, body.pose, person, 0.0))
        for body, target in zip(self._bodies, targets, strict=True):
            self._step(body, target)

    def _step(self, body: _Body, target: BodyVelocity) -> None:
        dt = self._dt
        for k, rate in enumerate(body.drive.rates(target)):
            body.travel[k] += rate * dt
        if target == BodyVelocity():
            return
        moved = after_strafe_loss(body.placed.robot, target)
        ahead, aside = (1.0, 1.0) if self._world.is_flat else _level_shares(body.carriage)
        new = body.pose @ SE2.exp(np.array([moved.vx * dt * ahead, moved.vy * dt * aside, moved.wz * dt]))
        speed = math.hypot(target.vx, target.vy) + abs(target.wz) * body.model.circumscribed_radius
        lies, heights, too_steep = self._on_ground(body, new, speed * dt)
        solids = body.collider.overlapping(new, lies.translation[2]) + self._overlapping_movers(body, new)
        others = self._overlapping_robots(body, new)
        if not solids and not others and too_steep is None:
            body.pose, body.carriage, body.heights = new, lies, heights
            return
        if too_steep is not None:
            body.touches.append(Touch("body", too_steep, lies.translation, speed, 0.0))
        body.touches += [_touch_of(body, new, solid, speed) for solid in solids]
        body.touches += [Touch("body", other.placed.name, (new.x, new.y, 0.0), speed, 0.0) for other in others]
        for other in others:
            if not any(touch.solid == body.placed.name for touch in other.touches):
                other.touches.append(Touch("body", body.placed.name, (new.x, new.y, 0.0), 0.0, 0.0))

    def _on_ground(self, body: _Body, pose: SE2, way: float) -> tuple[SE3, F64, str | None]:
        """Return how a base would lie at a pose that it reaches by `way` metres of its outermost point, the heights under it, and what is
        too steep for it there, if anything is."""
        world = self._world
        if world.is_flat:
            return SE3.from_se2(pose), body.heights, None
        height, footprint = body.carriage.translation[2], body.model.footprint
        heights = ground_under_base(world, pose, footprint, height)
        lies = pose_on(heights, pose, footprint)
        is_step = bool((np.abs(heights - body.heights) > way + STEP).any())
        is_steep = math.acos(min(1.0, lies.rotate((0.0, 0.0, 1.0))[2])) > STEEPEST
        name = world.terrain.name if world.terrain is not None else world.meshes[0].name
        return lies, heights, name if is_step or is_steep else None

    def move(self, places: Sequence[tuple[float, float]]) -> None:
        """Put everything that moves by itself to where it wants to be; a person whom a robot is in the way of stays, and touches it."""
        self._walked_into = []
        for k, ((x, y), solid) in enumerate(zip(places, self._movers, strict=True)):
            moved = replace(solid, world_from_solid=SE2(x, y, solid.world_from_solid.yaw))
            met = self._met_by(solid, moved) if k < self._people else []
            self._walked_into += [(body, solid) for body in met]
            if not met:
                self._movers[k] = moved

    def people(self) -> Sequence[tuple[float, float]]:
        """Where people are."""
        return [(s.world_from_solid.x, s.world_from_solid.y) for s in self._movers[: self._people]]

    def _met_by(self, person: Solid, moved: Solid) -> list[_Body]:
        """Return the robots into which a person would walk, or walk deeper."""
        radius = 0.5 * person.size_x
        here, there = (np.array([s.world_from_solid.x, s.world_from_solid.y]) for s in (person, moved))
        met = []
        for body in self._bodies:
            if math.dist(there, (body.pose.x, body.pose.y)) > body.model.circumscribed_radius + radius:
                continue
            polygon = body.pose.transform(body.model.footprint)
            is_nearer = math.dist(there, (body.pose.x, body.pose.y)) < math.dist(here, (body.pose.x, body.pose.y))
            if is_nearer and circle_overlaps(there, radius, polygon):
                met.append(body)
        return met

    def _overlapping_robots(self, body: _Body, pose: SE2) -> tuple[_Body, ...]:
        return tuple(
            other
            for other in self._bodies
            if other is not body
            and pose.distance_to(other.pose) < body.model.circumscribed_radius + other.model.circumscribed_radius
            and body.has_height_of(other)
            and polygons_overlap(pose.transform(body.model.footprint), other.pose.transform(other.model.footprint))
        )

    def _overlapping_movers(self, body: _Body, pose: SE2) -> tuple[Solid, ...]:
        polygon, reach = None, body.model.circumscribed_radius
        found = []
        for solid in self._movers:
            place = solid.world_from_solid
            if math.hypot(place.x - pose.x, place.y - pose.y) > reach + max(solid.size_x, solid.size_y):
                continue
            polygon = pose.transform(body.model.footprint) if polygon is None else polygon
            if solid.shape is Shape.BOX:
                is_hit = polygons_overlap(polygon, solid.corners())
            else:
                is_hit = circle_overlaps(np.array([place.x, place.y]), 0.5 * solid.size_x, polygon)
            if is_hit:
                found.append(solid)
        return tuple(found)

    def carriage(self, robot: int) -> Carriage:
        """Where a base is."""
        if not self._world.is_flat:
            lies = self._bodies[robot].carriage
            return Carriage(lies.translation, lies.rotation)
        pose = self._bodies[robot].pose
        half = 0.5 * pose.yaw
        return Carriage((pose.x, pose.y, 0.0), (math.cos(half), 0.0, 0.0, math.sin(half)))

    def travel(self, robot: int) -> tuple[float, ...]:
        """What its drive has counted."""
        return tuple(self._bodies[robot].travel)

    def touches(self, robot: int) -> tuple[Touch, ...]:
        """What it touched during the last step."""
        return tuple(self._bodies[robot].touches)


def _level_shares(carriage: SE3) -> tuple[float, float]:
    """The shares of a way ahead and of one sideways on tilted ground that are seen from above."""
    shares = [math.hypot(*carriage.rotate(axis)[:2]) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    return shares[0], shares[1]


def _touch_of(body: _Body, pose: SE2, solid: Solid, speed: float) -> Touch:
    """A touch with the point of the footprint at `pose` that is nearest to the middle of a cylinder; with the base's own for a box."""
    x, y = pose.x, pose.y
    if solid.shape is Shape.CYLINDER:
        polygon = pose.transform(body.model.footprint)
        center = np.array([solid.world_from_solid.x, solid.world_from_solid.y])
        x, y = nearest_on_outline(center, polygon)
    return Touch("body", solid.name, (x, y, 0.0), speed, 0.0)


def nearest_on_outline(point: F64, polygon: F64) -> tuple[float, float]:
    """Return the point of a polygon's outline (N, 2) that is nearest to a point."""
    edge, to = np.roll(polygon, -1, axis=0) - polygon, point - polygon
    along = np.clip(np.sum(edge * to, axis=1) / np.sum(edge * edge, axis=1), 0.0, 1.0)
    places = polygon + along[:, None] * edge
    x, y = places[int(np.argmin(np.hypot(*(point - places).T)))].tolist()
    return x, y
