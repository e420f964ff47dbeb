"""Where was the base at t: exact on constant twists, with height and lean, and honest about what it does not know."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.base_motion import LEVEL, BaseMotion, lean_of
from ambler.core.errors import StaleInputError
from ambler.core.messages import Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3

MS = 1_000_000
TWIST = np.array([0.8, -0.2, 1.1])


def on_an_arc(count: int = 20, period_ns: int = 20 * MS) -> BaseMotion:
    motion = BaseMotion()
    for k in range(count):
        motion.add_pose(k * period_ns, SE2(1.0, 2.0, 3.0) @ SE2.exp(TWIST * (k * period_ns * 1e-9)))
    return motion


@pytest.mark.parametrize("stamp_ms", [0, 7, 20, 133, 380, 500])
def test_a_constant_twist_is_followed_exactly_also_beyond_the_newest_pose(stamp_ms: int) -> None:
    motion = on_an_arc()
    true = SE2(1.0, 2.0, 3.0) @ SE2.exp(TWIST * (stamp_ms * 1e-3))
    np.testing.assert_allclose(motion.planar_at(stamp_ms * MS).as_array(), true.as_array(), atol=1e-12)
    np.testing.assert_allclose(motion.pose_at(stamp_ms * MS).to_se2().as_array(), true.as_array(), atol=1e-12)
    np.testing.assert_allclose(motion.twist_at(stamp_ms * MS), TWIST, atol=1e-9)


def test_a_sweep_is_known_or_steady_however_near_the_odometry_ends() -> None:
    """A scan at one instant asks for the motion of the next 10 ms, too: it was an error where the odometry ended 0.24 to 0.25 s before."""
    motion, otherwise = on_an_arc(), np.array([0.0, 0.0, 0.5])
    end_ns = 19 * 20 * MS
    for late_ms in np.arange(0.0, 270.0, 0.7):
        for seconds in (0.0, 0.004, 0.1):
            stamp_ns = end_ns + round(late_ms * MS)
            sweep = motion.sweep(stamp_ns, seconds, otherwise)
            assert sweep[0] == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=1e-12)
            is_known = late_ms + 1e3 * sweep[-1, 0] <= 250.0
            assert sweep[-1, 0] >= seconds
            assert sweep[-1, 3] == pytest.approx((TWIST if is_known else otherwise)[2] * sweep[-1, 0], abs=1e-9)


def test_twist_over_an_interval_is_the_mean() -> None:
    motion = BaseMotion()
    for stamp, x in ((0, 0.0), (100 * MS, 0.1), (200 * MS, 0.4)):
        motion.add_pose(stamp, SE2(x, 0.0, 0.0))
    np.testing.assert_allclose(motion.twist_over(50 * MS, 150 * MS), [2.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(motion.twist(), [3.0, 0.0, 0.0], atol=1e-12)


def test_height_and_lean_are_blended_under_the_motion_in_the_plane() -> None:
    motion = BaseMotion()
    motion.add_pose(0, SE3.from_rpy((0.0, 0.0, 0.50), 0.02, -0.04, 1.0))
    motion.add_pose(100 * MS, SE3.from_rpy((0.1, 0.0, 0.54), 0.06, 0.04, 1.2))
    middle = motion.pose_at(50 * MS)
    assert middle.translation[2] == pytest.approx(0.52)
    w, x, y, z = middle.rotation
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(2 * (w * y - z * x))
    assert (roll, pitch) == pytest.approx((0.04, 0.0), abs=1e-3)
    assert middle.to_se2().yaw == pytest.approx(1.1, abs=1e-3)
    beyond = motion.pose_at(150 * MS)
    assert beyond.translation[2] == pytest.approx(0.54), "the lean of a walking body does not go on"


@pytest.mark.parametrize("angles", [(0.1, -0.2, 2.0), (0.0, 0.0, -3.0), (-0.3, 0.0, 0.0)])
def test_heading_and_lean_make_up_the_rotation(angles: tuple[float, float, float]) -> None:
    pose = SE3.from_rpy((1.0, 2.0, 3.0), *angles)
    lean = lean_of(pose)
    again = SE3.from_se2(pose.to_se2(), 3.0) @ SE3((0.0, 0.0, 0.0), lean)
    np.testing.assert_allclose(again.matrix(), pose.matrix(), atol=1e-12)
    assert SE3((0.0, 0.0, 0.0), lean).to_se2().yaw == pytest.approx(0.0, abs=1e-12)
    assert (lean == LEVEL) == (angles[0] == angles[1] == 0.0)


def test_knots_cover_the_interval_and_say_what_the_poses_say() -> None:
    motion = on_an_arc()
    knots = motion.knots(33 * MS, 170 * MS, 100 * MS)
    assert knots.times[0] == pytest.approx(-0.08)
    assert knots.times[-1] == pytest.approx(0.08)
    np.testing.assert_allclose(knots.poses[4], np.zeros(3), atol=1e-12)
    for seconds, pose in zip(knots.times, knots.poses, strict=True):
        np.testing.assert_allclose(pose, SE2.exp(TWIST * seconds).as_array(), atol=1e-12)
    np.testing.assert_allclose(knots.twists, np.tile(TWIST, (len(knots.times), 1)), atol=1e-9)


def test_what_is_not_known_is_said() -> None:
    motion = BaseMotion(span=1.0, max_extrapolation=0.1)
    with pytest.raises(StaleInputError, match="no odometry yet"):
        motion.planar_at(0)
    for k in range(151):
        motion.add_pose(k * 10 * MS, SE2(0.01 * k, 0.0, 0.0))
    assert (motion.oldest_ns, motion.newest_ns) == (500 * MS, 1500 * MS)
    assert motion.covers(500 * MS, 1600 * MS)
    assert not motion.covers(499 * MS, 1500 * MS)
    with pytest.raises(StaleInputError, match=r"begins 0\.100 s after"):
        motion.pose_at(400 * MS)
    with pytest.raises(StaleInputError, match=r"ends 0\.101 s before"):
        motion.twist_at(1601 * MS)
    with pytest.raises(StaleInputError):
        motion.knots(600 * MS, 1700 * MS, 1000 * MS)


def test_one_pose_holds_for_a_moment_and_a_clock_that_is_set_back_begins_anew() -> None:
    motion = BaseMotion()
    motion.add_pose(1000 * MS, SE2(1.0, 0.0, 0.0))
    assert motion.planar_at(1100 * MS) == SE2(1.0, 0.0, 0.0)
    assert len(motion.knots(1000 * MS, 1100 * MS, 1050 * MS).times) == 1
    motion.add_pose(1000 * MS, SE2(9.0, 0.0, 0.0))
    assert motion.newest == SE2(1.0, 0.0, 0.0), "a repeated stamp is ignored"
    motion.add_pose(500 * MS, SE2(2.0, 0.0, 0.0))
    assert (motion.oldest_ns, motion.newest) == (500 * MS, SE2(2.0, 0.0, 0.0))


def test_it_takes_messages() -> None:
    motion = BaseMotion()
    pose = SE3.from_rpy((1.0, 2.0, 0.3), 0.1, 0.0, 0.5)
    motion.add(Odometry(5, "odom", "base", pose, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), np.zeros((6, 6)), np.zeros((6, 6))))
    np.testing.assert_allclose(motion.pose_at(5).matrix(), pose.matrix(), atol=1e-12)


def test_it_is_level_where_no_pose_that_is_blended_leans() -> None:
    motion = BaseMotion()
    assert motion.is_level(0, 100)
    for stamp_ns, roll in ((0, 0.0), (100, 0.0), (200, 0.1), (300, 0.0), (400, 0.0)):
        motion.add_pose(stamp_ns, SE3.from_rpy((0.0, 0.0, 0.0), roll, 0.0, 0.3))
    for begin_ns, end_ns in ((0, 50), (0, 99), (300, 400), (350, 390), (400, 450), (-50, 50)):
        assert motion.is_level(begin_ns, end_ns)
    for begin_ns, end_ns in ((0, 150), (150, 160), (200, 200), (250, 400), (299, 299)):
        assert not motion.is_level(begin_ns, end_ns)
        assert any(lean_of(motion.pose_at(t)) != LEVEL for t in range(begin_ns, end_ns + 1))
