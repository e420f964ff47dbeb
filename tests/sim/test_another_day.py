"""Another day in a drawn place: walls stand, a fifth of the furniture does not, and everything can still be reached."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.sim.generator.another_day import TURN, WAY, move_furniture, shifted
from ambler.sim.generator.draw import MOVED, draw_place, parse_name
from ambler.sim.generator.plan import Piece, Plan
from ambler.sim.generator.rect import Rect, around
from ambler.sim.world_file import load_world


@pytest.mark.parametrize("kind", ["office", "flat", "warehouse"])
def test_walls_stay_and_some_furniture_moves_within_its_room(kind: str) -> None:
    first, later = draw_place(kind, 7), draw_place(kind, 7, 2)
    assert later.content["walls"] == first.content["walls"]
    assert later.content["start"] == first.content["start"]
    before, after = first.world.solids, later.world.solids
    moved = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert later.moved > 0
    assert len(moved) >= later.moved
    for a, b in moved:
        assert a.name == b.name
        assert (a.size_x, a.size_y, a.z_min, a.z_max) == (b.size_x, b.size_y, b.z_min, b.z_max)
        assert a.world_from_solid.distance_to(b.world_from_solid) < WAY[1] + 5.0 * math.radians(TURN)
    assert later.floor.area > 0.8 * first.floor.area


def test_the_same_day_is_the_same_and_each_day_another() -> None:
    assert draw_place("flat", 7, 2).content == draw_place("flat", 7, 2).content
    assert draw_place("flat", 7, 2).content != draw_place("flat", 7, 3).content
    assert draw_place("flat", 7, 0).content == draw_place("flat", 7).content
    assert parse_name("flat-7-day2") == ("flat", 7, 2)
    assert load_world("flat-7-day2").solids == draw_place("flat", 7, 2).world.solids
    assert draw_place("flat", 7, 2).name == "flat-7-day2"


def _plan_of(pieces: int) -> Plan:
    plan = Plan(np.random.default_rng(0))
    plan.floors.append(Rect(0.0, 0.0, 40.0, 40.0))
    for k in range(pieces):
        at = (4.0 + 6.0 * (k % 6), 4.0 + 6.0 * (k // 6))
        plan.pieces.append(Piece(around(at, 1.0, 0.5)).box("cabinet", at, (1.0, 0.5, 1.0)))
    return plan


def test_the_share_is_moved_by_no_less_and_no_more_than_said() -> None:
    plan = _plan_of(30)
    before = list(plan.pieces)
    moved = move_furniture(plan, MOVED, np.random.default_rng(1))
    assert len(moved) == 6
    for k, (a, b) in enumerate(zip(before, plan.pieces, strict=True)):
        way = math.dist(a.place.center, b.place.center)
        assert (WAY[0] <= way <= WAY[1]) if k in moved else a is b


def test_a_piece_turns_about_its_middle_and_keeps_its_parts_together() -> None:
    piece = (
        Piece(around((2.0, 3.0), 2.0, 1.0))
        .box("top", (2.0, 3.0), (2.0, 1.0, 0.7))
        .cylinder("leg", (3.0, 3.0), 0.1, 0.7)
    )
    there = shifted(piece, (1.0, -1.0), 0.5 * math.pi)
    assert there.boxes[0]["center"] == [3.0, 2.0]
    assert there.boxes[0]["yaw_deg"] == 90.0
    assert there.cylinders[0]["center"] == [3.0, 3.0]
    assert there.place.width == pytest.approx(1.0)
    assert there.place.depth == pytest.approx(2.0)
