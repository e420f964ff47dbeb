"""How sure a localizer in a known map may be: the motion model against samples, and the tracker against maps that are wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.localization.localizer import Mode, Observation
from ambler.localization.matcher import MatchResult, fuse
from ambler.localization.motion import OdometryNoise, predict
from ambler.localization.surface_map import SurfaceMap
from tests.localization import rooms
from tests.localization.rooms import drive, error_of

F64 = NDArray[np.float64]


def test_a_carried_pose_spreads_as_samples_do() -> None:
    """20 000 robots with a pose drawn from the covariance drive the same motion, each with its own noise: 6 % per root metre,
    0.02 rad per root metre, 0.06 rad per root radian, 2 cm per root radian (the numbers that the model states)."""
    rng = np.random.default_rng(1)
    pose, motion = SE2(3.0, -2.0, 0.8), SE2(1.5, 0.4, 0.5)
    start = 1e-4 * np.array([[9.0, 2.0, 1.0], [2.0, 4.0, -1.0], [1.0, -1.0, 16.0]])
    count = 20_000
    x, y, yaw = (pose.as_array() + rng.multivariate_normal(np.zeros(3), start, count)).T
    way = math.hypot(1.5, 0.4)
    xy = math.sqrt(0.06**2 * way + 0.02**2 * 0.5)
    turn = math.sqrt(0.02**2 * way + 0.06**2 * 0.5)
    along, aside = xy * rng.standard_normal((2, count))
    end_x = x + np.cos(yaw) * 1.5 - np.sin(yaw) * 0.4
    end_y = y + np.sin(yaw) * 1.5 + np.cos(yaw) * 0.4
    end_yaw = yaw + 0.5 + turn * rng.standard_normal(count)
    heading = yaw + 0.5
    end_x += np.cos(heading) * along - np.sin(heading) * aside
    end_y += np.sin(heading) * along + np.cos(heading) * aside
    sampled = np.cov(np.stack([end_x, end_y, end_yaw]))
    moved, covariance = predict(pose, start, motion, OdometryNoise(0.06, 0.02, 0.06, 0.02))
    assert moved.as_array() == pytest.approx([end_x.mean(), end_y.mean(), end_yaw.mean()], abs=0.003)
    np.testing.assert_allclose(covariance, sampled, rtol=0.05, atol=6e-5)


def match_at(state: F64, information: float = 1e4) -> MatchResult:
    """A match that knows everything well; nothing of the map's errors."""
    normal = np.diag([1.0, 1.0, 1.0, 1e-6])
    variance = 1.0 / information
    return MatchResult(state, 1.0, 0.0, 3, normal, normal, np.zeros((4, 4)), variance, 0.0, 1.0)


def test_a_match_beyond_180_degrees_is_near_a_prediction_before_it() -> None:
    predicted = np.array([1.0, 2.0, math.pi - 0.01, 0.0])
    seen = np.array([1.0, 2.0, -math.pi + 0.01, 0.0])
    fusion = fuse(predicted, np.diag([1e-4, 1e-4, 1e-4, 1e-6]), match_at(seen))
    assert math.cos(fusion.state[2] - math.pi) > 1.0 - 1e-3
    assert fusion.surprise < 4.0


def errors_in_wrong_maps(seeds: range) -> tuple[F64, F64]:
    """Errors (N, 3) and NEES per direction (N,) of the tracker in maps in which every wall lies off by up to 25 mm."""
    errors, nees = [], []
    for seed in seeds:
        room = rooms.jittered(rooms.office(), np.random.default_rng(seed))
        surfaces = SurfaceMap.from_occupancy(*room.occupancy())
        steps = list(drive(room, rooms.ROUTES["office"][:3], np.random.default_rng(seed), beams=240))[:110:4]
        tracker = GridTracker(surfaces, GridTrackerConfig())
        tracker.set_pose(0, steps[0].odom_from_base, steps[0].truth, np.diag([0.01, 0.01, 0.003]))
        for step in steps:
            estimate = tracker.update(Observation(step.stamp_ns, step.odom_from_base, step.points_base))
            error = error_of(estimate.map_from_base, step.truth)
            errors.append(error)
            nees.append(error @ np.linalg.solve(estimate.covariance, error) / 3.0)
    return np.array(errors), np.array(nees)


def test_in_wrong_maps_the_covariance_covers_the_errors() -> None:
    """Averaging over scans does not help against walls that are drawn wrongly: what is told must not shrink below it."""
    errors, nees = errors_in_wrong_maps(range(10, 22))
    assert 0.002 < np.hypot(*errors[:, :2].T).mean() < 0.012
    assert 0.5 < nees.mean() < 1.9


def test_standing_still_does_not_make_a_wrong_map_right() -> None:
    """60 scans from one place average the scanner's noise away, but not the walls that were drawn wrongly: what is told stays true."""
    nees, sigmas = [], []
    for seed in range(10, 18):
        rng = np.random.default_rng(seed)
        room = rooms.jittered(rooms.office(), rng)
        surfaces = SurfaceMap.from_occupancy(*room.occupancy())
        tracker, pose = GridTracker(surfaces, GridTrackerConfig()), SE2(7.0 + 0.3 * (seed - 14), 4.0, 0.4 * seed)
        tracker.set_pose(0, SE2(), pose, np.diag([0.01, 0.01, 0.003]))
        told = [tracker.update(Observation(k, SE2(), room.scan(pose, rng, beams=240))) for k in range(60)]
        error = error_of(told[-1].map_from_base, pose)
        nees.append(error @ np.linalg.solve(told[-1].covariance, error) / 3.0)
        sigmas.append([math.sqrt(np.trace(e.covariance[:2, :2])) for e in (told[4], told[-1])])
    assert np.mean(nees) < 3.0
    early, late = np.array(sigmas).T
    assert (late > 0.5 * early).all()


def test_the_kidnapped_tracker_does_not_believe_the_first_match_elsewhere() -> None:
    """A pose that is sure to 1 cm sees a scan from 25 cm away: that is a surprise, and not believed at once."""
    room = rooms.office()
    surfaces = SurfaceMap.from_occupancy(*room.occupancy())
    rng = np.random.default_rng(2)
    tracker = GridTracker(surfaces, GridTrackerConfig())
    pose = SE2(7.0, 4.0, 0.3)
    tracker.set_pose(0, SE2(), pose, np.diag([1e-4, 1e-4, 1e-5]))
    for k in range(3):
        estimate = tracker.update(Observation(k, SE2(), room.scan(pose, rng, beams=360)))
    assert estimate.mode is Mode.FULL
    aside = pose @ SE2(0.25, 0.1, 0.0)
    estimate = tracker.update(Observation(9, SE2(), room.scan(aside, rng, beams=360)))
    assert estimate.surprise > 12.0
    assert not estimate.is_updated
    assert estimate.map_from_base.distance_to(pose) < 0.02
    for k in range(10, 30):
        estimate = tracker.update(Observation(k, SE2(), room.scan(aside, rng, beams=360)))
    assert estimate.map_from_base.distance_to(aside) < 0.02, "what is seen again and again is believed"
