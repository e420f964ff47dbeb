"""One scan of a recording, ready for 2-D SLAM, and the scans of a CARMEN log."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import scan_points
from ambler.registration.planar_scan import PlanarScan
from ambler.wire.carmen import CarmenLog, LaserLine

F64 = NDArray[np.float64]

_NO_RETURN_RATIO = 0.98
_STEP_NS = 1000
_NO_FLOOR = np.array([-np.inf, 0.0])  # of a planar log nothing is known of how the body leaned


@dataclass(frozen=True, slots=True)
class LogScanConfig:
    """Which ranges of a log count as returns, and how far a ray without return is taken as free, metres."""

    range_min: float = 0.1
    range_max: float = 30.0
    free_length: float = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class LogScan:
    """One scan of a recording and the odometry that is new since the scan before, up to this scan's last beam.

    `ranges` float32 (N,); `beam` float64 (3,) is (angle_min, angle_increment, time_increment); `limits` float64 (3,) is
    (range_min, range_max, free_length); `base_from_laser` the upper (3, 4) of a homogeneous matrix; `odometry` holds
    (stamp_ns, odom_from_base). The stamps of a recording's scans strictly increase.
    """

    stamp_ns: int
    ranges: NDArray[np.float32]
    beam: F64
    limits: F64
    base_from_laser: F64
    odometry: tuple[tuple[int, SE2], ...]

    @property
    def duration(self) -> float:
        """Seconds from the first beam to the last."""
        return max(0.0, (len(self.ranges) - 1) * float(self.beam[2]))

    def to_planar(self, sweep: F64) -> PlanarScan:
        """Return the points in the base frame of the stamp; `sweep` (K, 4) is the base's motion during the scan (`BaseMotion.sweep`)."""
        n = len(self.ranges)
        points, free_points = np.empty((n, 2), np.float32), np.empty((n, 2), np.float32)
        beams, counts = np.empty((2, n), np.int32), np.empty(2, np.int64)
        scan_points.beams_to_points(
            *(self.ranges, self.beam, self.limits, _NO_FLOOR, self.base_from_laser[None], 1.0, sweep, np.empty((3, 4))),
            *(points, free_points, beams[0], beams[1], counts),
        )
        origin = float(self.base_from_laser[0, 3]), float(self.base_from_laser[1, 3])
        return PlanarScan(self.stamp_ns, points[: counts[0]].copy(), free_points[: counts[1]].copy(), origin)


def mounting(lines: list[LaserLine], parameter: str | None) -> SE2:
    """Return base_from_laser of one laser: the median of odom^-1 * laser when it is constant over the log.

    In logs whose laser column holds a corrected pose it is not; then the offset comes from the parameter (metres along x) or is zero.
    """
    relative = np.array([(line.odom_from_base.inverse() @ line.odom_from_laser).as_array() for line in lines])
    middle = np.median(relative, axis=0)
    yaw = math.atan2(float(np.sin(relative[:, 2]).mean()), float(np.cos(relative[:, 2]).mean()))
    off = np.hypot(relative[:, 0] - middle[0], relative[:, 1] - middle[1])
    turned = np.abs([wrap_angle(float(a) - yaw) for a in relative[:, 2]])
    if np.mean((off < 0.02) & (turned < math.radians(2.0))) > 0.9 and math.hypot(middle[0], middle[1]) < 3.0:
        return SE2(float(middle[0]), float(middle[1]), yaw)
    try:
        return SE2(float(parameter or 0.0), 0.0, math.pi if lines[0].name in ("RLASER", "ROBOTLASER2") else 0.0)
    except ValueError as error:
        raise BadInputError(f"laser offset {parameter!r} is no number") from error


def scans_of(log: CarmenLog, config: LogScanConfig | None = None) -> Iterator[LogScan]:
    """Yield every laser line in file order; stamps that do not increase are moved just behind the one before."""
    config = config or LogScanConfig()
    mounts: dict[str, SE2] = {}
    for name, parameter in (("FLASER", "front"), ("RLASER", "rear"), ("ROBOTLASER1", "front"), ("ROBOTLASER2", "rear")):
        lines = [line for line in log.lasers if line.name == name]
        if lines:
            mounts[name] = mounting(lines, log.parameters.get(f"robot_{parameter}laser_offset"))
    stamp_ns = -1
    for line in log.lasers:
        stamp_ns = max(round(line.stamp * 1e9), stamp_ns + _STEP_NS)
        far = min(config.range_max, _NO_RETURN_RATIO * line.max_range)
        yield LogScan(
            stamp_ns,
            line.ranges,
            np.array([line.angle_min, line.angle_increment, 0.0]),
            np.array([config.range_min, far, min(config.free_length, far)]),
            planar_matrix(mounts[line.name]),
            ((stamp_ns, line.odom_from_base),),
        )


def planar_matrix(base_from_laser: SE2) -> F64:
    """Return the upper (3, 4) of the homogeneous matrix of a level mount at height 0."""
    c, s = math.cos(base_from_laser.yaw), math.sin(base_from_laser.yaw)
    return np.array([[c, -s, 0.0, base_from_laser.x], [s, c, 0.0, base_from_laser.y], [0.0, 0.0, 1.0, 0.0]])
