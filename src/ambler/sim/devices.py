"""The devices of a simulated robot (`core.devices`): each measures when its time has come and sends it when a real one would have.

`read` first lets the world catch up with its caller. Whoever asks for an instant first pays for it; the others find it done.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from typing import Generic, TypeVar

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.devices import DeviceHealth, DeviceState
from ambler.core.protocols import BodyVelocity
from ambler.core.se3 import Vector3
from ambler.sim.body import TICK, TICK_NS, Body
from ambler.sim.camera import CameraSpec
from ambler.sim.depth_camera import DepthCameraSensor
from ambler.sim.dock_camera import DockCamera
from ambler.sim.imu import ImuSensor
from ambler.sim.lidar import NO_KNOTS, LidarSensor
from ambler.sim.odometry import DeadReckoning
from ambler.sim.sensors import DepthCameraSpec, ImuSpec, LidarSpec, UltrasonicSpec
from ambler.sim.ultrasonic import UltrasonicSensor
from ambler.sim.world import World

M = TypeVar("M", bound=m.Message)

READ_NS = 10_000_000  # how often what has no transport latency is read
SLOWEST_READ_NS = 20_000_000
CAMERA_LATENCY_NS = 40_000_000
PART_NS = 10_000_000  # of a turn whose rays are cast at once: a simulator in real time must not fall behind at the end of every turn
NEVER_NS = -(1 << 62)


class SimulatedDevice(Generic[M]):
    """What the devices of a body share: their life, and a queue of what was measured and has not yet arrived."""

    def __init__(
        self, world: World, body: Body, name: str, period_ns: int, first_ns: int = 0, latency_ns: int = 0
    ) -> None:
        self.name = name
        self.due_ns = first_ns
        self._world, self._body, self._period_ns = world, body, max(period_ns, TICK_NS)
        self._latency_ns = latency_ns
        self._state = DeviceState.CLOSED
        self._sent: list[tuple[int, int, M]] = []
        self._messages = self._lost = 0

    @property
    def poll_period(self) -> float:
        """How often to read, seconds."""
        return READ_NS * 1e-9

    def open(self) -> None:
        """Begin to measure."""
        if self._state is DeviceState.OPEN:
            return
        self._state = DeviceState.OPEN
        missed = self._world.elapsed_ns - self.due_ns
        if missed > 0:
            self.due_ns += -(-missed // self._period_ns) * self._period_ns
        self._world.attach(self)

    def close(self) -> None:
        """Measure no more."""
        if self._state is DeviceState.OPEN:
            self._world.detach(self)
            self._state = DeviceState.CLOSED

    def health(self) -> DeviceHealth:
        """Return how it does: `lost` counts what faults kept from being sent."""
        return DeviceHealth(self._state, "", self._messages, self._lost)

    def read(self, now_ns: int) -> Sequence[M]:
        """Return what has arrived since the last call, oldest first."""
        with self._world.lock:
            self._world.advance(now_ns)
            return self.take(now_ns - self._latency_ns)

    def take(self, until_ns: int) -> Sequence[M]:
        """Return what was sent until an instant, oldest first, however long it takes to arrive."""
        sent = self._sent
        if not sent or sent[0][0] > until_ns:
            return ()
        out = []
        while sent and sent[0][0] <= until_ns:
            out.append(heapq.heappop(sent)[2])
        return out

    def sense(self) -> None:
        """Measure now, and say when to measure next."""
        self.due_ns += self._period_ns
        self._measure(self._world.now_ns, self._world.elapsed_ns)

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        """Measure at an instant, which is `elapsed_ns` after the world's begin, and `_send` what comes of it."""
        raise AssertionError(f"{type(self).__name__} does not say how it measures")

    def _send(self, message: M, delay_ns: int = 0) -> None:
        self._messages += 1
        heapq.heappush(self._sent, (self._world.now_ns + delay_ns, self._messages, message))


class SimulatedBase(SimulatedDevice[m.Odometry]):
    """The base: takes commands, tells its own dead reckoning."""

    def __init__(self, world: World, body: Body) -> None:
        spec = body.robot.odometry.perfect() if world.config.is_perfect else body.robot.odometry
        super().__init__(world, body, "base", round(1e9 / spec.rate_hz))
        self._reckoning = DeadReckoning(body.robot, spec, body.seed)

    @property
    def poll_period(self) -> float:
        """The period of its odometry, seconds."""
        return self._period_ns * 1e-9

    @property
    def watchdog(self) -> float:
        """Seconds without a command after which it stops."""
        return self._body.robot.watchdog

    def command(self, velocity: BodyVelocity) -> None:
        """Take a velocity in the base frame; a base that is closed takes none."""
        if self._state is not DeviceState.OPEN:
            return
        with self._world.lock:
            self._body.controller.command(velocity, self._world.elapsed_ns)

    def close(self) -> None:
        """Stop, and measure no more."""
        if self._state is DeviceState.OPEN:
            self.command(BodyVelocity())
        super().close()

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        self._send(self._reckoning.update(self._body.travel, self._body.lean, now_ns))


class SimulatedLegs:
    """Legs that rise and fold."""

    def __init__(self, world: World, body: Body) -> None:
        self._world, self._body = world, body

    def stand(self) -> None:
        """Rise; the base obeys velocities again once it stands."""
        with self._world.lock:
            self._body.posture.is_up = True

    def sit(self) -> None:
        """Halt and sit down."""
        with self._world.lock:
            self._body.posture.is_up = False


class SimulatedLidar(SimulatedDevice[m.LaserScan | m.PointCloud]):
    """A scanner: a scan or a cloud arrives `latency` after the end of its sweep. The many rays of a cloud are cast part by part while it turns."""

    def __init__(self, world: World, body: Body, frame: str, spec: LidarSpec) -> None:
        spec = spec.perfect() if world.config.is_perfect else spec
        self._turn_ns, self._sweep_ns = round(spec.period * 1e9), round(spec.sweep_time * 1e9)
        self._is_flat = len(spec.elevations) == 1
        parts = 1 if self._is_flat else -(-self._sweep_ns // PART_NS)
        self._ends_ns = [round(k * self._sweep_ns / parts / TICK_NS) * TICK_NS for k in range(1, parts)] + [
            self._sweep_ns
        ]
        first_ns = _first_after(self._sweep_ns, round(spec.phase * 1e9), self._turn_ns)
        latency_ns = round(spec.latency * 1e9)
        super().__init__(world, body, frame, self._turn_ns, first_ns - self._sweep_ns + self._ends_ns[0], latency_ns)
        self._part = 0
        self.frame = frame
        self._spec = spec
        self._sensor = LidarSensor(spec, frame, world.scene, body.seed)
        self._poll_ns = _poll_ns(self._turn_ns, first_ns + self._latency_ns)

    @property
    def poll_period(self) -> float:
        """Seconds, so that a reader meets the instants of arrival."""
        return self._poll_ns * 1e-9

    def open(self) -> None:
        """Begin to measure, with the first part of a turn."""
        if self._state is not DeviceState.OPEN:
            self.due_ns -= self._ends_ns[self._part] - self._ends_ns[0]
            self._part = 0
        super().open()

    def sense(self) -> None:
        """Cast the part of the turn that ends now; the last one completes it."""
        begin_ns, end_ns = ([0, *self._ends_ns][self._part], self._ends_ns[self._part])
        elapsed_ns, body, sensor = self._world.elapsed_ns, self._body, self._sensor
        first_ns = elapsed_ns - end_ns
        is_last = end_ns == self._sweep_ns
        if self._part == 0:
            sensor.begin(1e-9 * first_ns)
        knots = body.knots(self.frame, first_ns + begin_ns)
        movers = self._world.movers_around(body, 1e-9 * (end_ns - begin_ns))
        sensor.cast(1e-9 * begin_ns, math.inf if is_last else 1e-9 * end_ns, knots, movers)
        if is_last:
            self._complete(first_ns)
        self._part = 0 if is_last else self._part + 1
        self.due_ns += (
            self._turn_ns - self._sweep_ns + self._ends_ns[0] if is_last else self._ends_ns[self._part] - end_ns
        )

    def _complete(self, first_ns: int) -> None:
        sensor, body, elapsed_ns = self._sensor, self._body, self._world.elapsed_ns
        airs = body.faults.airs(elapsed_ns * 1e-9)
        sensor.finish(body.knots(self.frame, first_ns) if airs else NO_KNOTS, airs)
        stamp_ns = self._world.now_ns - self._sweep_ns - round(self._spec.clock * 1e9)
        measured = sensor.to_scan(stamp_ns) if self._is_flat else sensor.to_cloud(stamp_ns)
        sent = body.faults.pass_on(measured, elapsed_ns * 1e-9)
        if sent is None:
            self._lost += 1
        else:
            self._send(sent[0], round(sent[1] * 1e9))


class SimulatedRange(SimulatedDevice[m.Range]):
    """A transducer: an echo arrives `latency` after its pulse."""

    def __init__(self, world: World, body: Body, frame: str, spec: UltrasonicSpec) -> None:
        spec = spec.perfect() if world.config.is_perfect else spec
        period_ns, first_ns = round(spec.period * 1e9), round(spec.phase * 1e9)
        super().__init__(world, body, frame, period_ns, first_ns, round(spec.latency * 1e9))
        self.frame = frame
        self._sensor = UltrasonicSensor(spec, frame, world.scene, body.seed)
        self._poll_ns = _poll_ns(period_ns, first_ns + self._latency_ns)

    @property
    def poll_period(self) -> float:
        """Seconds, so that a reader meets the instants of arrival."""
        return self._poll_ns * 1e-9

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        body = self._body
        movers = self._world.movers_around(body, 0.0)
        measured = self._sensor.measure(body.world_from_base @ body.mounts[self.frame], now_ns, movers)
        sent = body.faults.pass_on(measured, elapsed_ns * 1e-9)
        if sent is None:
            self._lost += 1
        else:
            self._send(sent[0], round(sent[1] * 1e9))


class SimulatedImu(SimulatedDevice[m.Imu]):
    """An IMU: means over each of its periods, stamped in their middle."""

    def __init__(self, world: World, body: Body, frame: str, spec: ImuSpec) -> None:
        spec = spec.perfect() if world.config.is_perfect else spec
        super().__init__(world, body, frame, round(1e9 / spec.rate_hz))
        self.frame = frame
        self._sensor = ImuSensor(spec, frame, body.seed)

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        mount, history = self._body.mounts[self.frame], self._body.history
        world_from_imu = history[-1][1] @ mount
        velocity: Vector3 = (0.0, 0.0, 0.0)
        if len(history) > 1:
            a, b = (history[-2][1] @ mount).translation, world_from_imu.translation
            velocity = ((b[0] - a[0]) / TICK, (b[1] - a[1]) / TICK, (b[2] - a[2]) / TICK)
        sample = self._sensor.update(world_from_imu, velocity, now_ns - self._period_ns // 2)
        if sample is not None:
            self._send(sample)


class SimulatedCamera(SimulatedDevice[m.Image]):
    """A camera: pictures arrive 40 ms after they were taken, and are taken only while they are wanted."""

    def __init__(self, world: World, body: Body, frame: str, spec: CameraSpec) -> None:
        super().__init__(world, body, frame, READ_NS, latency_ns=CAMERA_LATENCY_NS)
        self.frame = frame
        self.spec = spec
        self._eye = DockCamera(
            spec, body.robot.model.sensor(frame), world.spec.docks, world.scene, body.faults, body.seed
        )
        self._rate_ns, self._exposure_ns = round(1e9 / spec.rate_hz), round(spec.exposure * 1e9)
        self._wanted_until_ns = self._next_ns = NEVER_NS

    @property
    def model(self) -> CameraModel:
        """How it projects."""
        return self.spec.model

    def request(self, until_ns: int) -> None:
        """Take pictures until that instant."""
        self._wanted_until_ns = max(self._wanted_until_ns, until_ns)

    def take_picture(self) -> m.Image:
        """Return what the camera sees now, stamped in the middle of its exposure."""
        world, body = self._world, self._body
        poses = [pose for t, pose in body.history if t >= world.elapsed_ns - self._exposure_ns]
        movers = world.movers_around(body, 0.0)
        picture = self._eye.take(poses, world.elapsed_ns * 1e-9, movers)
        return m.Image(world.now_ns - self._exposure_ns // 2, self.frame, picture)

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        if self._next_ns <= now_ns <= self._wanted_until_ns:
            self._next_ns = now_ns + self._rate_ns
            self._send(self.take_picture())


class SimulatedDepthCamera(SimulatedDevice[m.Image]):
    """A depth camera: a picture arrives `latency` after it was taken. It takes them only while they are wanted."""

    def __init__(self, world: World, body: Body, frame: str, spec: DepthCameraSpec) -> None:
        spec = spec.perfect() if world.config.is_perfect else spec
        period_ns, first_ns = round(spec.period * 1e9), round(spec.phase * 1e9)
        super().__init__(world, body, frame, period_ns, first_ns, round(spec.latency * 1e9))
        self.frame = frame
        self.spec = spec
        self._sensor = DepthCameraSensor(spec, frame, world.scene, body.seed)
        self._poll_ns = _poll_ns(period_ns, first_ns + self._latency_ns)
        self._wanted_until_ns = NEVER_NS

    @property
    def poll_period(self) -> float:
        """Seconds, so that a reader meets the instants of arrival."""
        return self._poll_ns * 1e-9

    @property
    def model(self) -> CameraModel:
        """How it projects."""
        return self.spec.model

    def request(self, until_ns: int) -> None:
        """Take pictures until that instant."""
        self._wanted_until_ns = max(self._wanted_until_ns, until_ns)

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        if now_ns > self._wanted_until_ns:
            return
        body = self._body
        movers = self._world.movers_around(body, 0.0)
        measured = self._sensor.take(body.world_from_base @ body.mounts[self.frame], now_ns, movers)
        sent = body.faults.pass_on(measured, elapsed_ns * 1e-9)
        if sent is None:
            self._lost += 1
        else:
            self._send(sent[0], round(sent[1] * 1e9))


class SimulatedBattery(SimulatedDevice[m.BatteryState]):
    """The battery; a change of the supply is told at once."""

    def __init__(self, world: World, body: Body) -> None:
        super().__init__(world, body, "battery", TICK_NS)

    @property
    def poll_period(self) -> float:
        """How often to read, seconds."""
        return SLOWEST_READ_NS * 1e-9

    def stop_charging(self) -> None:
        """Let no current flow until the contacts have opened."""
        with self._world.lock:
            self._body.battery.stop_charging()

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        told = self._body.battery.told(now_ns)
        if told is not None:
            self._send(told)


def _first_after(elapsed_ns: int, phase_ns: int, period_ns: int) -> int:
    """The first instant of a rhythm that is not before another."""
    return phase_ns + max(0, -(-(elapsed_ns - phase_ns) // period_ns)) * period_ns


def _poll_ns(period_ns: int, arrival_ns: int) -> int:
    """The longest period of reading, 5 to 20 ms, that meets every instant `arrival_ns + k * period_ns`."""
    common = math.gcd(period_ns, arrival_ns)
    fitting = [k * TICK_NS for k in (4, 2, 1) if common % (k * TICK_NS) == 0]
    return min(fitting[0] if fitting else TICK_NS, SLOWEST_READ_NS)
