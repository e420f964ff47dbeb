"""Real photographs of an AprilTag on a turntable (recorded data, read where it lies)."""

import math

import cv2
import numpy as np

from ambler.core.camera import CameraModel, MarkerSpec
from ambler.perception.fiducials import FiducialConfig, FiducialDetector
from tests.public_data import public

CAMERA = CameraModel("photo", 1056, 792, 329.8729619143081, 332.94611303946357, 528.0, 396.0)
TAG = MarkerSpec("APRILTAG_36H11", 76, 0.065)


def test_a_turned_tag_is_followed_over_120_degrees() -> None:
    """The pictures are undistorted imperfectly (the corners of a true square miss by about a pixel), and the zero of the turntable is
    known to a degree or two: the angles must follow it to 3 degrees, the places lie on a circle to 3 mm."""
    detector = FiducialDetector(CAMERA, [TAG], FiducialConfig(error_px=3.0))
    angles, places = np.array([-60, -30, 0, 30, 60]), []
    turned = []
    for angle in angles:
        image = cv2.imread(str(public(f"apriltag/test_image_rotation_{angle}.png")), cv2.IMREAD_GRAYSCALE)
        (found,) = detector.detect(image)
        matrix = found.camera_from_marker.matrix()
        turned.append(math.degrees(math.atan2(matrix[0, 2], -matrix[2, 2])))
        places.append(matrix[:3, 3])
        assert matrix[1, 1] < -0.9, "it stands upright: its y axis points up"
    off = np.array(turned) - angles
    assert np.abs(off).max() < 4.0
    assert np.abs(off - off.mean()).max() < 3.0
    a = np.radians(angles)
    design = np.zeros((10, 3))
    design[:5, 0], design[5:, 1] = 1.0, 1.0
    design[:5, 2], design[5:, 2] = np.sin(a), -np.cos(a)
    seen = np.array(places)[:, [0, 2]].T.reshape(-1)
    circle, *_ = np.linalg.lstsq(design, seen, rcond=None)
    assert np.abs(design @ circle - seen).max() < 0.003
    assert np.ptp(np.array(places)[:, 1]) < 0.003
