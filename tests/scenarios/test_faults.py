"""A scenario per fault: nothing is touched, and the run ends well, or with a name for what was wrong."""

from pathlib import Path

import numpy as np
import pytest

from ambler.apps.judgement import judge
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.messages import PointCloud
from ambler.evaluation.exploration_run import read_exploration
from ambler.runtime.topics import MOVERS
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import read_recording
from tests.scenarios.conftest import explore

DOOR = 3.5  # metres, x of the door of `two_rooms` in the map frame


def run(
    folder: Path, faults: tuple[str, ...], robot: str = "diff", time_limit: float = 150.0, seed: int = 0
) -> SimulatedRun:
    options = RunOptions(world="two_rooms", robot=robot, port=None, time_limit=time_limit, faults=faults, seed=seed)
    return explore(folder / "run", options)


def assert_it_stood(demo: SimulatedRun, begin: float, end: float) -> None:
    """It had been driving before `begin`, came to rest within 1.2 s, and stood until `end` (seconds)."""
    record = read_exploration(demo.folder.recording)
    seconds = record.true_stamps_ns * 1e-9
    assert record.speeds[seconds < begin].max() > 0.3
    assert record.speeds[(seconds >= begin + 1.2) & (seconds < end)].max() < 0.02


def test_a_silent_scanner_stops_the_robot_and_the_run_goes_on_afterwards(tmp_path: Path) -> None:
    demo = run(tmp_path, ("scanner_dropout:15:19",))
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert fields["coverage_ratio"] >= 0.97
    assert fields["ate_rms_m"] <= 0.10
    assert_it_stood(demo, 15.0, 19.0)
    assert "STALE_POINTS" in demo.folder.log.read_text()


def test_a_scanner_that_stays_silent_is_named(tmp_path: Path) -> None:
    demo = run(tmp_path, ("scanner_dropout:15",), time_limit=40.0)
    assert judge(demo).fields["collisions"] == 0
    assert demo.ended == "stuck"
    assert "STALE_POINTS: no fresh scan or cloud from laser" in demo.text
    assert 25.0 < demo.run_seconds < 35.0
    assert_it_stood(demo, 15.0, 40.0)
    assert "STALE_POINTS: no fresh scan or cloud from laser" in demo.folder.log.read_text()


def test_a_stuck_scanner_is_found_and_named(tmp_path: Path) -> None:
    demo = run(tmp_path, ("scanner_stuck:15:19",))
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert fields["coverage_ratio"] >= 0.97
    assert fields["ate_rms_m"] <= 0.10
    assert_it_stood(demo, 15.3, 19.0)
    assert "SCANNER_STUCK" in demo.folder.log.read_text()
    movers = [m.decode_as(PointCloud) for m in read_recording(demo.folder.recording, [MOVERS.ros_name])]
    assert not any(len(cloud.points) for cloud in movers), "walls that turn with a stuck scanner are nobody who walks"


@pytest.mark.slow
def test_one_silent_scanner_of_three_stops_the_robot(tmp_path: Path) -> None:
    demo = run(tmp_path, ("scanner_dropout@rear_left:42:46",), robot="amr_omni")
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert_it_stood(demo, 42.0, 46.0)
    text = demo.folder.log.read_text()
    assert "STALE_POINTS: no fresh scan or cloud from rear_left" in text
    assert "SCANNER_STALE" in text, "the merger names it, too"


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["diff", "amr_omni"])
def test_slipping_wheels_only_cost_accuracy(robot: str, tmp_path: Path) -> None:
    demo = run(tmp_path, ("wheel_slip:4:20",), robot)
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert fields["coverage_ratio"] >= 0.98
    assert fields["ate_rms_m"] <= 0.10


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["diff", "amr_omni"])
def test_late_stamps_only_cost_accuracy(robot: str, tmp_path: Path) -> None:
    demo = run(tmp_path, ("delayed_stamps@all:4:25",), robot)
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert fields["coverage_ratio"] >= 0.95
    assert fields["ate_rms_m"] <= 0.25


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["diff", "amr_omni"])
def test_people_who_cross_are_never_touched(robot: str, tmp_path: Path) -> None:
    """Three people who walk to and fro on 35 m² are nearer than two metres nearly all the time, and half of them yield to nobody: whether a robot ends in time is their luck
    (`eval crowd` counts that where there is room). It touches nobody that it need not touch, and gets on where they let it."""
    demo = run(tmp_path, ("people",), robot)
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended in ("finished", "time_limit")
    assert fields["coverage_ratio"] >= 0.7
    assert fields["path_length_m"] >= 3.0


def x_over_time(demo: SimulatedRun) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and true x (m, map frame) of the base."""
    record = read_exploration(demo.folder.recording)
    return record.true_stamps_ns * 1e-9, record.true_poses[:, 0]


@pytest.mark.slow
def test_a_door_that_closes_leaves_a_room_out_and_the_end_is_proved(tmp_path: Path) -> None:
    demo = run(tmp_path, ("door:1",), "diff")
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert 0.5 < fields["coverage_ratio"] < 0.8, "the first room, and what was seen through the door before it shut"
    assert fields["is_home"]
    assert x_over_time(demo)[1].max() < DOOR - 0.25, "it never stood in the doorway"


@pytest.mark.slow
def test_a_door_that_closes_behind_the_robot_is_a_named_end(tmp_path: Path) -> None:
    """What moved by a metre may be somebody for a minute, and people are waited for until a minute after that."""
    demo = run(tmp_path, ("door:30",), "diff", time_limit=300.0)
    fields = judge(demo).fields
    seconds, x = x_over_time(demo)
    assert x[seconds >= 30.0].min() > DOOR + 0.25, "it was in the second room and did not force the door"
    assert fields["collisions"] == 0
    assert demo.ended == "return_failed"
    assert fields["coverage_ratio"] >= 0.97
    assert not fields["is_home"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_door_that_opens_again_is_waited_for(seed: int, tmp_path: Path) -> None:
    """Wherever the robot is when its way home is shut: it goes to where it sees the door."""
    demo = run(tmp_path, ("door:30:75",), "diff", seed=seed)
    fields = judge(demo).fields
    seconds, x = x_over_time(demo)
    assert x[(seconds >= 30.0) & (seconds < 75.0)].min() > DOOR + 0.25
    assert "the way home is shut" in demo.folder.log.read_text()
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert abs(x[-1]) < 0.2, "home, 5 m behind the door"


@pytest.mark.slow
def test_a_scanner_that_is_dead_from_the_start_keeps_the_robot_standing(tmp_path: Path) -> None:
    demo = run(tmp_path, ("scanner_dropout@front_left",), "amr_omni", time_limit=15.0)
    assert judge(demo).fields["collisions"] == 0
    assert read_exploration(demo.folder.recording).speeds.max() < 0.02
    assert "STALE_POINTS: no fresh scan or cloud from front_left" in demo.folder.log.read_text()


@pytest.mark.slow
def test_panes_are_kept_off_with_a_ring_and_without(tmp_path: Path) -> None:
    """Without a ring the gate knows a pane by its light."""
    panes = {solid.name for solid in load_world("glass").solids if solid.is_glass}

    def touched(robot: str) -> list[str]:
        options = RunOptions(world="glass", robot=robot, port=None, time_limit=90.0)
        demo = explore(tmp_path / robot, options)
        return [c.other_geom for c in read_exploration(demo.folder.recording).contacts]

    assert not set(touched("diff")) & panes
    assert touched("diff+ultrasonic") == []


@pytest.mark.slow
def test_a_robot_with_a_ring_explores_beside_panels_of_glass(tmp_path: Path) -> None:
    demo = run(tmp_path, ("glass",), "diff+ultrasonic", time_limit=300.0)
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert fields["coverage_ratio"] >= 0.95
