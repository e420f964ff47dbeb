"""From how far away a robot's LiDAR sees the floor ahead, and what an exploration makes of it."""

from __future__ import annotations

import math

import pytest

from ambler.apps.config import GROUND_PROFILE, robot_config
from ambler.core.robot import SensorKind, SensorMount
from ambler.core.se3 import SE3
from ambler.robots.catalog import robot_model


def mount(pitch: float, lowest: float, x: float = 0.0) -> SensorMount:
    return SensorMount(
        "lidar", SensorKind.CLOUD, SE3.from_rpy((x, 0.0, 1.0), 0.0, pitch, 0.0), elevation=(lowest, math.radians(50.0))
    )


@pytest.mark.parametrize(
    ("pitch", "lowest", "far"),
    [
        (0.0, -45.0, 1.0),
        (30.0, -15.0, 1.0),
        (0.0, 5.0, math.inf),
        (-30.0, -15.0, math.inf),
        (90.0, -7.0, 0.0),
        (-90.0, -7.0, math.inf),
    ],
)
def test_the_lowest_beam_ahead_meets_the_floor_there(pitch: float, lowest: float, far: float) -> None:
    assert mount(math.radians(pitch), math.radians(lowest)).sees_floor_from == pytest.approx(far)


def test_it_counts_from_the_base() -> None:
    assert mount(0.0, math.radians(-45.0), x=0.4).sees_floor_from == pytest.approx(1.4)


def test_a_mount_that_says_nothing_of_its_beams_sees_everything() -> None:
    assert SensorMount("lidar", SensorKind.CLOUD, SE3((0.0, 0.0, 1.0))).sees_floor_from == 0.0


@pytest.mark.parametrize(("name", "nearest"), [("mecanum", 5.05), ("go2", 0.85), ("spot", 2.81)])
def test_sites_are_looked_at_from_where_the_floor_is_in_sight(name: str, nearest: float) -> None:
    robot = robot_model(name)
    config = robot_config(robot, GROUND_PROFILE)
    assert config.survey.sees_floor[0] == pytest.approx(nearest + 0.2, abs=0.01)
    assert config.survey.assumed is not None
    assert robot_config(robot, {}).survey.sees_floor == (0.0, 0.0), (
        "on level floors, maps of scans have no assumed cells"
    )
