"""What is counted of a robot that does not know where it is: when it noticed, when it was right again, and what it told wrongly."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.messages import Odometry, Status
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.runtime.topics import LOCALIZED_POSE, STATUS
from ambler.studies.lost_robot import FoundAgain, _Watch

S = 1_000_000_000
HERE = SE2(3.0, -2.0, math.pi - 0.02)  # beside the cut of the heading
WRONG_XY, WRONG_YAW = HERE @ SE2(0.4, 0.0, 0.0), HERE @ SE2(0.0, 0.0, 0.3)


class Executor:
    """Notes that it was stopped."""

    is_stopped = False

    def stop(self) -> None:
        self.is_stopped = True


class Story:
    """A watch of a robot that stands at HERE; everything is told in seconds."""

    def __init__(self, jump: float = 0.0) -> None:
        truth = [(round(0.1 * k * S), HERE) for k in range(400)]
        self.watch, self.executor = _Watch(truth, round(jump * S)), Executor()
        self.watch.executor = self.executor  # type: ignore[assignment]

    def pose(self, seconds: float, pose: SE2) -> None:
        covariance = np.eye(6)
        zero = (0.0, 0.0, 0.0)
        stamp = round(seconds * S)
        told = Odometry(stamp, "map", "base", SE3.from_se2(pose), zero, zero, covariance, covariance)
        self.watch.on_message(LOCALIZED_POSE, told, stamp, "localization")

    def status(self, seconds: float, code: str, writer: str = "localization") -> None:
        stamp = round(seconds * S)
        self.watch.on_message(STATUS, Status(stamp, writer, code, ""), stamp, writer)

    @property
    def result(self) -> FoundAgain:
        return self.watch.result()


def test_poses_are_right_within_a_foot_and_a_few_degrees() -> None:
    for pose, wrong in (
        (HERE, 0),
        (HERE @ SE2(0.25, 0.0, 0.0), 0),
        (HERE @ SE2(0.0, 0.0, 0.05), 0),  # on the other side of 180 degrees
        (WRONG_XY, 1),
        (HERE @ SE2(0.0, -0.4, 0.0), 1),
        (WRONG_YAW, 1),
    ):
        story = Story()
        story.pose(1.0, pose)
        assert story.result.wrong == wrong
        assert (story.result.found is None) == (wrong == 1)


def test_a_found_pose_must_stay_right_for_a_second() -> None:
    story = Story()
    story.pose(2.0, HERE)
    assert story.result.found == pytest.approx(2.0, abs=0.5)  # and what thinking took
    story.pose(2.5, WRONG_XY)
    assert story.result.found is None, "it was luck"
    assert story.result.wrong == 1
    story.pose(4.0, HERE)
    story.pose(4.9, HERE)
    assert not story.executor.is_stopped
    story.pose(5.1, HERE)
    assert story.executor.is_stopped
    assert story.result.found == pytest.approx(4.0, abs=0.5)


def test_a_robot_that_was_carried_off_is_judged_from_its_first_doubt() -> None:
    story = Story(jump=5.0)
    story.pose(4.0, WRONG_XY)  # before it was carried away: does not matter
    story.status(4.5, "LOCALIZATION_LOST")
    assert story.result == FoundAgain(None, None, 0, "")
    story.pose(5.5, WRONG_XY)  # it has not noticed yet
    story.status(6.0, "LOCALIZATION_TRACKING")
    assert story.result.noticed is None
    assert story.result.wrong == 0
    story.status(6.5, "LOCALIZATION_LOST", writer="navigator")
    assert story.result.noticed is None, "somebody else's word"
    story.status(7.0, "LOCALIZATION_LOST")
    assert story.result.noticed == pytest.approx(2.0, abs=0.5)
    story.status(8.0, "LOCALIZATION_RELOCALIZING")
    assert story.result.noticed == pytest.approx(2.0, abs=0.5), "the first doubt counts"
    story.pose(9.0, WRONG_YAW)
    story.pose(9.5, HERE)
    assert story.result.wrong == 1
    assert story.result.found == pytest.approx(4.5, abs=0.5)
    assert story.result.last_state == "LOCALIZATION_RELOCALIZING"
