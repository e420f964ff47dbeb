"""Large floors: warehouses, halls of 100 m, long corridors, yards with open sides."""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np

from ambler.sim.generator import furnish as f
from ambler.sim.generator import things
from ambler.sim.generator.plan import Piece, Plan
from ambler.sim.generator.rect import Rect, drawn_widths
from ambler.sim.generator.rooms import Rng, finish, turned_at_random, walk_along
from ambler.sim.generator.zones import Building, Style, Zone

BAY = 2.7
WALL_GAP = 0.2  # metres between a row of racks and the wall, or the end of the block
PAIR_GAP = 0.2  # between the two racks of a double row


def warehouse(plan: Plan) -> None:
    """A warehouse of 450 to 1500 m²: rows of racks, a staging area with pallets, offices in a corner, columns."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(5.0, 8.0))
    plan.ceiling = plan.wall_height + 0.3
    width, depth = float(rng.uniform(26.0, 48.0)), float(rng.uniform(17.0, 30.0))
    width = min(width, 1450.0 / depth)
    outline = Rect(0.0, 0.0, width, depth)
    outer = float(rng.choice([0.15, 0.2, 0.3]))
    staging = float(rng.uniform(5.0, 9.0))
    office_size = (float(rng.uniform(5.0, 9.0)), float(rng.uniform(4.0, 6.0)))
    has_office = bool(rng.random() < 0.8)
    floor = outline
    zones = [Zone(outline, space=0)]
    if has_office:  # in the corner of the staging area
        w, d = min(office_size[0], staging - 0.3), office_size[1] + 2.0
        low, high = Rect(0.0, 0.0, w, d), Rect(0.0, d, w, depth)
        zones = [Zone(r, u) for r, u in zip(low.cut_y([1.2, 1.0]), (f.cell_office, f.storage), strict=True)]
        zones += [Zone(high, space=0), Zone(Rect(w, 0.0, width, depth), space=0)]
        floor = Rect(w, 0.0, width, depth)
    plan.set_start((staging - 1.5 if not has_office else floor.x0 + 1.6, depth - 2.0))
    Building(plan, zones, Style(0.15, outer, (1.1, 1.5), 0.5, windows=0.0)).build()
    inner = outline.inset(0.5 * outer)
    field = Rect(staging + 1.5, inner.y0, inner.x1 - float(rng.uniform(2.2, 3.5)), inner.y1)
    _rack_rows(plan, field)
    goods = Rect(inner.x0, inner.y0 + (office_size[1] + 2.5 if has_office else 0.0), staging, inner.y1)
    f.scatter(plan, goods, (things.pallet, things.pallet, things.pallets_stacked), int(rng.integers(5, 14)), 1.1, 8.0)
    for _ in range(int(rng.integers(6, 16))):
        f.against_wall(plan, inner, things.pallet(rng), gap=0.1)
    f.row_along_walls(
        plan, inner, [(things.workbench, 0.7), (things.cabinet, 0.6), (things.trolley, 0.7), (things.bin_of, 0.8)]
    )
    for _ in range(int(rng.integers(2, 7))):
        lane = (
            Rect(staging - 0.5, inner.y0, field.x0 + 0.5, inner.y1)
            if rng.random() < 0.5
            else Rect(field.x1, inner.y0, inner.x1, inner.y1)
        )
        walk_along(plan, lane)


def _rack_rows(plan: Plan, field: Rect) -> None:
    """Rows of racks along one side, double between aisles and single at the walls, spread over the field; a cross aisle in long rows."""
    rng = plan.rng
    depth, aisle = float(rng.choice([0.9, 1.1])), float(rng.uniform(2.5, 3.6))
    is_along_x = bool(rng.random() < 0.5) or field.width > 1.8 * field.depth
    length, across = (field.width, field.depth) if is_along_x else (field.depth, field.width)
    margin = 0.0 if is_along_x else float(rng.uniform(2.4, 3.2))
    bays = int((length - 2 * margin) / BAY)
    gap = int(rng.integers(3, bays - 3)) if bays > 9 else None
    has_first, has_last = (bool(b) for b in rng.random(2) < 0.7)
    low = WALL_GAP + depth if has_first else 0.0
    high = across - (WALL_GAP + depth if has_last else 0.0)
    pair = 2 * depth + PAIR_GAP
    count = int((high - low - aisle) / (pair + aisle))
    spread = (high - low - count * pair) / (count + 1)
    offsets = [low + spread + k * (pair + spread) for k in range(count)]
    rows = [o + side * (depth + PAIR_GAP) for o in offsets for side in (0, 1)]
    rows += [WALL_GAP] * has_first + [across - WALL_GAP - depth] * has_last
    for offset in rows:
        _rack_row(plan, field, offset, depth, bays, gap, is_along_x, margin)


def _rack_row(
    plan: Plan, field: Rect, offset: float, depth: float, bays: int, gap: int | None, is_along_x: bool, begin: float
) -> None:
    rng = plan.rng
    runs = [(0, bays)] if gap is None else [(0, gap), (gap + 1, bays)]
    for first, last in runs:
        count = last - first
        if count < 1:
            continue
        along = begin + first * BAY
        loads = "".join("1" if rng.random() < 0.85 else "0" for _ in range(count))
        entry = {
            "bays": loads,
            "bay": BAY,
            "depth": depth,
            "height": round(float(rng.uniform(3.5, 6.0)), 2),
            "load_height": round(float(rng.uniform(0.9, 1.4)), 2),
        }
        if is_along_x:
            corner = (field.x0 + along, field.y0 + offset)
            place = Rect(corner[0], corner[1], corner[0] + count * BAY, corner[1] + depth)
            entry |= {"corner": [round(c, 3) for c in corner]}
        else:
            corner = (field.x0 + offset + depth, field.y0 + along)
            place = Rect(corner[0] - depth, corner[1], corner[0], corner[1] + count * BAY)
            entry |= {"corner": [round(c, 3) for c in corner], "yaw_deg": 90.0}
        plan.put(Piece(place.inset(-0.05), racks=[entry]))


def hall(plan: Plan) -> None:
    """A hall of about 100 x 100 m: columns, lanes, and blocks of machines, racks, pallets, conveyors, benches, or nothing."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(6.0, 10.0))
    plan.ceiling = plan.wall_height + 0.3
    width = float(rng.uniform(92.0, 116.0))
    depth = float(rng.uniform(9600.0, 10400.0)) / width
    outline = Rect(0.0, 0.0, width, depth)
    plan.set_start((float(rng.uniform(2.5, 6.0)), float(rng.uniform(0.3, 0.7)) * depth))
    lane = float(rng.uniform(3.5, 5.0))
    Building(plan, [Zone(outline, space=0)], Style(0.2, 0.3, (1.5, 2.0), windows=0.0)).build()
    inner = outline.inset(1.5 + lane)
    for column in inner.cut_x(drawn_widths(rng, inner.width, 16.0, 28.0)):
        for block in column.cut_y(drawn_widths(rng, inner.depth, 14.0, 26.0)):
            _block(plan, block.inset(0.5 * lane))
    pitch = (float(rng.choice([10.0, 12.0, 15.0, 20.0])), float(rng.choice([10.0, 12.0, 20.0])))
    f.columns_on_grid(plan, outline, pitch, float(rng.choice([0.4, 0.5, 0.6])))
    wall_side = outline.inset(0.2)
    for _ in range(int(rng.integers(25, 60))):
        f.row_along_walls(
            plan,
            wall_side,
            [(things.pallet, 0.5), (things.workbench, 0.3), (things.cabinet, 0.4), (things.extinguisher, 0.3)],
        )
    for _ in range(int(rng.integers(6, 16))):
        y = float(rng.uniform(1.5, depth - 1.5 - lane))
        walk_along(plan, Rect(1.5, y, width - 1.5, y + lane))


def _block(plan: Plan, block: Rect) -> None:
    """Fill a block of a hall with what belongs together."""
    rng = plan.rng
    kind = rng.choice(
        ["machines", "racks", "pallets", "conveyors", "benches", "empty"], p=[0.28, 0.2, 0.18, 0.12, 0.12, 0.1]
    )
    if kind == "machines":
        f.scatter(plan, block, (things.machine,), int(block.area / 40.0), 1.6)
        f.scatter(plan, block, (things.cabinet, things.trolley, things.pallet), int(block.area / 60.0), 1.2)
    elif kind == "racks":
        _rack_rows(plan, block)
    elif kind == "pallets":
        _pallet_field(plan, block)
    elif kind == "conveyors":
        for y in np.arange(block.y0 + 1.5, block.y1 - 1.0, float(rng.uniform(3.5, 5.0))):
            thing = things.conveyor(rng, 0.8 * block.width)
            plan.put(thing.placed((block.center[0], float(y)), 0), 1.2)
        f.scatter(plan, block, (things.pallet, things.workbench), int(block.area / 50.0), 1.2)
    elif kind == "benches":
        f.scatter(
            plan, block, (things.workbench, things.shelf, things.trolley, things.cabinet), int(block.area / 14.0), 1.2
        )
    else:
        f.scatter(plan, block, (things.pallet, things.bollard), int(rng.integers(0, 4)), 1.5, 10.0)


def _pallet_field(plan: Plan, block: Rect) -> None:
    """Rows of pallets on the floor, with gaps, each a little crooked."""
    rng = plan.rng
    for x in np.arange(block.x0 + 1.0, block.x1 - 0.8, 3.4):
        for y in np.arange(block.y0 + 0.8, block.y1 - 0.6, 1.15):
            if rng.random() < 0.7:
                at = (float(x) + float(rng.normal(0.0, 0.04)), float(y) + float(rng.normal(0.0, 0.03)))
                plan.put(things.pallet(rng).placed(at, 0, float(rng.normal(0.0, 2.0))))


def corridor(plan: Plan) -> None:
    """A corridor of 70 to 150 m with bends, closed doors, niches and a few rooms."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(2.5, 3.0))
    plan.ceiling = plan.wall_height + 0.02
    across = float(rng.uniform(1.9, 3.0))
    zones: list[Zone] = []
    x, y, heading = 0.0, 0.0, 0
    legs = [float(v) for v in rng.uniform(0.6, 1.4, int(rng.integers(1, 4)))]
    total = float(rng.uniform(70.0, 150.0))
    turns = [int(t) for t in rng.choice([-1, 1], len(legs))]
    for leg, turn in zip(legs, turns, strict=True):
        length = total * leg / sum(legs)
        run = Rect(x, y, x + length, y + across) if heading == 0 else _standing(x, y, length, across, heading)
        zones.append(Zone(run, space=0))
        zones += _corridor_rooms(rng, run, heading)
        if heading == 0:
            x, y, heading = run.x1, (run.y1 if turn > 0 else run.y0), turn
            zones.append(Zone(Rect(run.x1, run.y0, run.x1 + across, run.y1), space=0))
        else:
            y = run.y1 if heading > 0 else run.y0 - across
            zones.append(Zone(Rect(run.x0, y, run.x1, y + across), space=0))
            x, heading = run.x1, 0
    zones = _without_overlaps(zones)
    style = Style(
        float(rng.choice([0.1, 0.15, 0.2])),
        float(rng.choice([0.24, 0.3])),
        (1.0, 1.2),
        0.05,
        windows=float(rng.uniform(0.0, 0.5)),
    )
    clutter = functools.partial(
        f.corridor,
        makers=(things.cabinet, things.extinguisher, things.bin_of, things.trolley, things.plant, things.bench),
        every=12.0,
        least=1.4,
    )
    finish(plan, turned_at_random(rng, zones), style, clutter, people=(0, 3))


def _standing(x: float, y: float, length: float, across: float, heading: int) -> Rect:
    return Rect(x, y, x + across, y + length) if heading > 0 else Rect(x, y - length, x + across, y)


def _corridor_rooms(rng: Rng, run: Rect, heading: int) -> list[Zone]:
    """Rooms and niches at both sides, with closed wall between them."""
    out = []
    is_level = heading == 0
    for side in (-1, 1):
        at = float(rng.uniform(4.0, 12.0))
        length = run.width if is_level else run.depth
        while at < length - 8.0:
            is_niche = rng.random() < 0.55
            wide = float(rng.uniform(0.9, 1.6)) if is_niche else float(rng.uniform(3.0, 6.5))
            deep = float(rng.uniform(0.3, 0.8)) if is_niche else float(rng.uniform(3.5, 6.0))
            if is_level:
                low = run.y1 if side > 0 else run.y0 - deep
                rect = Rect(run.x0 + at, low, run.x0 + at + wide, low + deep)
            else:
                low = run.x1 if side > 0 else run.x0 - deep
                rect = Rect(low, run.y0 + at, low + deep, run.y0 + at + wide)
            use = (f.cell_office, f.storage, f.workshop, f.meeting_room, f.kitchenette)[int(rng.integers(5))]
            out.append(Zone(rect, space=0, has_doors=False) if is_niche else Zone(rect, use))
            at += wide + float(rng.uniform(3.0, 16.0))
    return out


def _without_overlaps(zones: list[Zone]) -> list[Zone]:
    """Leave out rooms that would lie over what is there already; corridors come first."""
    out = [z for z in zones if z.space == 0 and z.has_doors]
    for zone in zones:
        if zone not in out and not any(zone.rect.inset(0.3).overlaps(z.rect) for z in out):
            out.append(zone)
    return out


def yard(plan: Plan) -> None:
    """A building beside a yard that is fenced on some sides and open on others: containers, cars, pallets, trees."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(3.0, 6.0))
    width, depth = float(rng.uniform(24.0, 44.0)), float(rng.uniform(18.0, 30.0))
    house = float(rng.uniform(6.0, 10.0))
    ground = Rect(0.0, 0.0, width, depth)
    building = Rect(0.0, depth, width * float(rng.uniform(0.5, 1.0)), depth + house)
    gate_x = building.x0 + float(rng.uniform(0.3, 0.7)) * building.width
    plan.set_start((gate_x, depth - 2.5))
    rooms = building.cut_x(drawn_widths(rng, building.width, 6.0, 14.0))
    zones = [Zone(r, (f.workshop, f.storage, f.cell_office)[int(rng.integers(3))]) for r in rooms]
    style = Style(0.2, 0.3, (1.2, 1.8), 0.4, windows=0.3)
    gates = [
        ((r.center[0], depth), float(rng.uniform(1.6, 3.0)))
        for k, r in enumerate(rooms)
        if k == 0 or rng.random() < 0.5
    ]
    Building(plan, zones, style, entrances=gates).build()
    corners = [(0.0, depth), (0.0, 0.0), (width, 0.0), (width, depth)]
    sides = list(itertools.pairwise(corners))
    if building.x1 < width - 0.5:
        sides.append(((building.x1, depth), (width, depth)))
    open_ones = {int(k) for k in rng.choice(3, int(rng.integers(1, 3)), replace=False)}
    for k, (a, b) in enumerate(sides):
        if k in open_ones:
            _bollards(plan, a, b)
        else:
            plan.wall(a, b, 0.1, height=float(rng.uniform(1.6, 2.2)))
    f.clear_lane(plan, (gate_x, depth), (gate_x, 2.0), 3.0)
    for maker, count in ((things.container, rng.integers(0, 4)), (things.car, rng.integers(1, 5))):
        f.scatter(plan, ground, (maker,), int(count), 1.5)
    f.scatter(
        plan,
        ground,
        (things.pallet, things.pallets_stacked, things.trolley, things.bin_of),
        int(rng.integers(4, 14)),
        1.1,
        12.0,
    )
    f.scatter(plan, ground, (things.tree, things.lamp, things.bench), int(rng.integers(2, 8)), 1.1)
    plan.floors.append(ground.inset(0.3))
    for _ in range(int(rng.integers(0, 4))):
        y = float(rng.uniform(1.0, depth - 4.0))
        walk_along(plan, Rect(1.0, y, width - 1.0, y + 3.0))


def _bollards(plan: Plan, a: tuple[float, float], b: tuple[float, float]) -> None:
    """Mark an open side by a few bollards, which hold nobody back."""
    length = math.dist(a, b)
    for along in np.arange(3.0, length - 2.0, float(plan.rng.uniform(4.0, 9.0))):
        s = float(along) / length
        at = (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]))
        plan.put(things.bollard(plan.rng).placed(at, 0))
