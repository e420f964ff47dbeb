"""Loop closure in space: planted drift is taken out, what slides or looks alike is not closed, and what contradicts does not count."""

from __future__ import annotations

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import spatial_error
from ambler.lio.config import DriftConfig, LioConfig, LoopConfig
from ambler.lio.degeneracy import Degeneracy
from ambler.lio.health import Health, LioResult
from ambler.lio.keyframes import Keyframe, KeyframeBuilder
from ambler.lio.loop_closure import LoopClosure
from ambler.lio.loop_match import error_of, match_keyframes, search_keyframes
from ambler.lio.odometry import LidarInertialOdometry
from ambler.registration import submap_match
from ambler.registration.submap_match import match_clouds, thin_cloud
from tests.lio.carried import scans_of, walk

F64 = NDArray[np.float64]
HEALTH = Health(1, 1, 0.01, 0.0, 0.0, 0.3, *([Degeneracy.none().translation] * 2), 1, 0.0, False)
DRIFTING = LioConfig(  # a loop of 25 m whose odometry drifts as that of kilometres does
    drift=DriftConfig(position=5.3e-3, rotation=1.06e-3), loops=LoopConfig(keyframe_m=2.5, way_least=15.0)
)


@functools.cache
def walked() -> tuple[list[LioResult], list[SE3]]:
    rig, scans = walk()
    odometry = LidarInertialOdometry(LioConfig(), rig.told_mount)
    pairs = [(odometry.update(scan), told.world_from_imu) for scan, told in zip(scans_of(scans), scans, strict=True)]
    return [r for r, _ in pairs if r is not None], [t for r, t in pairs if r is not None]


def drifted(results: list[LioResult], yaw: float, climb: float) -> list[LioResult]:
    """The same odometry with an error of heading (rad) and height (m) per metre."""
    out, pose = [results[0]], results[0].map_from_imu
    for before, after in pairwise(results):
        step = before.map_from_imu.inverse() @ after.map_from_imu
        way = float(np.linalg.norm(step.translation))
        pose = pose @ step @ SE3.from_rpy((0.0, 0.0, climb * way), 0.0, 0.0, yaw * way)
        out.append(replace(after, map_from_imu=pose))
    return out


def closed(results: list[LioResult], config: LioConfig) -> LoopClosure:
    loops = LoopClosure(config)
    for result in results:
        loops.add(result)
    loops.finish()
    return loops


def rms(results: list[LioResult], poses: list[SE3], truth: list[SE3]) -> float:
    stamps = np.array([r.stamp_ns for r in results])
    return spatial_error(stamps, poses, stamps, truth).ate_rms_m


def test_planted_drift_is_taken_out() -> None:
    results, truth = walked()
    bent = drifted(results, 0.004, 0.01)
    poses = [r.map_from_imu for r in bent]
    loops = closed(bent, DRIFTING)
    after = loops.corrected(np.array([r.stamp_ns for r in bent]), poses)
    assert len(loops.closures) >= 3
    assert loops.is_converged
    assert rms(bent, poses, truth) > 0.1
    assert rms(bent, after, truth) < 0.025
    end = loops.map_from_odom @ poses[-1]
    assert np.linalg.norm(np.array(end.translation) - after[-1].translation) < 1e-9
    assert after[0].translation == pytest.approx(poses[0].translation, abs=1e-12)


def test_every_closure_is_true() -> None:
    results, truth = walked()
    loops = closed(drifted(results, 0.004, 0.01), DRIFTING)
    mount = walk()[0].mount
    of = {r.stamp_ns: (t @ mount).matrix() for r, t in zip(results, truth, strict=True)}
    for closure in loops.closures:
        frames = (loops.keyframes[k].stamp_ns for k in (closure.earlier, closure.later))
        a, b = (of[stamp] for stamp in frames)
        error = error_of(np.linalg.inv(a) @ b, closure.earlier_from_later)
        assert np.linalg.norm(error[:3]) < 0.05
        assert np.linalg.norm(error[3:]) < 0.005


def test_twice_the_same_is_the_same_to_the_bit() -> None:
    results, _ = walked()
    bent = drifted(results, 0.004, 0.01)
    a, b = (closed(bent, DRIFTING) for _ in range(2))
    assert all((p == q).all() for p, q in zip(a.map_from_keyframes, b.map_from_keyframes, strict=True))


def test_a_keyframe_covers_a_stretch_and_stays_bounded() -> None:
    results, _ = walked()
    config = LioConfig(loops=LoopConfig(keyframe_m=4.0, points_most=3000))
    builder = KeyframeBuilder(config)
    frames = [f for r in results if (f := builder.add(r)) is not None] + [builder.finish()]
    assert 5 <= len(frames) <= 9
    ways = [f.way for f in frames if f is not None]
    assert frames[0] is not None
    assert frames[0].is_at_rest
    assert np.diff(ways)[1:-1] == pytest.approx(4.0, abs=0.3)
    assert all(f is not None and 300 < len(f.cloud.points) <= 3000 for f in frames)
    ups = np.array([f.up for f in frames if f is not None])
    assert (ups[:, 2] > 0.99).all()


def wall(rng: np.random.Generator, along: F64, up: F64, corner: F64, count: int) -> F64:
    """Points of a rectangle with a centimetre of noise across."""
    across = np.cross(along, up) / np.linalg.norm(np.cross(along, up))
    return np.asarray(corner + rng.random((count, 1)) * along + rng.random((count, 1)) * up + 0.01 * rng.standard_normal((count, 1)) * across)  # fmt: skip


def frame_of(points: F64) -> Keyframe:
    return Keyframe(0, 0.0, np.eye(4), thin_cloud(points, 0.3), None, 1e-6 * np.eye(6))


def corridor(seed: int, has_end: bool) -> Keyframe:
    rng, x, y, z = np.random.default_rng(seed), *np.eye(3)
    low = np.array([-20.0, -1.5, -1.0])
    parts = [wall(rng, 40 * x, 3 * z, low + off * y, 8000) for off in (0.0, 3.0)]
    parts += [wall(rng, 40 * x, 3 * y, low + off * z, 8000) for off in (0.0, 3.0)]
    if has_end:
        parts += [wall(rng, 3 * y, 3 * z, low + at * x, 1500) for at in (3.0, 36.0)]
    return frame_of(np.vstack(parts))


def test_a_corridor_is_not_closed_along_itself() -> None:
    guess = np.eye(4)
    guess[:3, 3] = (0.6, 0.1, -0.1)
    found = match_keyframes((corridor(1, False), corridor(2, False)), (0, 1), guess, LoopConfig())
    assert found is not None
    assert found.is_weak
    along = np.array([1.0, 0, 0, 0, 0, 0])
    assert along @ found.information @ along < 1e-3 * found.information[1, 1]
    assert along @ found.covariance @ along > 1e3
    assert np.abs(found.earlier_from_later[1:3, 3]).max() < 0.01
    ended = match_keyframes((corridor(1, True), corridor(2, True)), (0, 1), guess, LoopConfig())
    assert ended is not None
    assert not ended.is_weak
    assert np.abs(ended.earlier_from_later[:3, 3]).max() < 0.02


def test_another_place_is_refused() -> None:
    rng, (x, y, z) = np.random.default_rng(3), np.eye(3)
    ground = [wall(rng, 30 * x, 30 * y, np.array([-15.0, -15.0, -1.0]), 9000)]
    places = []
    for _ in range(2):
        houses = [wall(rng, 8 * np.cos(a) * x + 8 * np.sin(a) * y, 5 * z, np.array([*rng.uniform(-14, 14, 2), -1.0]), 3000) for a in rng.uniform(0, 3, 6)]  # fmt: skip
        places.append(frame_of(np.vstack([*ground, *houses])))
    assert match_keyframes((places[0], places[0]), (0, 1), np.eye(4), LoopConfig()) is not None
    assert match_keyframes((places[0], places[1]), (0, 1), np.eye(4), LoopConfig()) is None


def test_what_cannot_overlap_is_refused_before_it_is_matched_and_what_can_is_matched_as_ever() -> None:
    """A storey above another one has walls at the same places; the height tells them apart."""
    rng = np.random.default_rng(3)
    floor = np.column_stack([rng.uniform(-12, 12, (9000, 2)), np.zeros(9000)])
    walls = [
        np.column_stack([rng.uniform(-12, 12, 3000), np.full(3000, y), rng.uniform(0, 2.6, 3000)]) for y in (-12.0, 9.0)
    ]
    walls += [w[:, [1, 0, 2]] for w in walls]
    storey = thin_cloud(np.concatenate([floor, *walls]), 0.3)
    assert len(submap_match._prepared(storey).few.points()) < 0.4 * len(storey.points)
    near, far = np.eye(4), np.eye(4)
    near[:3, 3], far[:3, 3] = (0.6, -0.4, 0.2), (0.0, 0.0, 3.4)
    checked, unchecked = (match_clouds(storey, storey, near, 2.0, least) for least in (0.55, 0.0))
    assert checked is not None
    assert unchecked is not None
    np.testing.assert_array_equal(checked.target_from_source, unchecked.target_from_source)
    assert np.abs(checked.target_from_source - np.eye(4)).max() < 2e-3
    assert match_clouds(storey, storey, far, 2.0, 0.55) is None


def test_a_third_of_the_points_is_no_place_whatever_it_fits() -> None:
    place = corridor(5, True).cloud.points
    more = frame_of(np.vstack([place, place + np.array([0.0, 60.0, 0.0]), place - np.array([0.0, 60.0, 0.0])]))
    assert match_keyframes((frame_of(place), frame_of(place)), (0, 1), np.eye(4), LoopConfig()) is not None
    assert match_keyframes((frame_of(place), more), (0, 1), np.eye(4), LoopConfig()) is None


def test_a_match_beside_what_the_drift_allows_does_not_count() -> None:
    """Equal bays every three metres: odometry that drifts by a millimetre per metre cannot have slipped by a bay."""
    results, _ = walked()
    bent = drifted(results, 0.0, 0.06)
    loops = closed(bent, replace(DRIFTING, drift=DriftConfig()))
    assert loops.tried > 0
    assert loops.closures == []


def test_a_keyframe_is_small_however_many_there_are() -> None:
    """A way of kilometres has a thousand of them: their points lie on the disk, and what a match makes of them is forgotten but for the last ones."""
    results, _ = walked()
    loops = closed(results, DRIFTING)
    assert len(loops.keyframes) > 6
    for frame in loops.keyframes:
        points = frame.cloud.points
        assert points is not frame.cloud.points  # read from the disk each time
        assert points.dtype == np.float32
        assert 1000 < len(points) <= DRIFTING.loops.points_most
    kept = results[-1].without_points().points_imu
    assert (len(kept), kept.base) == (0, None)
    assert submap_match._prepared.cache_info().maxsize == submap_match.KEPT <= 16


def bent_frames() -> tuple[LoopClosure, list[SE3]]:
    results, truth = walked()
    loops = closed(results, replace(DRIFTING, loops=replace(DRIFTING.loops, way_least=1e9)))
    return loops, truth


def test_a_window_is_searched_where_drift_is_beyond_reach() -> None:
    loops, _ = bent_frames()
    frames, poses = loops.keyframes, loops.map_from_keyframes
    last = len(frames) - 1
    true = np.linalg.inv(poses[0]) @ poses[last]
    off = SE3.from_rpy((4.0, -3.5, 0.1), 0.0, 0.0, 0.3).matrix() @ poses[last]
    pair, window, config = (frames[0], frames[last]), (6.0, 0.5), LoopConfig(range_most=20.0)
    found = search_keyframes(pair, (0, last), (poses[0], off), window, config)
    assert found is not None
    assert np.linalg.norm(error_of(true, found.earlier_from_later)[:3]) < 0.03
    assert found.moved_m > 3.0


def test_two_places_that_fit_about_as_well_are_none() -> None:
    """Equal bays in a corridor: a window that holds several of them cannot tell which."""
    rng, (x, y, z) = np.random.default_rng(4), np.eye(3)

    def bays() -> Keyframe:
        low = np.array([-16.0, -2.0, -1.0])
        parts = [wall(rng, 32 * x, 3 * z, low + off * y, 9000) for off in (0.0, 4.0)] + [wall(rng, 32 * x, 4 * y, low, 9000)]  # fmt: skip
        parts += [wall(rng, 1.2 * y, 3 * z, low + (4.0 * k + 0.7) * x, 700) for k in range(8)]
        return frame_of(np.vstack(parts))

    frames, pose = (bays(), bays()), np.eye(4)
    assert match_keyframes(frames, (0, 1), pose, LoopConfig()) is not None
    assert search_keyframes(frames, (0, 1), (pose, pose), (9.0, 0.1), LoopConfig()) is None
