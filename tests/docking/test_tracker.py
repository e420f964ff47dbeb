"""The tracker averages, refuses what cannot be, starts again when it was wrong, and forgets what was not seen."""

import math

import numpy as np

from ambler.core.se2 import SE2
from ambler.docking.covariance import difference
from ambler.docking.detection import DockSighting
from ambler.docking.tracker import DockTracker, TrackerConfig

S = 1_000_000_000
COVARIANCE = np.diag([0.003, 0.002, 0.01]) ** 2
ODOM_FROM_DOCK = SE2(3.0, -1.0, 0.4)


def sighting(stamp_ns: int, pose: SE2, covariance: np.ndarray = COVARIANCE) -> DockSighting:
    return DockSighting(stamp_ns, "test", pose, covariance, 1)


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
