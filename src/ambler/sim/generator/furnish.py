"""How rooms are furnished: along walls, in the middle, with what belongs to each kind of room."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ambler.sim.generator import things
from ambler.sim.generator.plan import Plan
from ambler.sim.generator.rect import Rect
from ambler.sim.generator.things import Maker, Thing

AISLE = 1.1  # metres between a thing in the middle of a room and others
TRIES = 12


def against_wall(
    plan: Plan, room: Rect, thing: Thing, *, sides: Sequence[int] = (0, 1, 2, 3), gap: float = 0.0, tries: int = TRIES
) -> bool:
    """Put a thing with its back to a wall of the room (inner faces): 0 below, 1 right, 2 above, 3 left. Returns whether it fitted."""
    rng = plan.rng
    for _ in range(tries):
        side = int(rng.choice(list(sides)))
        width, depth = thing.size_at(side)
        free_x, free_y = room.width - width, room.depth - depth
        if min(free_x, free_y) < 0.0:
            continue
        off = float(rng.uniform(0.01, 0.05))
        x = room.x0 + 0.5 * width + float(rng.uniform(0.0, free_x))
        y = room.y0 + 0.5 * depth + float(rng.uniform(0.0, free_y))
        if rng.random() < 0.4:  # into a corner, where most furniture stands
            x = room.x0 + 0.5 * width + (off if rng.random() < 0.5 else free_x - off)
            y = room.y0 + 0.5 * depth + (off if rng.random() < 0.5 else free_y - off)
        if side == 0:
            y = room.y0 + 0.5 * depth + off
        elif side == 1:
            x = room.x1 - 0.5 * width - off
        elif side == 2:
            y = room.y1 - 0.5 * depth - off
        else:
            x = room.x0 + 0.5 * width + off
        if plan.put(thing.placed((x, y), side), gap):
            return True
    return False


def in_middle(plan: Plan, room: Rect, thing: Thing, *, aisle: float = AISLE, tilt_deg: float = 0.0) -> bool:
    """Put a thing near the middle of a room with an aisle around it. Returns whether it fitted."""
    rng = plan.rng
    for quarter in rng.permutation(2):
        width, depth = thing.size_at(int(quarter))
        if width + 2 * aisle > room.width or depth + 2 * aisle > room.depth:
            continue
        slack_x, slack_y = room.width - width - 2 * aisle, room.depth - depth - 2 * aisle
        x, y = room.center
        at = (x + float(rng.uniform(-0.25, 0.25)) * slack_x, y + float(rng.uniform(-0.25, 0.25)) * slack_y)
        if plan.put(thing.placed(at, int(quarter), tilt_deg), 0.6):
            return True
    return False


def anywhere(plan: Plan, room: Rect, thing: Thing, gap: float, *, tilt_deg: float = 0.0) -> bool:
    """Put a thing somewhere in a room with `gap` metres to others. Returns whether it fitted."""
    rng = plan.rng
    quarter = int(rng.integers(4))
    width, depth = thing.size_at(quarter)
    if room.width < width + 2 * gap or room.depth < depth + 2 * gap:
        return False
    for _ in range(TRIES):
        x = float(rng.uniform(room.x0 + gap + 0.5 * width, room.x1 - gap - 0.5 * width))
        y = float(rng.uniform(room.y0 + gap + 0.5 * depth, room.y1 - gap - 0.5 * depth))
        if plan.put(thing.placed((x, y), quarter, tilt_deg), gap):
            return True
    return False


def row_along_walls(
    plan: Plan, room: Rect, makers: Sequence[tuple[Maker, float]], sides: Sequence[int] = (0, 1, 2, 3)
) -> None:
    """Put each thing with its probability."""
    for maker, chance in makers:
        if plan.rng.random() < chance:
            against_wall(plan, room, maker(plan.rng), sides=sides, gap=0.02)


def cell_office(plan: Plan, room: Rect) -> None:
    """An office of one to three desks."""
    desks = 1 + int(room.area > 15.0) + int(room.area > 24.0)
    for _ in range(desks):
        against_wall(plan, room, things.desk(plan.rng), gap=0.3)
    row_along_walls(
        plan,
        room,
        [(things.cabinet, 0.9), (things.cabinet, 0.5), (things.shelf, 0.3), (things.plant, 0.4), (things.bin_of, 0.4)],
    )


def open_office(plan: Plan, room: Rect) -> None:
    """Islands of desks in rows, and cabinets along the walls."""
    rng = plan.rng
    inner = room.inset(1.3)
    along_x = inner.width >= inner.depth
    pitch_x, pitch_y = float(rng.uniform(6.4, 7.2)), float(rng.uniform(4.4, 5.0))
    if not along_x:
        pitch_x, pitch_y = pitch_y, pitch_x
    columns, rows = max(1, int(inner.width / pitch_x)), max(1, int(inner.depth / pitch_y))
    for i in range(columns):
        for j in range(rows):
            if rng.random() < 0.1:
                continue
            at = (inner.x0 + (i + 0.5) * inner.width / columns, inner.y0 + (j + 0.5) * inner.depth / rows)
            thing = things.island(rng)
            width, depth = thing.size_at(0 if along_x else 1)
            if width <= inner.width and depth <= inner.depth:
                plan.put(thing.placed(at, 0 if along_x else 1), 1.0)
    for _ in range(int(room.area / 25.0)):
        row_along_walls(plan, room, [(things.cabinet, 0.7), (things.plant, 0.4), (things.copier, 0.15)])


def meeting_room(plan: Plan, room: Rect) -> None:
    """A long table with chairs around it, a sideboard."""
    rng = plan.rng
    long_x = room.width >= room.depth
    length, across = max(room.width, room.depth), min(room.width, room.depth)
    seats = min(5, int((length - 3.4) / 0.7))
    if seats < 1 or across < 4.0:
        cell_office(plan, room)
        return
    table = things.table(rng, 0.7 * seats + 0.3, float(rng.uniform(1.0, 1.3)))
    whole = Thing(table.width, table.depth + 1.0, table.boxes, table.cylinders)
    for k in range(seats):
        for side in (-1.0, 1.0):
            if rng.random() < 0.85:
                at = ((k - 0.5 * (seats - 1)) * 0.7, side * (0.5 * table.depth + 0.2))
                whole.box("seat", at, (0.46, 0.46, things.SEAT))
                whole.box("backrest", (at[0], at[1] + side * 0.2), (0.46, 0.05, 0.42), things.SEAT)
    plan.put(whole.placed(room.center, 0 if long_x else 1), 0.5)
    row_along_walls(plan, room, [(things.cabinet, 0.6), (things.plant, 0.5), (things.bin_of, 0.3)])


def kitchenette(plan: Plan, room: Rect) -> None:
    """A kitchen of an office: a counter with cabinets above, a fridge, small tables."""
    against_wall(plan, room, things.wall_cabinet(plan.rng))
    row_along_walls(plan, room, [(things.fridge, 1.0), (things.counter, 0.5), (things.bin_of, 0.7)])
    dining_table(plan, room)


def dining_table(plan: Plan, room: Rect) -> None:
    """A table with two to six chairs, in the middle."""
    rng = plan.rng
    seats = int(rng.integers(1, 4)) if room.area > 14.0 else 1
    table = things.table(rng, 0.65 * seats + 0.25, float(rng.uniform(0.75, 0.9)))
    whole = Thing(table.width, table.depth + 0.9, table.boxes, table.cylinders)
    for k in range(seats):
        for side in (-1.0, 1.0):
            seat = things.chair(rng)
            at = ((k - 0.5 * (seats - 1)) * 0.65, side * (0.5 * table.depth + 0.15))
            for name, (x, y), size, base, albedo in seat.boxes:
                whole.box(name, (at[0] + x, at[1] - side * y), size, base, albedo)
            for name, (x, y), radius, height, base in seat.cylinders:
                whole.cylinder(name, (at[0] + x, at[1] - side * y), radius, height, base)
    if not in_middle(plan, room, whole, aisle=1.0):
        against_wall(plan, room, whole, gap=0.5)


def storage(plan: Plan, room: Rect) -> None:
    """Shelves along the walls."""
    for _ in range(2 + int(room.area / 6.0)):
        against_wall(plan, room, things.shelf(plan.rng))
    row_along_walls(plan, room, [(things.pallets_stacked, 0.2), (things.bin_of, 0.4)])


def toilets(plan: Plan, room: Rect) -> None:
    """Toilets along a wall with partitions between them, basins opposite."""
    rng = plan.rng
    side = int(rng.integers(4))
    for _ in range(1 + int(room.area / 8.0)):
        against_wall(plan, room, things.toilet(rng), sides=[side], gap=0.4)
        against_wall(plan, room, things.basin(rng), sides=[(side + 2) % 4], gap=0.2)


def lobby(plan: Plan, room: Rect) -> None:
    """A reception, sofas and plants."""
    rng = plan.rng
    in_middle(plan, room, things.counter(rng), aisle=1.3)
    row_along_walls(
        plan,
        room,
        [(things.sofa, 0.9), (things.sofa, 0.5), (things.plant, 0.8), (things.plant, 0.6), (things.cabinet, 0.3)],
    )


def living_room(plan: Plan, room: Rect) -> None:
    """A sofa before a low table, a board opposite, a dining table, bookcases."""
    rng = plan.rng
    side = int(rng.integers(4))
    against_wall(plan, room, things.sofa(rng), sides=[side], gap=0.3)
    against_wall(plan, room, things.wall_cabinet(rng), sides=[(side + 2) % 4], gap=0.3)
    if room.area > 22.0:
        dining_table(plan, room)
    anywhere(plan, room, things.coffee_table(rng), 0.75)
    row_along_walls(
        plan, room, [(things.armchair, 0.6), (things.cabinet, 0.8), (things.plant, 0.6), (things.plant, 0.3)]
    )


def bedroom(plan: Plan, room: Rect) -> None:
    """A bed, a wardrobe, sometimes a desk."""
    rng = plan.rng
    wide = 0.9 if room.area < 11.0 else None
    against_wall(plan, room, things.bed(rng, wide), gap=0.5, tries=30)
    against_wall(plan, room, things.wardrobe(rng), gap=0.6)
    row_along_walls(plan, room, [(things.desk, 0.4), (things.cabinet, 0.5), (things.plant, 0.2)])


def bathroom(plan: Plan, room: Rect) -> None:
    """A tub, a basin, a toilet."""
    rng = plan.rng
    against_wall(plan, room, things.tub(rng) if room.area > 5.0 else things.basin(rng), gap=0.1)
    against_wall(plan, room, things.basin(rng), gap=0.1)
    against_wall(plan, room, things.toilet(rng), gap=0.2)


def kitchen(plan: Plan, room: Rect) -> None:
    """Counters along one or two walls, a fridge, a table when there is room."""
    rng = plan.rng
    side = int(rng.integers(4))
    against_wall(plan, room, things.wall_cabinet(rng), sides=[side])
    against_wall(plan, room, things.counter(rng), sides=[(side + 1) % 4])
    against_wall(plan, room, things.fridge(rng))
    if room.area > 11.0:
        dining_table(plan, room)


def hallway(plan: Plan, room: Rect) -> None:
    """A wardrobe or a chest, where there is room."""
    if min(room.width, room.depth) > 1.9:
        row_along_walls(plan, room, [(things.cabinet, 0.6), (things.plant, 0.3)])


def patient_room(plan: Plan, room: Rect) -> None:
    """One to three hospital beds with their heads at one wall, a wardrobe, a table."""
    rng = plan.rng
    side = int(rng.integers(2)) * 2 + int(rng.integers(2))
    for _ in range(1 + int(room.area > 18.0) + int(room.area > 30.0)):
        against_wall(plan, room, things.hospital_bed(rng), sides=[side], gap=0.5, tries=40)
    against_wall(plan, room, things.wardrobe(rng), gap=0.5)
    row_along_walls(plan, room, [(things.armchair, 0.5), (things.basin, 0.6), (things.bin_of, 0.3)])


def nurse_station(plan: Plan, room: Rect) -> None:
    """A counter, desks, cabinets."""
    in_middle(plan, room, things.counter(plan.rng), aisle=1.1)
    row_along_walls(plan, room, [(things.desk, 0.9), (things.cabinet, 0.9), (things.shelf, 0.6), (things.copier, 0.4)])


def workshop(plan: Plan, room: Rect) -> None:
    """Benches along the walls, a machine in the middle."""
    in_middle(plan, room, things.machine(plan.rng), aisle=1.4)
    row_along_walls(
        plan, room, [(things.workbench, 1.0), (things.workbench, 0.7), (things.shelf, 0.7), (things.pallet, 0.5)]
    )


def corridor(plan: Plan, zone: Rect, makers: Sequence[Maker], every: float, least: float = 1.5) -> None:
    """Things along the long walls of a corridor, one for about `every` metres, where a way of `least` metres remains."""
    rng = plan.rng
    sides = (0, 2) if zone.width >= zone.depth else (1, 3)
    across = min(zone.width, zone.depth)
    for _ in range(int(rng.poisson(max(zone.width, zone.depth) / every))):
        thing = makers[int(rng.integers(len(makers)))](rng)
        if thing.depth <= across - least:
            against_wall(plan, zone, thing, sides=sides, gap=1.2, tries=4)


Furnisher = Callable[[Plan, Rect], None]


def nothing(plan: Plan, room: Rect) -> None:
    """Leave a room empty."""


def scatter(plan: Plan, zone: Rect, makers: Sequence[Maker], count: int, gap: float, tilt_deg: float = 0.0) -> None:
    """Put things anywhere in a zone, as they come."""
    rng = plan.rng
    for _ in range(count):
        maker = makers[int(rng.integers(len(makers)))]
        anywhere(plan, zone, maker(rng), gap, tilt_deg=float(rng.uniform(-tilt_deg, tilt_deg)) if tilt_deg else 0.0)


def columns_on_grid(plan: Plan, zone: Rect, pitch: tuple[float, float], side: float) -> None:
    """Put columns on a grid, where nothing stands yet."""
    for x in np.arange(zone.x0 + pitch[0], zone.x1 - 0.5 * pitch[0], pitch[0]):
        for y in np.arange(zone.y0 + pitch[1], zone.y1 - 0.5 * pitch[1], pitch[1]):
            plan.put(things.column(plan.rng, side).placed((float(x), float(y)), 0))


def clear_lane(plan: Plan, a: tuple[float, float], b: tuple[float, float], width: float) -> None:
    """Keep a straight way along an axis clear."""
    half = 0.5 * width
    plan.keep_clear(
        Rect(min(a[0], b[0]) - half, min(a[1], b[1]) - half, max(a[0], b[0]) + half, max(a[1], b[1]) + half)
    )
