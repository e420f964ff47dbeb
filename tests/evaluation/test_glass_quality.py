"""Found and invented glass, in metres."""

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.evaluation.glass_quality import compare_glass
from ambler.sim.solids import Shape, Solid

PANE = Solid("pane", Shape.BOX, SE2(1.0, 2.0, math.radians(30)), 4.0, 0.02, 0.0, 2.0, is_glass=True)
WALL = Solid("wall", Shape.BOX, SE2(5.0, 0.0, 0.0), 0.1, 6.0, 0.0, 2.0)


def part(first: float, last: float, beside: float = 0.0) -> np.ndarray:
    ends = PANE.world_from_solid.transform(np.array([[first, beside], [last, beside]]))
    return ends.reshape(1, 4).astype(np.float32)


def test_all_half_and_nothing_found() -> None:
    assert compare_glass(part(-2, 2), (PANE, WALL), SE2()).found_ratio == 1.0
    half = compare_glass(part(-2, -0.15, 0.1), (PANE, WALL), SE2())
    assert half.found_ratio == pytest.approx(0.5, abs=0.04)
    assert (half.invented_m, half.true_m) == (0.0, pytest.approx(4.0))
    nothing = compare_glass(np.zeros((0, 4), np.float32), (PANE, WALL), SE2())
    assert (nothing.found_ratio, nothing.invented_m) == (0.0, 0.0)


def test_glass_where_a_wall_or_nothing_stands_is_invented() -> None:
    segments = np.concatenate([part(-2, 2), part(-1, 1, 0.5)])
    assert compare_glass(segments, (PANE, WALL), SE2()).invented_m == pytest.approx(2.0, abs=0.06)
    alone = compare_glass(part(-1, 1), (WALL,), SE2())
    assert math.isnan(alone.found_ratio)
    assert alone.invented_m == pytest.approx(2.0, abs=0.06)


def test_the_map_begins_where_the_robot_started() -> None:
    world_from_map = SE2(1.5, -1.3, 0.4)
    told = world_from_map.inverse().transform(part(-2, 2).reshape(2, 2)).reshape(1, 4)
    quality = compare_glass(told, (PANE, WALL), world_from_map)
    assert (quality.found_ratio, quality.invented_m) == (1.0, 0.0)
    assert compare_glass(told, (PANE, WALL), SE2()).found_ratio < 0.5
