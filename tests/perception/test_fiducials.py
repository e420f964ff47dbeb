"""Markers in rendered pictures: how exact, how honest, and what happens with bad light, motion, covers and unknown prints."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ambler.calibration.range_bias import TapedPicture, calibrate_range, check_range
from ambler.core.camera import MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.perception.fiducials import FiducialDetector, angle_between
from ambler.sim.camera import (
    FRONT_CAMERA,
    CameraSpec,
    Light,
    PictureNoise,
    Print,
    PrintCamera,
    marker_print,
    plain_print,
)

MARKER = MarkerSpec("4X4_50", 3, 0.15)
FACING = SE3.from_rpy((0.0, 0.0, 0.0), math.pi, 0.0, 0.0)
DETECTOR = FiducialDetector(FRONT_CAMERA, [MARKER])


@pytest.fixture(scope="module")
def camera() -> PrintCamera:
    return PrintCamera(CameraSpec(), np.random.default_rng(1))


def placed(x: float, y: float, z: float, turn: float = 0.0, tilt: float = 0.0) -> SE3:
    """A marker before the camera, turned about its vertical."""
    return SE3((x, y, z)) @ FACING @ SE3.from_rpy((0.0, 0.0, 0.0), tilt, turn, 0.0)


def shown(marker: MarkerSpec, camera_from_marker: SE3) -> Print:
    return marker_print(marker.dictionary, marker.number, marker.size, camera_from_marker)


def error_of(found: SE3, truth: SE3) -> float:
    return float(np.linalg.norm(np.subtract(found.translation, truth.translation)))


def test_position_at_one_metre_while_the_robot_stands(camera: PrintCamera) -> None:
    """The bar of the issue: 1 mm in 95 % of the pictures."""
    rng, errors, surprises = np.random.default_rng(2), [], []
    for _ in range(24):
        pose = placed(rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), 1.0, rng.uniform(-0.4, 0.4))
        (found,) = DETECTOR.detect(camera.take([SE3()], [shown(MARKER, pose)]))
        errors.append(error_of(found.camera_from_marker, pose))
        d = pose.inverse() @ found.camera_from_marker
        e = np.array([*d.translation, *(2.0 * np.sign(d.rotation[0]) * np.array(d.rotation[1:]))])
        surprises.append(float(e @ np.linalg.solve(found.covariance, e)) / 6.0)
    assert np.percentile(errors, 95) < 0.0006
    assert 0.05 < np.mean(surprises) < 3.0


def test_position_at_one_metre_while_the_robot_moves(camera: PrintCamera) -> None:
    """0.3 m/s sideways and 0.3 rad/s, exposed for 8 ms, slanted light: 3 mm in 95 %; the pose is that of the middle of the exposure."""
    rng, errors = np.random.default_rng(3), []
    for _ in range(12):
        pose = placed(rng.uniform(-0.1, 0.1), 0.0, 1.0, rng.uniform(-0.3, 0.3))
        way, turn = 0.3 * 0.008, 0.3 * 0.008
        poses = [SE3.from_rpy((way * t, 0.0, 0.5 * way * t), 0.0, turn * t, 0.0) for t in (-0.4, -0.2, 0.0, 0.2, 0.4)]
        (found,) = DETECTOR.detect(camera.take(poses, [shown(MARKER, pose)], Light(1.0, (0.2, -0.2))))
        errors.append(error_of(found.camera_from_marker, pose))
    assert np.percentile(errors, 95) < 0.002


def test_several_dictionaries_at_once(camera: PrintCamera) -> None:
    markers = [MARKER, MarkerSpec("APRILTAG_36H11", 7, 0.12), MarkerSpec("5X5_250", 100, 0.1)]
    poses = [placed(-0.22, 0.0, 0.9), placed(0.0, 0.05, 0.9, 0.2), placed(0.2, 0.0, 0.9, -0.3)]
    image = camera.take([SE3()], [shown(m, p) for m, p in zip(markers, poses, strict=True)])
    found = {s.marker: s.camera_from_marker for s in FiducialDetector(FRONT_CAMERA, markers).detect(image)}
    assert set(found) == set(markers)
    for marker, pose in zip(markers, poses, strict=True):
        assert error_of(found[marker], pose) < 0.001
        assert angle_between(found[marker], pose) < math.radians(0.5)


@pytest.mark.parametrize(
    ("light", "noise"),
    [
        (Light(0.25), PictureNoise(0.6, 2.5)),
        (Light(1.0, (0.6, 0.3)), PictureNoise(0.6, 2.5)),
        (Light(), PictureNoise(1.8, 2.5)),
        (Light(), PictureNoise(0.6, 12.0)),
    ],
    ids=["dark", "slanted_light", "out_of_focus", "noisy"],
)
def test_bad_pictures_cost_little(light: Light, noise: PictureNoise) -> None:
    bad, pose = PrintCamera(CameraSpec(picture=noise), np.random.default_rng(4)), placed(0.05, 0.0, 1.0, 0.3)
    for _ in range(3):
        (found,) = DETECTOR.detect(bad.take([SE3()], [shown(MARKER, pose)], light))
        assert error_of(found.camera_from_marker, pose) < 0.003
        assert angle_between(found.camera_from_marker, pose) < math.radians(1.0)


def test_a_hand_over_an_edge_is_noticed_or_borne(camera: PrintCamera) -> None:
    pose = placed(0.0, 0.0, 0.8, 0.25)
    for y in (0.066, 0.072, 0.08):
        hand = plain_print(90, 0.03, 0.03, placed(0.02, y, 0.7))
        for found in DETECTOR.detect(camera.take([SE3()], [shown(MARKER, pose), hand])):
            assert error_of(found.camera_from_marker, pose) < 0.003


def test_a_prior_chooses_between_the_two_poses() -> None:
    """Far away the wrong pose fits as well: without a prior the detection says so, with one it is right."""
    noisy = PrintCamera(CameraSpec(picture=PictureNoise(0.8, 8.0)), np.random.default_rng(5))
    small, wrong, unsure = MarkerSpec("4X4_50", 3, 0.08), 0, 0
    detector = FiducialDetector(FRONT_CAMERA, [small])
    for k in range(10):
        pose = placed(0.0, 0.0, 2.0, 0.12 * (-1) ** k)
        image = noisy.take([SE3()], [shown(small, pose)])
        for found in detector.detect(image):
            unsure += found.is_ambiguous
            is_wrong = angle_between(found.camera_from_marker, pose) > math.radians(8.0)
            wrong += is_wrong and not found.is_ambiguous
        (guided,) = detector.detect(image, {small.name: placed(0.0, 0.0, 2.0, 0.1 * (-1) ** k)})
        assert angle_between(guided.camera_from_marker, pose) < math.radians(7.0)
    assert wrong == 0
    assert unsure >= 3


def test_unknown_markers_are_ignored_and_doubles_need_a_prior(camera: PrintCamera) -> None:
    stranger = MarkerSpec("4X4_50", 9, 0.15)
    assert DETECTOR.detect(camera.take([SE3()], [shown(stranger, placed(0.0, 0.0, 1.0))])) == ()
    twins = [placed(-0.2, 0.0, 1.0), placed(0.2, 0.0, 1.0)]
    image = camera.take([SE3()], [shown(MARKER, p) for p in twins])
    assert DETECTOR.detect(image) == ()
    (found,) = DETECTOR.detect(image, {MARKER.name: placed(0.15, 0.0, 1.0)})
    assert error_of(found.camera_from_marker, twins[1]) < 0.001


def test_bad_input_is_refused() -> None:
    with pytest.raises(BadInputError, match="no dictionary"):
        FiducialDetector(FRONT_CAMERA, [MarkerSpec("9X9_1", 0, 0.1)])
    with pytest.raises(BadInputError, match="twice"):
        FiducialDetector(FRONT_CAMERA, [MARKER, MARKER])
    with pytest.raises(BadInputError, match="640 x 480"):
        DETECTOR.detect(np.zeros((100, 100), np.uint8))


def blooming(camera: PrintCamera, marker: MarkerSpec, distance: float) -> np.ndarray:
    """A picture in which bright eats dark: the brightest of what a pixel and its neighbours see, in part."""
    image = camera.take([SE3()], [shown(marker, placed(0.01, 0.0, distance, 0.2))])
    spread = cv2.dilate(image, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.addWeighted(image, 0.7, spread, 0.3, 0.0), np.uint8)


def test_the_bias_of_the_range_is_found_with_a_tape_and_holds_for_another_size() -> None:
    camera = PrintCamera(CameraSpec(), np.random.default_rng(6))
    tape = np.random.default_rng(7)
    used = [
        TapedPicture(blooming(camera, MARKER, d), d - 0.021 + float(tape.uniform(-0.002, 0.002)))
        for d in np.linspace(0.5, 2.3, 8)
    ]
    bias = calibrate_range(DETECTOR, used)
    assert bias.shift_px > 0.1
    assert bias.offset == pytest.approx(0.021, abs=0.003)
    assert bias.residual < 0.004
    other = MarkerSpec("4X4_50", 3, 0.1)
    check = [TapedPicture(blooming(camera, other, d), d - 0.021) for d in (0.6, 1.0, 1.4)]
    plain = FiducialDetector(FRONT_CAMERA, [other])
    before = np.abs(check_range(plain, check, bias.offset))
    after = np.abs(check_range(plain.with_shift(bias.shift_px), check, bias.offset))
    assert before.max() > 0.006
    assert after[1] < 0.003
    assert after.max() < 0.5 * before.max()
    wrong = FiducialDetector(FRONT_CAMERA, [replace(other, size=0.105)])
    assert np.abs(check_range(wrong.with_shift(bias.shift_px), check, bias.offset)).min() > 0.02, (
        "the check sees a wrong size"
    )
    with pytest.raises(BadInputError, match="5 are needed"):
        calibrate_range(DETECTOR, used[:3])
    with pytest.raises(BadInputError, match="times the nearest"):
        calibrate_range(DETECTOR, used[-1:] * 5)
    with pytest.raises(BadInputError, match="disagree"):
        calibrate_range(DETECTOR, [replace(p, distance=p.distance + 0.03 * (k % 2)) for k, p in enumerate(used[:5])])
