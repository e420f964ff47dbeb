"""A world: upright solids on a floor, triangle meshes, a height field in the floor's place, in the coordinates of whoever wrote it: the
frame `world`.

A robot's map frame is its own business. `WorldSpec.seen_from` gives the same world in another frame: that of the start pose, in
which drawn maps are told, or that of a robot's own start, in which its SLAM begins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.core.se3 import Vector3
from ambler.sim.meshes import HeightField, TriangleMesh, highest_below

TERRAIN_DROP = 0.005  # metres that the floor around a terrain lies below the terrain's lowest point
STEP_ON = 0.5  # metres; a mesh that begins higher above the ground than this is a roof and not what a robot starts on


class Shape(IntEnum):
    """Kinds of solids; the numbers are those of the ray kernel."""

    BOX = 0
    CYLINDER = 1


@dataclass(frozen=True, slots=True)
class Solid:
    """An upright solid: planar pose of its centre in the frame of its world, full sizes (box) or diameters (cylinder), height range. `albedo`: 1 is
    white paint; retro-reflecting film has hundreds.

    A laser passes a box of glass unless it meets it almost squarely; bodies do not.
    """

    name: str
    shape: Shape
    world_from_solid: SE2
    size_x: float
    size_y: float
    z_min: float
    z_max: float
    albedo: float = 0.6
    is_glass: bool = False

    def corners(self) -> NDArray[np.float64]:
        """Return the four corners of a box (or of a cylinder's square) in the frame of its world, counter-clockwise, float64 (4, 2)."""
        half = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [self.size_x, self.size_y]
        return self.world_from_solid.transform(half)


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody who walks a closed way of straight legs, float points (x, y), at `speed` m/s. Who `yields` halts before robots, who does not
    walks on and into them; None: the seed decides, for half of all such people. `mass` in kg."""

    name: str
    way: tuple[tuple[float, float], ...]
    speed: float = 1.1
    radius: float = 0.25
    height: float = 1.75
    yields: bool | None = None
    mass: float = 75.0


@dataclass(frozen=True, slots=True)
class Door:
    """A sliding door: its leaf when closed, and the way (x, y) from there into the wall, where it is while open."""

    name: str
    leaf: Solid
    slide: tuple[float, float]


@dataclass(frozen=True, slots=True)
class SimMarker:
    """A printed marker on a dock's panel: `y` to the left of the dock's line and `z` above the floor, metres; hung beside that by `place` (m)
    and `turn` (roll, pitch, yaw; rad) of its own frame: x to the right and y up for who looks at it, z towards them."""

    dictionary: str
    number: int
    size: float
    y: float
    z: float
    place: Vector3 = (0.0, 0.0, 0.0)
    turn: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class SimVShape:
    """Two plates of `leg` metres at the height of safety scanners, which meet `x` metres ahead of the docked base at `angle` as seen from
    there: below pi a notch, above a wedge."""

    angle: float
    leg: float
    x: float


@dataclass(frozen=True, slots=True)
class SimReflector:
    """An upright strip of retro-reflecting film on a dock's panel: its middle `y` to the left of the dock's line, metres."""

    y: float
    width: float = 0.05


@dataclass(frozen=True, slots=True)
class SimDock:
    """A charging dock. `world_from_dock` is where the base stands when docked, x into the dock; the robot's front is then `front` metres
    ahead, the lip with the contacts just beyond it, and the panel `panel` metres ahead of the base. Markers or reflectors hang on
    the panel, a V shape stands before it. `contact`: how much deeper (m) than it should the switch of the contacts closes."""

    name: str
    world_from_dock: SE2
    front: float
    width: float
    panel: float
    markers: tuple[SimMarker, ...] = ()
    v_shape: SimVShape | None = None
    reflectors: tuple[SimReflector, ...] = ()
    contact: float = 0.0


@dataclass(frozen=True, slots=True)
class WorldSpec:
    """A world in its own frame. `start` is where a robot begins unless it is told otherwise; `ceiling` inf: none; `route`: waypoints of a
    drive that the world brings along, at `route_speed` m/s."""

    name: str
    solids: tuple[Solid, ...]
    start: SE2
    ceiling: float = math.inf
    friction: float = 0.8
    floor_albedo: float = 0.3
    people: tuple[Person, ...] = ()
    doors: tuple[Door, ...] = ()
    docks: tuple[SimDock, ...] = ()
    meshes: tuple[TriangleMesh, ...] = ()
    terrain: HeightField | None = None
    route: tuple[tuple[float, float], ...] = ()
    route_speed: float = 0.8

    @property
    def is_flat(self) -> bool:
        """Whether there is nothing but upright solids on the plane z = 0."""
        return self.terrain is None and not self.meshes

    @property
    def floor(self) -> float:
        """Height of the endless floor: 0, or with a terrain just below its lowest point."""
        return 0.0 if self.terrain is None else self.terrain.lowest - TERRAIN_DROP

    def ground_at(self, points: NDArray[np.float64], height: float = -math.inf) -> NDArray[np.float64]:
        """Return the heights of what a robot stands on at points (N, 2), its middle first, float64 (N,): floor, terrain, or meshes up to half
        a metre above the ground in its middle, or above the `height` at which it is, on an upper level. Solids do not count."""
        bare = np.full(len(points), self.floor)
        if self.terrain is not None:
            bare = np.fmax(bare, self.terrain.heights_at(points))
        if not self.meshes:
            return bare
        corners = np.concatenate([m.corners for m in self.meshes])
        limit = max(float(bare[0]), height) + STEP_ON
        middle = max(bare[0], highest_below(corners, points[:1], limit)[0])
        return np.asarray(np.maximum(bare, highest_below(corners, points, middle + STEP_ON)))

    def bounds(self) -> tuple[float, float, float, float]:
        """Return (x_min, y_min, x_max, y_max) of all solids, meshes and the terrain."""
        parts = [s.corners() for s in self.solids] + [m.vertices[:, :2] for m in self.meshes]
        if self.terrain is not None:
            parts.append(self.terrain.outline)
        if not parts:
            return (-5.0, -5.0, 5.0, 5.0)
        corners = np.concatenate(parts)
        low, high = corners.min(axis=0), corners.max(axis=0)
        return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))

    def seen_from(self, world_from_frame: SE2) -> WorldSpec:
        """Return the same world in the coordinates of another frame."""
        frame_from_world = world_from_frame.inverse()

        def moved(solid: Solid) -> Solid:
            return replace(solid, world_from_solid=frame_from_world @ solid.world_from_solid)

        return replace(
            self,
            solids=tuple(moved(s) for s in self.solids),
            start=frame_from_world @ self.start,
            people=tuple(replace(p, way=tuple(_moved_point(frame_from_world, w) for w in p.way)) for p in self.people),
            doors=tuple(
                replace(d, leaf=moved(d.leaf), slide=_moved_point(SE2(0.0, 0.0, frame_from_world.yaw), d.slide))
                for d in self.doors
            ),
            docks=tuple(replace(d, world_from_dock=frame_from_world @ d.world_from_dock) for d in self.docks),
            meshes=tuple(m.moved(frame_from_world) for m in self.meshes),
            terrain=self.terrain.moved(frame_from_world) if self.terrain is not None else None,
            route=tuple(_moved_point(frame_from_world, p) for p in self.route),
        )

    def from_start(self) -> WorldSpec:
        """Return the same world in the frame of its start: the map frame of drawn maps, and of goals in them."""
        return self.seen_from(self.start)


def _moved_point(a_from_b: SE2, point: tuple[float, float]) -> tuple[float, float]:
    moved = a_from_b @ SE2(*point, 0.0)
    return (moved.x, moved.y)
