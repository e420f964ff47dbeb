"""What a scanner of many rings sees at its own height, as a planar scan: panes of glass show themselves to beams that meet them squarely, and those are level."""

from __future__ import annotations

import math

import numpy as np

from ambler.core.base_motion import BaseMotion
from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se3 import SE3
from ambler.kernels import level_ring as kernels

BEAMS = 720
SLOPE = math.tan(math.radians(2.0))  # rings are up to 2 degrees apart: one at least is as level as that
SWEEP_STEP_NS = 10_000_000  # a walking body leans by degrees within a turn of its scanner
RANGE_MAX = 100.0


def level_ring(cloud: PointCloud, base_from_sensor: SE3, motion: BaseMotion) -> tuple[LaserScan, SE3]:
    """Return the planar scan, all of it of the moment of the cloud's stamp, and where its scanner is: base_from_scanner, level, its x axis that of the base, its place
    that of the sensor in a base without lean. Raises StaleInputError where the motion is not known."""
    poses = [motion.pose_at(stamp_ns) @ base_from_sensor for stamp_ns in sweep_stamps(cloud)]
    level_from_odom = SE3.from_se2(motion.planar_at(cloud.stamp_ns)).inverse()
    sweep = np.stack([(level_from_odom @ pose).matrix()[:3] for pose in poses])
    ranges, intensities = np.empty(BEAMS, np.float32), np.empty(BEAMS, np.float32)
    points, intensity, time = (np.ascontiguousarray(v, np.float32) for v in (cloud.points, cloud.intensity, cloud.time))
    kernels.level_ring(points, intensity, time, sweep, SLOPE, ranges, intensities)
    beams = (-math.pi, 2.0 * math.pi / BEAMS, 0.0, 0.0)
    scan = LaserScan(cloud.stamp_ns, cloud.frame, *beams, 0.0, RANGE_MAX, ranges, intensities)
    x, y, z = sweep[0, :, 3].tolist()
    return scan, SE3((x, y, z - float(motion.pose_at(cloud.stamp_ns).translation[2])))


def sweep_stamps(cloud: PointCloud) -> list[int]:
    """Return equal times (ns) from a cloud's stamp to its last point, between which a walking body leans too little to matter."""
    duration_ns = round(float(cloud.time.max(initial=0.0)) * 1e9)
    parts = max(1, math.ceil(duration_ns / SWEEP_STEP_NS))
    return [cloud.stamp_ns + duration_ns * k // parts for k in range(parts + 1)]
