"""One protocol for everything that sees a dock: an observation in, the dock's pose in the base frame out, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class DockObservation:
    """What a detector may look at; a field is None when there is nothing new of it.

    image        uint8 (H, W), grey
    points_base  float64 (N, 2) of a scan in the base frame of the stamp, in the order of the beams, scanner after scanner; `intensities` (N,)
                 of the points, or None
    """

    stamp_ns: int
    image: U8 | None = None
    points_base: F64 | None = None
    intensities: NDArray[np.floating] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DockDetection:
    """The dock as seen at one instant: `base_from_dock` with covariance (3, 3) of (x, y, yaw), perturbed on the right; `source` tells
    what saw it, `parts` how many markers, legs or reflectors agree."""

    stamp_ns: int
    source: str
    base_from_dock: SE2
    covariance: F64
    parts: int


class DockDetector(Protocol):
    """Sees one dock."""

    def detect(self, observation: DockObservation, prior: SE2 | None = None) -> DockDetection | None:
        """Return the dock, or None when it is not seen. `prior` is where it is expected in the base frame: it decides between
        ambiguous poses and may limit the search, but does not move the result."""
        ...


def require_numbers(observation: DockObservation) -> bool:
    """Say whether the points of an observation can be used: there are some and all are finite."""
    points = observation.points_base
    return points is not None and len(points) > 0 and bool(np.isfinite(points).all())
