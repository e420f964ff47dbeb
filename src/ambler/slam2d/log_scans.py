"""Planar scans from the laser lines of a CARMEN log."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import scan_points
from ambler.registration.planar_scan import PlanarScan
from ambler.wire.carmen import CarmenLog, LaserLine

_NO_RETURN_RATIO = 0.98
_STEP_NS = 1000


@dataclass(frozen=True, slots=True)
class LogScanConfig:
    """Which ranges of a log count as returns, and how far a ray without return is taken as free, metres."""

    range_min: float = 0.1
    range_max: float = 30.0
    free_length: float = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class LogScan:
    """One laser line as a planar scan whose stamps strictly increase, with the odometry that the line carries."""

    scan: PlanarScan
    odom_from_base: SE2


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
        yield LogScan(_planar(line, stamp_ns, mounts[line.name], config), line.odom_from_base)


def _planar(line: LaserLine, stamp_ns: int, base_from_laser: SE2, config: LogScanConfig) -> PlanarScan:
    n = len(line.ranges)
    points, free_points = np.empty((n, 2), np.float32), np.empty((n, 2), np.float32)
    counts = np.empty(2, np.int64)
    c, s = math.cos(base_from_laser.yaw), math.sin(base_from_laser.yaw)
    matrix = np.array(
        [[c, -s, 0.0, base_from_laser.x], [s, c, 0.0, base_from_laser.y], [0.0, 0.0, 1.0, 0.0]], np.float64
    )
    far = min(config.range_max, _NO_RETURN_RATIO * line.max_range)
    scan_points.beams_to_points(
        line.ranges,
        np.array([line.angle_min, line.angle_increment, 0.0]),
        np.array([config.range_min, far, min(config.free_length, far)]),
        matrix,
        np.zeros(3),
        points,
        free_points,
        counts,
    )
    origin = base_from_laser.x, base_from_laser.y
    return PlanarScan(stamp_ns, points[: counts[0]].copy(), free_points[: counts[1]].copy(), origin)
