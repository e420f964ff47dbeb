"""Campuses: streets between blocks of buildings, car parks and lawns, so that ways close loops of 0.3 to 1 km, through buildings too."""

from __future__ import annotations

import numpy as np

from ambler.sim.generator import furnish as f
from ambler.sim.generator import things
from ambler.sim.generator.plan import Plan, Point
from ambler.sim.generator.rect import Rect, drawn_widths
from ambler.sim.generator.rooms import office_rooms
from ambler.sim.generator.zones import Building, Style, Zone

STREET = (8.0, 14.0)
LANE = 2.8  # metres of a street that nothing stands in


def campus(plan: Plan) -> None:
    """Blocks of 35 to 70 m with streets between and around them; of each block a house, two houses, a car park or a lawn."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(3.0, 5.0))
    columns, rows = ((3, 2), (2, 3), (3, 3), (4, 2))[int(rng.integers(4))]
    xs = _streets(rng, columns)
    ys = _streets(rng, rows)
    grid = [[((a + b) / 2.0, (c + d) / 2.0) for c, d in ys] for a, b in xs]
    for i in range(columns + 1):
        for j in range(rows + 1):
            if i < columns:
                _way(plan, grid[i][j], grid[i + 1][j])
            if j < rows:
                _way(plan, grid[i][j], grid[i][j + 1])
    outline = Rect(xs[0][0], ys[0][0], xs[-1][1], ys[-1][1])
    plan.enclose(outline, float(rng.choice([0.15, 0.2, 0.3])))
    plan.floors.append(outline)
    corner = grid[int(rng.integers(2)) * columns][int(rng.integers(2)) * rows]
    plan.set_start(corner)
    blocks = [Rect(xs[i][1], ys[j][1], xs[i + 1][0], ys[j + 1][0]) for i in range(columns) for j in range(rows)]
    uses = _uses(rng, len(blocks))
    for k, block in enumerate(blocks):
        i, j = divmod(k, rows)
        _fill(plan, block, uses[k], (grid[i][j][1], grid[i + 1][j + 1][1]))
    for street in (
        *(Rect(a, outline.y0, b, outline.y1) for a, b in xs),
        *(Rect(outline.x0, a, outline.x1, b) for a, b in ys),
    ):
        _roadside(plan, street)
    for way in list(plan.ways[: 3 * columns]):
        if rng.random() < 0.5:
            plan.person([(x + 0.9, y + 0.9) for x, y in way], float(rng.uniform(0.9, 1.5)))


def _streets(rng: np.random.Generator, blocks: int) -> list[tuple[float, float]]:
    """Draw the streets' intervals along an axis: one before, between and after the blocks."""
    at, streets = 0.0, []
    for k in range(blocks + 1):
        width = float(rng.uniform(*STREET))
        streets.append((at, at + width))
        at += width + (float(rng.uniform(35.0, 70.0)) if k < blocks else 0.0)
    return streets


def _uses(rng: np.random.Generator, count: int) -> list[str]:
    """Draw what the blocks are used for; at least half of them hold houses with a way through."""
    uses = ["house"] * (count - count // 3)
    uses += [str(rng.choice(["cars", "lawn", "pair"])) for _ in range(count // 3)]
    return [uses[int(k)] for k in rng.permutation(count)]


def _way(plan: Plan, a: Point, b: Point) -> None:
    plan.ways.append([a, b])
    f.clear_lane(plan, a, b, LANE)


def _fill(plan: Plan, block: Rect, use: str, streets_y: tuple[float, float]) -> None:
    """Put what a block is used for; `streets_y` are the middles of the streets below and above it."""
    rng = plan.rng
    place = block.inset(float(rng.uniform(0.0, 3.0)))
    if use == "house":
        _house(plan, place, streets_y)
    elif use == "pair":
        passage = float(rng.uniform(5.0, 9.0))
        left, gap, right = place.cut_x([1.0, 2 * passage / place.width, 1.0])
        for part in (left, right):
            _closed_house(plan, part)
        plan.ways.append([(gap.center[0], streets_y[0]), (gap.center[0], streets_y[1])])
        f.clear_lane(plan, plan.ways[-1][0], plan.ways[-1][1], LANE)
        f.scatter(plan, gap, (things.bench, things.bin_of, things.tree), 5, 0.6)
    elif use == "cars":
        for y in np.arange(place.y0 + 3.0, place.y1 - 2.5, 8.0):
            for x in np.arange(place.x0 + 1.5, place.x1 - 1.5, 2.7):
                if rng.random() < 0.6:
                    plan.put(
                        things.car(rng).placed(
                            (float(x), float(y)), 1 + 2 * int(rng.integers(2)), float(rng.normal(0.0, 2.0))
                        )
                    )
        f.scatter(plan, place, (things.lamp, things.tree), 8, 0.8)
    else:
        f.scatter(plan, place, (things.tree, things.tree, things.bench), int(place.area / 60.0), 1.2)
        _hedges(plan, place)


def _hedges(plan: Plan, place: Rect) -> None:
    """Put pieces of hedge along the borders of a lawn."""
    rng = plan.rng
    for thing_y in (place.y0 + 0.4, place.y1 - 0.4):
        for x in np.arange(place.x0 + 3.0, place.x1 - 3.0, 6.0):
            if rng.random() < 0.7:
                hedge = things.solid("hedge", float(rng.uniform(3.0, 5.5)), 0.7, float(rng.uniform(0.8, 1.6)), 0.4)
                plan.put(hedge.placed((float(x), thing_y), 0), 0.3)


def _closed_house(plan: Plan, place: Rect) -> None:
    """A house that nobody enters: its walls, with pilasters, steps and bays."""
    plan.enclose(place, 0.3)
    _facade_things(plan, place)


def _house(plan: Plan, place: Rect, streets_y: tuple[float, float]) -> None:
    """A house with a corridor through it from street to street, rooms at both sides."""
    rng = plan.rng
    corridor = float(rng.uniform(2.4, 4.0))
    deep = [float(d) for d in rng.uniform(5.0, 9.0, 2)]
    middle = place.x0 + float(rng.uniform(0.3, 0.7)) * place.width
    x0, x1 = max(place.x0, middle - deep[0]), min(place.x1, middle + deep[1])
    body = Rect(x0, place.y0, x1, place.y1)
    left, hallway, right = body.cut_x([middle - 0.5 * corridor - x0, corridor, x1 - middle - 0.5 * corridor])
    zones = [Zone(hallway, space=0)]
    for row in (left, right):
        if row.width > 2.8:
            zones += office_rooms(rng, row, is_level=False)
        else:
            zones += [Zone(r, f.storage) for r in row.cut_y(drawn_widths(rng, row.depth, 3.0, 6.0))]
    entrances = [((hallway.center[0], y), min(2.4, corridor - 0.8)) for y in (place.y0, place.y1)]
    way = [(hallway.center[0], y) for y in streets_y]
    plan.ways.append(way)
    f.clear_lane(plan, way[0], way[1], min(LANE, corridor - 0.9))
    Building(plan, zones, Style(0.15, 0.35, (1.0, 1.2), 0.1, windows=0.6), entrances=entrances).build()
    f.corridor(plan, hallway.inset(0.2), (things.cabinet, things.extinguisher, things.plant, things.bin_of), 8.0, 1.6)
    for wing in (Rect(place.x0, place.y0, x0, place.y1), Rect(x1, place.y0, place.x1, place.y1)):
        if wing.width > 6.0:  # the rest of the block: another house, or a court
            if rng.random() < 0.7:
                _closed_house(
                    plan, Rect(wing.x0 + 0.6, wing.y0 + 1.0, wing.x1 - 0.6, wing.y1 - float(rng.uniform(1.0, 12.0)))
                )
            else:
                f.scatter(plan, wing.inset(0.5), (things.tree, things.bench, things.car), int(wing.area / 80.0), 1.5)
    _facade_things(plan, body)


def _facade_things(plan: Plan, place: Rect) -> None:
    """Pilasters, bins and planters along the outside of a house."""
    rng = plan.rng
    for _ in range(int((place.width + place.depth) / 6.0)):
        side = int(rng.integers(4))
        name = ("pilaster", "bin", "planter", "steps")[int(rng.integers(4))]
        size = (float(rng.uniform(0.4, 2.2)), float(rng.uniform(0.25, 0.7)), float(rng.uniform(0.6, 2.5)))
        along = float(rng.uniform(0.05, 0.95))
        thing = things.solid(name, *size)
        x, y = place.x0 + along * place.width, place.y0 + along * place.depth
        off = 0.18 + 0.5 * size[1]
        at = ((x, place.y0 - off), (place.x1 + off, y), (x, place.y1 + off), (place.x0 - off, y))[side]
        plan.put(thing.placed(at, side), 0.2)


def _roadside(plan: Plan, street: Rect) -> None:
    """Cars, trees, lamps, bins and benches along a street, outside of its lane."""
    makers = (
        things.car,
        things.car,
        things.tree,
        things.tree,
        things.lamp,
        things.bench,
        things.bin_of,
        things.bollard,
    )
    f.scatter(plan, street.inset(0.5), makers, int(street.area / 45.0), 0.4)
