"""Robots on ground that is not level: what they are told by default, and a short run that maps a ramp."""

from __future__ import annotations

import json
import math

import pytest

from ambler.apps.config import robot_config
from ambler.apps.scene import RunOptions, checked_scene
from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.missions.recovery import RecoveryAction
from ambler.nodes.steps import NavigateStep
from ambler.sim.robots import robot_named
from ambler.wire.ground_files import load_levels


def test_where_the_ground_is_not_level_a_robot_that_can_maps_it_and_its_gate_takes_slopes():
    config = checked_scene(RunOptions(world="ramp", robot="go2")).config
    assert (config.mapping, config.odometry_source) == ("ground", "lidar")
    go2 = robot_named("go2").model
    assert config.gate_for(go2).slope == pytest.approx(math.tan(config.ground.steep))
    assert config.global_costmap.inflation.inscribed_radius > go2.inscribed_radius + 0.2
    assert config.survey.min_size == pytest.approx(2.0 * config.global_costmap.inflation.inscribed_radius)
    assert min(config.planner.way_out, config.visibility.way_out) > 2.0
    actions = {step.action for step in config.navigation.recoveries}
    assert RecoveryAction.BACK_UP not in actions, "it does not see where it backs up to"
    assert RecoveryAction.ROTATE in actions


@pytest.mark.parametrize(
    ("world", "robot", "profile"),
    [("office", "go2", {}), ("ramp", "diff", {}), ("ramp", "go2", {"mapping": "scans", "odometry_source": "wheels"})],
)
def test_elsewhere_and_where_it_is_told_otherwise_it_maps_scans(world, robot, profile):
    config = checked_scene(RunOptions(world=world, robot=robot, profile=profile)).config
    assert (config.mapping, config.odometry_source) == ("scans", "wheels")
    assert config.gate_for(robot_named(robot).model).slope == 0.0


def test_a_known_map_is_driven_in_as_before():
    steps = (NavigateStep(SE2(1.0, 0.0, 0.0)),)
    assert checked_scene(RunOptions(steps, world="ramp", robot="go2")).config.mapping == "scans"


def test_a_map_of_ground_without_what_it_needs_is_refused():
    spot = robot_named("spot").model
    with pytest.raises(BadInputError, match="odometry_source lidar"):
        robot_config(spot, {"mapping": "ground"}).check_odometry(spot)


def test_a_robot_maps_the_ground_of_a_ramp(tmp_path):
    """Some seconds of an exploration: what it holds of the ground is ground, where it lies, and it touches nothing."""
    result = tmp_path / "result.json"
    words = [
        "demo",
        "--world",
        "ramp",
        "--robot",
        "mecanum",
        "--kinematic",
        "--time-limit",
        "12",
        "--exit",
        "--no-view",
    ]
    main([*words, "--out", str(tmp_path / "runs"), "--json", str(result)])
    told = json.loads(result.read_text())
    assert told["ended"] == "time_limit"
    assert told["collisions"] == 0
    assert told["false_free_ratio"] < 0.02
    assert 0.02 < told["reachable_coverage_ratio"] <= 1.0
    assert told["ate_unaligned_max_m"] < 0.2
    assert told["known_tour_m"] > 10.0
    (levels,) = (tmp_path / "runs").glob("2*/map.levels.npz")
    assert len(load_levels(levels)) == told["levels"] == 1
