"""Prediction from odometry, gyroscope or the last motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ambler.core.se2 import SE2
from ambler.slam2d.extrapolator import PoseExtrapolator

MS = 1_000_000
TWISTS = st.tuples(st.floats(-1, 1), st.floats(-0.5, 0.5), st.floats(-1.5, 1.5)).map(np.array)


def close(a: SE2, b: SE2, tolerance: float = 1e-7) -> bool:
    return bool(np.abs((a.inverse() @ b).as_array()).max() < tolerance)


def test_nothing_known_predicts_the_origin() -> None:
    prediction = PoseExtrapolator().predict(5)
    assert prediction.local_from_base == SE2()
    assert not prediction.is_measured
    one = PoseExtrapolator()
    one.add_matched(100 * MS, SE2(1.0, 2.0, 0.5))
    assert close(one.predict(200 * MS).local_from_base, SE2(1.0, 2.0, 0.5))


@given(TWISTS)
def test_without_odometry_the_last_motion_continues_along_its_arc(twist: np.ndarray) -> None:
    extrapolator, start = PoseExtrapolator(), SE2(1.0, -2.0, 3.0)
    for k in range(2):
        extrapolator.add_matched(k * 100 * MS, start @ SE2.exp(0.1 * k * twist))
    prediction = extrapolator.predict(250 * MS)
    assert close(prediction.local_from_base, start @ SE2.exp(0.25 * twist))
    assert close(prediction.steady_pose, prediction.local_from_base)
    assert not prediction.is_measured
    assert extrapolator.twist(100 * MS, 0.1) == pytest.approx(twist, abs=1e-7)
    # A late scan: no more than twice the last motion, and none after a long pause.
    assert close(extrapolator.predict(600 * MS).motion, SE2.exp(0.2 * twist))
    assert close(extrapolator.predict(1200 * MS).motion, SE2())


@given(TWISTS, st.integers(110, 290))
def test_odometry_is_interpolated_and_carried_from_the_last_match(twist: np.ndarray, stamp_ms: int) -> None:
    extrapolator, odom, local = PoseExtrapolator(), SE2(5.0, 5.0, -2.0), SE2(0.3, 0.4, 1.0)
    for k in range(7):
        extrapolator.add_odometry(k * 50 * MS, odom @ SE2.exp(0.05 * k * twist))
    extrapolator.add_matched(0, local)
    extrapolator.add_matched(110 * MS, local)  # the matches stand still: odometry counts
    prediction = extrapolator.predict(stamp_ms * MS)
    assert prediction.is_measured
    assert close(prediction.local_from_base, local @ SE2.exp((stamp_ms - 110) * 1e-3 * twist))
    assert close(prediction.steady_pose, local)
    assert extrapolator.twist(100 * MS, 0.1) == pytest.approx(twist, abs=1e-7)
    at = extrapolator.odom_from_base(stamp_ms * MS)
    assert at is not None
    assert close(at, odom @ SE2.exp(stamp_ms * 1e-3 * twist))


@given(TWISTS)
def test_two_scanners_of_one_instant_continue_the_motion_between_instants(twist: np.ndarray) -> None:
    """Their stamps lie a microsecond apart; taken for a motion in that time, they had predicted that the robot stands."""
    extrapolator = PoseExtrapolator()
    for k in range(3):
        for behind in (0, 1000):
            extrapolator.add_matched(k * 100 * MS + behind, SE2.exp(0.1 * k * twist))
    assert close(extrapolator.predict(300 * MS).local_from_base, SE2.exp(0.3 * twist), 1e-4)
    extrapolator.add_matched(300 * MS, SE2.exp(0.3 * twist))
    assert close(extrapolator.predict(300 * MS + 1000).local_from_base, SE2.exp(0.3 * twist), 1e-4)


@given(TWISTS)
def test_a_wrong_twist_is_forgotten_however_long_the_sweep_takes(twist: np.ndarray) -> None:
    """A scan that is straightened with it fits where its middle beams are right; its first beam, to which the pose belongs, is off by half a sweep."""
    extrapolator, start = PoseExtrapolator(), SE2(1.0, -2.0, 3.0)
    for k in range(6):
        told = extrapolator.twist(k * 100 * MS, 0.1)
        matched = start @ SE2.exp((0.1 * k + 0.05) * twist) @ SE2.exp(-0.05 * told)
        assert k < 2 or close(extrapolator.predict(k * 100 * MS).local_from_base, start @ SE2.exp(0.1 * k * twist))
        extrapolator.add_matched(k * 100 * MS, matched)
    assert told == pytest.approx(twist, abs=1e-7)


def test_odometry_that_ended_is_not_used() -> None:
    extrapolator = PoseExtrapolator()
    extrapolator.add_odometry(0, SE2())
    extrapolator.add_odometry(100 * MS, SE2(0.1, 0.0, 0.0))
    extrapolator.add_matched(100 * MS, SE2())
    assert extrapolator.predict(390 * MS).is_measured
    assert close(extrapolator.predict(390 * MS).motion, SE2(0.29, 0.0, 0.0))
    assert not extrapolator.predict(500 * MS).is_measured
    assert extrapolator.odom_from_base(500 * MS) is None


def test_the_gyroscope_replaces_the_rotation_only() -> None:
    extrapolator = PoseExtrapolator()
    for k in range(30):
        extrapolator.add_imu(k * 10 * MS, 0.8)
    extrapolator.add_odometry(0, SE2())
    extrapolator.add_odometry(200 * MS, SE2(0.2, 0.05, -0.3))
    extrapolator.add_matched(0, SE2())
    assert close(extrapolator.predict(200 * MS).motion, SE2(0.2, 0.05, 0.16))
    alone = PoseExtrapolator()
    for k in range(400):
        alone.add_imu(k * 10 * MS, 2.0)  # turns through pi and beyond
    alone.add_matched(3800 * MS, SE2(1.0, 0.0, math.pi))
    assert close(alone.predict(3950 * MS).local_from_base, SE2(1.0, 0.0, math.pi) @ SE2(0.0, 0.0, 0.3))


def test_stamps_that_do_not_increase_are_ignored() -> None:
    extrapolator = PoseExtrapolator()
    extrapolator.add_odometry(100 * MS, SE2(1.0, 0.0, 0.0))
    extrapolator.add_odometry(100 * MS, SE2(9.0, 0.0, 0.0))
    extrapolator.add_odometry(50 * MS, SE2(9.0, 0.0, 0.0))
    for k in range(4):
        extrapolator.add_imu(0 if k else 10 * MS, 1.0)
    assert extrapolator.odom_from_base(100 * MS) == SE2(1.0, 0.0, 0.0)


def test_odometry_bridges_a_long_silence_of_the_scanner() -> None:
    extrapolator, twist = PoseExtrapolator(), np.array([0.3, 0.0, 0.2])
    for k in range(600):
        extrapolator.add_odometry(k * 20 * MS, SE2.exp(0.02 * k * twist))
        if k == 50:
            extrapolator.add_matched(1000 * MS, SE2())
    prediction = extrapolator.predict(11_000 * MS)  # ten seconds later
    assert prediction.is_measured
    assert close(prediction.motion, SE2.exp(10.0 * twist))


def test_before_its_first_pose_there_is_no_odometry() -> None:
    extrapolator = PoseExtrapolator()
    extrapolator.add_matched(1000 * MS, SE2())
    extrapolator.add_odometry(9000 * MS, SE2(5.0, 5.0, 1.0))
    assert not extrapolator.predict(1100 * MS).is_measured, "one pose"
    extrapolator.add_odometry(9020 * MS, SE2(5.1, 5.0, 1.0))
    assert not extrapolator.predict(1100 * MS).is_measured
    assert extrapolator.odom_from_base(1100 * MS) is None
    # A scan shortly before the first of several poses is as good as one at its instant.
    extrapolator.add_matched(8960 * MS, SE2())
    assert extrapolator.predict(9020 * MS).motion.distance_to(SE2()) == pytest.approx(0.1)


@pytest.mark.parametrize("leap", [SE2(300.0, 0.0, 0.0), SE2(0.0, 0.0, 3.0)])
def test_odometry_begins_anew_after_a_leap(leap: SE2) -> None:
    """What a base may do within half a second or a minute is no leap."""
    extrapolator, pose = PoseExtrapolator(), SE2(2.0, 1.0, 0.5)
    extrapolator.add_odometry(0, pose)
    extrapolator.add_matched(0, SE2())
    extrapolator.add_odometry(500 * MS, pose @ SE2(1.5, 0.0, 1.5))
    assert extrapolator.predict(500 * MS).motion.distance_to(SE2(1.5, 0.0, 0.0)) < 1e-9
    extrapolator.add_odometry(60_500 * MS, pose @ SE2(41.5, 0.0, 3.0))
    extrapolator.add_matched(60_500 * MS, SE2())
    at = pose @ SE2(41.5, 0.0, 3.0) @ leap
    extrapolator.add_odometry(60_600 * MS, at)
    assert not extrapolator.predict(60_600 * MS).is_measured
    assert extrapolator.odometry_motion(0, 60_600 * MS) is None
    extrapolator.add_matched(60_600 * MS, SE2())
    extrapolator.add_odometry(60_700 * MS, at @ SE2(0.1, 0.0, 0.0))
    assert close(extrapolator.predict(60_700 * MS).motion, SE2(0.1, 0.0, 0.0))


def test_odometry_is_kept_from_the_last_node_on() -> None:
    extrapolator = PoseExtrapolator()
    for k in range(100):
        extrapolator.add_odometry(k * 100 * MS, SE2(0.1 * k, 0.0, 0.0))
        extrapolator.add_matched(k * 100 * MS, SE2(), 1000 * MS)
    motion = extrapolator.odometry_motion(1000 * MS, 9900 * MS)
    assert motion is not None
    assert close(motion, SE2(8.9, 0.0, 0.0))
