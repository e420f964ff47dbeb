"""Floors of rooms along corridors: offices, flats and wards."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from ambler.sim.generator import furnish as f
from ambler.sim.generator import things
from ambler.sim.generator.plan import Plan
from ambler.sim.generator.rect import Rect, drawn_widths
from ambler.sim.generator.zones import Building, Style, Zone

Rng = np.random.Generator
WALKS_TRIED = 3  # ways that are drawn for each person, until one is free
OFFICE_CLUTTER = (things.cabinet, things.plant, things.bin_of, things.copier, things.extinguisher, things.shelf)


def office(plan: Plan) -> None:
    """An office floor of 250 to 1400 m²: one or two corridors, a ring, an open plan, or two wings."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(2.5, 3.2))
    plan.ceiling = plan.wall_height + 0.02
    style = Style(
        inner=float(rng.choice([0.08, 0.1, 0.125, 0.15, 0.2])),
        outer=float(rng.choice([0.24, 0.3, 0.365])),
        door=(0.75, 1.1),
        extra_doors=float(rng.uniform(0.05, 0.3)),
        windows=float(rng.uniform(0.2, 0.9)),
        glass_fronts=float(rng.choice([0.0, 0.0, 0.5])),
    )
    layout = (spine, ring, open_plan, wings)[int(rng.integers(4))]
    zones = turned_at_random(rng, layout(rng))
    finish(plan, zones, style, functools.partial(f.corridor, makers=OFFICE_CLUTTER, every=9.0), people=(0, 3))


def spine(rng: Rng) -> list[Zone]:
    """Rooms on both sides of a corridor, often with a lobby between them."""
    width, corridor = float(rng.uniform(18.0, 42.0)), float(rng.uniform(1.75, 2.6))
    south, north = (float(d) for d in rng.uniform(4.2, 6.8, 2))
    outline = Rect(0.0, 0.0, width, south + corridor + north)
    below, middle, above = outline.cut_y([south, corridor, north])
    zones = [Zone(middle, space=0)]
    for row in (below, above):
        zones += office_rooms(rng, row, lobby=rng.random() < 0.5)
    return zones


def ring(rng: Rng) -> list[Zone]:
    """A corridor around a core of toilets, stores and meeting rooms."""
    width, corridor = float(rng.uniform(22.0, 40.0)), float(rng.uniform(1.75, 2.5))
    south, core, north = float(rng.uniform(4.2, 6.0)), float(rng.uniform(4.0, 7.0)), float(rng.uniform(4.2, 6.0))
    rows = Rect(0.0, 0.0, width, south + north + core + 2 * corridor).cut_y([south, corridor, core, corridor, north])
    zones = [Zone(rows[1], space=0), Zone(rows[3], space=0)]
    ends = [float(rng.choice([0.0, rng.uniform(3.0, 5.0)])) for _ in range(2)]
    cross = int(width > 30.0 and rng.random() < 0.6)
    parts = [ends[0], corridor, *([10.0, corridor] * cross), 10.0, corridor, ends[1]]
    fixed = sum(p for k, p in enumerate(parts) if k % 2 or k in (0, len(parts) - 1))
    share = (width - fixed) / (1 + cross)
    x = 0.0
    for k, part in enumerate(parts):
        size = part if k % 2 or k in (0, len(parts) - 1) else share
        piece = Rect(x, rows[2].y0, x + size, rows[2].y1)
        x += size
        if size < 0.1:
            continue
        if k % 2:
            zones.append(Zone(piece, space=0))
        elif k in (0, len(parts) - 1):
            zones.append(Zone(piece, f.cell_office))
        else:
            zones += core_rooms(rng, piece)
    return zones + office_rooms(rng, rows[0]) + office_rooms(rng, rows[4])


def open_plan(rng: Rng) -> list[Zone]:
    """A large open office with rooms along one or two of its sides."""
    width, depth = float(rng.uniform(20.0, 36.0)), float(rng.uniform(9.0, 16.0))
    rooms, other = float(rng.uniform(3.8, 5.5)), float(rng.choice([0.0, rng.uniform(3.8, 5.0)]))
    outline = Rect(0.0, 0.0, width, rooms + depth + other)
    rows = outline.cut_y([rooms, depth, other] if other else [rooms, depth])
    zones = [Zone(rows[1], f.open_office, space=0)]
    for row in (rows[0], *rows[2:]):
        zones += office_rooms(rng, row, lobby=rng.random() < 0.5)
    return zones


def wings(rng: Rng) -> list[Zone]:
    """Two wings at a right angle, whose corridors meet."""
    width, corridor = float(rng.uniform(22.0, 34.0)), float(rng.uniform(1.75, 2.5))
    south, north = (float(d) for d in rng.uniform(4.2, 6.0, 2))
    below, middle, above = Rect(0.0, 0.0, width, south + corridor + north).cut_y([south, corridor, north])
    left, right = (float(d) for d in rng.uniform(4.0, 5.5, 2))
    x = width - right - corridor
    top = above.y1 + float(rng.uniform(10.0, 18.0))
    zones = [Zone(middle, space=0), Zone(Rect(x, above.y0, x + corridor, top), space=0)]
    zones += office_rooms(rng, below, lobby=True)
    zones += office_rooms(rng, Rect(0.0, above.y0, x - left, above.y1))
    zones += office_rooms(rng, Rect(x - left, above.y0, x, top), is_level=False)
    zones += office_rooms(rng, Rect(x + corridor, above.y0, width, top), is_level=False)
    return zones


def office_rooms(rng: Rng, row: Rect, *, lobby: bool = False, is_level: bool = True) -> list[Zone]:
    """Divide a row into rooms, each with a purpose that fits its size; a lobby is a part of the corridor."""
    length = row.width if is_level else row.depth
    widths = drawn_widths(rng, length, 2.8, float(rng.choice([4.2, 6.0, 8.0])))
    rects = row.cut_x(widths) if is_level else row.cut_y(widths)
    open_one = int(rng.integers(len(rects))) if lobby and len(rects) > 2 else -1
    return [Zone(r, f.lobby, space=0) if k == open_one else _office_room(rng, r) for k, r in enumerate(rects)]


def _office_room(rng: Rng, rect: Rect) -> Zone:
    luck = rng.random()
    if rect.area > 22.0 and luck < 0.5:
        return Zone(rect, f.meeting_room, may_have_glass=True)
    if rect.area > 40.0:
        return Zone(rect, f.open_office)
    if luck < 0.68:
        return Zone(rect, f.cell_office, may_have_glass=luck < 0.2)
    return Zone(rect, (f.storage, f.kitchenette, f.toilets, f.cell_office)[int(rng.integers(4))])


def core_rooms(rng: Rng, rect: Rect) -> list[Zone]:
    """Toilets, stores and kitchens of a core."""
    makers = (f.toilets, f.storage, f.kitchenette, f.meeting_room, f.storage)
    return [
        Zone(r, makers[int(rng.integers(len(makers)))]) for r in rect.cut_x(drawn_widths(rng, rect.width, 3.0, 6.0))
    ]


def flat(plan: Plan) -> None:
    """A flat of 60 to 170 m²: a hall, a living room, bedrooms, kitchen and bath."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(2.4, 2.9))
    plan.ceiling = plan.wall_height + 0.02
    style = Style(
        inner=float(rng.choice([0.1, 0.115, 0.15, 0.175])),
        outer=float(rng.choice([0.3, 0.365, 0.42])),
        door=(0.7, 0.95),
        extra_doors=float(rng.uniform(0.05, 0.35)),
        windows=float(rng.uniform(0.4, 0.9)),
    )
    hall = float(rng.uniform(1.75, 2.3))
    south, north = (float(d) for d in rng.uniform(3.3, 4.8, 2))
    length = float(rng.uniform(5.5, 14.0))
    living = float(rng.uniform(4.2, 6.5))
    below, middle, above = Rect(0.0, 0.0, length, south + hall + north).cut_y([south, hall, north])
    end = Rect(length, 0.0, length + living, above.y1)
    zones = [Zone(middle, f.hallway, space=0)]
    if rng.random() < 0.5:
        low, high = end.cut_y([south + hall, north] if rng.random() < 0.5 else [south, hall + north])
        zones += [Zone(max(low, high, key=lambda r: r.area), f.living_room)]
        zones += [Zone(min(low, high, key=lambda r: r.area), f.kitchen)]
        rest = [f.bathroom, f.bedroom, f.bedroom, f.cell_office, f.bedroom]
    else:
        zones.append(Zone(end, f.living_room, space=0 if rng.random() < 0.4 else None))
        rest = [f.kitchen, f.bathroom, f.bedroom, f.bedroom, f.cell_office]
    rects = [*below.cut_x(drawn_widths(rng, length, 2.4, 4.4)), *above.cut_x(drawn_widths(rng, length, 2.4, 4.4))]
    order = sorted(range(len(rects)), key=lambda k: rects[k].area)
    small, large = order[0], order[1:]
    zones.append(Zone(rects[small], f.bathroom))
    uses = [use for use in rest if use is not f.bathroom] + [f.storage, f.bedroom, f.bedroom, f.cell_office]
    zones += [Zone(rects[k], use) for k, use in zip(reversed(large), uses, strict=False)]
    finish(plan, turned_at_random(rng, zones), style, None, people=(0, 1))


def ward(plan: Plan) -> None:
    """A ward of 400 to 1300 m²: patient rooms with bathrooms on one or two wide corridors, a station, stores, things parked in the way."""
    rng = plan.rng
    plan.wall_height = float(rng.uniform(2.6, 3.0))
    plan.ceiling = plan.wall_height + 0.02
    style = Style(
        inner=float(rng.choice([0.125, 0.15, 0.2])),
        outer=float(rng.choice([0.3, 0.365, 0.42])),
        door=(0.9, 1.3),
        extra_doors=0.03,
        windows=float(rng.uniform(0.5, 0.95)),
    )
    width, corridor = float(rng.uniform(26.0, 48.0)), float(rng.uniform(2.2, 3.0))
    depths = [float(d) for d in rng.uniform(5.8, 7.2, 2)]
    if rng.random() < 0.6:
        below, middle, above = Rect(0.0, 0.0, width, sum(depths) + corridor).cut_y([depths[0], corridor, depths[1]])
        zones = [Zone(middle, space=0)]
    else:
        core = float(rng.uniform(4.0, 5.5))
        rows = Rect(0.0, 0.0, width, sum(depths) + 2 * corridor + core).cut_y(
            [depths[0], corridor, core, corridor, depths[1]]
        )
        below, above = rows[0], rows[4]
        ends = Rect(corridor, rows[2].y0, width - corridor, rows[2].y1)
        zones = [Zone(rows[1], space=0), Zone(rows[3], space=0)]
        zones += [Zone(Rect(0.0, ends.y0, corridor, ends.y1), space=0)]
        zones += [Zone(Rect(ends.x1, ends.y0, width, ends.y1), space=0)]
        makers = (f.nurse_station, f.storage, f.kitchenette, f.toilets, f.nurse_station)
        rects = ends.cut_x(drawn_widths(rng, ends.width, 3.5, 8.0))
        zones += [Zone(r, makers[k % len(makers)], door=(0.8, 1.1)) for k, r in enumerate(rects)]
    number = 1
    for row, door_at_top in ((below, True), (above, False)):
        for rect in row.cut_x(drawn_widths(rng, row.width, 3.6, float(rng.choice([4.6, 6.5])))):
            zones += _patient_zones(rng, rect, number, door_at_top=door_at_top)
            number += 1
    finish(
        plan,
        turned_at_random(rng, zones),
        style,
        functools.partial(f.corridor, makers=_ward_clutter(), every=7.0, least=1.5),
        people=(1, 4),
    )


def _ward_clutter() -> Sequence[things.Maker]:
    return (
        things.trolley,
        things.trolley,
        things.cabinet,
        things.armchair,
        things.extinguisher,
        things.bin_of,
        things.bench,
    )


def _patient_zones(rng: Rng, rect: Rect, number: int, *, door_at_top: bool) -> list[Zone]:
    """A patient room with a bathroom beside its entry, or another room of the ward."""
    luck = rng.random()
    if luck < 0.12:
        return [Zone(rect, f.nurse_station, space=0)]
    if luck < 0.3 or rect.width < 3.5:
        return [Zone(rect, (f.storage, f.cell_office, f.kitchenette)[int(rng.integers(3))], door=(0.8, 1.1))]
    deep, wide = float(rng.uniform(2.1, 2.5)), float(rng.uniform(1.75, 2.1))
    main, wet = rect.cut_y([rect.depth - deep, deep] if door_at_top else [deep, rect.depth - deep])
    if not door_at_top:
        main, wet = wet, main
    is_left = rng.random() < 0.5
    cut = [wide, rect.width - wide] if is_left else [rect.width - wide, wide]
    left, right = wet.cut_x(cut)
    bath, entry = (left, right) if is_left else (right, left)
    return [
        Zone(main, f.patient_room, space=number, has_doors=False),
        Zone(entry, space=number),
        Zone(bath, f.bathroom, door=(0.7, 0.9)),
    ]


def turned_at_random(rng: Rng, zones: Sequence[Zone]) -> list[Zone]:
    """Mirror and transpose a layout by chance."""
    swap, mirror_x, mirror_y = (bool(b) for b in rng.integers(0, 2, 3))
    x1, y1 = max(z.rect.x1 for z in zones), max(z.rect.y1 for z in zones)
    out = []
    for zone in zones:
        r = zone.rect
        if mirror_x:
            r = Rect(x1 - r.x1, r.y0, x1 - r.x0, r.y1)
        if mirror_y:
            r = Rect(r.x0, y1 - r.y1, r.x1, y1 - r.y0)
        if swap:
            r = Rect(r.y0, r.x0, r.y1, r.x1)
        out.append(Zone(r, zone.furnish, zone.space, zone.has_doors, zone.door, zone.may_have_glass))
    return out


def finish(
    plan: Plan,
    zones: Sequence[Zone],
    style: Style,
    clutter: f.Furnisher | None,
    *,
    people: tuple[int, int],
) -> None:
    """Start in a corridor, build, put things into the corridors, and let people walk there."""
    rng = plan.rng
    corridors = [z.rect for z in zones if z.is_corridor]
    longest = max(corridors, key=lambda r: max(r.width, r.depth))
    place_start(plan, longest)
    Building(plan, zones, style).build()
    for rect in corridors:
        if clutter is not None:
            clutter(plan, rect.inset(0.5 * style.outer))
    for _ in range(int(rng.integers(people[0], people[1] + 1))):
        for _ in range(WALKS_TRIED):
            if walk_along(plan, corridors[int(rng.integers(len(corridors)))]):
                break


def place_start(plan: Plan, corridor: Rect) -> None:
    """Start near an end of a corridor."""
    rng = plan.rng
    is_level = corridor.width >= corridor.depth
    length = corridor.width if is_level else corridor.depth
    along = float(rng.uniform(0.0, 0.3)) * length + 1.5
    along = length - along if rng.random() < 0.5 else along
    x, y = corridor.center
    at = (corridor.x0 + along, y) if is_level else (x, corridor.y0 + along)
    plan.set_start(at)


def walk_along(plan: Plan, corridor: Rect) -> bool:
    """Let somebody walk up and down a corridor, where nothing stands in the way, and nobody else walks: keeping right where it is wide, else on a straight line;
    return whether there was such a way."""
    rng = plan.rng
    is_level = corridor.width >= corridor.depth
    length, across = (corridor.width, corridor.depth) if is_level else (corridor.depth, corridor.width)
    if length < 6.0 or across < 1.5:
        return False
    begin, end = sorted(float(v) for v in rng.uniform(1.0, length - 1.0, 2))
    middle = float(rng.uniform(0.35, 0.65)) * across
    off = 0.15 * across
    if end - begin < 4.0:
        return False
    for half in (off, 0.0):
        place = Rect(begin, middle - half, end, middle + half).inset(-0.35)
        if is_level:
            place = Rect(corridor.x0 + place.x0, corridor.y0 + place.y0, corridor.x0 + place.x1, corridor.y0 + place.y1)
        else:
            place = Rect(corridor.x0 + place.y0, corridor.y0 + place.x0, corridor.x0 + place.y1, corridor.y0 + place.x1)
        taken = (*(piece.place for piece in plan.pieces), *plan.walks)
        if not any(place.overlaps(other) for other in taken):
            plan.walks.append(place)
            line = place.inset(0.35)
            way = [(line.x0, line.y0), (line.x1, line.y0), (line.x1, line.y1), (line.x0, line.y1)]
            plan.person(way if half else [way[0], way[2]], float(rng.uniform(0.8, 1.3)))
            return True
    return False
