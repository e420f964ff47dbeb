"""Made rooms full of what hangs above a planar scanner: tables on a column, signs and bars on wires, a cabinet with an open drawer."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.sensors import named_generator
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec
from ambler.sim.truth import reachable_cells
from ambler.sim.world_file import world_from_content

LENGTH, WIDTH = 12.0, 9.0  # metres of the room
START = (-5.0, 0.0)
ROOM = 0.25  # metres between a robot at a goal, however it is turned, and anything
GAP = 1.3  # metres between two things: wider than any robot here
RESOLUTION = 0.05
LEAST_WAY = 3.0  # metres between two goals
DRAWS = 4000
Content = dict[str, Any]


def room_content(seed: int) -> Content:
    """Return the file of a room: three tables, a sign, a bar and a cabinet with an open drawer, in places of their own around its middle."""
    rng = named_generator(seed, "overhangs")
    boxes: list[Content] = []
    cylinders: list[Content] = []
    places: list[tuple[float, float, float]] = []
    for make in (_table, _table, _table, _sign, _bar, _cabinet):
        for _ in range(DRAWS):
            x, y = float(rng.uniform(-3.6, 4.6)), float(rng.uniform(-3.2, 3.2))
            boxes_here, cylinders_here, radius = make(rng, x, y)
            if all(math.hypot(x - px, y - py) > radius + pr + GAP for px, py, pr in places):
                places.append((x, y, radius))
                boxes += boxes_here
                cylinders += cylinders_here
                break
    return {
        "size": [LENGTH, WIDTH],
        "start": {"x": START[0], "y": START[1]},
        "walls": _walls(),
        "boxes": boxes,
        "cylinders": cylinders,
    }


def save_room(seed: int, path: Path) -> None:
    """Write a room as a world's file."""
    path.write_text(yaml.safe_dump(room_content(seed), sort_keys=False))


def room_world(seed: int) -> WorldSpec:
    """Return the room as a world."""
    return world_from_content(Path(f"room-{seed}.yaml"), room_content(seed))


def draw_goals(seed: int, robot: SimRobot, count: int) -> tuple[SE2, ...]:
    """Return goals in the frame of the start to which the robot can get whatever hangs there, each from the last one straight through something that
    hangs. Raises BadInputError when the room has none."""
    world = room_world(seed).from_start()
    rng = named_generator(seed, "overhang-goals")
    full = replace(world, solids=tuple(replace(s, z_min=0.0, z_max=2.5) for s in world.solids))
    radius = robot.model.circumscribed_radius + ROOM
    spec, free = reachable_cells(full, radius, RESOLUTION, 1.0)
    _, open_floor = reachable_cells(full, 0.5 * RESOLUTION, RESOLUTION, 1.0)
    cells = np.argwhere(free)
    goals: list[SE2] = []
    at = SE2()
    for cell in cells[rng.integers(len(cells), size=DRAWS)] if len(cells) else ():
        x, y = spec.center_of(*cell.tolist())
        way = math.hypot(x - at.x, y - at.y)
        line = np.linspace((at.x, at.y), (x, y), max(2, round(way / RESOLUTION)))
        across = spec.cells_of(line)
        if way >= LEAST_WAY and not open_floor[across[:, 0], across[:, 1]].all():
            at = SE2(x, y, float(rng.uniform(-math.pi, math.pi)))
            goals.append(at)
            if len(goals) == count:
                return tuple(goals)
    raise BadInputError(f"room {seed}: no {count} goals behind what hangs there")


def _walls() -> list[Content]:
    x, y = 0.5 * LENGTH, 0.5 * WIDTH
    corners = [[-x, -y], [x, -y], [x, y], [-x, y]]
    return [{"from": corners[k], "to": corners[(k + 1) % 4]} for k in range(4)]


def _table(rng: np.random.Generator, x: float, y: float) -> tuple[list[Content], list[Content], float]:
    """A top of 3 cm on one column."""
    length, width, yaw = float(rng.uniform(1.0, 1.8)), float(rng.uniform(0.7, 1.0)), float(rng.uniform(-90.0, 90.0))
    top = _box("table_top", (x, y), (length, width, 0.03), yaw, float(rng.uniform(0.68, 0.76)))
    column = {"name": "table_column", "center": [x, y], "radius": 0.05, "height": 0.68}
    return [top], [column], 0.5 * math.hypot(length, width)


def _sign(rng: np.random.Generator, x: float, y: float) -> tuple[list[Content], list[Content], float]:
    """A board that hangs from the ceiling."""
    length, base = float(rng.uniform(0.8, 1.4)), float(rng.uniform(0.5, 0.85))
    board = _box("sign", (x, y), (length, 0.03, 1.2 - base), float(rng.uniform(-90.0, 90.0)), base)
    return [board], [], 0.5 * length


def _bar(rng: np.random.Generator, x: float, y: float) -> tuple[list[Content], list[Content], float]:
    """A bar of 6 cm on thin wires."""
    length = float(rng.uniform(1.2, 2.0))
    bar = _box("bar", (x, y), (length, 0.06, 0.06), float(rng.uniform(-90.0, 90.0)), float(rng.uniform(0.5, 1.05)))
    return [bar], [], 0.5 * length


def _cabinet(rng: np.random.Generator, x: float, y: float) -> tuple[list[Content], list[Content], float]:
    """A cabinet whose drawer stands out 0.45 m, above a scanner."""
    yaw, base = float(rng.uniform(-180.0, 180.0)), float(rng.uniform(0.42, 0.6))
    front = SE2(x, y, math.radians(yaw)) @ SE2(0.45, 0.0, 0.0)
    drawer = _box("drawer", (front.x, front.y), (0.45, 0.55, 0.16), yaw, base)
    return [_box("cabinet", (x, y), (0.45, 0.6, 0.9), yaw), drawer], [], 0.75


def _box(
    name: str, center: tuple[float, float], size: tuple[float, float, float], yaw_deg: float, base: float = 0.0
) -> Content:
    return {"name": name, "center": list(center), "size": list(size), "yaw_deg": yaw_deg, "base": base}
