"""How exact and how late the scan merger is: a simulated robot at full speed with three scanners, judged by the true walls."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.calibration.planar_arrays import PlanarTrack
from ambler.core.messages import LaserScan, Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.merger import MergerConfig, MergeResult, ScanMerger, ScannerConfig
from ambler.sim.lidar import LidarSensor
from ambler.sim.odometry import DeadReckoning
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.sensors import SCANNER_360, LidarSpec
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
SECONDS = 3.0


@dataclass(frozen=True, slots=True)
class MergeErrors:
    """Distances (m) of merged points and of filled bins from the true walls, and the latency (s) of every merged scan."""

    cloud: F64
    bins: F64
    latency: F64
    period: float


class Wheels(enum.Enum):
    """Odometry of a drive: exact, with the wheels' full errors (radius, track, slip, encoders), or blind: the robot seems to stand,
    which is what a merger without compensation assumes."""

    EXACT = "exact"
    NOISY = "noisy"
    BLIND = "blind"


def drive_and_merge(seed: int, wheels: Wheels) -> MergeErrors:
    """Drive a circle at 1 m/s and 90°/s with exact ranges; merge as the scans arrive."""
    world = _hall()
    scene = build_scene(world)
    spec = replace(SCANNER_360.perfect(), columns=720)
    truth = PlanarTrack(
        np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], SE2.exp(np.array([SPEED, 0.0, TURN])).as_array()])
    )
    sensors = {s.frame: LidarSensor(spec, s.frame, scene, seed) for s in SCANNERS}
    merger = ScanMerger(MergerConfig(SCANNERS, self_mask=(BODY,)))
    events: list[tuple[int, int, str]] = [(round(t * 1e9), 0, "odometry") for t in np.arange(0.0, SECONDS, 0.02)]
    for scanner, phase in zip(SCANNERS, PHASES, strict=True):
        ends = 0.2 + phase + spec.period * np.arange(1, int((SECONDS - 0.5) / spec.period))
        events += [(round((end + spec.latency) * 1e9), 1, scanner.frame) for end in ends]
    odometry = iter(_odometry(seed, wheels))
    cloud, bins, latency = [], [], []
    for now_ns, _, what in sorted(events):
        if what == "odometry":
            merger.odometry.add(next(odometry))
            continue
        begin = now_ns * 1e-9 - spec.latency - spec.period
        merger.add_scan(_sweep(sensors[what], what, truth, begin), now_ns)
        if merger.is_due(now_ns):
            result = merger.merge(now_ns)
            pose = SE2.from_array(truth.at(np.array([result.scan.stamp_ns * 1e-9]))[0])
            cloud.append(distances_to_walls(world, pose.transform(result.cloud.points[:, :2])))
            bins.append(distances_to_walls(world, pose.transform(_bin_ends(result))))
            latency.append(result.latency)
    return MergeErrors(np.concatenate(cloud), np.concatenate(bins), np.array(latency), spec.period)


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


def _hall() -> WorldSpec:
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


def _odometry(seed: int, wheels: Wheels) -> list[Odometry]:
    robot = robot_named("diff")
    spec = robot.odometry if wheels is Wheels.NOISY else robot.odometry.perfect()
    reckoning = DeadReckoning(robot, spec, seed)
    half = 0.5 * robot.track * TURN
    rates = np.array([SPEED - half, SPEED + half]) / robot.wheel_radius
    if wheels is Wheels.BLIND:
        rates = np.zeros(2)
    times = np.arange(0.0, SECONDS, 0.02)
    return [reckoning.update(tuple((rates * t).tolist()), SE3(), round(t * 1e9)) for t in times.tolist()]


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
