"""What every localizer in a known map is: observations in, estimates out. One conformance suite runs over all of them."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What was seen at one instant: points float32 (N, 2) in the base frame (merged scan, merged cloud or both), the odometry
    pose of that instant, and optionally intensities float32 (N,) of the points."""

    stamp_ns: int
    odom_from_base: SE2
    points_base: F32
    intensities: F32 | None = None


class Mode(enum.IntEnum):
    """How much of the pose the last observation determined; the rest is left to odometry and its variance grows."""

    ODOMETRY = 0
    LINE = 1
    LINE_AND_YAW = 2
    FULL = 3


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A pose in the map with its covariance float64 (3, 3) of (x, y, yaw) along the map's axes (m², m rad, rad²).

    `score` is the share of the points that the map explains (0 to 1); `mode` what the observation determined; `surprise` the squared
    Mahalanobis distance between prediction and observation per direction (about 1 when all is well); `is_updated` is False when the
    pose was only carried on by odometry.
    """

    stamp_ns: int
    map_from_base: SE2
    covariance: F64
    score: float
    mode: Mode
    surprise: float
    is_updated: bool


INITIAL_COVARIANCE: F64 = np.diag([0.25, 0.25, (np.pi / 12) ** 2])


class Localizer(Protocol):
    """Tracks the pose of the base in one map. Same calls, same results: every random number comes from a generator given at birth."""

    def set_pose(
        self, stamp_ns: int, odom_from_base: SE2, map_from_base: SE2, covariance: F64 = INITIAL_COVARIANCE
    ) -> None:
        """Start again from a pose that a person or a relocalization gave; it holds at once, also while the robot stands."""
        ...

    def update(self, observation: Observation) -> Estimate:
        """Take in one observation; observations come in the order of time. Raises NoPoseError before the first `set_pose`."""
        ...

    def request_update(self) -> None:
        """Use the next observation in full even if the robot has not moved since the last."""
        ...

    @property
    def estimate(self) -> Estimate | None:
        """The last estimate, or None before the first pose."""
        ...
