"""The bias of a marker's range, calibrated with a tape measure.

Blooming, ink that runs and a camera's curve of brightness move the edges of a dark square outwards or inwards by a constant part of a
pixel, whatever its size; a square of side s at range r then seems nearer by 2 shift r^2 / (focal s). So one number, found with
one marker at several distances, holds for every size. The tape starts at the housing, not at the optical centre: that offset is
found with it. Distances are those from the camera to the middle of the marker, measured to about 2 mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel, MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

SPAN = 1.8  # the farthest distance must be so many times the nearest: shift and offset look alike otherwise
PICTURES = 5


class SeenMarker(Protocol):
    """A marker of known size where a detector sees it."""

    @property
    def marker(self) -> MarkerSpec: ...

    @property
    def camera_from_marker(self) -> SE3: ...


class MarkerRanger(Protocol):
    """What is calibrated: a detector of markers that takes their edges to be `shift_px` farther out than they are."""

    @property
    def camera(self) -> CameraModel: ...

    @property
    def shift_px(self) -> float: ...

    def detect(self, image: U8) -> Sequence[SeenMarker]:
        """Return the markers of a grey picture uint8 (H, W)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TapedPicture:
    """A picture of one marker and the taped distance from the camera to its middle (m)."""

    image: U8
    distance: float


@dataclass(frozen=True, slots=True)
class RangeBias:
    """`shift_px` is what the detector's `shift_px` must be, `offset` how far before (positive) the optical centre the tape began; `residual`
    (m, RMS) is what stays, about the tape's own error if all is well."""

    shift_px: float
    shift_sigma_px: float
    offset: float
    residual: float
    pictures: int


def calibrate_range(detector: MarkerRanger, pictures: Sequence[TapedPicture], tape_sigma: float = 0.002) -> RangeBias:
    """Find the shift from pictures of one marker; raises BadInputError when they cannot tell it."""
    ranges, slopes, tape = _ranges(detector, pictures)
    if len(tape) < PICTURES:
        raise BadInputError(f"a marker was found in {len(tape)} of {len(pictures)} pictures; {PICTURES} are needed")
    if tape.max() < SPAN * tape.min():
        raise BadInputError(
            f"the distances reach from {tape.min():.2f} to {tape.max():.2f} m; the farthest must be {SPAN} times the nearest"
        )
    # range - tape = offset + slope * shift; the picture's own noise grows with the square of the range.
    sigma = np.hypot(tape_sigma, 0.05 * np.abs(slopes))
    design = np.column_stack((np.ones(len(tape)), slopes)) / sigma[:, None]
    wanted = (ranges - tape) / sigma
    solution = np.linalg.lstsq(design, wanted, rcond=None)[0]
    covariance = np.linalg.inv(design.T @ design)
    rest = ranges - tape - solution[0] - slopes * solution[1]
    residual = float(np.sqrt(np.mean(rest**2)))
    if residual > 5.0 * tape_sigma:
        raise BadInputError(
            f"distances and pictures disagree by {residual * 1e3:.1f} mm: a distance or the size of the marker is wrong"
        )
    return RangeBias(
        detector.shift_px + float(solution[1]), math.sqrt(float(covariance[1, 1])), float(solution[0]), residual, len(tape)
    )  # fmt: skip


def check_range(detector: MarkerRanger, pictures: Sequence[TapedPicture], offset: float) -> F64:
    """Return the errors of the range (m), float64 (K,), on pictures that were not used: of a marker of another size."""
    ranges, _, tape = _ranges(detector, pictures)
    if len(tape) == 0:
        raise BadInputError("no marker was found in the pictures of the check")
    return np.asarray(ranges - tape - offset)


def _ranges(detector: MarkerRanger, pictures: Sequence[TapedPicture]) -> tuple[F64, F64, F64]:
    """Return ranges, their change per pixel of shift that is missing, and taped distances, each (K,)."""
    rows = []
    for picture in pictures:
        if not math.isfinite(picture.distance) or picture.distance <= 0.0:
            raise BadInputError(f"a distance of {picture.distance} m cannot have been measured")
        found = detector.detect(picture.image)
        if len(found) != 1:
            continue
        x, y, z = found[0].camera_from_marker.translation
        r = math.sqrt(x * x + y * y + z * z)
        rows.append((r, 2.0 * r * r / (detector.camera.fx * found[0].marker.size), picture.distance))
    table = np.array(rows).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]
