"""One robot in one world, stepped from outside: commands in, sensor messages and ground truth out.

Everything is told in the map frame, whose origin is the robot's start pose (`sim.world`). All sensors fire at whole ticks of
5 ms after the start, so that the same run comes out however the caller cuts time into steps.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3, Vector3
from ambler.sim.base import BaseController, Physics
from ambler.sim.battery import Battery, BatterySpec
from ambler.sim.dock_camera import DockCamera
from ambler.sim.faults import Fault, FaultInjector, FaultKind, world_with_faults
from ambler.sim.gait import Gait
from ambler.sim.imu import ImuSensor
from ambler.sim.kinematic_physics import KinematicPhysics
from ambler.sim.lidar import NO_MOVERS, LidarSensor
from ambler.sim.movers import UPDATE_NS, Crowd
from ambler.sim.odometry import DeadReckoning
from ambler.sim.scene import build_scene
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec
from ambler.sim.ultrasonic import UltrasonicSensor

TICK_NS = 5_000_000
TICK = TICK_NS * 1e-9
TRUTH_PERIOD_NS = 20_000_000
CONTACT_PERIOD_NS = 100_000_000
HISTORY_NS = 250_000_000


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """How to simulate: `physics` contact (MuJoCo) or kinematic; `is_perfect` turns noise, losses, slip and drift off."""

    seed: int = 0
    is_perfect: bool = False
    physics: Literal["contact", "kinematic"] = "contact"
    faults: tuple[Fault, ...] = ()


@dataclass(slots=True)
class SimulationOutput:
    """What happened during a step, in order of time."""

    scans: list[m.LaserScan] = field(default_factory=list)
    clouds: list[m.PointCloud] = field(default_factory=list)
    ranges: list[m.Range] = field(default_factory=list)
    imus: list[m.Imu] = field(default_factory=list)
    odometry: list[m.Odometry] = field(default_factory=list)
    true_poses: list[m.Odometry] = field(default_factory=list)
    contacts: list[m.Contact] = field(default_factory=list)
    batteries: list[m.BatteryState] = field(default_factory=list)

    def add(self, measured: m.LaserScan | m.PointCloud | m.Range | None) -> None:
        """Add what a scanner or transducer sent, if it sent anything."""
        if isinstance(measured, m.LaserScan):
            self.scans.append(measured)
        elif isinstance(measured, m.Range):
            self.ranges.append(measured)
        elif measured is not None:
            self.clouds.append(measured)


class Simulation:
    """Owns the physics, the sensors and their chance. Two with the same arguments and commands give equal bits."""

    def __init__(self, world: WorldSpec, robot: SimRobot, config: SimulationConfig | None = None) -> None:
        self.config = config if config is not None else SimulationConfig()
        seed, is_perfect = self.config.seed, self.config.is_perfect
        robot = replace(robot, strafe_loss=0.0) if is_perfect else robot
        faults = self.config.faults
        self._faults = FaultInjector(faults, world, (*robot.lidars, *robot.ultrasonics))
        world = world_with_faults(world, faults, seed)
        self.world, self.robot = world, robot
        self._crowd = Crowd(world, seed, robot.model.footprint)
        self._physics = _make_physics(world, robot, self.config, self._crowd)
        self._controller = BaseController(robot.model.limits, robot.watchdog)
        self._gait = Gait(robot.gait, 0.7 * robot.model.body_height) if robot.gait is not None else None
        scene = build_scene(world, self._crowd.solids)
        self._lidars = [
            LidarSensor(spec.perfect() if is_perfect else spec, frame, scene, seed)
            for frame, spec in robot.lidars.items()
        ]
        self._rangers = [
            UltrasonicSensor(spec.perfect() if is_perfect else spec, frame, scene, seed)
            for frame, spec in robot.ultrasonics.items()
        ]
        self.battery = Battery(BatterySpec(), world.docks) if world.docks else None
        self.camera: DockCamera | None = None
        if world.docks and robot.camera is not None and robot.model.camera is not None:
            self.camera = DockCamera(robot.camera, robot.model.camera, world.docks, scene, self._faults, seed)
        self._mounts = {s.frame: s.base_from_sensor for s in robot.model.sensors}
        imu_spec = robot.imu.perfect() if is_perfect else robot.imu
        self._imu_frame = next(s.frame for s in robot.model.sensors if s.kind == "imu")
        self._imu, self._imu_period_ns = ImuSensor(imu_spec, self._imu_frame, seed), round(1e9 / robot.imu.rate_hz)
        odometry = robot.odometry.perfect() if is_perfect else robot.odometry
        self._reckoning = DeadReckoning(robot, odometry, seed)
        self._odometry_period_ns = round(1e9 / odometry.rate_hz)
        self._travel = self._physics.travel
        self._start_ns = 0
        self._elapsed_ns = 0
        self._is_started = False
        self._lean = SE3()
        self._history: deque[tuple[int, SE3]] = deque([(0, self._true_pose())])
        self._reported: dict[tuple[str, str], int] = {}

    @property
    def now_ns(self) -> int:
        """Time up to which the world has been simulated."""
        return self._start_ns + self._elapsed_ns

    @property
    def map_from_base(self) -> SE3:
        """The true pose of the base now."""
        return self._history[-1][1]

    def pose_at(self, stamp_ns: int) -> SE3:
        """The true pose of the base at an instant of the last quarter of a second, between ticks by equal shares of their motion."""
        elapsed = stamp_ns - self._start_ns
        after = next((k for k, (t, _) in enumerate(self._history) if t >= elapsed), len(self._history) - 1)
        (t1, b), (t0, a) = self._history[after], self._history[max(after - 1, 0)]
        if t1 == t0 or elapsed >= t1:
            return b
        step = a.to_se2().inverse() @ b.to_se2()
        return a @ SE3.from_se2(SE2.exp(step.log() * ((elapsed - t0) / (t1 - t0))))

    def start_at(self, now_ns: int) -> None:
        """Let the simulation begin at this instant; only before the first step."""
        if self._is_started:
            raise RuntimeError("the simulation has already begun")
        self._start_ns = now_ns

    def command(self, command: BodyVelocity) -> None:
        """Give the base a command; without a new one for `watchdog` seconds it stops by itself."""
        self._controller.command(command, self._elapsed_ns)

    def step(self, until_ns: int) -> SimulationOutput:
        """Advance by whole ticks, not beyond `until_ns`; returns what was measured and what truly happened."""
        out = SimulationOutput()
        if not self._is_started:
            self._is_started = True
            self._sense(out)
        while self.now_ns + TICK_NS <= until_ns:
            self._tick()
            self._sense(out)
        return out

    def take_picture(self) -> m.Image:
        """Return what the camera sees now, stamped in the middle of its exposure; raises RuntimeError without a camera and docks."""
        if self.camera is None:
            raise RuntimeError("there is no camera, or nothing for it to see")
        exposure_ns = round(self.camera.spec.exposure * 1e9)
        poses = [pose for t, pose in self._history if t >= self._elapsed_ns - exposure_ns]
        picture = self.camera.take(poses, self._elapsed_ns * 1e-9)
        return m.Image(self.now_ns - exposure_ns // 2, self.camera.mount.frame, picture)

    def _tick(self) -> None:
        if len(self._crowd) and self._elapsed_ns % UPDATE_NS == 0:
            self._crowd.update(self._physics.carriage.to_se2(), self._faults, self._elapsed_ns * 1e-9)
            self._physics.move(self._crowd.solids)
        target = self._controller.update(self._elapsed_ns, TICK)
        self._move(target)
        if self._gait is not None:
            self._lean = self._gait.update(target, TICK)
        self._elapsed_ns += TICK_NS
        self._history.append((self._elapsed_ns, self._true_pose()))
        if self.battery is not None:
            has_power = not self._faults.is_on(FaultKind.NO_POWER, self._elapsed_ns * 1e-9)
            speed = abs(target.vx) + abs(target.vy)
            self.battery.update(self._physics.carriage.to_se2(), speed, TICK, has_power=has_power)
        while self._history[0][0] < self._elapsed_ns - HISTORY_NS:
            self._history.popleft()

    def _move(self, target: BodyVelocity) -> None:
        """Step the physics. While the wheels slip they turn for the whole target, and the base moves a part of it."""
        if not self._faults.has_slip:
            self._physics.step(target)
            self._travel = self._physics.travel
            return
        grip, before = 1.0 - self._faults.slip(self._elapsed_ns * 1e-9), self._physics.travel
        self._physics.step(BodyVelocity(target.vx * grip, target.vy * grip, target.wz * grip))
        moved = zip(self._travel, before, self._physics.travel, strict=True)
        self._travel = tuple(t + (b - a) / grip for t, a, b in moved)

    def _true_pose(self) -> SE3:
        carriage = self._physics.carriage
        pose = SE3(carriage.position, carriage.rotation)
        return pose if self._gait is None else pose @ self._lean

    def _sense(self, out: SimulationOutput) -> None:
        now, elapsed = self.now_ns, self._elapsed_ns
        self._sense_contacts(out)
        told = self.battery.told(now) if self.battery is not None else None
        if told is not None:
            out.batteries.append(told)
        if elapsed % self._imu_period_ns == 0:
            self._sense_imu(out)
        if elapsed % self._odometry_period_ns == 0:
            out.odometry.append(self._reckoning.update(self._travel, self._lean, now))
        if elapsed % TRUTH_PERIOD_NS == 0:
            out.true_poses.append(self._truth())
        for lidar in self._lidars:
            spec = lidar.spec
            sweep_ns = round(spec.sweep_time * 1e9)
            if elapsed >= sweep_ns and (elapsed - round(spec.phase * 1e9)) % round(spec.period * 1e9) == 0:
                movers = self._crowd.as_rays_see_it(spec.sweep_time) if len(self._crowd) else NO_MOVERS
                lidar.sweep(*self._knots(lidar.frame, elapsed - sweep_ns), movers)
                is_flat = len(spec.elevations) == 1
                measured = lidar.to_scan(now - sweep_ns) if is_flat else lidar.to_cloud(now - sweep_ns)
                out.add(self._faults.pass_on(measured, elapsed * 1e-9))
        self._sense_ranges(out)
        for late in self._faults.take_late(elapsed * 1e-9):
            out.add(late)

    def _sense_ranges(self, out: SimulationOutput) -> None:
        elapsed, pose = self._elapsed_ns, self._history[-1][1]
        for ranger in self._rangers:
            spec = ranger.spec
            if (elapsed - round(spec.phase * 1e9)) % round(spec.period * 1e9) == 0:
                movers = self._crowd.as_rays_see_it(0.0) if len(self._crowd) else NO_MOVERS
                measured = ranger.measure(pose @ self._mounts[ranger.frame], self.now_ns, movers)
                out.add(self._faults.pass_on(measured, elapsed * 1e-9))

    def _knots(self, frame: str, since_ns: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The sensor's poses from an instant until now: seconds after it, positions, quaternions (wxyz)."""
        mount = self._mounts[frame]
        knots = [(t, pose @ mount) for t, pose in self._history if t > since_ns - TICK_NS]
        times = np.array([t - since_ns for t, _ in knots]) * 1e-9
        return times, np.array([p.translation for _, p in knots]), np.array([p.rotation for _, p in knots])

    def _sense_imu(self, out: SimulationOutput) -> None:
        mount, (_, pose) = self._mounts[self._imu_frame], self._history[-1]
        map_from_imu = pose @ mount
        velocity: Vector3 = (0.0, 0.0, 0.0)
        if len(self._history) > 1:
            a, b = (self._history[-2][1] @ mount).translation, map_from_imu.translation
            velocity = ((b[0] - a[0]) / TICK, (b[1] - a[1]) / TICK, (b[2] - a[2]) / TICK)
        sample = self._imu.update(map_from_imu, velocity, self.now_ns - self._imu_period_ns // 2)
        if sample is not None:
            out.imus.append(sample)

    def _truth(self) -> m.Odometry:
        pose, linear, angular = self.map_from_base, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if len(self._history) > 1:
            motion = self._history[-2][1].inverse() @ pose
            x, y, z = motion.translation
            _, qx, qy, qz = motion.rotation if motion.rotation[0] >= 0 else tuple(-v for v in motion.rotation)
            linear, angular = (x / TICK, y / TICK, z / TICK), (2 * qx / TICK, 2 * qy / TICK, 2 * qz / TICK)
        return m.Odometry(self.now_ns, "map", "base", pose, linear, angular, np.zeros((6, 6)), np.zeros((6, 6)))

    def _sense_contacts(self, out: SimulationOutput) -> None:
        """Report a contact when it begins, and every 0.1 s while it lasts."""
        for touch in self._physics.touches():
            key = (touch.part, touch.solid)
            if self._elapsed_ns - self._reported.get(key, -CONTACT_PERIOD_NS) >= CONTACT_PERIOD_NS:
                self._reported[key] = self._elapsed_ns
                out.contacts.append(
                    m.Contact(self.now_ns, touch.part, touch.solid, touch.position, touch.speed, touch.force)
                )


def _make_physics(world: WorldSpec, robot: SimRobot, config: SimulationConfig, crowd: Crowd) -> Physics:
    if config.physics == "kinematic":
        return KinematicPhysics(world, robot, TICK, crowd.solids)
    try:
        from ambler.sim.contact_physics import ContactPhysics
    except ModuleNotFoundError as error:
        raise BadInputError("contact physics needs MuJoCo (the extra `sim`); or choose kinematic physics") from error
    return ContactPhysics(world, robot, TICK, crowd.solids)
