"""Things that stand in buildings, drawn in sizes as they are sold.

What a low robot could run into crosses the planes of planar scanners (0.18 and 0.28 m), so that it can be seen; above the lowest body
(0.35 m) there are seats, table tops, shelves and wall cabinets that only a scanner of many rings sees.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ambler.sim.generator.plan import Piece, Point, turned
from ambler.sim.generator.rect import around

Rng = np.random.Generator
TOP = 0.03  # thickness of table tops, metres
SEAT = 0.46  # height of a seat


@dataclass
class Thing:
    """Something of `width` along the wall and `depth` into the room; parts about its middle, +y into the room."""

    width: float
    depth: float
    boxes: list[tuple[str, Point, tuple[float, float, float], float, float]] = field(default_factory=list)
    cylinders: list[tuple[str, Point, float, float, float]] = field(default_factory=list)

    def box(
        self, name: str, at: Point, size: tuple[float, float, float], base: float = 0.0, albedo: float = 0.5
    ) -> Thing:
        """Add a box."""
        self.boxes.append((name, at, size, base, albedo))
        return self

    def cylinder(self, name: str, at: Point, radius: float, height: float, base: float = 0.0) -> Thing:
        """Add an upright cylinder."""
        self.cylinders.append((name, at, radius, height, base))
        return self

    def size_at(self, quarter: int) -> tuple[float, float]:
        """Return its sizes along x and y after quarter turns."""
        return (self.width, self.depth) if quarter % 2 == 0 else (self.depth, self.width)

    def placed(self, center: Point, quarter: int, tilt_deg: float = 0.0) -> Piece:
        """Return it at a place, turned by quarter turns counter-clockwise and a little more."""
        width, depth = self.size_at(quarter)
        grown = abs(math.sin(math.radians(tilt_deg)))
        piece = Piece(around(center, width + grown * depth, depth + grown * width))
        c, s = math.cos(math.radians(tilt_deg)), math.sin(math.radians(tilt_deg))
        for name, (x, y), (sx, sy, sz), base, albedo in self.boxes:
            at = turned(center, (c * x - s * y, s * x + c * y), quarter)
            size = (sx, sy, sz) if quarter % 2 == 0 else (sy, sx, sz)
            piece.box(name, at, size, base=base, yaw_deg=tilt_deg, albedo=albedo)
        for name, (x, y), radius, height, base in self.cylinders:
            piece.cylinder(name, turned(center, (c * x - s * y, s * x + c * y), quarter), radius, height, base)
        return piece


def solid(name: str, width: float, depth: float, height: float, albedo: float = 0.5) -> Thing:
    """Return a plain body."""
    return Thing(width, depth).box(name, (0.0, 0.0), (width, depth, height), 0.0, albedo)


def legs(thing: Thing, name: str, width: float, depth: float, height: float, radius: float = 0.03) -> Thing:
    """Add four legs under the corners."""
    for x in (-0.5 * width + 0.06, 0.5 * width - 0.06):
        for y in (-0.5 * depth + 0.06, 0.5 * depth - 0.06):
            thing.cylinder(f"{name}_leg", (x, y), radius, height)
    return thing


def table(rng: Rng, width: float, depth: float) -> Thing:
    """A table on four legs."""
    height = float(rng.uniform(0.72, 0.76))
    thing = Thing(width, depth).box("table_top", (0.0, 0.0), (width, depth, TOP), height - TOP, 0.6)
    return legs(thing, "table", width, depth, height - TOP)


def chair(rng: Rng) -> Thing:
    """A chair: on four legs, or an upholstered one down to the floor."""
    side = float(rng.uniform(0.44, 0.52))
    thing = Thing(side, side)
    if rng.random() < 0.5:
        legs(thing, "chair", side, side, SEAT - 0.04, 0.02)
        thing.box("seat", (0.0, 0.0), (side, side, 0.04), SEAT - 0.04)
    else:
        thing.box("seat", (0.0, 0.0), (side - 0.04, side - 0.04, SEAT))
    return thing.box("backrest", (0.0, -0.5 * side + 0.03), (side, 0.05, 0.42), SEAT)


def desk(rng: Rng) -> Thing:
    """A desk with its drawers, a chair before it, sometimes a screen on it."""
    width, depth = float(rng.choice([1.2, 1.4, 1.6, 1.8])), float(rng.choice([0.7, 0.8]))
    whole = Thing(width, depth + 0.55)
    y = -0.5 * (0.55)
    whole.box("desk_top", (0.0, y), (width, depth, TOP), 0.71, 0.6)
    whole.box("desk_side", (-0.5 * width + 0.02, y), (0.04, depth, 0.71))
    side = 1.0 if rng.random() < 0.5 else -1.0
    whole.box("drawers", (side * (0.5 * width - 0.22), y), (0.42, depth - 0.1, 0.68))
    whole.box("desk_side", (0.5 * width - 0.02, y), (0.04, depth, 0.71))
    if rng.random() < 0.7:
        whole.box("screen", (0.0, y - 0.15), (0.6, 0.06, 0.42), 0.74)
    at = (-side * 0.12 * width, y + 0.5 * depth + 0.27)
    for name, (x, dy), size, base, albedo in chair(rng).boxes:
        whole.box(name, (at[0] + x, at[1] - dy), size, base, albedo)
    whole.cylinder("chair_foot", at, 0.06, SEAT)
    return whole


def island(rng: Rng) -> Thing:
    """Four or six desks back to back with a screen wall between them, and chairs on both sides."""
    seats = int(rng.integers(2, 4))
    width = 1.6 * seats
    whole = Thing(width, 2.7)
    whole.box("partition", (0.0, 0.0), (width, 0.05, float(rng.uniform(1.1, 1.4))), 0.0, 0.6)
    for k in range(seats):
        x = (k - 0.5 * (seats - 1)) * 1.6
        for side in (-1.0, 1.0):
            whole.box("desk_top", (x, side * 0.43), (1.56, 0.78, TOP), 0.71, 0.6)
            whole.box("desk_side", (x - 0.76, side * 0.43), (0.04, 0.74, 0.71))
            if rng.random() < 0.8:
                off = float(rng.uniform(-0.25, 0.25))
                whole.box("seat", (x + off, side * 1.08), (0.44, 0.44, SEAT))
                whole.box("backrest", (x + off, side * 1.27), (0.44, 0.05, 0.42), SEAT)
    for side in (-1.0, 1.0):
        whole.box("desk_side", (0.5 * width - 0.02, side * 0.43), (0.04, 0.74, 0.71))
    return whole


def cabinet(rng: Rng) -> Thing:
    """A cabinet or a bookcase."""
    width = float(rng.choice([0.8, 1.0, 1.2, 1.6, 2.0]))
    return solid("cabinet", width, float(rng.uniform(0.35, 0.5)), float(rng.choice([0.9, 1.2, 1.8, 2.0])))


def wall_cabinet(rng: Rng) -> Thing:
    """A sideboard, with cabinets on the wall above it."""
    width = float(rng.uniform(1.2, 2.4))
    thing = solid("sideboard", width, 0.45, 0.85)
    return thing.box("wall_cabinet", (0.0, -0.05), (width, 0.33, 0.6), 1.45)


def shelf(rng: Rng) -> Thing:
    """An open shelf: uprights, boards, and boxes on the lowest of them."""
    width, depth = float(rng.choice([0.9, 1.2, 1.8])), float(rng.choice([0.4, 0.5]))
    thing = Thing(width, depth)
    for x in (-0.5 * width + 0.02, 0.5 * width - 0.02):
        thing.box("upright", (x, 0.0), (0.04, depth, 2.0))
    for height in (0.4, 0.8, 1.2, 1.6):
        thing.box("board", (0.0, 0.0), (width, depth, 0.03), height)
    return thing.box("boxes", (0.0, 0.0), (width - 0.12, depth - 0.06, float(rng.uniform(0.31, 0.38))))


def counter(rng: Rng) -> Thing:
    """A counter of a kitchen or a reception."""
    return solid("counter", float(rng.uniform(1.8, 3.2)), 0.62, float(rng.choice([0.9, 1.1])), 0.7)


def fridge(rng: Rng) -> Thing:
    """A fridge."""
    return solid("fridge", 0.6, 0.65, float(rng.uniform(1.5, 2.0)), 0.8)


def sofa(rng: Rng) -> Thing:
    """A sofa with its back to the wall."""
    width = float(rng.uniform(1.6, 2.4))
    thing = solid("sofa", width, 0.9, 0.42)
    return thing.box("sofa_back", (0.0, -0.36), (width, 0.18, 0.45), 0.42)


def armchair(rng: Rng) -> Thing:
    """An armchair."""
    return solid("armchair", 0.8, 0.8, 0.42).box("sofa_back", (0.0, -0.32), (0.8, 0.16, 0.45), 0.42)


def coffee_table(rng: Rng) -> Thing:
    """A low table that reaches the floor."""
    return solid("coffee_table", float(rng.uniform(0.9, 1.2)), 0.6, 0.42)


def bed(rng: Rng, width: float | None = None) -> Thing:
    """A bed, its head at the wall."""
    wide = float(rng.choice([0.9, 1.4, 1.6, 1.8])) if width is None else width
    thing = solid("bed", wide, 2.05, float(rng.uniform(0.42, 0.55)))
    return thing.box("bed_head", (0.0, -1.0), (wide, 0.05, 0.5), 0.55)


def hospital_bed(rng: Rng) -> Thing:
    """A hospital bed: a frame on four wheels with a panel, head and foot boards, and a locker beside it."""
    thing = Thing(1.5, 2.15)
    thing.box("bed_frame", (-0.25, 0.0), (0.9, 2.05, 0.4), 0.4, 0.7)
    thing.box("bed_chassis", (-0.25, 0.0), (0.7, 1.7, 0.24), 0.12)
    for y in (-1.05, 1.05):
        thing.box("bed_board", (-0.25, y), (0.9, 0.05, 0.6), 0.4)
    for x in (-0.6, 0.1):
        for y in (-0.9, 0.9):
            thing.cylinder("bed_leg", (x, y), 0.05, 0.4)
    return thing.box("locker", (0.5, -0.8), (0.45, 0.45, 0.85))


def wardrobe(rng: Rng) -> Thing:
    """A wardrobe."""
    return solid("wardrobe", float(rng.choice([1.0, 1.5, 2.0, 2.5])), 0.6, float(rng.uniform(2.0, 2.3)))


def plant(rng: Rng) -> Thing:
    """A plant in its pot."""
    side = float(rng.uniform(0.35, 0.55))
    thing = Thing(side, side).cylinder("pot", (0.0, 0.0), 0.5 * side, float(rng.uniform(0.35, 0.5)))
    return thing.cylinder("plant", (0.0, 0.0), 0.4 * side, float(rng.uniform(0.5, 1.0)), 0.5)


def bin_of(rng: Rng) -> Thing:
    """A bin."""
    side = float(rng.uniform(0.3, 0.45))
    return Thing(side, side).cylinder("bin", (0.0, 0.0), 0.5 * side, float(rng.uniform(0.4, 0.8)))


def extinguisher(rng: Rng) -> Thing:
    """A fire box on the wall down to the floor."""
    return solid("fire_box", 0.3, 0.25, 1.1, 0.6)


def copier(rng: Rng) -> Thing:
    """A copier."""
    return solid("copier", 0.65, 0.7, 1.1, 0.7)


def basin(rng: Rng) -> Thing:
    """A washbasin on its column, a mirror cabinet over it."""
    thing = Thing(0.6, 0.5).box("basin", (0.0, 0.0), (0.6, 0.5, 0.2), 0.65, 0.8)
    thing.box("column", (0.0, -0.15), (0.22, 0.2, 0.65), 0.0, 0.8)
    return thing.box("mirror", (0.0, -0.18), (0.6, 0.12, 0.6), 1.2)


def toilet(rng: Rng) -> Thing:
    """A toilet."""
    return solid("toilet", 0.38, 0.65, 0.42, 0.8).box("cistern", (0.0, -0.22), (0.38, 0.18, 0.4), 0.42, 0.8)


def tub(rng: Rng) -> Thing:
    """A bath tub."""
    return solid("tub", 1.7, 0.75, 0.58, 0.8)


def trolley(rng: Rng) -> Thing:
    """A trolley with a box down to near the floor."""
    thing = Thing(0.9, 0.55).box("trolley", (0.0, 0.0), (0.9, 0.55, float(rng.uniform(0.75, 1.0))), 0.12, 0.6)
    for x in (-0.38, 0.38):
        for y in (-0.2, 0.2):
            thing.cylinder("trolley_leg", (x, y), 0.04, 0.12)
    return thing


def pallet(rng: Rng) -> Thing:
    """A loaded pallet; the load hangs over its edge by a little."""
    height = float(rng.choice([0.45, 0.7, 1.0, 1.3, 1.6, 1.9]))
    thing = solid("pallet", 1.2, 0.8, 0.35, 0.45)
    over = float(rng.uniform(-0.04, 0.04))
    return thing.box("load", (0.0, 0.0), (1.2 + over, 0.8 + over, height), 0.35, float(rng.uniform(0.2, 0.8)))


def pallets_stacked(rng: Rng) -> Thing:
    """A stack of empty pallets."""
    return solid("pallet_stack", 1.2, 0.8, 0.144 * int(rng.integers(4, 13)), 0.4)


def machine(rng: Rng) -> Thing:
    """A machine in its housing, a control cabinet on an arm beside it."""
    width, depth = float(rng.uniform(2.0, 5.0)), float(rng.uniform(1.5, 2.8))
    thing = solid("machine", width, depth, float(rng.uniform(1.3, 2.6)), 0.6)
    if rng.random() < 0.6:
        thing.box("control", (0.5 * width - 0.3, 0.5 * depth + 0.2), (0.5, 0.35, 1.5), 0.0)
        thing.depth = depth + 0.75
        thing.boxes = [(n, (x, y - 0.375), s, b, a) for n, (x, y), s, b, a in thing.boxes]
    return thing


def workbench(rng: Rng) -> Thing:
    """A workbench: a top on frames, tools on a board behind it, drawers below."""
    width = float(rng.choice([1.5, 2.0, 2.5]))
    thing = Thing(width, 0.8).box("bench_top", (0.0, 0.0), (width, 0.75, 0.05), 0.85, 0.6)
    thing.box("drawers", (0.3 * width, 0.0), (0.5, 0.65, 0.85)).box("tools", (0.0, -0.36), (width, 0.05, 0.7), 0.95)
    return legs(thing, "bench", width, 0.75, 0.85, 0.04)


def conveyor(rng: Rng, length: float) -> Thing:
    """A conveyor: a belt at 0.7 m on legs every 2 m, skirted at knee height."""
    thing = Thing(length, 0.9).box("belt", (0.0, 0.0), (length, 0.8, 0.2), 0.6)
    for k in range(max(2, round(length / 2.0)) + 1):
        x = -0.5 * length + 0.1 + k * (length - 0.2) / max(2, round(length / 2.0))
        for y in (-0.36, 0.36):
            thing.box("conveyor_leg", (x, y), (0.08, 0.08, 0.6))
    return thing


def container(rng: Rng) -> Thing:
    """A container of 20 feet."""
    return solid("container", 6.06, 2.44, 2.59, 0.5)


def car(rng: Rng) -> Thing:
    """A parked car: the body down to 0.15 m on its four wheels, the cabin above."""
    width, depth = float(rng.uniform(3.8, 4.9)), float(rng.uniform(1.7, 1.95))
    thing = Thing(width, depth).box("car", (0.0, 0.0), (width, depth, 0.75), 0.15, 0.4)
    thing.box("cabin", (-0.2, 0.0), (0.55 * width, depth - 0.2, 0.55), 0.9)
    for x in (-0.3 * width, 0.32 * width):
        for y in (-0.5 * depth + 0.12, 0.5 * depth - 0.12):
            thing.box("wheel", (x, y), (0.62, 0.2, 0.3))
    return thing


def truck(rng: Rng) -> Thing:
    """A trailer at its ramp, closed at the sides by its guards."""
    thing = Thing(2.5, 9.0).box("trailer", (0.0, 0.0), (2.5, 9.0, 2.7), 1.1)
    return thing.box("guards", (0.0, 0.0), (2.45, 8.6, 1.0), 0.1)


def tree(rng: Rng) -> Thing:
    """A tree: its trunk, and the crown above everybody."""
    radius = float(rng.uniform(0.1, 0.25))
    thing = Thing(1.0, 1.0).cylinder("trunk", (0.0, 0.0), radius, 3.0)
    return thing.cylinder("crown", (0.0, 0.0), float(rng.uniform(1.0, 2.2)), 3.0, 2.4)


def bollard(rng: Rng) -> Thing:
    """A bollard."""
    return Thing(0.3, 0.3).cylinder("bollard", (0.0, 0.0), 0.1, 1.0)


def lamp(rng: Rng) -> Thing:
    """A lamp post."""
    return Thing(0.4, 0.4).cylinder("lamp", (0.0, 0.0), 0.08, 4.0)


def bench(rng: Rng) -> Thing:
    """A bench of stone in the open."""
    return solid("bench", float(rng.uniform(1.5, 2.2)), 0.5, 0.45)


def column(rng: Rng, side: float) -> Thing:
    """A square column."""
    return solid("column", side, side, 6.0, 0.7)


Maker = Callable[[Rng], Thing]
