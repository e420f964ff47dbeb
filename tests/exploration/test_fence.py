"""The fence of exploration: polygon, radius, and the reach of known surfaces."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.messages import CostGrid, FrontierState, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.exploration.fence import Boundary, Fence, FenceConfig, Side, is_inside
from ambler.exploration.survey import FrontierSurvey, Survey, SurveyConfig
from tests.exploration.test_survey import corridor, grids, path_distances

START = SE2(2.0, 2.0)


def survey(occupancy: NDArray[np.int8], fence: FenceConfig, boundary: Boundary = (), at: SE2 = START) -> Survey:
    surveyor = FrontierSurvey(SurveyConfig(fence=fence), path_distances)
    return surveyor.update(*grids(occupancy), at, boundary)


def test_a_radius_is_about_the_start_on_every_level() -> None:
    """Not about where the robot came to the next one."""
    surveyor = FrontierSurvey(SurveyConfig(fence=FenceConfig(radius=4.0)), path_distances)
    surveyor.update(*grids(corridor()), START)
    assert not surveyor.another().update(*grids(corridor()), SE2(5.5, 2.0)).open


FAR = FenceConfig(structure_reach=15.0, open_reach=100.0)


def plain() -> NDArray[np.int8]:
    """A wall along x = 1 m, and nothing known to be there on the right of it up to x = 28 m."""
    occupancy = np.full((60, 300), -1, np.int8)
    occupancy[15:45, 11:280] = 0
    occupancy[:, 9:11] = 100
    return occupancy


def test_a_polygon_keeps_the_robot_in_and_says_what_it_left() -> None:
    square = ((0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0))
    for fence, boundary in ((FenceConfig(), square), (FenceConfig(boundary=square), ())):
        seen = survey(corridor(), fence, boundary)
        assert seen.open == ()
        assert [f.state for f in seen.frontiers] == [FrontierState.OUTSIDE_BOUNDARY]
        assert seen.frontiers[0].reason == "outside the boundary"
        assert seen.left_out == pytest.approx(2.0, abs=0.11)
    assert len(survey(corridor(), FenceConfig()).open) == 1


def test_the_boundary_of_the_goal_goes_before_that_of_the_configuration() -> None:
    small = ((0.0, 0.0), (3.0, 0.0), (3.0, 4.0), (0.0, 4.0))
    large = ((0.0, 0.0), (9.0, 0.0), (9.0, 4.0), (0.0, 4.0))
    assert len(survey(corridor(), FenceConfig(boundary=small), large).open) == 1


@pytest.mark.parametrize(("radius", "is_open"), [(4.0, False), (6.0, True)])
def test_a_radius_about_the_start_holds_wherever_the_robot_is(radius: float, is_open: bool) -> None:
    surveyor = FrontierSurvey(SurveyConfig(fence=FenceConfig(radius=radius)), path_distances)
    surveyor.update(*grids(corridor()), START)
    assert bool(surveyor.update(*grids(corridor()), SE2(5.5, 2.0)).open) is is_open
    surveyor.reset()
    assert surveyor.update(*grids(corridor()), SE2(5.5, 2.0)).open, "a new exploration has a new start"


def test_frontiers_far_from_any_surface_are_left_with_that_reason() -> None:
    seen = survey(plain(), FAR)
    far = [f for f in seen.frontiers if f.state is FrontierState.OUTSIDE_BOUNDARY]
    assert far
    assert all(f.reason.startswith("no known surface within 15 m") for f in far)
    assert min(float(f.cells[:, 0].min()) for f in far) == pytest.approx(1.0 + 15.0, abs=0.8)
    near = [f for i, f in enumerate(seen.frontiers) if i in seen.open]
    assert near
    assert max(float(f.cells[:, 0].max()) for f in near) < 1.0 + 15.0 + 0.8
    # Without the rule the far end is what a robot would be drawn to.
    free = survey(plain(), FenceConfig(structure_reach=0.0))
    assert free.left_out == 0.0
    assert max(float(f.cells[:, 0].max()) for i, f in enumerate(free.frontiers) if i in free.open) > 27.0


def test_the_outer_side_of_a_wall_is_left_after_a_few_metres_and_what_walls_surround_is_not() -> None:
    occupancy = plain()
    outside = survey(occupancy, FenceConfig())
    left = np.concatenate([f.cells for f in outside.frontiers if f.state is FrontierState.OUTSIDE_BOUNDARY])
    assert float(left[:, 0].min()) == pytest.approx(1.0 + 5.0, abs=0.8)
    occupancy = occupancy.copy()
    occupancy[20:40, 150:152] = 100  # a wall on the other side, 14 m away
    between = survey(occupancy, FenceConfig())
    left = np.concatenate([f.cells for f in between.frontiers if f.state is FrontierState.OUTSIDE_BOUNDARY])
    assert float(left[:, 0].min()) == pytest.approx(15.1 + 5.0, abs=0.8)


def test_the_outside_of_a_building_is_left_after_a_few_metres_of_way_however_near_its_wall() -> None:
    spec = GridSpec(0.1, 240, 160, 0.0, 0.0)
    data = np.zeros(spec.shape, np.int8)
    data[20:140, [20, 120]] = data[[20, 139], 20:121] = 100  # 10 m x 12 m
    data[70:90, 120] = 0  # a gap of 2 m
    fence = Fence(FenceConfig())
    fence.update(OccupancyGrid(0, "map", spec, data), SE2(5.0, 8.0))

    def side(x: float, y: float) -> Side:
        iy, ix = spec.cell_of(x, y)
        return Side(int(fence.sides_of(np.array([iy * spec.width + ix]))[0]))

    assert side(11.0, 3.0) is side(14.0, 8.0) is side(16.0, 8.2) is Side.INSIDE
    assert side(18.5, 8.0) is Side.BEYOND_STRUCTURE
    assert side(13.2, 2.6) is side(13.2, 13.5) is Side.BEYOND_STRUCTURE  # 1 m beside the wall, 6 m from the gap
    assert side(1.2, 8.0) is Side.BEYOND_STRUCTURE  # the other side of the building, where no gap is


@pytest.mark.parametrize("first", range(40, 50))
def test_a_narrow_door_leads_out_wherever_it_lies_in_the_cells(first: int) -> None:
    """A door of 0.6 m in a thick wall; what lies behind it is bare."""
    spec = GridSpec(0.05, 300, 200, 0.0, 0.0)
    data = np.zeros(spec.shape, np.int8)
    data[20:180, 20:24] = data[20:180, 100:106] = data[20:24, 20:106] = data[176:180, 20:106] = 100
    data[first : first + 12, 100:106] = 0
    fence = Fence(FenceConfig())
    fence.update(OccupancyGrid(0, "map", spec, data), SE2(3.0, 3.0))
    middle = first + 6
    cells = np.array([middle * spec.width + ix for ix in (120, 160, 190)])
    assert (fence.sides_of(cells) == Side.INSIDE).all()
    assert fence.sides_of(np.array([middle * spec.width + 230]))[0] == Side.BEYOND_STRUCTURE


def test_columns_hold_a_hall_together_and_lost_returns_do_not() -> None:
    hall = plain()
    hall[30, 120] = hall[20, 200] = 100  # single cells: lost returns
    reached = survey(hall, FAR).left_out
    hall = hall.copy()
    hall[29:33, 119:123] = hall[19:23, 199:203] = 100  # two columns
    assert survey(hall, FAR).left_out < 0.2 * reached


def test_ways_do_not_lead_through_what_is_left_out() -> None:
    occupancy, costs = grids(plain())
    square = ((0.0, 0.0), (12.0, 0.0), (12.0, 6.0), (0.0, 6.0))
    fence = Fence(FenceConfig(boundary=square, open_reach=100.0))
    fence.update(occupancy, START)
    inside = fence.inside(costs, START)
    assert (inside.data[:, 125:280] == COST_LETHAL).all()
    assert np.array_equal(inside.data[:, 15:115], costs.data[:, 15:115])
    assert fence.inside(costs, SE2(20.0, 3.0)) is costs, "a robot that stands beyond must find its way back"


def test_a_costmap_that_is_larger_than_the_map_is_masked_where_the_map_lies() -> None:
    occupancy, costs = grids(plain())
    wide = np.full((80, 340), 7, np.uint8)
    wide[10:70, 20:320] = costs.data
    wider = CostGrid(0, "map", GridSpec(0.1, 340, 80, -2.0, -1.0), wide)
    fence = Fence(FenceConfig(radius=5.0, structure_reach=0.0))
    fence.update(occupancy, START)
    masked, plainly = fence.inside(wider, START).data, fence.inside(costs, START).data
    assert np.array_equal(masked[10:70, 20:320], plainly)
    assert (masked[:10] == 7).all()


def test_the_whole_map_may_lie_inside() -> None:
    occupancy, costs = grids(corridor())
    fence = Fence(FAR)
    fence.update(occupancy, START)
    assert fence.inside(costs, START) is costs
    assert (fence.sides_of(np.arange(100)) == Side.INSIDE).all()


def test_a_map_without_any_surface_is_beyond() -> None:
    nothing = OccupancyGrid(0, "map", GridSpec(0.1, 50, 50, 0.0, 0.0), np.zeros((50, 50), np.int8))
    fence = Fence(FenceConfig())
    fence.update(nothing, START)
    assert (fence.sides_of(np.arange(2500)) == Side.BEYOND_STRUCTURE).all()


def test_points_in_a_polygon() -> None:
    star = tuple(
        ((2.0 if k % 2 else 1.0) * math.cos(k * math.pi / 5), (2.0 if k % 2 else 1.0) * math.sin(k * math.pi / 5))
        for k in range(10)
    )
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.5, 2.5, (500, 2))
    angle, radius = np.arctan2(points[:, 1], points[:, 0]) % (2 * math.pi), np.hypot(points[:, 0], points[:, 1])
    k = (angle // (math.pi / 5)).astype(int)
    a, b = np.array(star)[k], np.array(star)[(k + 1) % 10]
    cross = (b[:, 0] - a[:, 0]) * (points[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (points[:, 0] - a[:, 0])
    assert np.array_equal(is_inside(star, points[:, 0], points[:, 1]), cross > 0)
    assert radius.max() > 2.0


def test_a_fence_that_means_nothing_is_refused() -> None:
    with pytest.raises(BadInputError, match="three corners"):
        FenceConfig(boundary=((0.0, 0.0), (1.0, 1.0)))
    with pytest.raises(BadInputError, match="negative"):
        replace(FenceConfig(), radius=-1.0)
