"""Random goals lie where the robot can stand and get to; drives are judged by the truth of a recording."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ambler.bridges.recorder import Recorder
from ambler.core.errors import BadInputError
from ambler.core.messages import Contact, Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.goals import MARGIN, Drive, DriveSpan, draw_goals, judge_drives
from ambler.evaluation.truth_frame import TruthFrame
from ambler.runtime.topics import CONTACT, TRUE_POSE
from ambler.sim.robots import robot_named
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.studies.navigation_study import is_reached, summarize

UNKNOWN = (np.zeros((6, 6)), np.zeros((6, 6)))


def walled(half: float, extra: tuple[Solid, ...] = ()) -> WorldSpec:
    """A room of 2 `half` metres, beside it a closed one of the same size."""
    walls = [(half, 0.0, 0.1, 2 * half), (-half, 0.0, 0.1, 2 * half), (3 * half, 0.0, 0.1, 2 * half)]
    walls += [(half, half, 4 * half, 0.1), (half, -half, 4 * half, 0.1)]
    solids = tuple(Solid(f"w{k}", Shape.BOX, SE2(x, y, 0.0), a, b, 0.0, 2.0) for k, (x, y, a, b) in enumerate(walls))
    return WorldSpec("walled", solids + extra, SE2())


def test_goals_keep_the_footprint_off_the_walls_and_spread_over_the_room() -> None:
    robot = robot_named("diff")
    goals = draw_goals(walled(3.0), robot, 400, np.random.default_rng(4))
    x, y, yaw = (np.array([getattr(g, name) for g in goals]) for name in ("x", "y", "yaw"))
    room = 3.0 - 0.05 - robot.model.circumscribed_radius - 0.5 * MARGIN  # cells are known to half a cell
    assert max(np.abs(x).max(), np.abs(y).max()) < room
    for quarter in (x > 0, x < 0, y > 0, y < 0):
        assert 0.4 < quarter.mean() < 0.6
    assert np.abs(x).max() > 0.95 * room
    assert yaw.min() < -3.0
    assert yaw.max() > 3.0


def test_fewer_goals_are_the_first_of_more() -> None:
    robot, world = robot_named("diff"), walled(3.0)
    many, few = (draw_goals(world, robot, n, np.random.default_rng(1)) for n in (30, 7))
    assert many[:7] == few


def test_a_robot_that_is_walled_in_has_no_goal() -> None:
    with pytest.raises(BadInputError, match="cannot get anywhere"):
        draw_goals(walled(0.35), robot_named("amr_omni"), 3, np.random.default_rng(0))


START = SE2(3.0, -2.0, 2.5)  # of the drawn map in the world


def record(folder: Path) -> Path:
    """Drive 2 m along x of the drawn map within 4 s to each of two goals, touching something at 0.5 m/s in between."""
    recorder = Recorder(folder)
    for k in range(81):
        stamp_ns = k * 100_000_000
        true_pose = SE3.from_se2(START @ SE2(0.05 * k, 0.0, 0.0))
        pose = Odometry(stamp_ns, "world", "base", true_pose, (0.5, 0.0, 0.0), (0.0,) * 3, *UNKNOWN)
        recorder.on_message(TRUE_POSE, pose, stamp_ns)
        if k == 60:
            recorder.on_message(CONTACT, Contact(stamp_ns, "body", "wall", (0.0, 0.0, 0.0), 0.5, 10.0), stamp_ns)
    recorder.close()
    return recorder.folder


def test_drives_are_judged_by_the_truth(tmp_path: Path) -> None:
    middle, end = 4_000_000_000, 8_000_000_000
    spans = [
        DriveSpan(SE2(2.05, 0.0, 0.0), "SUCCEEDED", 0, middle),
        DriveSpan(SE2(4.0, 0.5, 0.0), "NO_VALID_PATH", middle, end),
    ]
    drives, collisions = judge_drives(record(tmp_path / "r"), spans, TruthFrame(START))
    assert collisions == 1
    assert [d.code for d in drives] == ["SUCCEEDED", "NO_VALID_PATH"]
    assert [d.path_length for d in drives] == pytest.approx([2.0, 2.0])
    assert [d.seconds for d in drives] == pytest.approx([4.0, 4.0])
    assert [d.speed for d in drives] == pytest.approx([0.5, 0.5])
    assert [d.error for d in drives] == pytest.approx([0.05, 0.5])


def test_a_goal_counts_only_when_the_truth_agrees() -> None:
    near = {"code": "SUCCEEDED", "seconds": 9.0, "path_length": 3.0, "speed": 0.5, "error": 0.1}
    far, failed, unknown = near | {"error": 0.5}, near | {"code": "NO_VALID_PATH"}, near | {"error": math.nan}
    assert set(near) == set(Drive.__slots__)
    assert [is_reached(d) for d in (near, far, failed, unknown)] == [True, False, False, False]
    journey = {
        "goals": 5,
        "collisions": 1,
        "sim_seconds": 40.0,
        "run_seconds": 10.0,
        "cpu_seconds": 5.0,
        "ended": "time_limit",
    }
    fields = summarize([journey | {"drives": [near, far, failed, unknown]}])
    assert (fields["goals"], fields["reached"], fields["collisions"]) == (5, 1, 1)
    assert fields["failures"] == "NO_VALID_PATH,time_limit"
    assert fields["real_time_factor"] == pytest.approx(4.0)
    assert fields["sim_seconds_per_cpu_second"] == pytest.approx(8.0)
    assert fields["drive_mean_s"] == pytest.approx(9.0)
