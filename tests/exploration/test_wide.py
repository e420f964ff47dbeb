"""Distances in wide places: coarse ones agree with fine ones, walls stay closed, and looks are as in narrow ones."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.grid import COST_INSCRIBED, GridSpec
from ambler.core.messages import CostGrid, OccupancyGrid
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.exploration.tour import TourConfig, TourStrategy
from ambler.exploration.wide import cropped, join, shrunk, spread
from ambler.planning.distance import distance_field

R = 0.05
FIELD = partial(distance_field, escape_radius=0.6)


def robot() -> RobotModel:
    square = 0.3 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    return RobotModel("r", DriveKind.DIFFERENTIAL, square, VelocityLimits())


def hall() -> tuple[GridSpec, NDArray[np.int8]]:
    """20 x 12 m with a thin wall across, one door of 1.2 m, a closed cell, and unknown ground on the right."""
    spec = GridSpec(R, 400, 240, 0.0, 0.0)
    cells = np.full(spec.shape, -1, np.int8)
    cells[5:235, 5:300] = 0
    cells[5, 5:300] = cells[234, 5:300] = 100
    cells[5:235, 5] = 100
    cells[5:235, 150] = 100
    cells[40:64, 150] = 0
    cells[160:220, 60] = cells[160:220, 110] = cells[160, 60:111] = cells[219, 60:111] = 100
    return spec, cells


def costs_of(spec: GridSpec, cells: NDArray[np.int8]) -> NDArray[np.uint8]:
    costmap = GlobalCostmap(GlobalCostmapConfig(), robot())
    return costmap.set_map(spec, cells)


def test_coarse_distances_agree_with_fine_ones_and_thin_walls_stay_closed() -> None:
    spec, cells = hall()
    costs, start = costs_of(spec, cells), SE2(2.0, 2.0)
    fine = FIELD(costs, spec, start)
    coarse, coarse_spec = shrunk(costs, spec, 0.2)
    wide = spread(FIELD(coarse, coarse_spec, start), 4, costs)
    assert wide.shape == fine.shape
    both = np.isfinite(fine) & np.isfinite(wide)
    assert np.count_nonzero(np.isfinite(fine) ^ np.isfinite(wide)) < 0.002 * fine.size
    assert np.abs(wide[both] - fine[both]).max() < 0.6
    assert np.isinf(wide[costs >= COST_INSCRIBED]).all()
    inside = spec.cell_of(4.2, 9.5)
    assert np.isinf(wide[inside]), "no way leads into the closed cell"


@pytest.mark.parametrize("door", [8, 10, 11, 12])
def test_what_lies_behind_a_door_that_is_a_little_too_narrow_is_not_reached(door: int) -> None:
    spec, cells = hall()
    cells[40:64, 150] = 100
    cells[41 : 41 + door, 150] = 0
    costs, start = costs_of(spec, cells), SE2(2.0, 2.0)
    fine = FIELD(costs, spec, start)
    coarse, coarse_spec = shrunk(costs, spec, 0.2)
    wide = spread(FIELD(coarse, coarse_spec, start), 4, costs)
    join(wide, costs, spec, start)
    behind = spec.cell_of(12.0, 2.5)
    assert np.isinf(fine[behind])
    assert np.isinf(wide[behind])
    np.testing.assert_array_equal(np.isfinite(wide), np.isfinite(fine))


def test_small_cells_are_left_as_they_are() -> None:
    costs, spec = np.zeros((4, 4), np.uint8), GridSpec(0.2, 4, 4, 0.0, 0.0)
    assert shrunk(costs, spec, 0.2)[0] is costs


@pytest.mark.parametrize(("margin", "shape"), [(1.0, (60, 80)), (100.0, (240, 400))])
def test_a_crop_holds_its_points_with_their_surroundings(margin: float, shape: tuple[int, int]) -> None:
    spec, cells = hall()
    costs = costs_of(spec, cells)
    points = np.array([[5.0, 6.0], [7.0, 7.0]])
    part, part_spec = cropped(costs, spec, points, margin)
    assert part.shape == part_spec.shape == shape
    for x, y in points:
        assert part[part_spec.cell_of(x, y)] == costs[spec.cell_of(x, y)]


def test_a_survey_of_a_wide_place_finds_what_one_of_a_narrow_place_does() -> None:
    spec, cells = hall()
    occupancy = OccupancyGrid(1, "map", spec, cells)
    costs = CostGrid(1, "map", spec, costs_of(spec, cells))
    narrow, wide = (
        FrontierSurvey(SurveyConfig(wide_cells=limit), FIELD).update(occupancy, costs, SE2(2.0, 2.0))
        for limit in (10**9, 0)
    )
    assert narrow.open == wide.open
    assert len(narrow.open) > 0
    for a, b in zip(narrow.frontiers, wide.frontiers, strict=True):
        assert a.state is b.state
        if math.isfinite(a.path_distance):
            assert b.path_distance == pytest.approx(a.path_distance, abs=0.6)


def test_a_tour_takes_fewer_places_where_they_lie_far_apart() -> None:
    spec, cells = hall()
    for y in range(20, 220, 24):
        cells[y : y + 8, 299:301] = 100  # many openings on the right
    occupancy, costs = OccupancyGrid(1, "map", spec, cells), CostGrid(1, "map", spec, costs_of(spec, cells))
    config = SurveyConfig(min_size=0.1, min_gain=0.01)
    survey = FrontierSurvey(config, FIELD).update(occupancy, costs, SE2(8.0, 6.0))
    assert len(survey.open) > 4
    fields = 0

    def counted(*args: object) -> NDArray[np.float32]:
        nonlocal fields
        fields += 1
        return FIELD(*args)  # type: ignore[arg-type]

    all_costs = TourStrategy(counted).costs(survey, SE2(8.0, 6.0))
    assert fields == len(survey.open) - 1
    fields = 0
    few = TourStrategy(counted, TourConfig(exact_places=3, work=1.0)).costs(survey, SE2(8.0, 6.0))
    assert fields == 2
    assert len(few) == len(all_costs) == len(survey.open)
    nearest = np.argsort([survey.frontiers[i].path_distance for i in survey.open])[:3]
    assert int(np.argmin(few)) in nearest
