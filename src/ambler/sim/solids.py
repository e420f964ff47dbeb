"""A world: upright solids on a floor, triangle meshes, a height field in the floor's place.

The *map frame*, in which SLAM starts and ground truth is told, has its origin at the robot's start pose: `WorldSpec` holds
every solid in that frame, so that an estimated trajectory and map can be compared with the truth without alignment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.sim.meshes import HeightField, TriangleMesh, highest_below


class Shape(IntEnum):
    """Kinds of solids; the numbers are those of the ray kernel."""

    BOX = 0
    CYLINDER = 1


TERRAIN_DROP = 0.005  # metres that the floor around a terrain lies below the terrain's lowest point
STEP_ON = 0.5  # metres; a mesh that begins higher above the ground than this is a roof and not what a robot starts on


@dataclass(frozen=True, slots=True)
class Solid:
    """An upright solid: planar pose of its centre in the map frame, full sizes (box) or diameters (cylinder), height range. `albedo`: 1 is
    white paint; retro-reflecting film has hundreds.

    A laser passes a box of glass unless it meets it almost squarely; bodies do not.
    """

    name: str
    shape: Shape
    map_from_solid: SE2
    size_x: float
    size_y: float
    z_min: float
    z_max: float
    albedo: float = 0.6
    is_glass: bool = False

    def corners(self) -> NDArray[np.float64]:
        """Return the four corners of a box (or of a cylinder's square) in the map frame, counter-clockwise, float64 (4, 2)."""
        half = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [self.size_x, self.size_y]
        return self.map_from_solid.transform(half)


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody who walks a closed way of straight legs, float points (x, y) in the map frame, at `speed` m/s."""

    name: str
    way: tuple[tuple[float, float], ...]
    speed: float = 1.1
    radius: float = 0.25
    height: float = 1.75


@dataclass(frozen=True, slots=True)
class Door:
    """A sliding door: its leaf when closed, and the way (x, y) from there into the wall, where it is while open."""

    name: str
    leaf: Solid
    slide: tuple[float, float]


@dataclass(frozen=True, slots=True)
class SimMarker:
    """A printed marker on a dock's panel: `y` to the left of the dock's line and `z` above the floor, metres."""

    dictionary: str
    number: int
    size: float
    y: float
    z: float


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
    """A charging dock. `map_from_dock` is where the base stands when docked, x into the dock; the robot's front is then `front` metres
    ahead, the lip with the contacts just beyond it, and the panel `panel` metres ahead of the base. Markers or reflectors hang on
    the panel, a V shape stands before it."""

    name: str
    map_from_dock: SE2
    front: float
    width: float
    panel: float
    markers: tuple[SimMarker, ...] = ()
    v_shape: SimVShape | None = None
    reflectors: tuple[SimReflector, ...] = ()


@dataclass(frozen=True, slots=True)
class WorldSpec:
    """A world in the map frame. `world_from_start` is the start pose in the author's coordinates; `ceiling` inf: none."""

    name: str
    solids: tuple[Solid, ...]
    world_from_start: SE2
    ceiling: float = math.inf
    friction: float = 0.8
    floor_albedo: float = 0.3
    people: tuple[Person, ...] = ()
    doors: tuple[Door, ...] = ()
    docks: tuple[SimDock, ...] = ()
    meshes: tuple[TriangleMesh, ...] = ()
    terrain: HeightField | None = None

    @property
    def is_flat(self) -> bool:
        """Whether there is nothing but upright solids on the plane z = 0."""
        return self.terrain is None and not self.meshes

    @property
    def floor(self) -> float:
        """Height of the endless floor: 0, or with a terrain just below its lowest point."""
        return 0.0 if self.terrain is None else self.terrain.lowest - TERRAIN_DROP

    def ground_at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the heights of what a robot that starts at points (N, 2), its middle first, stands on, float64 (N,): floor, terrain, or
        meshes up to half a metre above the ground in its middle. Solids do not count."""
        bare = np.full(len(points), self.floor)
        if self.terrain is not None:
            bare = np.fmax(bare, self.terrain.heights_at(points))
        if not self.meshes:
            return bare
        corners = np.concatenate([m.corners for m in self.meshes])
        middle = max(bare[0], highest_below(corners, points[:1], bare[0] + STEP_ON)[0])
        return np.asarray(np.maximum(bare, highest_below(corners, points, middle + STEP_ON)))

    def bounds(self) -> tuple[float, float, float, float]:
        """Return (x_min, y_min, x_max, y_max) of all solids, meshes and the terrain in the map frame."""
        parts = [s.corners() for s in self.solids] + [m.vertices[:, :2] for m in self.meshes]
        if self.terrain is not None:
            parts.append(self.terrain.outline)
        if not parts:
            return (-5.0, -5.0, 5.0, 5.0)
        corners = np.concatenate(parts)
        low, high = corners.min(axis=0), corners.max(axis=0)
        return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def to_map_frame(solids: list[Solid], world_from_start: SE2) -> tuple[Solid, ...]:
    """Move solids from the author's coordinates to the map frame, whose origin is the start pose."""
    start_from_world = world_from_start.inverse()
    return tuple(replace(s, map_from_solid=start_from_world @ s.map_from_solid) for s in solids)
