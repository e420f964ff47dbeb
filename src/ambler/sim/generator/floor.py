"""Proves by a flood fill that a robot can get everywhere in a plan, and takes away furniture that is in the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.sim.generator.plan import Piece, Plan
from ambler.sim.generator.rect import Rect
from ambler.sim.solids import WorldSpec
from ambler.sim.truth import reachable_floor

RADIUS = 0.3  # metres: half the width of `spot` and 5 cm; a wider robot finds doors that it does not pass, as in real buildings
HEIGHTS = (0.05, 0.85)  # between the undersides of the robots and the top of the tallest one's scanner
LARGE = 4000.0  # square metres from which cells are coarser
LEAST_SHARE = 0.6  # of the clear cells of a room that must be reached
LEAST_AREA = 0.4  # square metres that must be reached in every room
ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Where the middle of a disc of `RADIUS` can be and can get to from the start, both bool [iy, ix]."""

    spec: GridSpec
    clear: NDArray[np.bool_]
    reached: NDArray[np.bool_]

    @property
    def area(self) -> float:
        """Square metres that the middle of the disc can reach."""
        return float(np.count_nonzero(self.reached)) * self.spec.resolution**2

    def is_reached(self, room: Rect) -> bool:
        """Tell whether a room is entered, and most of what is clear in it is reached."""
        low = self.spec.cell_of(room.x0, room.y0)
        high = self.spec.cell_of(room.x1, room.y1)
        part = slice(max(low[0], 0), high[0] + 1), slice(max(low[1], 0), high[1] + 1)
        clear, reached = int(np.count_nonzero(self.clear[part])), int(np.count_nonzero(self.reached[part]))
        return reached * self.spec.resolution**2 >= LEAST_AREA and reached >= LEAST_SHARE * clear


def floor_of(world: WorldSpec, area: float) -> Floor:
    """Return the floor of a world whose plan covers `area` square metres."""
    resolution = 0.05 if area < LARGE else 0.1
    spec, clear, reached = reachable_floor(world, RADIUS, resolution, HEIGHTS)
    return Floor(spec, clear, reached)


def unreached_rooms(plan: Plan, floor: Floor) -> list[Rect]:
    """Return the rooms that a robot cannot get into or about."""
    return [room for room in plan.floors if not floor.is_reached(room)]


def make_room(plan: Plan, rooms: list[Rect], is_last: bool) -> bool:
    """Take a part of the furniture (in the last round all of it) out of rooms; returns whether there was any."""
    keep: list[Piece] = []
    for piece in plan.pieces:
        x, y = piece.place.center
        is_there = any(room.has(x, y) for room in rooms)
        if not is_there or not (is_last or plan.rng.random() < 0.4):
            keep.append(piece)
    is_changed = len(keep) < len(plan.pieces)
    plan.pieces = keep
    return is_changed
