"""Planar scans from laser scans and clouds: motion-compensated to the message's stamp, in the base frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import steady_sweep
from ambler.core.messages import LaserScan, PointCloud
from ambler.core.robot import RobotModel
from ambler.core.units import Radians
from ambler.kernels import scan_points
from ambler.perception.ground_below import LEVEL_GROUND, GroundBelow
from ambler.perception.level_mount import LevelMount, Mount, matrix_of
from ambler.registration.planar_scan import PlanarScan, RayFalls

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlanarConfig:
    """Which measurements count. Ranges are planar distances from the sensor; a ray without return is free for `free_length` at most;
    the height band (metres above the base's ground), the azimuth bins and the depth (m) of what counts as one surface in a bin concern
    clouds only. Where a body leans, what lies lower than the band plus `lean_doubt` (rad) times the distance is taken for the floor: three
    sigma of what a body's IMU tells of its lean (0.1°)."""

    range_min: float = 0.1
    range_max: float = 30.0
    free_length: float = 5.0
    height_min: float = 0.1
    height_max: float = 0.6
    azimuth_bins: int = 900
    surface_depth: float = 0.06
    lean_doubt: Radians = math.radians(0.3)


def default_planar(robot: RobotModel) -> PlanarConfig:
    """Return a height band from above the floor to above the robot and its scanners: a wall close by is hit only by beams that
    are still high, so a band that ends below the scanner would lose it."""
    top = max([robot.body_height, *(m.base_from_sensor.translation[2] for m in robot.sensors)])
    return PlanarConfig(height_max=top + 0.1, range_max=10.0)


def _sweep_of(mount: Mount) -> tuple[F64, float, tuple[float, float]]:
    """The sensor's poses, the seconds between them, and where it is at the stamp."""
    if isinstance(mount, LevelMount):
        return mount.matrices, mount.step, mount.origin
    return matrix_of(mount)[None], 1.0, (mount.translation[0], mount.translation[1])


def _swept(motion: F64, seconds: float) -> F64:
    return motion if motion.ndim == 2 else steady_sweep(motion, seconds)


def scan_to_points(scan: LaserScan, base_from_sensor: Mount, motion: F64, config: PlanarConfig) -> PlanarScan:
    """Return the returns and free ends of a laser scan; `motion` is the base's sweep (K, 4) (`BaseMotion.sweep`), or its velocity (vx, vy, wz).

    Beam i was taken at stamp + i * time_increment; everything is moved to the base frame at the stamp. While the body leans, returns on
    the floor are no obstacles.
    """
    n = len(scan.ranges)
    points, free_points = np.empty((n, 2), np.float32), np.empty((n, 2), np.float32)
    beams, free_beams = np.empty(n, np.int32), np.empty(n, np.int32)
    counts = np.empty(2, np.int64)
    far = min(config.range_max, scan.range_max)
    mounts, step, origin = _sweep_of(base_from_sensor)
    sweep = _swept(motion, scan_duration(scan))
    floor = np.array([-math.inf, 0.0])
    if isinstance(base_from_sensor, LevelMount):
        floor[:] = min(config.height_min, 0.5 * float(mounts[0, 2, 3])), config.lean_doubt
    scan_points.beams_to_points(
        np.ascontiguousarray(scan.ranges, np.float32),
        np.array([scan.angle_min, scan.angle_increment, scan.time_increment]),
        np.array([max(config.range_min, scan.range_min), far, min(config.free_length, far)]),
        floor,
        mounts,
        step,
        sweep,
        np.empty((3, 4)),
        points,
        free_points,
        beams,
        free_beams,
        counts,
    )
    hits, free = int(counts[0]), int(counts[1])
    starts: F32 | None = None
    free_starts: F32 | None = None
    if scan.time_increment > 0.0 and sweep[-1, 1:].any():
        starts, free_starts = np.empty((hits, 2), np.float32), np.empty((free, 2), np.float32)
        scan_points.beam_starts(beams[:hits], scan.time_increment, np.array(origin), sweep, starts)
        scan_points.beam_starts(free_beams[:free], scan.time_increment, np.array(origin), sweep, free_starts)
    bright = scan.intensities[beams[:hits]] if len(scan.intensities) == n > 0 else None
    return PlanarScan(scan.stamp_ns, points[:hits], free_points[:free], origin, bright, starts, free_starts)


def merged_to_points(
    cloud: PointCloud, free: PointCloud | None, offsets: F64, twist: F64, config: PlanarConfig
) -> PlanarScan:
    """Return the rays of a merged cloud and of the rays without return beside it, each from the scanner that measured it.

    Both clouds are in the base frame of their stamp, with `ring` the scanner and `time` the instant (s after the stamp) of each ray.
    `offsets` float64 (S, 2) are the scanners in the base frame; `twist` (vx, vy, wz) of the base carries them to the rays' instants.
    """
    limits = np.array([config.range_min, config.range_max, min(config.free_length, config.range_max)])
    hits = _split(cloud, offsets, twist, limits)
    parts = [hits]
    if free is not None:
        limits[1] = -1.0
        parts.append(_split(free, offsets, twist, limits))
    return PlanarScan(
        cloud.stamp_ns,
        hits.points,
        np.concatenate([p.free_points for p in parts]),
        (0.0, 0.0),
        cloud.intensity[hits.kept],
        hits.starts,
        np.concatenate([p.free_starts for p in parts]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    points: F32
    starts: F32
    free_points: F32
    free_starts: F32
    kept: NDArray[np.int32]


def _split(cloud: PointCloud, offsets: F64, twist: F64, limits: F64) -> _Rays:
    n = len(cloud.points)
    points, starts, free_points, free_starts = (np.empty((n, 2), np.float32) for _ in range(4))
    kept, counts = np.empty(n, np.int32), np.empty(2, np.int64)
    scan_points.split_rays(
        *(np.require(cloud.points, np.float32, ["C", "W"]), np.require(cloud.ring, np.uint16, ["C", "W"])),
        *(np.require(cloud.time, np.float32, ["C", "W"]), offsets, twist, limits),
        *(points, starts, free_points, free_starts, kept, counts),
    )
    h, f = int(counts[0]), int(counts[1])
    return _Rays(points[:h], starts[:h], free_points[:f], free_starts[:f], kept[:h])


def cloud_to_points(
    cloud: PointCloud,
    base_from_sensor: Mount,
    motion: F64,
    config: PlanarConfig,
    height_offset: float = 0.0,
    ground: GroundBelow = LEVEL_GROUND,
) -> PlanarScan:
    """Flatten a cloud: per azimuth bin the nearest surface of the height band, else how far the bin is proved free.

    `motion` is the base's sweep (K, 4) (`BaseMotion.sweep`), or its velocity (vx, vy, wz). Returns on the floor and above the band are no obstacles; they prove their ray free while it is inside the band. How low each bin was looked
    through is told as `falls`: a scanner of many rings looks over low things nearby. `base_from_sensor`
    should be that of `level_mount` when the body leans; `height_offset` is the height of the base origin above the ground; heights count from `ground`, where it is known.
    """
    counts = np.empty(2, np.int64)
    bins = config.azimuth_bins
    points, free_points = np.empty((bins, 2), np.float32), np.empty((bins, 2), np.float32)
    heights, free_sinks = np.empty((bins, 2), np.float32), np.empty(bins, np.float32)
    mounts, step, origin = _sweep_of(base_from_sensor)
    doubt = config.lean_doubt if isinstance(base_from_sensor, LevelMount) else 0.0
    band = np.array([config.height_min - height_offset, config.height_max - height_offset, doubt])
    scan_points.cloud_to_points(
        np.ascontiguousarray(cloud.points, np.float32),
        np.ascontiguousarray(cloud.time, np.float32),
        mounts,
        step,
        _swept(motion, scan_duration(cloud)),
        band,
        np.array([config.range_min, config.range_max, min(config.free_length, config.range_max), config.surface_depth]),
        ground.heights,
        ground.place,
        np.empty((3, 4)),
        np.empty((len(cloud.points), 5)),
        np.empty((bins, 6)),
        np.empty((bins, 3)),
        points,
        free_points,
        heights,
        free_sinks,
        counts,
    )
    hits, free = int(counts[0]), int(counts[1])
    falls = RayFalls(
        float(mounts[0, 2, 3]) + height_offset,
        heights[:hits, 1],
        free_sinks[:free],
        heights[:hits, 0] + np.float32(height_offset),
    )
    return PlanarScan(cloud.stamp_ns, points[:hits], free_points[:free], origin, falls=falls)


def scan_duration(message: LaserScan | PointCloud) -> float:
    """Return how long the measurement lasted, seconds."""
    if isinstance(message, LaserScan):
        return max(0.0, (len(message.ranges) - 1) * message.time_increment)
    return float(message.time.max()) if len(message.time) else 0.0
