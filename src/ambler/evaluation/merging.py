"""How exact and how late the scan merger is: a simulated robot at full speed with three scanners, judged by the true walls."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.calibration.planar_arrays import PlanarTrack
from ambler.core.messages import LaserScan, Odometry, PointCloud
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.localization.odometry import WheelInertialOdometry
from ambler.perception.merger import MergerConfig, MergeResult, ScanMerger, ScannerConfig
from ambler.sim.drive import drive_of
from ambler.sim.imu import ImuSensor
from ambler.sim.lidar import LidarSensor
from ambler.sim.odometry import DeadReckoning
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.sensors import SCANNER_360, ImuSpec, LidarSpec
from ambler.sim.solids import Shape, Solid, WorldSpec

F64 = NDArray[np.float64]

# Three scanners at three corners of a 1.2 m × 0.8 m base (source 002, §4.2.1); the rear one hangs upside down.
SCANNERS = (
    ScannerConfig.planar("front_right", SE2(0.5, -0.35, -math.pi / 4), 0.2),
    ScannerConfig.planar("front_left", SE2(0.5, 0.35, math.pi / 4), 0.2),
    ScannerConfig.planar("back", SE2(-0.5, 0.35, 0.75 * math.pi), 0.2, upside_down=True),
)
BODY = np.array([[0.6, 0.4], [-0.6, 0.4], [-0.6, -0.4], [0.6, -0.4]])
SPEED, TURN = 1.0, math.pi / 2
PHASES = (0.0, 0.031, 0.067)
REST, RAMP, HOLD, SWERVE = (
    1.0,
    1.0,
    1.5,
    1.2,
)  # seconds: standing, to full speed, around to the left, over to the right; around again
START = SE2(0.3, -1.2, 0.0)  # from here nothing of the hall stands in the way
FULL = REST + RAMP  # from here on it goes at full speed
SECONDS = FULL + HOLD + SWERVE + HOLD
NOISY_SCANNER = replace(SCANNER_360, columns=720)
EXACT_SCANNER = NOISY_SCANNER.perfect()


@dataclass(frozen=True, slots=True)
class MergeErrors:
    """Distances (m) of merged points and of filled bins from the true walls; `carry`: of merged points from where the true motion would
    have carried them, whatever the scanners' own noise; the latency (s) of every merged scan."""

    cloud: F64
    bins: F64
    carry: F64
    latency: F64
    period: float


class Wheels(enum.Enum):
    """Odometry of a drive: exact; fused, the one odometry of every robot: wheels with their full errors (radius, track, slip, encoders)
    and a gyroscope with its own; those wheels alone; or blind: the robot seems to stand, which is what a merger without compensation
    assumes."""

    EXACT = "exact"
    FUSED = "fused"
    ALONE = "alone"
    BLIND = "blind"


def drive_and_merge(seed: int, wheels: Wheels, scanner: LidarSpec = EXACT_SCANNER) -> MergeErrors:
    """Drive at 1 m/s and 90°/s; merge as the scans arrive, beside a merger that is told the true motion."""
    world, truth = hall(), true_motion()
    scene = build_scene(world)
    sensors = {s.frame: LidarSensor(scanner, s.frame, scene, seed) for s in SCANNERS}
    merger, exact = (ScanMerger(MergerConfig(SCANNERS, self_mask=(BODY,))) for _ in range(2))
    told = {odometry.stamp_ns: odometry for odometry in _odometry(seed, wheels, truth)}
    cloud, bins, carry, latency = [], [], [], []
    for now_ns, _, what in _events(scanner, told):
        if what == "odometry":
            merger.odometry.add(told[now_ns])
            exact.odometry.add_pose(now_ns, _pose(truth, now_ns * 1e-9))
            continue
        scan = _sweep(sensors[what], what, truth, now_ns * 1e-9 - scanner.latency - scanner.period)
        for each in (merger, exact):
            each.add_scan(scan, now_ns)
        if merger.is_due(now_ns):
            result, ideal = merger.merge(now_ns), exact.merge(now_ns)
            pose = _pose(truth, result.scan.stamp_ns * 1e-9)
            cloud.append(distances_to_walls(world, pose.transform(result.cloud.points[:, :2])))
            bins.append(distances_to_walls(world, pose.transform(_bin_ends(result))))
            carry.append(_moved_apart(result.cloud, ideal.cloud))
            latency.append(result.latency)
    return MergeErrors(
        np.concatenate(cloud), np.concatenate(bins), np.concatenate(carry), np.array(latency), scanner.period
    )


def _events(scanner: LidarSpec, stamps_ns: Iterable[int]) -> list[tuple[int, int, str]]:
    """Return what arrives when, in order: odometry first, then the scans whose instant it is."""
    events = [(stamp_ns, 0, "odometry") for stamp_ns in stamps_ns]
    for mounted, phase in zip(SCANNERS, PHASES, strict=True):
        ends = FULL + phase + scanner.period * np.arange(2, int((SECONDS - FULL - 0.2) / scanner.period))
        events += [(round((end + scanner.latency) * 1e9), 1, mounted.frame) for end in ends]
    return sorted(events)


def _pose(track: PlanarTrack, seconds: float) -> SE2:
    return SE2.from_array(track.at(np.array([seconds]))[0])


def _moved_apart(a: PointCloud, b: PointCloud) -> F64:
    """Return how far apart (m) the same returns lie in two clouds; a return that one of them took for the robot itself is left out."""
    one, other = (cloud.ring * 10.0 + cloud.time for cloud in (a, b))
    _, of_a, of_b = np.intersect1d(one, other, return_indices=True)
    return np.asarray(np.hypot(*(a.points[of_a, :2] - b.points[of_b, :2]).T.astype(np.float64)))


def distances_to_walls(world: WorldSpec, points: F64) -> F64:
    """Return how far points (N, 2) of the map frame lie from the nearest outline of a solid, metres."""
    best = np.full(len(points), np.inf)
    for solid in world.solids:
        if solid.shape is Shape.CYLINDER:
            pose = solid.world_from_solid
            distance = np.abs(np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y) - 0.5 * solid.size_x)
            best = np.minimum(best, distance)
            continue
        corners = solid.corners()
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = b - a
            s = np.clip((points - a) @ edge / (edge @ edge), 0.0, 1.0)
            best = np.minimum(best, np.hypot(*(points - a - s[:, None] * edge).T))
    return best


def hall() -> WorldSpec:
    """A hall of 12 × 10 m with boxes, a skew wall and pillars."""
    walls = [(6, 0, 10, 0.5), (-6, 0, 10, 0.5), (0, 5, 12, 0.0), (0, -5, 12, 0.0), (-2.5, 3.0, 3.0, 0.15)]
    solids = [
        Solid(f"wall_{k}", Shape.BOX, SE2(x, y, turn * math.pi), length, 0.1, 0.0, 2.0)
        for k, (x, y, length, turn) in enumerate(walls)
    ]
    for k, (x, y) in enumerate(((3.5, 2.0), (-3.0, -2.5), (2.5, -2.5))):
        solids.append(Solid(f"box_{k}", Shape.BOX, SE2(x, y, 0.4 * k), 0.8, 0.6, 0.0, 1.0))
        solids.append(Solid(f"pillar_{k}", Shape.CYLINDER, SE2(y, x, 0.0), 0.25, 0.25, 0.0, 2.0))
    return WorldSpec("hall", tuple(solids), SE2())


def true_motion() -> PlanarTrack:
    """Return the drive: from a rest, as every drive begins, up to full speed in a left circle, then over into a right one."""
    times = np.arange(0.0, SECONDS + 0.2, 0.001)
    speed = SPEED * np.clip((times - REST) / RAMP, 0.0, 1.0)
    turn = TURN * np.clip((times - REST) / RAMP, 0.0, 1.0)
    turn -= 2.0 * TURN * np.clip((times - FULL - HOLD) / SWERVE, 0.0, 1.0)
    poses = [START]
    for v, w, dt in zip(speed[:-1].tolist(), turn[:-1].tolist(), np.diff(times).tolist(), strict=True):
        poses.append(poses[-1] @ SE2.exp(np.array([v, 0.0, w]) * dt))
    return PlanarTrack(times, np.array([pose.as_array() for pose in poses]))


def _odometry(seed: int, wheels: Wheels, truth: PlanarTrack) -> list[Odometry]:
    robot = robot_named("diff")
    spec = robot.odometry if wheels in (Wheels.FUSED, Wheels.ALONE) else robot.odometry.perfect()
    reckoning = DeadReckoning(robot, spec, seed)
    drive, travel, told = drive_of(robot), np.zeros(2), []
    times = np.arange(0.0, SECONDS, 1.0 / spec.rate_hz)
    twists = truth.twist_at(times - 0.5 / spec.rate_hz, 1.0 / spec.rate_hz) / spec.rate_hz
    for t, (x, y, yaw) in zip(times.tolist(), twists.tolist(), strict=True):
        if wheels is not Wheels.BLIND:
            travel += drive.rates(BodyVelocity(x, y, yaw))
        told.append(reckoning.update(tuple(travel.tolist()), SE3(), round(t * 1e9)))
    return _fused(told, robot.imus["imu"], seed, truth) if wheels is Wheels.FUSED else told


def _fused(wheels: Sequence[Odometry], spec: ImuSpec, seed: int, truth: PlanarTrack) -> list[Odometry]:
    """Return what the robot's odometry makes of its wheels and its gyroscope."""
    imu, estimator = ImuSensor(spec, "imu", seed), WheelInertialOdometry()
    period, k, out = 1.0 / spec.rate_hz, 0, []
    for message in wheels:
        while k * period <= message.stamp_ns * 1e-9 + 1e-9:
            pose = SE3.from_se2(_pose(truth, k * period))
            measured = imu.update(pose, (0.0, 0.0, 0.0), round((k - 0.5) * period * 1e9))  # of its forces nobody asks
            if measured is not None:
                estimator.add_imu(measured.stamp_ns, measured.angular_velocity)
            k += 1
        odometry = estimator.update(message).odometry
        if odometry is not None:
            out.append(odometry)
    return out


def _sweep(sensor: LidarSensor, frame: str, truth: PlanarTrack, begin: float) -> LaserScan:
    """Take one turn; the beams that look into the robot itself are lost, as behind a housing of 275°."""
    spec: LidarSpec = sensor.spec
    mount = next(s for s in SCANNERS if s.frame == frame).base_from_sensor
    knots = np.linspace(0.0, spec.period, 33)
    poses = [SE3.from_se2(SE2(*p)) @ mount for p in truth.at(begin + knots).tolist()]
    sensor.sweep(knots, np.array([p.translation for p in poses]), np.array([p.rotation for p in poses]))
    scan = sensor.to_scan(round(begin * 1e9))
    angles = spec.azimuth_start + np.arange(spec.columns) * spec.azimuth_increment
    ranges = np.where(np.abs(angles) <= math.radians(137.5), scan.ranges, np.float32(np.nan)).astype(np.float32)
    return replace(scan, ranges=ranges)


def _bin_ends(result: MergeResult) -> F64:
    scan = result.scan
    hit = np.isfinite(scan.ranges)
    angles = scan.angle_min + np.nonzero(hit)[0] * scan.angle_increment
    return np.asarray(scan.ranges[hit, None] * np.column_stack([np.cos(angles), np.sin(angles)]))
