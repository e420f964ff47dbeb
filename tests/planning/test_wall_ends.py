"""Where walls are supposed to go on: along their line into unknown ground, and nowhere else; and what that does to a plan."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.kernels.wall_ends import continue_walls
from ambler.planning.clearance_map import FORBIDDEN, FREE, UnknownPrice
from ambler.planning.clearance_map import UNKNOWN as UNKNOWN_CELL
from ambler.planning.visibility_graph import VisibilityGraph
from ambler.planning.visibility_planner import VisibilityConfig, VisibilityPlanner
from ambler.studies.planner_worlds import inflated

LETHAL, BLOCKED, UNKNOWN = 254, 253, 255
SIZE, RADIUS, REACH = 160, 12, 60


def scene(angle: float, length: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return costs in which a wall of two cells runs from the middle outwards, free on one side of it and unknown elsewhere, with how far each cell lies before the wall's end and
    beside its line."""
    iy, ix = np.mgrid[:SIZE, :SIZE].astype(float) - SIZE / 2
    along, beside = -(iy * math.sin(angle) + ix * math.cos(angle)), ix * math.sin(angle) - iy * math.cos(angle)
    costs = np.full((SIZE, SIZE), UNKNOWN, np.uint8)
    is_wall_part = (along <= 0.0) & (along > -length)
    costs[is_wall_part & (beside > 0.0) & (beside < 40.0)] = 0
    costs[is_wall_part & (np.abs(beside) <= 1.0)] = LETHAL
    return costs, along, beside


def marked(costs: np.ndarray, reach: int = REACH) -> np.ndarray:
    out = np.zeros(costs.shape, np.uint8)
    continue_walls(costs, LETHAL, BLOCKED, UNKNOWN, RADIUS, reach, out)
    return out > 0


@pytest.mark.parametrize("angle", np.linspace(0.1, 6.2, 9))
def test_a_wall_goes_on_along_its_line_from_both_ends(angle: float) -> None:
    costs, along, beside = scene(angle)
    found = marked(costs)
    assert found.any()
    assert (costs[found] == UNKNOWN).all()
    assert np.abs(beside[found]).max() < 8.0, "within 6 degrees or so of its line"
    for before, after in ((2.0, 50.0), (-60.0, -42.0)):
        covered = np.unique(np.round(along[found & (along > before) & (along < after)]))
        assert len(covered) > 0.9 * (after - before), "without gaps"
    assert along[found].max() <= REACH + 2.0


@pytest.mark.parametrize("angle", np.linspace(0.1, 6.2, 9))
def test_where_free_ground_lies_beyond_its_end_a_wall_is_over(angle: float) -> None:
    costs, along, beside = scene(angle)
    costs[(along > 0.0) & (along < 6.0) & (np.abs(beside) < 30.0)] = 0
    assert not marked(costs)[along > 0.0].any(), "the jamb of a door that was seen"


def test_inflation_beside_a_wall_hides_no_end_and_another_wall_ends_the_line() -> None:
    costs, along, beside = scene(0.0)
    costs[(costs == UNKNOWN) & (np.hypot(along, beside) < 7.0)] = BLOCKED  # unknown, but too near to the wall
    costs[(along > 30.0) & (along < 32.0)] = LETHAL
    found = marked(costs)
    assert found[(along > 8.0) & (along < 29.0) & (np.abs(beside) < 1.0)].mean() > 0.5
    assert not found[along > 33.0].any()


def test_corners_blobs_and_single_cells_say_nothing() -> None:
    costs = np.full((SIZE, SIZE), UNKNOWN, np.uint8)
    costs[60:90, 60:90] = LETHAL  # a block
    costs[20, 20] = LETHAL
    costs[120:122, 120:122] = LETHAL
    assert not marked(costs).any()
    corner = np.full((SIZE, SIZE), UNKNOWN, np.uint8)
    corner[40:42, 40:100] = corner[40:100, 40:42] = LETHAL
    found = np.argwhere(marked(corner))
    assert len(found) > 0
    assert (found.max(axis=1) > 95).all(), "at its open ends only, not where the walls meet"


SPEC = GridSpec(0.05, 200, 200, -5.0, -5.0)


def hidden_gap() -> np.ndarray:
    """Return lethal, free and unknown cells of a corridor whose far wall has a gap of 1.4 m that a post hides, and at its side a door that leads into unknown ground."""
    cells = np.full(SPEC.shape, UNKNOWN, np.uint8)
    cells[40:160, 60:120] = 0
    cells[40:160, 120:122] = LETHAL  # the far wall
    cells[116:144, 118:130] = UNKNOWN  # hidden
    cells[160:168, 84:106] = 0
    cells[36:40, 60:122], cells[160:164, 60:84], cells[160:164, 106:122] = LETHAL, LETHAL, LETHAL
    return cells


def test_a_robot_would_rather_take_a_door_that_it_sees_than_the_hidden_piece_of_a_wall() -> None:
    costs, start, goal = inflated(hidden_gap(), inscribed=0.25), SE2(-0.5, 1.5), SE2(3.0, 1.5)
    trusting = VisibilityConfig(is_unknown_allowed=True, margin=3.0, price=UnknownPrice(0.5, 3.0))
    through = VisibilityPlanner(trusting).plan(costs, SPEC, start, goal).path
    around = (
        VisibilityPlanner(VisibilityConfig(is_unknown_allowed=True, margin=3.0)).plan(costs, SPEC, start, goal).path
    )
    assert through[:, 1].max() < 2.0
    assert around[:, 1].max() > 3.0


def test_edges_are_weighed_anew_where_a_wall_is_supposed_now() -> None:
    """A planner that saw the wall later comes to the plan of one that saw it from the beginning."""
    costs, start, goal = inflated(hidden_gap(), inscribed=0.25), SE2(-0.5, 1.5), SE2(3.0, 1.5)
    config = VisibilityConfig(is_unknown_allowed=True, margin=3.0, hysteresis=0.0)
    before = hidden_gap()
    before[40:160, 120:122] = UNKNOWN
    planner = VisibilityPlanner(config)
    planner.plan(inflated(before, inscribed=0.25), SPEC, start, goal)
    after = planner.plan(costs, SPEC, start, goal)
    assert after.cost == pytest.approx(VisibilityPlanner(config).plan(costs, SPEC, start, goal).cost, rel=1e-6)


def test_edges_cost_what_a_wall_that_is_supposed_across_them_costs_although_nothing_else_changed() -> None:
    """The end of the wall that was seen lies farther away than what an update looks at again anyway: two corners see each other through unknown ground, and
    the wall is supposed between them, or is not any more."""
    cells = np.full(SPEC.shape, FREE, np.uint8)
    cells[60:140, 40:160] = UNKNOWN_CELL
    cells[96:104, 56:64] = cells[96:104, 136:144] = FORBIDDEN
    across = np.zeros(SPEC.shape, np.uint8)
    across[70:130, 98:102] = 1
    none = np.zeros_like(across)
    price, start, goal = UnknownPrice(0.5, wall=10.0), SPEC.center_of(100, 30), SPEC.center_of(100, 170)
    for before, after in ((none, across), (across, none)):
        graph, fresh = VisibilityGraph(price=price), VisibilityGraph(price=price)
        graph.update(SPEC, cells, hidden=before)
        graph.update(SPEC, cells, hidden=after)
        fresh.update(SPEC, cells, hidden=after)
        found, wanted = graph.search(start, goal), fresh.search(start, goal)
        assert found is not None
        assert wanted is not None
        assert found[1] == pytest.approx(wanted[1])
