"""The tracker averages, refuses what cannot be, starts again when it was wrong, and forgets what was not seen."""

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.docking.covariance import difference
from ambler.docking.detection import DockDetection
from ambler.docking.tracker import DockTracker, TrackerConfig

S = 1_000_000_000
COVARIANCE = np.diag([0.003, 0.002, 0.01]) ** 2
ODOM_FROM_DOCK = SE2(3.0, -1.0, 0.4)


def sighting(stamp_ns: int, pose: SE2, covariance: np.ndarray = COVARIANCE) -> DockDetection:
    return DockDetection(stamp_ns, "test", pose, covariance, 1)


def noisy(rng: np.random.Generator, pose: SE2) -> SE2:
    return pose @ SE2(*(rng.normal(0.0, 1.0, 3) * (0.003, 0.002, 0.01)).tolist())


def test_a_mean_of_many_sightings_while_driving_is_better_and_honest() -> None:
    rng, errors, surprises = np.random.default_rng(1), [], []
    for _ in range(60):
        tracker = DockTracker()
        for k in range(20):
            base = SE2(1.0 + 0.02 * k, -1.2, 0.3)
            seen = noisy(rng, base.inverse() @ ODOM_FROM_DOCK)
            tracker.update(sighting(k * S // 15, seen), base, k * S // 15)
        track = tracker.track(20 * S // 15, base)
        assert track is not None
        d = difference(base.inverse() @ ODOM_FROM_DOCK, track.base_from_dock)
        errors.append(np.abs(d))
        surprises.append(float(d @ np.linalg.solve(track.covariance, d)) / 3.0)
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (spread < (0.0022, 0.0019, 0.005)).all()
    assert 0.1 < np.mean(surprises) < 2.0


def test_outliers_are_refused_until_they_agree() -> None:
    tracker, here = DockTracker(), SE2()
    good, bad = SE2(1.0, 0.0, 0.0), SE2(1.1, 0.05, 0.0)
    for k in range(5):
        assert tracker.update(sighting(k, good), here, k)
    assert not tracker.update(sighting(10, bad), here, 10)
    assert tracker.update(sighting(11, good), here, 11)
    track = tracker.track(11, here)
    assert track is not None
    assert track.base_from_dock.distance_to(good) < 1e-9
    used = [tracker.update(sighting(20 + k, bad), here, 20 + k) for k in range(6)]
    assert used == [False, False, False, True, True, True]
    scattered = [SE2(1.3, 0.0, 0.0), SE2(0.6, 0.0, 0.0), SE2(1.0, 0.4, 0.0), SE2(1.0, -0.4, 0.3)] * 3
    assert not any(tracker.update(sighting(40 + k, p), here, 40 + k) for k, p in enumerate(scattered))


def test_stale_and_impossible_sightings_are_dropped() -> None:
    tracker, here, pose = DockTracker(), SE2(), SE2(1.0, 0.0, 0.0)
    assert not tracker.update(sighting(0, pose), here, S), "a second old"
    assert not tracker.update(sighting(S, pose), here, 0), "from the future"
    assert not tracker.update(sighting(0, SE2(math.nan, 0.0, 0.0)), here, 0)
    assert not tracker.update(sighting(0, pose, np.full((3, 3), np.inf)), here, 0)
    assert tracker.update(sighting(100, pose), here, 100)
    assert not tracker.update(sighting(100, pose), here, 100), "the same picture twice"
    assert not tracker.update(sighting(50, pose), here, 100), "an older one later"
    assert tracker.rejected == 6


def test_a_dock_that_is_not_seen_is_forgotten_by_time_and_by_way() -> None:
    config = TrackerConfig(max_age=2.0, max_travel=0.5, first=2)
    tracker, pose = DockTracker(config), SE2(1.0, 0.0, 0.0)
    tracker.update(sighting(0, pose), SE2(), 0)
    assert tracker.track(0, SE2()) is None, "one sighting alone may be an error"
    tracker.update(sighting(1, pose), SE2(), 1)
    near = tracker.track(S, SE2(0.4, 0.0, 0.0))
    assert near is not None
    assert near.travel == 0.4
    assert near.base_from_dock.distance_to(SE2(0.6, 0.0, 0.0)) < 1e-9
    start = tracker.track(S, SE2(0.4, 0.0, 0.0))
    assert start is not None
    assert tracker.track(S, SE2(0.6, 0.0, 0.0)) is None, "60 cm further"
    tracker.update(sighting(3 * S, SE2(0.4, 0.0, 0.0)), SE2(0.6, 0.0, 0.0), 3 * S)
    assert tracker.track(3 * S, SE2(0.6, 0.0, 0.0)) is not None
    assert tracker.track(3 * S + 2 * S + 1, SE2(0.6, 0.0, 0.0)) is None, "2 s later"
    assert tracker.expected(SE2(0.6, 0.0, 0.0)) is not None, "as a prior it still serves"
    tracker.reset()
    assert tracker.expected(SE2()) is None


def test_a_sighting_elsewhere_takes_the_place_of_a_forgotten_one() -> None:
    """A false sighting of long ago refuses no true one."""
    tracker, here, pose = DockTracker(TrackerConfig(max_age=2.0)), SE2(), SE2(1.0, 0.0, 0.0)
    tracker.update(sighting(0, SE2(1.0, 0.6, 0.0)), here, 0)
    assert not tracker.update(sighting(S, pose), here, S)
    assert tracker.update(sighting(3 * S, pose), here, 3 * S)
    assert tracker.update(sighting(3 * S + 1, pose), here, 3 * S + 1)
    track = tracker.track(3 * S + 1, here)
    assert track is not None
    assert track.base_from_dock.distance_to(pose) < 1e-9


def test_uncertainty_grows_with_the_way_not_with_the_calls() -> None:
    def spread(steps: int) -> np.ndarray:
        tracker = DockTracker()
        for k in range(3):
            tracker.update(sighting(k, SE2(1.0, 0.0, 0.0)), SE2(), k)
        for x in np.linspace(0.0, 0.4, steps + 1):
            tracker.move(SE2(float(x), 0.0, 0.0))
        track = tracker.track(3, SE2(0.4, 0.0, 0.0))
        assert track is not None
        return np.sqrt(np.diag(track.covariance))

    few, many = spread(2), spread(200)
    assert np.allclose(few, many, rtol=0.2)
    assert 0.003 < many[0] < 0.02


def test_beside_a_gyroscope_the_way_costs_less_heading() -> None:
    def heading(*, has_gyroscope: bool) -> float:
        tracker = DockTracker(has_gyroscope=has_gyroscope)
        for k in range(3):
            tracker.update(sighting(k, SE2(1.0, 0.0, 0.0)), SE2(), k)
        before = tracker.track(3, SE2())
        tracker.move(SE2(0.3, 0.0, 0.2))
        after = tracker.track(3, SE2(0.3, 0.0, 0.2))
        assert before is not None
        assert after is not None
        return math.sqrt(after.covariance[2, 2] - before.covariance[2, 2])

    assert heading(has_gyroscope=True) == pytest.approx(0.2 * heading(has_gyroscope=False), rel=1e-6)
    assert math.degrees(heading(has_gyroscope=False)) > 0.2


def track_of(sightings: int = 6) -> tuple[DockTracker, np.ndarray, int]:
    """A tracker that has seen the dock some times where it is, the covariance that the next sighting will be judged by, and the instant."""
    tracker, here = DockTracker(), SE2()
    for k in range(sightings):
        assert tracker.update(sighting(k, SE2(1.0, 0.0, 0.0)), here, k)
    track = tracker.track(sightings, here)
    assert track is not None
    return tracker, track.covariance + COVARIANCE + np.diag([0.001, 0.001, math.radians(0.1)]) ** 2, sightings


def test_of_a_thousand_true_sightings_one_is_refused_and_farther_ones_always_are() -> None:
    """The gate is chi-squared of three degrees of freedom: 16.3 is exceeded by chance once in a thousand."""
    for squared, is_used in ((14.0, True), (19.0, False), (40.0, False)):
        for axis in range(3):
            tracker, spread, now = track_of()
            off = np.zeros(3)
            off[axis] = math.sqrt(squared * spread[axis, axis])
            assert tracker.update(sighting(now, SE2(1.0, 0.0, 0.0) @ SE2(*off.tolist())), SE2(), now) == is_used


def test_errors_that_repeat_from_picture_to_picture_are_allowed_for() -> None:
    """A detector that states a hundredth of a millimetre is off by 2 mm when the light changes: that is no outlier, and one such
    sighting tells the dock to no better than a millimetre and a tenth of a degree."""
    sure = np.diag([1e-5, 1e-5, 1e-5]) ** 2
    tracker = DockTracker(TrackerConfig(first=1))
    assert tracker.update(sighting(0, SE2(1.0, 0.0, 0.0), sure), SE2(), 0)
    track = tracker.track(0, SE2())
    assert track is not None
    assert (np.sqrt(np.diag(track.covariance)) > (0.00099, 0.00099, 0.0017)).all()
    assert tracker.update(sighting(1, SE2(1.002, 0.001, 0.0), sure), SE2(), 1)


def test_outliers_that_only_lie_on_one_side_do_not_agree() -> None:
    """Four in a row, 15 to 30 cm from one another: reflections, not a dock. Four within 3 cm: the dock is there."""
    for spacing, begins_anew in ((0.15, False), (0.01, True)):
        tracker, _, now = track_of()
        used = [
            tracker.update(sighting(now + k, SE2(1.4 + spacing * (k % 3), 0.3, 0.0)), SE2(), now + k) for k in range(6)
        ]
        assert any(used) == begins_anew


def test_sightings_that_agree_in_place_but_not_in_heading_do_not_begin_anew() -> None:
    tracker, _, now = track_of()
    turned = [SE2(1.4, 0.3, 0.2 * (k % 3)) for k in range(6)]
    assert not any(tracker.update(sighting(now + k, pose), SE2(), now + k) for k, pose in enumerate(turned))


def test_a_turn_moves_a_far_dock_sideways() -> None:
    """Odometry that drifts by half a degree per radian leaves a dock 2 m away uncertain across, by 2 m times that, and hardly along."""
    tracker = DockTracker()
    for k in range(4):
        tracker.update(sighting(k, SE2(2.0, 0.0, 0.0), 1e-10 * np.eye(3)), SE2(), k)
    before = tracker.track(4, SE2())
    for angle in np.linspace(0.0, 1.0, 51):
        tracker.move(SE2(0.0, 0.0, float(angle)))
    after = tracker.track(4, SE2(0.0, 0.0, 1.0))
    assert before is not None
    assert after is not None
    grown = np.sqrt(np.diag(after.covariance) - np.diag(before.covariance))
    assert grown[2] == pytest.approx(math.radians(0.5), rel=0.05)
    across = math.hypot(2.0 * math.radians(0.5), 0.005)
    assert math.hypot(grown[0], grown[1]) == pytest.approx(math.hypot(across, 0.005), rel=0.05)
    # The dock's x axis points along the sight at the time of the sightings.
    assert grown[1] > 3.0 * grown[0]
