"""A 3-D cloud to a planar scan: the nearest return inside a height band of each azimuth.

The band is told in the base frame and keeps every height unless it is narrowed, so that floors and negative obstacles are
never lost in silence; when most points fall outside of it the result says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import cloud_bins
from ambler.perception.self_mask import SelfMask

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CloudToScanConfig:
    """The band `z_min`..`z_max` (m, base frame), and the virtual scanner `frame` at `base_from_origin`, height `origin_z`.

    `empty_is_free`: a bin whose every return lies outside of the band becomes +inf, as pointcloud_to_laserscan does; without
    it only a bin that is known free up to range_max does, and the others are NaN (unknown).
    """

    z_min: float = -math.inf
    z_max: float = math.inf
    frame: str = "merged"
    base_from_origin: SE2 = field(default_factory=SE2)
    origin_z: float = 0.3
    bins: int = 720
    range_min: float = 0.05
    range_max: float = 30.0
    scan_time: float = 0.1
    empty_is_free: bool = False
    self_mask: tuple[F64, ...] = ()
    warn_ratio: float = 0.5

    def __post_init__(self) -> None:
        if not self.z_min < self.z_max:
            raise BadInputError(f"the height band {self.z_min} … {self.z_max} m holds nothing")
        if self.bins < 8 or not 0 <= self.range_min < self.range_max:
            raise BadInputError("cloud to scan needs bins >= 8 and 0 <= range_min < range_max")


@dataclass(frozen=True, slots=True)
class CloudScan:
    """The scan, how far each bin is known free (`reach` float32 (B,) m), where the points went, and a warning for people.

    All bins hold at the stamp of the scan.
    """

    scan: LaserScan
    reach: NDArray[np.float32]
    used: int
    outside_band: int
    on_robot: int
    out_of_range: int
    invalid: int
    warning: str | None


class CloudToScan:
    """Flattens clouds of one sensor."""

    def __init__(self, config: CloudToScanConfig, base_from_sensor: SE3) -> None:
        self.config = config
        self._matrix = np.ascontiguousarray(base_from_sensor.matrix()[:3])
        self._mask = SelfMask(config.self_mask)
        origin = config.base_from_origin
        self._origin = np.array([origin.x, origin.y, math.cos(origin.yaw), math.sin(origin.yaw), config.origin_z])

    def update(self, cloud: PointCloud, twist: F64 | None = None) -> CloudScan:
        """Flatten one cloud; `twist` (vx, vy, wz) of the base moves every point to the stamp by its own time."""
        config = self.config
        ranges, reach = np.full(config.bins, np.inf, np.float32), np.zeros(config.bins, np.float32)
        counts = np.zeros(5, np.int64)
        cloud_bins.cloud_to_bins(
            *(cloud.points, cloud.time, self._matrix, np.zeros(3) if twist is None else twist),
            *(self._mask.vertices, self._mask.starts, self._mask.reach, self._origin),
            *(np.array([config.z_min, config.z_max]), np.array([config.range_min, config.range_max])),
            *(ranges, reach, counts),
        )
        free = (reach > 0.0) if config.empty_is_free else (reach >= config.range_max)
        out = np.where(np.isinf(ranges) & ~free, np.float32(np.nan), ranges)
        scan = LaserScan(
            cloud.stamp_ns,
            config.frame,
            angle_min=-math.pi,
            angle_increment=2.0 * math.pi / config.bins,
            time_increment=0.0,
            scan_time=config.scan_time,
            range_min=config.range_min,
            range_max=config.range_max,
            ranges=out,
            intensities=np.zeros(0, np.float32),
        )
        used, outside, on_robot, out_of_range, invalid = (int(c) for c in counts)
        return CloudScan(scan, reach, used, outside, on_robot, out_of_range, invalid, self._warning(counts))

    def _warning(self, counts: NDArray[np.int64]) -> str | None:
        total, used = int(counts.sum()), int(counts[0])
        if total == 0 or (total - used) <= self.config.warn_ratio * total:
            return None
        reasons = {
            f"outside of the height band {self.config.z_min:g} … {self.config.z_max:g} m": int(counts[1]),
            "on the robot itself": int(counts[2]),
            f"outside of {self.config.range_min:g} … {self.config.range_max:g} m": int(counts[3]),
            "not finite": int(counts[4]),
        }
        parts = [f"{n / total:.0%} {text}" for text, n in reasons.items() if n]
        return f"{(total - used) / total:.0%} of the cloud's points are not used: " + ", ".join(parts)
