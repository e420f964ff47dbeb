"""Dense logs of drives through drawn campuses: a scanner, odometry and people as in the simulator, on a route that is prescribed.

Nothing is controlled and no physics steps, so a kilometre takes seconds: poses are given, beams are cast from where the scanner is at
their time, with the noise of `sim.sensors` (simulation.md §6), and the odometry counts what the wheels of such a drive turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.bridges.recorder import Recorder
from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan, Odometry, Transforms, TransformStamped
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.runtime.topics import ODOMETRY, SCAN, TRANSFORMS
from ambler.sim.body import TICK, TICK_NS
from ambler.sim.drive import drive_of
from ambler.sim.generator.draw import DrawnPlace, draw_place
from ambler.sim.lidar import LidarSensor, Movers
from ambler.sim.movers import Walker
from ambler.sim.odometry import DeadReckoning
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene, primitive
from ambler.sim.sensors import SAFETY_270, SCANNER_360, LidarSpec
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Shape, Solid
from ambler.studies.campus_route import Motion, draw_motion
from ambler.wire.tum import write_tum

F64 = NDArray[np.float64]
ROBOT = "diff"  # whose wheels and mount are taken
SCANNERS: dict[str, LidarSpec] = {"scanner_360": SCANNER_360, "safety_270": SAFETY_270}
FRAME = "laser"
BEGIN_NS = 1_000_000_000
VISITS = (4, 8)
SPEEDS = (0.9, 1.4)
PEOPLE_GAP = 1.0  # metres from the robot within which nobody walks: the way is prescribed, and people step aside


@dataclass(frozen=True, slots=True, eq=False)
class CampusLog:
    """A log: the place, how the robot truly moved, the name of its scanner, and where the recording lies."""

    place: DrawnPlace
    motion: Motion
    scanner: str
    recording: Path

    def true_poses(self, stamps_ns: NDArray[np.int64]) -> F64:
        """Return where the base truly was at stamps (N,), float64 (N, 3) in the frame of its start."""
        ticks = (stamps_ns - BEGIN_NS) / TICK_NS
        grid = np.arange(len(self.motion.poses))
        x, y, yaw = (np.interp(ticks, grid, column) for column in self.motion.poses.T)
        start = SE2.from_array(self.motion.poses[0])
        moved = start.inverse().transform(np.stack([x, y], axis=1))
        return np.column_stack([moved, np.arctan2(np.sin(yaw - start.yaw), np.cos(yaw - start.yaw))])


def record_campus(seed: int, folder: Path, scanner: str | None = None) -> CampusLog:
    """Draw a campus, a route and (unless told) a scanner by a seed, drive it, and write `recording` (scans, odometry, the mount) and
    `truth.tum` (a pose for each scan, in the frame of the start) into a folder. Raises BadInputError for unknown scanners."""
    if scanner is not None and scanner not in SCANNERS:
        raise BadInputError(f"no scanner {scanner!r} for campuses; there are {', '.join(SCANNERS)}")
    place = draw_place("campus", seed)
    rng = np.random.default_rng([seed, 31])
    drawn = str(rng.choice(list(SCANNERS)))
    name = scanner if scanner is not None else drawn
    start = (place.world.start.x, place.world.start.y)
    visits = int(rng.integers(VISITS[0], VISITS[1] + 1))
    motion = draw_motion(place.ways, start, visits, float(rng.uniform(*SPEEDS)), rng)
    log = CampusLog(place, motion, name, folder / "recording")
    recorder = Recorder(log.recording)
    mount = robot_named(ROBOT).model.sensor(FRAME).base_from_sensor
    edge = TransformStamped(BEGIN_NS, "base", FRAME, mount)
    recorder.on_message(TRANSFORMS, Transforms(BEGIN_NS, (edge,)), BEGIN_NS)
    stamps = []
    for message, time_ns in measured(place, motion, SCANNERS[name], seed):
        if isinstance(message, LaserScan):
            recorder.on_message(SCAN, message, time_ns)
            stamps.append(message.stamp_ns)
        else:
            recorder.on_message(ODOMETRY, message, time_ns)
    recorder.close()
    stamps_ns = np.array(stamps, np.int64)
    write_tum(folder / "truth.tum", np.asarray(stamps_ns * 1e-9, np.float64), log.true_poses(stamps_ns))
    return log


def measured(
    place: DrawnPlace, motion: Motion, spec: LidarSpec, seed: int
) -> Iterator[tuple[LaserScan | Odometry, int]]:
    """Yield what the robot measures, with the time when it is known, ns."""
    robot = robot_named(ROBOT)
    scans = _scans(place, motion, spec, robot, seed)
    odometry = _odometry(motion, robot, seed)
    scan = next(scans, None)
    for message in odometry:
        while scan is not None and scan[1] <= message.stamp_ns:
            yield scan
            scan = next(scans, None)
        yield message, message.stamp_ns


def _scans(
    place: DrawnPlace, motion: Motion, spec: LidarSpec, robot: SimRobot, seed: int
) -> Iterator[tuple[LaserScan, int]]:
    crowd = _Passers(place, seed)
    scene = build_scene(place.world, crowd.solids)
    sensor = LidarSensor(spec, FRAME, scene, seed)
    mount = robot.model.sensor(FRAME).base_from_sensor
    period, sweep = round(spec.period / TICK), math.ceil(spec.sweep_time / TICK) + 1
    offset = mount.to_se2()
    for first in range(period, len(motion.poses) - sweep, period):
        poses = motion.poses[first : first + sweep + 1]
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x = poses[:, 0] + c * offset.x - s * offset.y
        y = poses[:, 1] + s * offset.x + c * offset.y
        half = 0.5 * (poses[:, 2] + offset.yaw)
        zero = np.zeros(len(poses))
        positions = np.stack([x, y, np.full(len(poses), mount.translation[2])], axis=1)
        quaternions = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1)
        times = np.arange(len(poses), dtype=np.float64) * TICK
        sensor.sweep(times, positions, quaternions, crowd.movers(first * TICK, poses[0, :2]))
        stamp_ns = BEGIN_NS + first * TICK_NS
        yield sensor.to_scan(stamp_ns), stamp_ns + round((spec.sweep_time + spec.latency) * 1e9)


def _odometry(motion: Motion, robot: SimRobot, seed: int) -> Iterator[Odometry]:
    """Count what the wheels turn: forwards and around, from tick to tick."""
    steps = np.diff(motion.poses, axis=0)
    heading = 0.5 * (motion.poses[1:, 2] + motion.poses[:-1, 2])
    forward = np.cos(heading) * steps[:, 0] + np.sin(heading) * steps[:, 1]
    drive, reckoning = drive_of(robot), DeadReckoning(robot, robot.odometry, seed)
    ahead, around = (np.array(drive.rates(v)) for v in (BodyVelocity(1.0), BodyVelocity(0.0, 0.0, 1.0)))
    turned = np.concatenate(
        [np.zeros((1, drive.parts)), np.cumsum(np.outer(forward, ahead) + np.outer(steps[:, 2], around), axis=0)]
    )
    every = round(1.0 / robot.odometry.rate_hz / TICK)
    level = SE3()
    for k in range(every, len(turned), every):
        yield reckoning.update(tuple(turned[k].tolist()), level, BEGIN_NS + k * TICK_NS)


class _Passers:
    """People on their ways, who are not there where the robot is."""

    def __init__(self, place: DrawnPlace, seed: int) -> None:
        self._walkers = [Walker(person, seed) for person in place.world.people]
        self.solids = [
            Solid(p.name, Shape.CYLINDER, SE2(), 2 * p.radius, 2 * p.radius, 0.0, p.height, 0.5)
            for p in place.world.people
        ]
        self._rows = np.array([primitive(s) for s in self.solids]).reshape(-1, 15)
        self._kinds = np.array([s.shape for s in self.solids], np.uint8)

    def movers(self, seconds: float, robot: F64) -> Movers:
        """Return the kernels' arrays at an instant."""
        rows, rates = self._rows.copy(), np.zeros((len(self._walkers), 2))
        for k, walker in enumerate(self._walkers):
            at = walker.at + walker.person.speed * seconds
            here, soon = np.array(walker.place(at)), np.array(walker.place(at + 0.01 * walker.person.speed))
            is_near = np.hypot(*(here - robot)) < PEOPLE_GAP
            rows[k, :2] = here if not is_near else 1e6
            rates[k] = (soon - here) / 0.01
        return Movers(rows, self._kinds, rates)
