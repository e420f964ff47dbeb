"""Learns where reflectors hang from a recorded drive of a robot that knew where it was: by another localizer, or by the SLAM that made its map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.messages import LaserScan, Odometry
from ambler.core.robot import MERGED_FRAME, RobotModel
from ambler.localization.reflectors import ReflectorMap, ReflectorSurvey
from ambler.perception.planar import PlanarConfig, scan_duration, scan_to_points
from ambler.registration.reflectors import DetectorConfig, detect_reflectors
from ambler.runtime.topics import LOCALIZED_POSE
from ambler.wire.bags import open_bag

F64 = NDArray[np.float64]
PLANE = np.ix_((0, 1, 5), (0, 1, 5))


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedReflectors:
    """The reflectors in the map's frame, of how many scans, and how many of these had no pose."""

    map: ReflectorMap
    scans: int
    without_pose: int


def survey_reflectors(path: Path, robot: RobotModel, detector: DetectorConfig | None = None) -> SurveyedReflectors:
    """Read scans with intensities and poses in the map; raises BadInputError when one of them is missing, or no reflector was seen often."""
    poses, scans = _read(path, robot)
    if not poses:
        raise BadInputError(f"{path}: no poses in a map ({LOCALIZED_POSE.ros_name}): where was the robot?")
    if not scans:
        raise BadInputError(f"{path}: no scans with intensities of {robot.name}")
    motion, survey = BaseMotion(span=1e9, max_extrapolation=0.0), ReflectorSurvey()
    for pose in poses:
        motion.add(pose)
    covariance = np.mean([pose.pose_covariance[PLANE] for pose in poses], axis=0)
    detector = detector if detector is not None else DetectorConfig()
    planar, without_pose = PlanarConfig(), 0
    for scan in scans:
        try:
            map_from_base, twist = motion.planar_at(scan.stamp_ns), motion.twist_at(scan.stamp_ns)
            sweep = motion.sweep(scan.stamp_ns, scan_duration(scan), twist)
        except StaleInputError:
            without_pose += 1
            continue
        mount = robot.sensor(scan.frame).base_from_sensor
        near, far = max(planar.range_min, scan.range_min), min(planar.range_max, scan.range_max)
        points = scan_to_points(scan, mount, sweep, planar).points
        bright = scan.intensities[(scan.ranges >= near) & (scan.ranges <= far)]
        if len(bright) == len(points):
            survey.add(detect_reflectors(points, bright, detector).centers, map_from_base, covariance)
    found = survey.result()
    if len(found.positions) == 0:
        raise BadInputError(f"{path}: no reflector was seen often enough in {len(scans)} scans")
    return SurveyedReflectors(found, len(scans), without_pose)


def _read(path: Path, robot: RobotModel) -> tuple[list[Odometry], list[LaserScan]]:
    own = {mount.frame for mount in robot.scanners} - {MERGED_FRAME}
    poses: list[Odometry] = []
    scans: list[LaserScan] = []
    with open_bag(path) as bag:
        for topic, message, _ in bag.messages(types=(LaserScan, Odometry)):
            if isinstance(message, Odometry) and topic == LOCALIZED_POSE.ros_name:
                poses.append(message)
            elif isinstance(message, LaserScan) and message.frame.lstrip("/") in own and len(message.intensities) > 0:
                scans.append(message)
    return poses, scans
