"""Draws a place: a kind and a seed become the content of a world file whose floor a robot can reach."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.core.errors import BadInputError
from ambler.sim.generator import grounds, rooms, stores
from ambler.sim.generator.another_day import day_generator, move_furniture
from ambler.sim.generator.content import content_of
from ambler.sim.generator.floor import ROUNDS, Floor, floor_of, make_room, unreached_rooms
from ambler.sim.generator.plan import Plan, Point
from ambler.sim.generator.spatial import SPATIAL_KINDS
from ambler.sim.generator.spatial_floor import spatial_floor
from ambler.sim.solids import WorldSpec
from ambler.sim.world_file import world_from_content

KINDS: dict[str, Callable[[Plan], None]] = {
    "office": rooms.office,
    "flat": rooms.flat,
    "ward": rooms.ward,
    "warehouse": stores.warehouse,
    "hall": stores.hall,
    "corridor": stores.corridor,
    "yard": stores.yard,
    "campus": grounds.campus,
}
ATTEMPTS = 20
SEEDS_BELOW = 2**31
MOVED = 0.2  # share of the furniture that stands elsewhere on another day
_NAME = re.compile(rf"({'|'.join((*KINDS, *SPATIAL_KINDS))})-(\d+)(?:-day(\d+))?")


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPlace:
    """A place: `content` as a world file holds it, the world, its floor, and `ways` (polylines, metres) along which a robot can drive where
    the kind has such (campuses: streets and ways through houses; places with three dimensions: their route). `day` 0 is the place as it was drawn; on each other one `moved` pieces of
    its furniture stand elsewhere."""

    kind: str
    seed: int
    content: dict[str, Any]
    world: WorldSpec
    floor: Floor
    ways: tuple[tuple[Point, ...], ...]
    day: int = 0
    moved: int = 0

    @property
    def name(self) -> str:
        """Its name as a world: `kind-seed`, or `kind-seed-dayN`."""
        return f"{self.kind}-{self.seed}" + (f"-day{self.day}" if self.day else "")


def draw_place(kind: str, seed: int, day: int = 0) -> DrawnPlace:
    """Draw a place as it stands on a day; the same for the same arguments. Raises BadInputError for kinds and seeds that are none."""
    if kind not in KINDS and kind not in SPATIAL_KINDS:
        raise BadInputError(f"no kind of place {kind!r}; there are {', '.join((*KINDS, *SPATIAL_KINDS))}")
    if not 0 <= seed < SEEDS_BELOW:
        raise BadInputError(f"seed {seed}: a whole number from 0 on, below {SEEDS_BELOW}")
    if not 0 <= day < SEEDS_BELOW:
        raise BadInputError(f"day {day}: a whole number from 0 on, below {SEEDS_BELOW}")
    if kind in SPATIAL_KINDS:
        if day:
            raise BadInputError(f"day {day}: a {kind} has no furniture that stands elsewhere on another day")
        return _spatial(kind, seed)
    for attempt in range(ATTEMPTS):
        place = _drawn(kind, seed, attempt, day)
        if place is not None:
            return place
    raise BadInputError(f"{kind}-{seed}: no valid plan in {ATTEMPTS} attempts")


def is_spatial(kind: str) -> bool:
    """Tell whether places of a kind have three dimensions."""
    return kind in SPATIAL_KINDS


def _spatial(kind: str, seed: int) -> DrawnPlace:
    """Draw a place with three dimensions; its way is its route."""
    content = content_of(SPATIAL_KINDS[kind](seed))
    world = world_from_content(Path(f"{kind}-{seed}"), content)
    return DrawnPlace(kind, seed, content, world, spatial_floor(world), (world.route,))


def parse_name(name: str) -> tuple[str, int, int] | None:
    """Return (kind, seed, day) of a name such as `office-17` or `office-17-day2`, None for other names."""
    found = _NAME.fullmatch(name)
    return None if found is None else (found[1], int(found[2]), int(found[3] or 0))


def _drawn(kind: str, seed: int, attempt: int, day: int) -> DrawnPlace | None:
    """Draw once; None where rooms remain that cannot be reached though they are empty."""
    plan = Plan(np.random.Generator(np.random.SFC64([zlib.crc32(kind.encode()), seed, attempt])))
    KINDS[kind](plan)
    plan.start["yaw_deg"] = round(float(plan.rng.uniform(-180.0, 180.0)), 1)  # walls lie aslant of most robots' maps
    for k in range(ROUNDS + 1):
        place = _place(kind, seed, plan)
        missing = unreached_rooms(plan, place.floor)
        if not missing:
            return _on_day(place, plan, day) if day else place
        if not make_room(plan, missing, is_last=k == ROUNDS - 1):
            return None
    return None


def _on_day(place: DrawnPlace, plan: Plan, day: int) -> DrawnPlace:
    """Return the place with a share of its furniture elsewhere, so that every room can still be reached: draw after draw with fewer pieces."""
    rng, pieces, share = day_generator(place.kind, place.seed, day), list(plan.pieces), MOVED
    for _ in range(ATTEMPTS):
        plan.pieces = list(pieces)
        moved = move_furniture(plan, share, rng)
        later = _place(place.kind, place.seed, plan)
        if not unreached_rooms(plan, later.floor):
            return replace(later, day=day, moved=len(moved))
        share *= 0.9
    return replace(place, day=day)


def _place(kind: str, seed: int, plan: Plan) -> DrawnPlace:
    content = plan.content()
    world = world_from_content(Path(f"{kind}-{seed}"), content)
    x0, y0, x1, y1 = world.bounds()
    floor = floor_of(world, (x1 - x0) * (y1 - y0))
    return DrawnPlace(kind, seed, content, world, floor, tuple(tuple(way) for way in plan.ways))
