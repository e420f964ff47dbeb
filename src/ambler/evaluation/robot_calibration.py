"""Calibrating a robot's own scanners: from a recording, or in a simulated drive where they sit a little beside their drawing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ambler.calibration.scan_calibration import OdometryModel
from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan, Odometry
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import MERGED_FRAME, DriveKind
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.calibration import (
    LARGEST_OFFSET,
    STEP,
    CalibrationDrive,
    Motion,
    calibration_motion,
    calibration_room,
    record_scanner,
)
from ambler.perception.merger_config import ScannerConfig
from ambler.perception.scanner_profile import ScannerCalibration
from ambler.runtime.topics import WHEEL_ODOMETRY, all_topics
from ambler.sim.drive import drive_of
from ambler.sim.odometry import DeadReckoning
from ambler.sim.scene import build_scene
from ambler.sim.sensors import named_generator
from ambler.sim.sim_robot import SimRobot
from ambler.wire.bags import open_bag

MOUNT_ERROR = (0.03, math.radians(2.0))


@dataclass(frozen=True, slots=True)
class ScannerDrive:
    """What a calibration needs: scans by frame, odometry, and the scanners as the robot's model has them."""

    scans: dict[str, list[LaserScan]]
    odometry: list[Odometry]
    scanners: tuple[ScannerConfig, ...]
    model: OdometryModel


def odometry_model(robot: SimRobot) -> OdometryModel:
    """Return how far a robot's odometry is trusted."""
    if robot.has_mecanum_wheels:
        return OdometryModel.mecanum(0.5 * (robot.track + robot.wheel_base))
    if robot.model.drive is DriveKind.OMNI:
        return OdometryModel.omni()
    return OdometryModel.differential(robot.track if robot.track > 0.0 else None)


def read_drive(path: Path, robot: SimRobot) -> ScannerDrive:
    """Read the scans of a robot's scanners from a recording; raises BadInputError when one of them is missing."""
    scans: dict[str, list[LaserScan]] = {}
    odometry: list[Odometry] = []
    truths = {topic.ros_name for topic in all_topics() if topic.is_truth}
    with open_bag(path) as bag:
        found = [t.name for t in bag.topics() if t.message_class is Odometry and t.count > 0 and t.name not in truths]
        if WHEEL_ODOMETRY.ros_name in found:
            found = [WHEEL_ODOMETRY.ros_name]  # what is calibrated is the wheels, not what a gyroscope made of them
        if len(found) != 1:
            raise BadInputError(f"{path}: needs one topic with odometry, has {', '.join(found) or 'none'}")
        for topic, message, _ in bag.messages(types=(LaserScan, Odometry)):
            if isinstance(message, LaserScan):
                scans.setdefault(message.frame.lstrip("/"), []).append(message)
            elif isinstance(message, Odometry) and topic == found[0]:
                odometry.append(message)
    scans.pop(MERGED_FRAME, None)
    scanners = tuple(ScannerConfig(mount.frame, mount.base_from_sensor) for mount in robot.model.scanners)
    missing = [s.frame for s in scanners if s.frame not in scans]
    if missing:
        there = ", ".join(sorted(scans)) or "none"
        raise BadInputError(
            f"{path}: no scans of {', '.join(missing)}, which {robot.model.name} has; there are {there}"
        )
    return ScannerDrive(scans, odometry, scanners, odometry_model(robot))


def simulate_robot_drive(robot: SimRobot, seed: int, seconds: float = 60.0) -> CalibrationDrive:
    """Drive a robot whose scanners sit up to 3 cm and 2° beside its model, with clocks up to 0.1 s off; returns it with the truth."""
    rng = named_generator(seed, "robot calibration")
    times, velocities, track = calibration_motion(rng, _motion(robot), seconds)
    scene = build_scene(calibration_room(rng))
    scans, scanners, mounts, offsets = {}, [], [], []
    for mount in robot.model.scanners:
        nominal = mount.base_from_sensor.to_se2()
        shift = rng.uniform(-1.0, 1.0, 3) * np.array([MOUNT_ERROR[0], MOUNT_ERROR[0], MOUNT_ERROR[1]])
        true = SE2(nominal.x + shift[0], nominal.y + shift[1], nominal.yaw + shift[2])
        base_from_sensor = ScannerCalibration(true.x, true.y, true.yaw).applied_to(mount.base_from_sensor)
        offset, spec = float(rng.uniform(-LARGEST_OFFSET, LARGEST_OFFSET)), robot.lidars[mount.frame]
        truth = ScannerConfig(mount.frame, base_from_sensor)
        phase = float(rng.uniform(0.0, spec.period))
        scans[mount.frame] = record_scanner(scene, truth, spec, track, offset, phase, seconds, seed)
        scanners.append(ScannerConfig(mount.frame, mount.base_from_sensor))
        mounts.append(true)
        offsets.append(offset)
    odometry = _odometry(robot, times, velocities, seed)
    return CalibrationDrive(scans, odometry, tuple(scanners), tuple(mounts), tuple(offsets), odometry_model(robot))


def _motion(robot: SimRobot) -> Motion:
    if robot.has_mecanum_wheels:
        return Motion.DIAGONALS
    return Motion.SIDEWAYS if robot.model.drive is DriveKind.OMNI else Motion.WEAVE


def _odometry(robot: SimRobot, times: np.ndarray, velocities: np.ndarray, seed: int) -> list[Odometry]:
    """Let the wheels turn as the motion needs (sideways more, for what the rollers lose) and integrate what they count."""
    if robot.gait is not None:
        robot = replace(robot, gait=None)
    reckoning, drive = DeadReckoning(robot, robot.odometry, seed), drive_of(robot)
    rates = [drive.rates(BodyVelocity(vx, vy / (1.0 - robot.strafe_loss), wz)) for vx, vy, wz in velocities.tolist()]
    steps = np.array(rates) * STEP
    travel = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps[:-1], axis=0)])
    every = round(1.0 / (robot.odometry.rate_hz * STEP))
    return [
        reckoning.update(tuple(travel[k].tolist()), SE3(), round(times[k] * 1e9)) for k in range(0, len(times), every)
    ]
