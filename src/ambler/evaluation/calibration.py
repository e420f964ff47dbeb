"""Simulated calibration drives: random mountings and clock offsets, noisy scanners and wheels, and how well they are found."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.calibration.planar_arrays import PlanarTrack
from ambler.calibration.scan_calibration import (
    CalibrationConfig,
    CalibrationResult,
    OdometryModel,
    calibrate_scanners,
)
from ambler.core.messages import LaserScan, Odometry
from ambler.core.robot import DriveKind
from ambler.core.se2 import SE2, wrap_angle
from ambler.core.se3 import SE3
from ambler.perception.merger_config import ScannerConfig
from ambler.sim.lidar import LidarSensor
from ambler.sim.odometry import DeadReckoning
from ambler.sim.robots import SimRobot, robot_named
from ambler.sim.scene import RayScene, build_scene
from ambler.sim.sensors import SCANNER_360, WHEEL_ODOMETRY, LidarSpec, named_generator
from ambler.sim.solids import Shape, Solid, WorldSpec

F64 = NDArray[np.float64]

# A 275° safety scanner: 0.39° steps, a turn in 40 ms (simulation.md §6, microScan3); noise and losses as SCANNER_360.
SAFETY_SCANNER = replace(SCANNER_360, columns=923, period=0.04)
FIELD_OF_VIEW = math.radians(275.0)
SCANNER_HEIGHT = 0.2
LARGEST_OFFSET = 0.1
STEP = 0.005


@dataclass(frozen=True, slots=True)
class CalibrationDrive:
    """A recording with its truth: base_from_scanner and clock offset (s) of every scanner."""

    scans: dict[str, list[LaserScan]]
    odometry: list[Odometry]
    scanners: tuple[ScannerConfig, ...]
    mounts: tuple[SE2, ...]
    offsets: tuple[float, ...]
    model: OdometryModel


@dataclass(frozen=True, slots=True)
class CalibrationErrors:
    """Largest errors over the scanners of one drive: position (m), yaw (rad), clock (s); mean normalised squared error (4 values
    per scanner: 1 is honest), and the result itself."""

    position: float
    yaw: float
    offset: float
    nees: float
    result: CalibrationResult


def simulate_drive(seed: int, drive: DriveKind, seconds: float = 60.0, scanner_count: int = 3) -> CalibrationDrive:
    """Drive through a room with boxes, turning both ways; every sensor and the wheels have their full noise."""
    rng = named_generator(seed, "calibration drive")
    motion = Motion.SIDEWAYS if drive is DriveKind.OMNI else Motion.WEAVE
    times, velocities, track = calibration_motion(rng, motion, seconds)
    scene = build_scene(calibration_room(rng))
    robot = _robot(drive)
    odometry = _odometry(robot, times, velocities, drive, seed)
    scans, scanners, mounts, offsets = {}, [], [], []
    for k in range(scanner_count):
        frame, upside_down = f"scanner_{k}", bool(rng.integers(2))
        mount = SE2(rng.uniform(-0.6, 0.6), rng.uniform(-0.4, 0.4), rng.uniform(-math.pi, math.pi))
        offset = float(rng.uniform(-LARGEST_OFFSET, LARGEST_OFFSET))
        truth = ScannerConfig.planar(frame, mount, SCANNER_HEIGHT, upside_down=upside_down)
        phase = float(rng.uniform(0.0, 0.04))
        recorded = record_scanner(scene, truth, SAFETY_SCANNER, track, offset, phase, seconds, seed)
        scans[frame] = [_cut(scan, SAFETY_SCANNER) for scan in recorded]
        scanners.append(ScannerConfig.planar(frame, SE2(), SCANNER_HEIGHT, upside_down=upside_down))
        mounts.append(mount)
        offsets.append(offset)
    model = OdometryModel.omni() if drive is DriveKind.OMNI else OdometryModel.differential(robot.track)
    return CalibrationDrive(scans, odometry, tuple(scanners), tuple(mounts), tuple(offsets), model)


def evaluate_drive(drive: CalibrationDrive, config: CalibrationConfig | None = None) -> CalibrationErrors:
    """Calibrate from the recording alone and compare with the truth."""
    result = calibrate_scanners(drive.scans, drive.odometry, drive.scanners, drive.model, config)
    rows, nees = [], []
    for estimate, mount, offset in zip(result.scanners, drive.mounts, drive.offsets, strict=True):
        found = estimate.base_from_scanner
        yaw = wrap_angle(found.yaw - mount.yaw)
        error = np.array([found.x - mount.x, found.y - mount.y, yaw, estimate.clock_offset - offset])
        rows.append([math.hypot(error[0], error[1]), abs(error[2]), abs(error[3])])
        nees.append(float(error @ np.linalg.solve(estimate.covariance, error)) / 4.0)
    worst = np.max(rows, axis=0)
    return CalibrationErrors(float(worst[0]), float(worst[1]), float(worst[2]), float(np.mean(nees)), result)


class Motion(enum.Enum):
    """How a base is driven to calibrate its scanners: forwards and backwards with turns; the same and sideways; or, on mecanum
    wheels, along one diagonal, turning in place, along the other diagonal, turning in place, each there and back.

    On a diagonal two of the four wheels stand, and the slip of the others leads along the way: askew is only what the scanners are.
    That holds only while the base does not turn.
    """

    WEAVE = "weave"
    SIDEWAYS = "sideways"
    DIAGONALS = "diagonals"


def calibration_motion(rng: np.random.Generator, motion: Motion, seconds: float) -> tuple[F64, F64, PlanarTrack]:
    """Return times (N,), body velocities (N, 3) that hold until the next time, and the base's true path.

    Sines of random periods; drawn again until the path stays within 2.5 m of its start.
    """
    times = np.arange(0.0, seconds + STEP, STEP)
    while True:
        periods, phases = rng.uniform(6.0, 11.0, 3), rng.uniform(0.0, 2.0 * math.pi, 3)
        turns = times[:, None] / periods + phases / (2.0 * math.pi)
        waves = np.sin(2.0 * math.pi * turns)
        velocities = waves * np.array([0.5, 0.3 if motion is Motion.SIDEWAYS else 0.0, 0.9])
        if motion is Motion.DIAGONALS:
            leg = np.floor(1.6 * turns[:, 0]).astype(int) % 4
            wave = np.sin(2.0 * math.pi * 1.6 * turns[:, 0])
            legs = np.array([[0.42, 0.42, 0.0], [0.0, 0.0, 0.85], [0.42, -0.42, 0.0], [0.0, 0.0, 0.85]])
            velocities = wave[:, None] * legs[leg]
        poses = [SE2()]
        for velocity in velocities[:-1]:
            poses.append(poses[-1] @ SE2.exp(velocity * STEP))
        path = np.array([p.as_array() for p in poses])
        if np.hypot(path[:, 0], path[:, 1]).max() < 2.5:
            return times, velocities, PlanarTrack(times, path)


def calibration_room(rng: np.random.Generator) -> WorldSpec:
    """A room of about 10 × 9 m about the start, with boxes and pillars along its walls."""
    solids = []
    for k, (x, y, length, turn) in enumerate(((5, 0, 9, 0.5), (-5, 0, 9, 0.5), (0, 4.5, 10, 0.0), (0, -4.5, 10, 0.0))):
        solids.append(Solid(f"wall_{k}", Shape.BOX, SE2(x, y, turn * math.pi), length, 0.1, 0.0, 2.5))
    for k in range(10):
        angle, distance = 2.0 * math.pi * (k + rng.uniform(0.0, 0.8)) / 10, rng.uniform(3.5, 4.1)
        pose = SE2(distance * math.cos(angle), distance * math.sin(angle), rng.uniform(-math.pi, math.pi))
        shape = Shape.CYLINDER if k % 4 == 3 else Shape.BOX
        size = rng.uniform(0.2, 0.7, 2) if shape is Shape.BOX else np.repeat(rng.uniform(0.2, 0.5), 2)
        solids.append(Solid(f"thing_{k}", shape, pose, float(size[0]), float(size[1]), 0.0, 1.0))
    return WorldSpec("calibration", tuple(solids), SE2())


def _robot(drive: DriveKind) -> SimRobot:
    if drive is DriveKind.DIFFERENTIAL:
        return robot_named("diff")
    return replace(robot_named("spot"), odometry=replace(WHEEL_ODOMETRY, ticks=0), gait=None)


def _odometry(robot: SimRobot, times: F64, velocities: F64, drive: DriveKind, seed: int) -> list[Odometry]:
    """Count the travel of the wheels (omni: of the base's directions) and integrate it as the robot does."""
    reckoning = DeadReckoning(robot, robot.odometry, seed)
    steps = velocities * STEP
    if drive is DriveKind.DIFFERENTIAL:
        half = 0.5 * robot.track * steps[:, 2]
        steps = np.column_stack([steps[:, 0] - half, steps[:, 0] + half]) / robot.wheel_radius
    travel = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps[:-1], axis=0)])
    every = round(1.0 / (robot.odometry.rate_hz * STEP))
    return [
        reckoning.update(tuple(travel[k].tolist()), SE3(), round(times[k] * 1e9)) for k in range(0, len(times), every)
    ]


def record_scanner(
    scene: RayScene,
    truth: ScannerConfig,
    spec: LidarSpec,
    track: PlanarTrack,
    offset: float,
    phase: float,
    seconds: float,
    seed: int,
) -> list[LaserScan]:
    """Record one scanner from half a second on; its stamps are `offset` seconds ahead."""
    sensor = LidarSensor(spec, truth.frame, scene, seed)
    mount = truth.base_from_sensor
    knots = np.linspace(0.0, spec.period, 9)
    scans = []
    for n in range(int((seconds - 1.0) / spec.period)):
        begin = 0.5 + phase + n * spec.period
        poses = [SE3.from_se2(SE2(*p)) @ mount for p in track.at(begin + knots).tolist()]
        sensor.sweep(knots, np.array([p.translation for p in poses]), np.array([p.rotation for p in poses]))
        scans.append(sensor.to_scan(round((begin + offset) * 1e9)))
    return scans


def _cut(scan: LaserScan, spec: LidarSpec) -> LaserScan:
    """Keep the beams of the field of view; the rest of the turn the mirror looks into the housing."""
    first = math.ceil((math.pi - 0.5 * FIELD_OF_VIEW) / spec.azimuth_increment)
    last = spec.columns - first
    return replace(
        scan,
        stamp_ns=scan.stamp_ns + round(first * spec.period / spec.columns * 1e9),
        angle_min=spec.azimuth_start + first * spec.azimuth_increment,
        ranges=scan.ranges[first:last].copy(),
        intensities=scan.intensities[first:last].copy(),
    )
