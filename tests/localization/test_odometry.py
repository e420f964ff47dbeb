"""The robot's odometry: no worse than its wheels, turned by the gyroscope, continuous through every fault, and honest about it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import Odometry
from ambler.core.se2 import SE2, wrap_angle
from ambler.core.se3 import SE3
from ambler.localization.odometry import OdometryConfig, OdometryUpdate, WheelInertialOdometry

MS = 1_000_000
PERIOD = 0.02
STATED = np.diag([1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 1e-3])


class Base:
    """A base that drives as told. Its wheels turn too much by `turn_error` of the turn; its gyroscope has a bias and noise."""

    def __init__(self, turn_error: float = 0.04, bias: float = 0.004, seed: int = 0) -> None:
        self.truth, self.wheels = SE2(), SE2()
        self.turn_error, self.bias = turn_error, bias
        self.stamp_ns = 0
        self.rng = np.random.default_rng(seed)
        self.told = (0.0, 0.0, 0.0)
        self.grip = 1.0

    def drive(
        self, seconds: float, twist: tuple[float, float, float]
    ) -> Iterator[tuple[list[tuple[int, float]], Odometry]]:
        """Yield, per message of the wheels, what the gyroscope measured before it and the message."""
        for _ in range(round(seconds / PERIOD)):
            self.truth = self.truth @ SE2.exp(np.array(twist) * PERIOD * self.grip)
            self.told = (twist[0], twist[1], twist[2] * (1.0 + self.turn_error))
            self.wheels = self.wheels @ SE2.exp(np.array(self.told) * PERIOD)
            turns = []
            for late in (15, 5):
                stamp = self.stamp_ns + 20 * MS - late * MS
                turns.append((stamp, twist[2] * self.grip + self.bias + 1.2e-3 * float(self.rng.standard_normal())))
            self.stamp_ns += 20 * MS
            yield turns, self.message()

    def message(self, **changes: object) -> Odometry:
        vx, vy, wz = self.told
        return Odometry(
            self.stamp_ns,
            "odom",
            "base",
            SE3.from_se2(self.wheels),
            (vx, vy, 0.0),
            (0.0, 0.0, wz),
            STATED.copy(),
            STATED.copy(),
        )


def play(
    estimator: WheelInertialOdometry,
    base: Base,
    seconds: float,
    twist: tuple[float, float, float],
    *,
    has_imu: bool = True,
) -> list[OdometryUpdate]:
    out = []
    for turns, wheels in base.drive(seconds, twist):
        for stamp, rate in turns if has_imu else []:
            estimator.add_imu(stamp, (0.0, 0.0, rate))
        out.append(estimator.update(wheels))
    return out


def last_pose(updates: list[OdometryUpdate]) -> SE2:
    assert updates[-1].odometry is not None
    return updates[-1].odometry.pose.to_se2()


def codes(updates: list[OdometryUpdate]) -> list[str]:
    return [note.code for update in updates for note in update.notes]


def test_the_way_is_that_of_the_wheels_and_the_turning_that_of_the_gyroscope() -> None:
    base, estimator = Base(), WheelInertialOdometry()
    updates = play(estimator, base, 2.0, (0.0, 0.0, 0.0))
    for k in range(10):
        updates += play(estimator, base, 2.0, (0.6, 0.0, 0.6 * (-1) ** (k // 2)))
    error = base.truth.inverse() @ last_pose(updates)
    wheels = base.truth.inverse() @ base.wheels
    assert abs(error.yaw) < 0.008
    assert math.hypot(error.x, error.y) < 0.03
    assert math.hypot(wheels.x, wheels.y) > 3.0 * math.hypot(error.x, error.y)
    assert [u.odometry.stamp_ns for u in updates if u.odometry] == [(k + 1) * 20 * MS for k in range(len(updates))]
    assert not codes(updates)


def test_without_a_gyroscope_it_is_the_wheels() -> None:
    base, estimator = Base(), WheelInertialOdometry()
    updates = play(estimator, base, 4.0, (0.5, 0.2, 0.3), has_imu=False)
    error = base.wheels.inverse() @ last_pose(updates)
    assert math.hypot(error.x, error.y) < 0.002
    assert abs(error.yaw) < 0.002
    odometry = updates[-1].odometry
    assert odometry is not None
    assert (*odometry.linear[:2], odometry.angular[2]) == pytest.approx((0.5, 0.2, 0.3 * 1.04), abs=1e-3)


def test_it_stays_at_the_present_and_does_not_lag_by_a_period() -> None:
    base, estimator = Base(turn_error=0.0, bias=0.0), WheelInertialOdometry()
    updates = play(estimator, base, 1.0, (0.0, 0.0, 0.0))
    for k in range(51):
        updates += play(estimator, base, 0.02, (0.02 * k, 0.0, 0.0))
    assert last_pose(updates).x == pytest.approx(base.truth.x, abs=0.002)  # half a period would be 10 mm


def test_wheels_that_arrive_late_are_told_at_their_own_instant() -> None:
    """A gyroscope that is 60 ms ahead of the wheels does not carry the pose there under the wheels' stamp."""
    estimator, base = WheelInertialOdometry(), Base(turn_error=0.0, bias=0.0)
    late: list[tuple[Odometry, SE2]] = []
    for turns, wheels in base.drive(4.0, (0.5, 0.0, 1.0)):
        for stamp, rate in turns:
            estimator.add_imu(stamp, (0.0, 0.0, rate))
        late.append((wheels, base.truth))
        if len(late) > 3:
            message, truth = late.pop(0)
            told = estimator.update(message).odometry
            assert told is not None
            assert told.stamp_ns == message.stamp_ns
    off = truth.inverse() @ told.pose.to_se2()
    assert math.hypot(off.x, off.y) < 0.005, "of the 30 mm that it drives meanwhile"
    assert abs(off.yaw) < 0.01, "of the 0.06 rad that it turns meanwhile"


def test_height_lean_and_sway_of_a_walking_body_pass_through_but_not_into_the_velocity() -> None:
    estimator, planar = WheelInertialOdometry(), SE2()
    for k in range(200):
        phase = 2.0 * math.pi * 2.5 * k * PERIOD
        planar = planar @ SE2(0.4 * PERIOD, 0.0, 0.0)
        lean = SE3.from_rpy((0.0, 0.012 * math.sin(phase), 0.01 * math.cos(phase)), 0.02 * math.sin(phase), 0.01, 0.0)
        pose = SE3.from_se2(planar, 0.5) @ lean
        wheels = Odometry(
            k * 20 * MS, "odom", "base", pose, (0.4, 0.0, 0.0), (0.0, 0.0, 0.0), STATED.copy(), STATED.copy()
        )
        odometry = estimator.update(wheels).odometry
        assert odometry is not None
        if k > 5:
            np.testing.assert_allclose(odometry.pose.matrix(), pose.matrix(), atol=0.004)
            assert odometry.pose.translation[2] == pytest.approx(pose.translation[2])
            assert abs(odometry.linear[1]) < 0.03  # the body sways with 0.19 m/s


def test_turn_rates_are_taken_about_the_vertical_of_a_leaning_body() -> None:
    estimator = WheelInertialOdometry()
    roll = 0.4
    wheels = Base(turn_error=0.0, bias=0.0)
    for turns, message in wheels.drive(2.0, (0.0, 0.0, 0.5)):
        leaning = message.pose @ SE3.from_rpy((0.0, 0.0, 0.0), roll, 0.0, 0.0)
        told = Odometry(message.stamp_ns, "odom", "base", leaning, message.linear, message.angular, STATED, STATED)
        for stamp, rate in turns:
            estimator.add_imu(stamp, (0.0, rate * math.sin(roll), rate * math.cos(roll)))
        odometry = estimator.update(told).odometry
    assert odometry is not None
    assert odometry.pose.to_se2().yaw == pytest.approx(1.0, abs=0.005)  # the z axis alone would see 0.92


def test_a_gap_of_the_gyroscope_is_named_and_bridged_by_the_wheels() -> None:
    base, estimator = Base(turn_error=0.0, bias=0.0), WheelInertialOdometry()
    play(estimator, base, 1.0, (0.0, 0.0, 0.0))
    updates = play(estimator, base, 1.0, (0.5, 0.0, 0.4))
    updates += play(estimator, base, 2.0, (0.5, 0.0, 0.4), has_imu=False)
    updates += play(estimator, base, 1.0, (0.5, 0.0, 0.4))
    assert codes(updates) == ["IMU_SILENT", "IMU_BACK"]
    error = base.truth.inverse() @ last_pose(updates)
    assert math.hypot(error.x, error.y) < 0.005
    assert abs(error.yaw) < 0.005


@pytest.mark.parametrize("seconds", [0.1, 0.6, 3.0])
@pytest.mark.parametrize("has_imu", [True, False])
def test_a_gap_of_the_wheels_loses_no_way(seconds: float, has_imu: bool) -> None:
    base, estimator = Base(turn_error=0.0, bias=0.0), WheelInertialOdometry()
    play(estimator, base, 1.0, (0.0, 0.0, 0.0), has_imu=has_imu)
    play(estimator, base, 1.0, (0.4, 0.0, 0.3), has_imu=has_imu)
    for turns, _ in base.drive(seconds, (0.2, 0.0, -0.3)):
        for stamp, rate in turns if has_imu else []:
            estimator.add_imu(stamp, (0.0, 0.0, rate))
    updates = play(estimator, base, 1.0, (0.2, 0.0, -0.3), has_imu=has_imu)
    error = base.truth.inverse() @ last_pose(updates)
    assert math.hypot(error.x, error.y) < 0.01
    assert abs(error.yaw) < 0.02  # the base turned about within one instant, which no base does
    assert codes(updates) == (["WHEELS_BACK"] if seconds > 0.25 else [])


def test_wheels_that_begin_anew_are_no_jump() -> None:
    for pause in (0.0, 2.0):
        base, estimator = Base(turn_error=0.0, bias=0.0), WheelInertialOdometry()
        before = last_pose(play(estimator, base, 10.0, (0.8, 0.0, 0.0)))
        base.wheels, base.stamp_ns = SE2(), base.stamp_ns + round(pause * 1e9)
        updates = play(estimator, base, 0.1, (0.8, 0.0, 0.0))
        assert codes(updates) == (["WHEELS_BACK"] if pause else ["WHEELS_JUMPED"])
        assert last_pose(updates).distance_to(before) == pytest.approx(0.08, abs=0.02)


def test_stamps_that_run_backwards_are_named_and_left_out_then_followed() -> None:
    base, estimator = Base(), WheelInertialOdometry()
    before = last_pose(play(estimator, base, 2.0, (0.5, 0.0, 0.0)))
    newest_ns = base.stamp_ns
    base.stamp_ns -= 100 * MS
    late = play(estimator, base, 0.04, (0.5, 0.0, 0.0))
    assert codes(late) == ["WHEELS_OUT_OF_ORDER"]
    assert all(u.odometry is None for u in late)
    base.stamp_ns = newest_ns
    assert not codes(play(estimator, base, 0.1, (0.5, 0.0, 0.0)))
    base.stamp_ns -= 1_000_000 * MS
    updates = play(estimator, base, 0.2, (0.5, 0.0, 0.0))
    assert codes(updates) == ["WHEELS_OUT_OF_ORDER", "CLOCK_SET_BACK"]
    told = [u.odometry for u in updates if u.odometry is not None]
    assert [o.stamp_ns for o in told] == sorted(o.stamp_ns for o in told)
    assert told[-1].stamp_ns == base.stamp_ns
    assert told[0].pose.to_se2().distance_to(before) < 0.15


def test_numbers_that_are_none_are_left_out() -> None:
    base, estimator = Base(), WheelInertialOdometry()
    play(estimator, base, 0.5, (0.5, 0.0, 0.0))
    base.told = (math.nan, 0.0, 0.0)
    base.stamp_ns += 20 * MS
    first, second = estimator.update(base.message()), estimator.update(base.message())
    estimator.add_imu(base.stamp_ns, (0.0, 0.0, math.inf))
    assert (first.odometry, codes([first, second])) == (None, ["WHEELS_NOT_FINITE"])
    assert play(estimator, base, 0.1, (0.5, 0.0, 0.0))[-1].odometry is not None


def test_slipping_wheels_do_not_turn_the_robot_and_nothing_ever_jumps() -> None:
    base, estimator = Base(turn_error=0.0), WheelInertialOdometry()
    updates = play(estimator, base, 1.0, (0.0, 0.0, 0.0))
    updates += play(estimator, base, 2.0, (0.5, 0.0, 0.5))
    base.grip = 0.5
    updates += play(estimator, base, 2.0, (0.5, 0.0, 0.8))
    base.grip = 1.0
    updates += play(estimator, base, 2.0, (0.5, 0.0, -0.5))
    poses = [u.odometry.pose.to_se2() for u in updates if u.odometry is not None]
    assert abs(wrap_angle(poses[-1].yaw - base.truth.yaw)) < 0.01
    steps = [a.distance_to(b) for a, b in itertools.pairwise(poses)]
    turns = [abs(wrap_angle(b.yaw - a.yaw)) for a, b in itertools.pairwise(poses)]
    assert max(steps) < 0.5 * PERIOD + 0.003
    assert max(turns) < 0.8 * PERIOD + 0.003


def test_covariances_are_stated_and_grow() -> None:
    base, estimator = Base(), WheelInertialOdometry(OdometryConfig())
    updates = play(estimator, base, 1.0, (0.5, 0.0, 0.1)) + play(estimator, base, 9.0, (0.5, 0.0, 0.1))
    early, late = updates[50].odometry, updates[-1].odometry
    assert early is not None
    assert late is not None
    for odometry in (early, late):
        for covariance in (odometry.pose_covariance, odometry.twist_covariance):
            assert covariance.shape == (6, 6)
            assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    assert late.pose_covariance[5, 5] > 2.0 * early.pose_covariance[5, 5]
    assert 1e-4 < math.sqrt(late.twist_covariance[5, 5]) < 0.2


def test_what_the_wheels_state_of_the_way_is_added_to_what_the_filter_knows() -> None:
    told = []
    for stated in (0.0, 0.3):
        base, estimator = Base(), WheelInertialOdometry(OdometryConfig())
        for turns, message in base.drive(2.0, (0.5, 0.0, 0.1)):
            for stamp, rate in turns:
                estimator.add_imu(stamp, (0.0, 0.0, rate))
            way = np.diag([stated, 2.0 * stated, 1.0, 1.0, 1.0, 1.0])
            odometry = estimator.update(replace(message, pose_covariance=way)).odometry
        assert odometry is not None
        told.append(odometry.pose_covariance)
    assert told[1] - told[0] == pytest.approx(np.diag([0.3, 0.6, 0.0, 0.0, 0.0, 0.0]), abs=1e-12)


def test_wheels_that_state_no_covariance_are_not_certain() -> None:
    base, estimator = Base(turn_error=0.1, bias=0.0), WheelInertialOdometry()
    for turns, message in base.drive(3.0, (0.0, 0.0, 0.5)):
        for stamp, rate in turns:
            estimator.add_imu(stamp, (0.0, 0.0, rate))
        silent = Odometry(
            message.stamp_ns,
            "odom",
            "base",
            message.pose,
            message.linear,
            message.angular,
            np.zeros((6, 6)),
            np.zeros((6, 6)),
        )
        odometry = estimator.update(silent).odometry
    assert odometry is not None
    assert odometry.pose.to_se2().yaw == pytest.approx(1.5, abs=0.03)  # the wheels say 1.65
