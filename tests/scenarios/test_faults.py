"""A scenario per fault: nothing is touched, and the run ends well, or with a name for what was wrong."""

from pathlib import Path

import pytest

from ambler.apps.demo import Demo, DemoOptions
from ambler.apps.demo_report import judge
from ambler.evaluation.exploration_run import read_exploration
from tests.scenarios.conftest import explore

TWO_ROOMS = """
start: {x: 1.5, y: 2.5, yaw_deg: 0}
walls:
  - {from: [0, 0], to: [9, 0]}
  - {from: [9, 0], to: [9, 5]}
  - {from: [9, 5], to: [0, 5]}
  - {from: [0, 5], to: [0, 0]}
  - {from: [5, 0], to: [5, 5], doors: [{at: 1.6, width: 1.4}]}
boxes:
  - {name: crate, center: [3.2, 4.0], size: [0.6, 0.6, 1.0], yaw_deg: 20}
  - {name: crate, center: [7.4, 3.2], size: [0.5, 0.8, 1.0]}
"""


def run(folder: Path, faults: tuple[str, ...], robot: str = "diff", time_limit: float = 150.0) -> Demo:
    world = folder / "two_rooms.yaml"
    world.write_text(TWO_ROOMS)
    options = DemoOptions(world=str(world), robot=robot, port=None, time_limit=time_limit, faults=faults)
    return explore(folder / "run", options)


def assert_it_stood(demo: Demo, begin: float, end: float) -> None:
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
    demo = run(tmp_path, ("scanner_dropout:15",), time_limit=30.0)
    assert judge(demo).fields["collisions"] == 0
    assert demo.ended != "finished"
    assert_it_stood(demo, 15.0, 30.0)
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
@pytest.mark.parametrize(("robot", "coverage"), [("diff", 0.95), ("amr_omni", 0.85)])
def test_people_who_cross_are_never_touched(robot: str, coverage: float, tmp_path: Path) -> None:
    """Where somebody stood the map may have a smear; the large robot must keep away from it."""
    demo = run(tmp_path, ("people",), robot)
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert fields["coverage_ratio"] >= coverage


@pytest.mark.slow
def test_a_door_that_closes_leaves_a_room_out_and_the_end_is_proved(tmp_path: Path) -> None:
    demo = run(tmp_path, ("door:1",), "diff")
    fields = judge(demo).fields
    assert fields["collisions"] == 0
    assert demo.ended == "finished"
    assert 0.4 < fields["coverage_ratio"] < 0.8, "the second room stays unknown"


@pytest.mark.slow
def test_a_door_that_closes_behind_the_robot_is_a_named_end(tmp_path: Path) -> None:
    """The way home is shut: the robot says so, or comes home when it opens; it does not force the door."""
    demo = run(tmp_path, ("door:34:55",), "diff")
    assert judge(demo).fields["collisions"] == 0
    assert demo.ended in ("finished", "return_failed")


@pytest.mark.slow
def test_a_scanner_that_is_dead_from_the_start_keeps_the_robot_standing(tmp_path: Path) -> None:
    demo = run(tmp_path, ("scanner_dropout@front_left",), "amr_omni", time_limit=15.0)
    assert judge(demo).fields["collisions"] == 0
    assert read_exploration(demo.folder.recording).speeds.max() < 0.02
    assert "STALE_POINTS: no fresh scan or cloud from front_left" in demo.folder.log.read_text()


@pytest.mark.slow
def test_glass_is_not_known_to_lasers_but_touched_slowly_at_worst(tmp_path: Path) -> None:
    """Without a sensor for glass there may be contacts; the specular returns near square hold the robot back."""
    demo = run(tmp_path, ("glass",), "diff", time_limit=60.0)
    assert all(c.other_geom.endswith("_glass") and c.speed < 0.5 for c in judge(demo).collisions)
