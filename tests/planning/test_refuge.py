"""Where a robot stands aside: off somebody's way, in the nearest niche that takes it, and never behind him."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ambler.core.grid import COST_INSCRIBED, COST_LETHAL, GridSpec
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.planning.refuge import RefugeConfig, Walk, find_refuge
from ambler.robots.catalog import robot_model

SPEC = GridSpec(0.05, 400, 160, 0.0, 0.0)
LOW, HIGH = 3.0, 5.05  # the walls of the corridor, metres
MIDDLE = 0.5 * (LOW + HIGH)
NOBODY_WALKED = np.zeros((0, 2))


def corridor(robot: RobotModel, *doors: tuple[float, float]) -> NDArray[np.uint8]:
    """A corridor along x with a room of 2 m behind doors of so many metres (x, width) in its upper wall."""
    walls = np.ones(SPEC.shape, np.bool_)
    walls[round(LOW / 0.05) : round(HIGH / 0.05)] = False
    for x, width in doors:
        left, right = round((x - width / 2) / 0.05), round((x + width / 2) / 0.05)
        walls[round(HIGH / 0.05) : 105, left:right] = False
        walls[105:145, left - 20 : right + 20] = False
    near = distance_transform_edt(~walls) * 0.05 < robot.inscribed_radius
    return np.where(walls, COST_LETHAL, np.where(near, COST_INSCRIBED, 0)).astype(np.uint8)


def walk_from(x: float, y: float = MIDDLE, places: NDArray[np.float64] = NOBODY_WALKED) -> Walk:
    """Somebody at x who comes along the corridor from its right end."""
    return Walk((x, y), (-1.0, 0.0), places)


def outline(robot: RobotModel, pose: SE2) -> NDArray[np.float64]:
    return pose.transform(np.asarray(robot.footprint))


@pytest.mark.parametrize("name", ["amr_omni", "spot", "diff"])
def test_the_nearest_door_is_taken_and_leaves_him_his_way(name: str) -> None:
    robot = robot_model(name)
    costs = corridor(robot, (4.0, 1.3), (10.0, 1.3))
    refuge = find_refuge(costs, SPEC, SE2(12.0, MIDDLE, 0.0), robot, walk_from(13.5))
    assert refuge is not None
    corners = outline(robot, refuge)
    assert corners[:, 1].min() - MIDDLE >= RefugeConfig().enough - 1e-6, "with room to spare: it is worth the detour"
    assert abs(refuge.x - 10.0) < 1.5
    cells = SPEC.cells_of(corners)
    assert (costs[cells[:, 0], cells[:, 1]] != COST_LETHAL).all()


def test_a_narrow_robot_stands_at_the_wall_where_there_is_no_niche() -> None:
    robot = robot_model("diff")
    refuge = find_refuge(corridor(robot), SPEC, SE2(12.0, MIDDLE, 0.0), robot, walk_from(13.5))
    assert refuge is not None
    assert np.abs(outline(robot, refuge)[:, 1] - MIDDLE).min() >= RefugeConfig().least - 1e-6
    assert (
        find_refuge(corridor(robot), SPEC, SE2(12.0, MIDDLE, 0.0), robot, walk_from(13.5), RefugeConfig(least=0.9))
        is None
    )


def test_a_wide_robot_has_no_place_in_a_corridor_without_niches() -> None:
    robot = robot_model("amr_omni")
    assert find_refuge(corridor(robot), SPEC, SE2(12.0, MIDDLE, 0.0), robot, walk_from(13.5)) is None


def test_no_niche_behind_him_nor_too_far_away_counts() -> None:
    robot = robot_model("amr_omni")
    at = SE2(12.0, MIDDLE, 0.0)
    assert find_refuge(corridor(robot, (16.0, 1.3)), SPEC, at, robot, walk_from(13.5)) is None, "only through him"
    far = corridor(robot, (3.0, 1.3))
    assert find_refuge(far, SPEC, at, robot, walk_from(13.5), RefugeConfig(reach=6.0)) is None
    assert find_refuge(far, SPEC, at, robot, walk_from(13.5), RefugeConfig(reach=14.0)) is not None


def test_a_door_that_is_too_narrow_is_none() -> None:
    robot = robot_model("amr_omni")
    refuge = find_refuge(corridor(robot, (10.0, 0.7), (5.0, 1.2)), SPEC, SE2(12.0, MIDDLE, 0.0), robot, walk_from(13.5))
    assert refuge is not None
    assert abs(refuge.x - 5.0) < 1.5


def test_where_people_walked_lately_is_no_refuge() -> None:
    robot = robot_model("amr_omni")
    costs = corridor(robot, (10.0, 1.3), (4.0, 1.3))
    into_room = np.column_stack((np.full(20, 10.0), np.linspace(MIDDLE, 7.0, 20)))
    walk = walk_from(13.5, places=into_room)
    refuge = find_refuge(costs, SPEC, SE2(12.0, MIDDLE, 0.0), robot, walk, RefugeConfig(reach=14.0))
    assert refuge is not None
    assert abs(refuge.x - 4.0) < 1.5


def test_at_the_edge_of_a_map_nothing_is_searched_beyond_it() -> None:
    robot = robot_model("diff")
    refuge = find_refuge(corridor(robot, (1.5, 1.3)), SPEC, SE2(0.6, MIDDLE, math.pi), robot, walk_from(2.8))
    assert refuge is not None
    assert SPEC.contains(refuge.x, refuge.y)
    walled_in = np.full(SPEC.shape, COST_LETHAL, np.uint8)
    assert find_refuge(walled_in, SPEC, SE2(12.0, MIDDLE, 0.0), robot, walk_from(13.5)) is None
