"""What the filter says of a scan: where it was, and how far it is to be trusted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Health:
    """How well a scan fitted: `points` were tried, `inliers` lay on planes, `residual_m` from them (RMS; None: no plane), the update moved the
    prediction by `innovation_*`. `weakest`: see `Degeneracy`; `frozen_*` float64 (K, 3) are directions that were left to the inertial measurements,
    in the map and in the IMU. `imu_gap`: longest time between two samples, s. `false_ratio`: share of the points that floated in the air and were left out before. `is_contradicted`: the IMU's own motion led
    elsewhere than most of the scan fits, as it does with wrong forces, a velocity that nobody knew, or a map that repeats itself beside the place. `is_faint`: it moved, and believed of a direction what hardly any plane faces."""

    points: int
    inliers: int
    residual_m: float | None
    innovation_m: float
    innovation_rad: float
    weakest: float
    frozen_translation: F64
    frozen_rotation: F64
    iterations: int
    imu_gap: float
    is_lost: bool
    is_at_rest: bool = False
    is_biased: bool = False
    false_ratio: float = 0.0
    is_contradicted: bool = False
    is_faint: bool = False

    @property
    def inlier_ratio(self) -> float:
        """The share of the points that lay on planes."""
        return self.inliers / self.points if self.points else 0.0

    @property
    def is_degenerate(self) -> bool:
        """Whether some direction was left alone."""
        return len(self.frozen_translation) + len(self.frozen_rotation) > 0


@dataclass(frozen=True, slots=True, eq=False)
class LioResult:
    """The pose of the IMU in the map at a scan's last point, its velocity (m/s, in the map) and `covariance` float64 (6, 6): position in the axes of the start, rotation perturbed
    on the right. `points_imu` float64 (M, 3) are the points that were used, in the IMU's frame at that time. `up_imu` (3,) is the unit vector against gravity in
    the IMU's frame: what the accelerometer says of its tilt, good to `up_sigma` rad; None: without an IMU nothing is known. `imu_from_lidar` is the mount as it was known then,
    and `start_from_map` what its refinement since the start makes of poses in the map (see `lio.beginning`); `covariance` is that of the pose since the start."""

    stamp_ns: int
    map_from_imu: SE3
    velocity: F64
    covariance: F64
    points_imu: F64
    health: Health
    up_imu: F64 | None = None
    up_sigma: float = 0.0
    imu_from_lidar: SE3 = field(default_factory=SE3)
    start_from_map: SE3 = field(default_factory=SE3)

    @property
    def start_from_imu(self) -> SE3:
        """The pose of the IMU since the start: its first pose is exact, and the mount is what is known of it now."""
        return self.start_from_map @ self.map_from_imu

    @property
    def map_from_lidar(self) -> SE3:
        """The pose of the LiDAR, which the map holds whatever becomes of the mount."""
        return self.map_from_imu @ self.imu_from_lidar

    def without_points(self) -> LioResult:
        """Return the same for who keeps the results of a long way: an empty view would keep all points."""
        return replace(self, points_imu=np.zeros((0, 3)))
