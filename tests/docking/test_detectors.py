"""Every detector finds its dock to the millimetre, says honestly how well, and sees no dock where there is none."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.camera import MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.covariance import difference, through_offset
from ambler.docking.detection import DockDetector, DockObservation
from ambler.docking.dock import Dock
from ambler.docking.marker_dock import MarkerDockDetector, _moved_rays
from ambler.docking.reflector_dock import ReflectorDockDetector, align
from ambler.docking.v_shape_dock import VShapeDockDetector
from ambler.perception.fiducials import FiducialDetector
from ambler.sim.camera import Light
from tests.docking.docks import (
    BASE_FROM_CAMERA,
    FRONT,
    MARKER_DOCK,
    MARKERS,
    NOTCH,
    ONE_MARKER,
    REFLECTORS,
    WEDGE,
    View,
    scan_of,
    segments_of_v,
)


def by_camera(dock: Dock) -> MarkerDockDetector:
    return MarkerDockDetector(dock, FiducialDetector(FRONT, [m.spec for m in dock.markers]), BASE_FROM_CAMERA)


def surprise(found: SE2, truth: SE2, covariance: np.ndarray) -> float:
    d = difference(truth, found)
    return float(d @ np.linalg.solve(covariance, d)) / 3.0


def test_several_markers_give_the_dock_at_one_metre() -> None:
    view, detector, rng = View(MARKER_DOCK), by_camera(MARKER_DOCK), np.random.default_rng(2)
    errors, turns = [], []
    for _ in range(7):
        truth = SE2(1.0 + rng.uniform(-0.1, 0.1), rng.uniform(-0.15, 0.15), rng.uniform(-0.2, 0.2))
        found = detector.detect(DockObservation(7, view.picture(truth)))
        assert found is not None
        assert found.stamp_ns == 7
        assert found.parts == 3
        errors.append(found.base_from_dock.distance_to(truth))
        turns.append(abs(found.base_from_dock.yaw - truth.yaw))
        assert surprise(found.base_from_dock, truth, found.covariance) < 5.0
    assert np.percentile(errors, 95) < 0.004, "0.95 m from the markers to the dock's origin: yaw is a lever"
    # One picture; the detector counts on prints that hang 1 mm and 0.3° off, and trusts a far marker's own slant more than exact ones would have it.
    assert np.percentile(turns, 95) < math.radians(0.25)


def test_one_marker_near_the_end_of_the_approach() -> None:
    """The last picture before the contact: 0.37 m from the lens to the marker."""
    view, detector, rng = View(ONE_MARKER), by_camera(ONE_MARKER), np.random.default_rng(3)
    for _ in range(6):
        truth = SE2(rng.uniform(0.0, 0.1), rng.uniform(-0.02, 0.02), rng.uniform(-0.03, 0.03))
        found = detector.detect(DockObservation(0, view.picture(truth)), SE2(0.05, 0.0, 0.0))
        assert found is not None
        assert found.base_from_dock.distance_to(truth) < 0.002
        assert abs(found.base_from_dock.yaw - truth.yaw) < math.radians(0.1)


def test_a_hidden_marker_bad_light_and_none_at_all() -> None:
    view, detector, truth = View(MARKER_DOCK), by_camera(MARKER_DOCK), SE2(0.9, 0.05, -0.1)
    for light, hidden in ((None, (3,)), (None, (8, 5)), (Light(0.3, (0.5, 0.0)), ()), (Light(1.4), (5,))):
        found = detector.detect(DockObservation(0, view.picture(truth, light, hidden)), SE2(0.95, 0.0, 0.0))
        assert found is not None
        assert found.parts == 3 - len(hidden)
        assert found.base_from_dock.distance_to(truth) < (
            0.015 if 3 in hidden else 0.03 if light == Light(1.4) else 0.008
        )
        assert surprise(found.base_from_dock, truth, found.covariance) < 5.0
    assert detector.detect(DockObservation(0, view.picture(truth, None, (3, 5, 8)))) is None
    assert detector.detect(DockObservation(0, view.picture(truth, Light(0.01)))) is None
    assert detector.detect(DockObservation(0)) is None


def test_a_marker_at_a_wrong_place_is_outvoted_or_refused() -> None:
    """The third marker of a dock was hung up 2 cm off: two agree. Of two, nobody knows which is right."""
    moved = (*MARKERS[:2], replace(MARKERS[2], y=-0.16))
    truth, told = SE2(0.9, 0.0, 0.05), MARKER_DOCK
    view = View(replace(told, markers=moved))
    found = by_camera(told).detect(DockObservation(0, view.picture(truth)), SE2(0.9, 0.0, 0.0))
    assert found is not None
    assert found.parts == 2
    assert found.base_from_dock.distance_to(truth) < 0.006
    two = replace(told, markers=(told.markers[0], told.markers[2]))
    assert by_camera(two).detect(DockObservation(0, view.picture(truth)), SE2(0.9, 0.0, 0.0)) is None


@pytest.mark.parametrize("stretch", [(1.003, 0.997), (0.997, 1.003)])
def test_a_lens_that_is_told_a_little_wrong_hides_no_dock(stretch: tuple[float, float]) -> None:
    """Near the dock its markers lie far apart in the picture: 0.3 % of the focal lengths are pixels there, and no contradiction between markers."""
    told = replace(FRONT, fx=FRONT.fx * stretch[0], fy=FRONT.fy * stretch[1])
    finder = FiducialDetector(told, [m.spec for m in MARKER_DOCK.markers])
    view, detector = View(MARKER_DOCK), MarkerDockDetector(MARKER_DOCK, finder, BASE_FROM_CAMERA)
    for ahead in (0.5, 0.4, 0.3):
        truth = SE2(ahead, 0.02, 0.05)
        found = detector.detect(DockObservation(0, view.picture(truth)), SE2(ahead + 0.02, 0.0, 0.0))
        assert found is not None
        assert found.base_from_dock.distance_to(truth) < 0.012


def test_the_configured_offset_is_applied_in_the_frame_of_the_dock() -> None:
    truth, offset = SE2(0.9, 0.1, 0.1), SE2(0.01, -0.004, 0.02)
    picture = View(MARKER_DOCK).picture(truth)
    found = by_camera(replace(MARKER_DOCK, offset=offset)).detect(DockObservation(0, picture), truth @ offset)
    assert found is not None
    plain = by_camera(MARKER_DOCK).detect(DockObservation(0, picture), truth)
    assert plain is not None
    assert np.allclose(difference(plain.base_from_dock, found.base_from_dock), offset.as_array(), atol=1e-6)
    assert found.base_from_dock.distance_to(truth @ offset) < 0.005


def test_far_away_a_small_marker_says_nothing_without_a_prior() -> None:
    small = replace(ONE_MARKER, markers=(replace(MARKERS[0], spec=MarkerSpec("4X4_50", 3, 0.07)),))
    view, detector = View(small), by_camera(small)
    with_prior, wrong = 0, 0
    for k in range(8):
        truth = SE2(1.4, 0.0, 0.15 * (-1) ** k)
        observation = DockObservation(0, view.picture(truth))
        found = detector.detect(observation)
        wrong += found is not None and surprise(found.base_from_dock, truth, found.covariance) > 20.0
        guided = detector.detect(observation, SE2(1.35, 0.05, truth.yaw * 0.8))
        if guided is not None:
            with_prior += 1
            assert guided.base_from_dock.distance_to(truth) < 0.15
    assert wrong == 0
    assert with_prior >= 4


@pytest.mark.parametrize("dock", [NOTCH, WEDGE], ids=["notch", "wedge"])
def test_a_v_shape_is_found_where_it_is(dock: Dock) -> None:
    rng, detector = np.random.default_rng(4), VShapeDockDetector(dock)
    errors, turns, surprises = [], [], []
    for _ in range(60):
        truth = SE2(rng.uniform(0.2, 1.2), rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2))
        scan = scan_of(segments_of_v(dock, truth), rng)
        found = detector.detect(DockObservation(0, None, scan), truth @ SE2(0.1, -0.1, 0.1))
        assert found is not None
        errors.append(found.base_from_dock.distance_to(truth))
        turns.append(abs(found.base_from_dock.yaw - truth.yaw))
        surprises.append(surprise(found.base_from_dock, truth, found.covariance))
    assert np.percentile(turns, 95) < math.radians(1.2)
    assert np.percentile(errors, 95) < 0.003 + 0.8 * math.radians(1.2), (
        "the corner lies before the base: its yaw is a lever"
    )
    assert 0.2 < np.mean(surprises) < 2.0


def test_other_corners_are_no_v_shape() -> None:
    rng, detector = np.random.default_rng(5), VShapeDockDetector(NOTCH)
    square = replace(NOTCH, v_shape=replace(NOTCH.v_shape, angle=math.radians(90.0)))
    scan = scan_of(segments_of_v(square, SE2(0.6, 0.0, 0.0)), rng)
    assert detector.detect(DockObservation(0, None, scan)) is None
    right = scan_of(segments_of_v(NOTCH, SE2(0.6, 0.0, 0.0)), rng)
    assert detector.detect(DockObservation(0, None, right)) is not None, "the only notch needs no prior"
    assert detector.detect(DockObservation(0, None, right), SE2(0.6, 1.0, 0.0)) is None, (
        "it is not where the prior says"
    )
    assert detector.detect(DockObservation(0, None, np.full((50, 2), np.nan))) is None
    assert detector.detect(DockObservation(0)) is None


def test_two_scanners_that_see_one_leg_each_show_a_notch() -> None:
    """Docked, a scanner at either front corner of the robot may look past the leg on its side: neither scan has a corner in it."""
    rng, detector = np.random.default_rng(10), VShapeDockDetector(NOTCH)
    assert NOTCH.v_shape is not None
    half, errors, turns = 0.5 * NOTCH.v_shape.angle, [], []
    for _ in range(30):
        truth = SE2(rng.uniform(-0.005, 0.02), rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01))
        legs = []
        for side in (1.0, -1.0):
            along = np.linspace(0.2, 0.98, 60)[:, None] * NOTCH.v_shape.leg
            leg = np.array([[0.8, 0.0]]) + along * np.array([[-math.cos(half), side * math.sin(half)]])
            legs.append(truth.transform(leg) + rng.normal(0.0, 0.006, (60, 2)))
        observation = DockObservation(0, None, np.concatenate(legs))
        found = detector.detect(observation, truth @ SE2(0.01, -0.005, 0.01))
        assert found is not None
        errors.append(found.base_from_dock.distance_to(truth))
        turns.append(abs(found.base_from_dock.yaw - truth.yaw))
        alone = DockObservation(0, None, legs[0])
        assert detector.detect(alone, truth) is None, "one leg tells no corner"
    assert np.percentile(turns, 95) < math.radians(1.5)
    assert np.percentile(errors, 95) < 0.003 + 0.8 * math.radians(1.5)


def bright(points: np.ndarray, strips: np.ndarray) -> np.ndarray:
    away = np.hypot(*(points[:, None] - strips[None]).transpose(2, 0, 1)).min(axis=1)
    return np.where(away < 0.03, 240.0, 60.0)


def test_reflectors_are_found_and_recognized() -> None:
    rng, detector = np.random.default_rng(6), ReflectorDockDetector(REFLECTORS)
    errors, turns, surprises = [], [], []
    for _ in range(60):
        truth = SE2(rng.uniform(0.2, 1.2), rng.uniform(-0.2, 0.2), rng.uniform(-0.3, 0.3))
        a, b = truth.transform(np.array([[0.71, -0.5], [0.71, 0.5]]))
        scan = scan_of(np.array([[*a, *b], [-1.0, -2.5, 5.0, -2.5]]), rng, step=math.radians(0.17))
        strips = truth.transform(np.vstack((REFLECTORS.reflectors + np.array([0.01, 0.0]), [[2.0, 3.0]])))
        found = detector.detect(DockObservation(0, None, scan, bright(scan, strips)))
        assert found is not None
        d = difference(truth, found.base_from_dock)
        errors.append(math.hypot(d[0] - 0.01, d[1]))
        turns.append(abs(d[2]))
        surprises.append(surprise(found.base_from_dock, truth @ SE2(0.01, 0.0, 0.0), found.covariance))
    assert np.percentile(errors, 95) < 0.008
    assert np.percentile(turns, 95) < math.radians(1.0)
    assert 0.05 < np.mean(surprises) < 2.0


def test_reflectors_are_seen_beyond_the_docked_pose_but_not_from_behind() -> None:
    rng, detector = np.random.default_rng(11), ReflectorDockDetector(REFLECTORS)
    for truth, is_seen in ((SE2(-0.008, 0.0, 0.0), True), (SE2(-1.9, 0.0, 0.0), False)):
        a, b = truth.transform(np.array([[0.7, -0.5], [0.7, 0.5]]))
        scan = scan_of(np.array([[*a, *b]]), rng, step=math.radians(0.17))
        shining = bright(scan, truth.transform(REFLECTORS.reflectors))
        found = detector.detect(DockObservation(0, None, scan, shining), truth)
        assert (found is not None) is is_seen


def test_strange_or_missing_reflectors_are_no_dock() -> None:
    rng, detector = np.random.default_rng(7), ReflectorDockDetector(REFLECTORS)
    truth = SE2(0.5, 0.0, 0.0)
    a, b = truth.transform(np.array([[0.7, -0.5], [0.7, 0.5]]))
    scan = scan_of(np.array([[*a, *b]]), rng)
    strips = truth.transform(REFLECTORS.reflectors)
    for part in (strips[:1], strips + np.array([[0.0, 0.0], [0.0, 0.1], [0.0, 0.0]])):
        assert detector.detect(DockObservation(0, None, scan, bright(scan, part))) is None
    two = detector.detect(DockObservation(0, None, scan, bright(scan, strips[:2])), SE2(0.5, 0.0, 0.0))
    assert two is not None, "two of three are enough when a prior tells where"
    assert detector.detect(DockObservation(0, None, scan)) is None


def test_the_weighted_alignment_is_the_best_one() -> None:
    rng = np.random.default_rng(8)
    truth, points = SE2(0.4, -0.3, 2.0), rng.normal(0.0, 1.0, (6, 2))
    sigma = rng.uniform(0.005, 0.05, 6)
    runs = []
    for _ in range(400):
        pose, covariance = align(truth.transform(points) + rng.normal(0.0, 1.0, (6, 2)) * sigma[:, None], points, sigma)
        runs.append([pose.x - truth.x, pose.y - truth.y, pose.yaw - truth.yaw])
    sample = np.cov(np.array(runs).T)
    assert np.abs(np.sqrt(np.diag(sample)) / np.sqrt(np.diag(covariance)) - 1.0).max() < 0.15


def test_covariances_follow_an_offset() -> None:
    rng = np.random.default_rng(9)
    pose, offset, sigma = SE2(1.0, 2.0, 0.7), SE2(0.5, -0.3, 1.1), np.array([0.01, 0.02, 0.03])
    moved = [
        difference(pose @ offset, pose @ SE2(*(rng.normal(0.0, 1.0, 3) * sigma).tolist()) @ offset) for _ in range(4000)
    ]
    expected = through_offset(np.diag(sigma**2), offset)
    assert np.abs(np.cov(np.array(moved).T) - expected).max() < 0.08 * expected.max()


def test_a_detector_needs_what_it_looks_for() -> None:
    for maker in (VShapeDockDetector, ReflectorDockDetector):
        with pytest.raises(BadInputError, match="charger"):
            maker(MARKER_DOCK)
    with pytest.raises(BadInputError, match="no markers"):
        by_camera(NOTCH)
    detectors: list[DockDetector] = [
        by_camera(MARKER_DOCK),
        VShapeDockDetector(NOTCH),
        ReflectorDockDetector(REFLECTORS),
    ]
    assert all(d.detect(DockObservation(0)) is None for d in detectors)


def test_how_rays_move_with_a_marker_is_their_derivative() -> None:
    camera_from_marker = SE3.from_rpy((0.05, -0.03, 0.8), math.pi + 0.1, 0.2, -0.05)
    corners = MarkerSpec("4X4_50", 3, 0.12).corners()

    def rays(step: np.ndarray) -> np.ndarray:
        moved = camera_from_marker @ SE3.from_rpy(tuple(step[:3].tolist()), *step[3:6].tolist())
        seen = moved.transform(corners * (1.0 + step[6]))
        return np.asarray((seen[:, :2] / seen[:, 2:]).reshape(-1))

    h = 1e-6
    numeric = np.column_stack([(rays(h * e) - rays(-h * e)) / (2.0 * h) for e in np.eye(7)])
    assert np.abs(_moved_rays(camera_from_marker, corners) - numeric).max() < 1e-6


def test_markers_that_hang_as_people_hang_them_are_believed_and_surprise_nobody() -> None:
    """Each 1 mm and 0.3° off, its print 0.3 % too large: all are used, and the pose errs as much as its covariance says."""
    rng, truth, surprises = np.random.default_rng(8), SE2(0.4, 0.02, 0.03), []
    for _ in range(10):
        hung = []
        for m in MARKERS:
            x, y, z = (float(v) for v in rng.uniform(-0.001, 0.001, 3))
            size = m.spec.size * (1.0 + float(rng.uniform(-0.003, 0.003)))
            yaw = m.yaw + float(rng.uniform(-1.0, 1.0)) * math.radians(0.3)
            hung.append(replace(m, spec=replace(m.spec, size=size), x=m.x + x, y=m.y + y, z=m.z + z, yaw=yaw))
        view = View(replace(MARKER_DOCK, markers=tuple(hung)))
        found = by_camera(MARKER_DOCK).detect(DockObservation(0, view.picture(truth)), truth)
        assert found is not None
        assert found.parts == 3
        surprises.append(surprise(found.base_from_dock, truth, found.covariance))
    assert 0.2 < np.mean(surprises) < 2.0
