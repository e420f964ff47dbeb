"""The drift of dead reckoning over many seeds has the spread that its numbers state, each within its chi-squared interval."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.odometry import DeadReckoning
from ambler.sim.robots import robot_named
from ambler.sim.sensors import OdometrySpec

F64 = NDArray[np.float64]
SEEDS = 120
RATE_HZ = 50.0
DIFF, SPOT = robot_named("diff"), robot_named("spot")
PERFECT = replace(DIFF.odometry.perfect(), rate_hz=RATE_HZ, slip_time=2.0)


def interval(sigma: float, count: int = SEEDS) -> tuple[float, float]:
    """Return between which values the root mean square of `count` draws lies with 99.9 %."""
    low, high = stats.chi2.ppf([0.0005, 0.9995], count)
    return sigma * math.sqrt(low / count), sigma * math.sqrt(high / count)


def assert_spread(values: F64 | list[float], sigma: float) -> None:
    low, high = interval(sigma, len(values))
    assert low < float(np.sqrt(np.mean(np.square(values)))) < high, f"stated is {sigma}"


def ends(spec: OdometrySpec, speed: float, turn: float, seconds: float) -> list[SE2]:
    """Let wheels of a differential robot turn as a perfect drive would; return where each seed believes to be, x along its own way."""
    out = []
    rates = ((speed - 0.5 * DIFF.track * turn), (speed + 0.5 * DIFF.track * turn))
    for seed in range(SEEDS):
        reckoning = DeadReckoning(DIFF, spec, seed)
        way = 0.0
        for k in range(1, round(seconds * RATE_HZ) + 1):
            travel = tuple(rate / DIFF.wheel_radius * k / RATE_HZ for rate in rates)
            odometry = reckoning.update(travel, SE3(), k)
            way += odometry.linear[0] / RATE_HZ
        out.append(SE2(way, 0.0, odometry.pose.to_se2().yaw))
    return out


def test_a_track_that_is_known_badly_turns_too_much_or_too_little() -> None:
    """Turning on the spot for 2 rad: the counted angle is off by the track's share, in every seed by its own."""
    found = ends(replace(PERFECT, track_sigma=0.02), 0.0, 1.0, 2.0)
    assert_spread([2.0 / pose.yaw - 1.0 for pose in found], 0.02)
    assert max(abs(pose.x) for pose in found) < 1e-9


def test_wheels_whose_radii_are_known_badly_turn_a_straight_way() -> None:
    """Each wheel is off by its own share; their difference over the track is a turn that grows with the way."""
    found = ends(replace(PERFECT, radius_sigma=0.004), 0.5, 0.0, 2.0)
    assert_spread([pose.yaw for pose in found], 0.004 * math.sqrt(2.0) / DIFF.track)


def test_slip_is_a_share_of_the_way_that_changes_with_its_time_constant() -> None:
    """The integral of an Ornstein-Uhlenbeck process of sigma s and time constant T over the time t has the variance
    2 s^2 T^2 (t/T - 1 + exp(-t/T)); both wheels slip by themselves."""
    sigma, constant, seconds, speed = 0.03, 2.0, 4.0, 0.5
    found = ends(replace(PERFECT, slip_sigma=sigma), speed, 0.0, seconds)
    share = seconds / constant
    variance = 2.0 * (speed * sigma * constant) ** 2 * (share - 1.0 + math.exp(-share))
    assert_spread([pose.yaw for pose in found], math.sqrt(2.0 * variance) / DIFF.track)
    assert_spread([pose.x - speed * seconds for pose in found], math.sqrt(0.5 * variance))


def test_slip_forgets_itself() -> None:
    """Over 50 time constants its mean share is far smaller than over one: else it were a wrong radius, and no slip."""
    for constants in (1.0, 50.0):
        found = ends(replace(PERFECT, slip_sigma=0.05, slip_time=0.1), 1.0, 0.0, 0.1 * constants)
        share = 0.05 * math.sqrt(2.0 * (constants - 1.0 + math.exp(-constants))) / constants
        assert_spread([pose.x / (0.1 * constants) - 1.0 for pose in found], share / math.sqrt(2.0))


def test_a_legged_bodys_lean_is_sensed_with_its_noise() -> None:
    sigma = math.radians(0.5)
    reckoning = DeadReckoning(SPOT, replace(SPOT.odometry.perfect(), tilt_sigma=sigma), 3)
    leans = []
    for k in range(1, 501):
        _, x, y, _ = reckoning.update((0.0, 0.0, 0.0), SE3(), k).pose.rotation
        leans.append((2.0 * x, 2.0 * y))
    for axis in np.array(leans).T:
        assert_spread(axis, sigma)


def test_the_stated_covariance_covers_the_drift_of_the_real_wheels() -> None:
    """4 m straight on with the shipped errors: the squared error of the counted way is no more than three times what the wheels state
    (NEES over the seeds), and not a hundredth of it."""
    along = []
    for seed in range(SEEDS):
        reckoning = DeadReckoning(DIFF, DIFF.odometry, seed)
        way = 0.0
        for k in range(1, 201):
            odometry = reckoning.update((0.02 * k / DIFF.wheel_radius,) * 2, SE3(), k)
            way += odometry.linear[0] / DIFF.odometry.rate_hz
        along.append((way - 4.0) ** 2 / odometry.pose_covariance[0, 0])
    assert 0.01 < np.mean(along) < 3.0
