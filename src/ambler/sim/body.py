"""One robot in a world: its base's controller and gait, where it truly was a moment ago, its battery and its own faults."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.base import BaseController, Carriage, PlacedRobot
from ambler.sim.battery import Battery, BatterySpec
from ambler.sim.faults import FaultInjector
from ambler.sim.gait import Gait, Posture
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Shape, Solid, WorldSpec

TICK_NS = 5_000_000
TICK = TICK_NS * 1e-9
HISTORY_NS = 250_000_000
HIPS = 0.5  # metres above the ground about which even a tall body sways
F64 = NDArray[np.float64]


class Body:
    """Holds the state of one robot between the ticks of its world. All poses are in the world's frame; `elapsed` is the time since the
    world began."""

    def __init__(self, placed: PlacedRobot, seed: int, faults: FaultInjector, world: WorldSpec) -> None:
        self.name, self.robot, self.start = placed.name, placed.robot, placed.start
        self.seed = seed
        self.faults = faults
        self.battery = Battery(BatterySpec(), world.docks)
        self.controller = BaseController(self.robot.model.limits, self.robot.watchdog)
        self.mounts = {s.frame: s.base_from_sensor for s in self.robot.model.sensors}
        self.lean = SE3()
        self.travel: tuple[float, ...] = ()
        self.history: deque[tuple[int, SE3]] = deque()
        middle = min(0.7 * self.robot.model.body_height, HIPS)
        self._gait = Gait(self.robot.gait, middle) if self.robot.gait is not None else None
        self.posture = Posture(self.robot.gait.crouch if self.robot.gait is not None else 0.0)
        self._upright = self.robot.gait.upright if self.robot.gait is not None else 0.0
        self._counted: tuple[float, ...] = ()
        self._grip = 1.0
        self._wanted = BodyVelocity()
        self._hull = _hull_of(placed.name, self.robot)
        self._is_flat = world.is_flat

    def place(self, carriage: Carriage, travel: tuple[float, ...]) -> None:
        """Take the state in which the physics begins."""
        self.travel = self._counted = travel
        if self._upright > 0.0:
            self.lean = self._straightened(carriage)
        self.history.append((0, self._pose(carriage)))

    @property
    def world_from_base(self) -> SE3:
        """The true pose of the base now."""
        return self.history[-1][1]

    @property
    def footprint_world(self) -> F64:
        """The footprint (N, 2) where the base is now, without the sway of its gait."""
        return self._carriage.to_se2().transform(self.robot.model.footprint)

    def pose_at(self, elapsed_ns: int) -> SE3:
        """Return the true pose of the base at an instant of the last quarter of a second, between ticks by equal shares of their motion."""
        after = next((k for k, (t, _) in enumerate(self.history) if t >= elapsed_ns), len(self.history) - 1)
        (t1, b), (t0, a) = self.history[after], self.history[max(after - 1, 0)]
        if t1 == t0 or elapsed_ns >= t1:
            return b
        step = a.to_se2().inverse() @ b.to_se2()
        return a @ SE3.from_se2(SE2.exp(step.log() * ((elapsed_ns - t0) / (t1 - t0))))

    def target(self, elapsed_ns: int) -> BodyVelocity:
        """Return what the physics shall do for a tick. While the wheels slip they turn for the whole, and the base moves a part of it."""
        if not self.posture.is_standing:
            self.controller.command(BodyVelocity(), elapsed_ns)
        wanted = self._wanted = self.controller.update(elapsed_ns, TICK)
        if not self.faults.has_slip:
            return wanted
        grip = self._grip = 1.0 - self.faults.slip(elapsed_ns * 1e-9)
        return BodyVelocity(wanted.vx * grip, wanted.vy * grip, wanted.wz * grip)

    def follow(self, carriage: Carriage, travel: tuple[float, ...], elapsed_ns: int) -> None:
        """Take what the physics made of the tick that ends now."""
        if self.faults.has_slip:
            moved = zip(self.travel, self._counted, travel, strict=True)
            self.travel = tuple(t + (b - a) / self._grip for t, a, b in moved)
        else:
            self.travel = travel
        self._counted = travel
        if self._gait is not None:
            self.lean = self._gait.update(self._wanted, TICK)
            if self._upright > 0.0:
                self.lean = self._straightened(carriage) @ self.lean
            if not self.posture.is_standing:
                self.lean = SE3((0.0, 0.0, -self.posture.update(TICK))) @ self.lean
        self.history.append((elapsed_ns, self._pose(carriage)))
        while self.history[0][0] < elapsed_ns - HISTORY_NS:
            self.history.popleft()

    def charge(self, *, has_power: bool) -> None:
        """Let the battery live through the tick that ends now."""
        speed = abs(self._wanted.vx) + abs(self._wanted.vy)
        self.battery.update(self._carriage.to_se2(), speed, TICK, has_power=has_power)

    def knots(self, frame: str, since_ns: int) -> tuple[F64, F64, F64]:
        """A sensor's poses from an instant until now: seconds after it, positions, quaternions (wxyz)."""
        mount = self.mounts[frame]
        knots = [(t, pose @ mount) for t, pose in self.history if t > since_ns - TICK_NS]
        times = np.array([t - since_ns for t, _ in knots]) * 1e-9
        return times, np.array([p.translation for _, p in knots]), np.array([p.rotation for _, p in knots])

    def hull(self, elapsed_ns: int, ago_ns: int) -> tuple[Solid, tuple[float, float]]:
        """Return the box that others' rays meet, and its velocity (m/s), for rays of the last `ago_ns`: where it was at their first,
        turned as it was in their middle. It is upright on slopes, too, from the height of the base on."""
        now, then = self.world_from_base.to_se2(), self.pose_at(elapsed_ns - ago_ns).to_se2()
        middle = self.pose_at(elapsed_ns - ago_ns // 2).to_se2()
        offset = SE2(0.0, 0.0, middle.yaw) @ self._hull.world_from_solid
        seconds = ago_ns * 1e-9
        rate = ((now.x - then.x) / seconds, (now.y - then.y) / seconds) if ago_ns > 0 else (0.0, 0.0)
        place = SE2(then.x + offset.x, then.y + offset.y, offset.yaw)
        ground = 0.0 if self._is_flat else self._carriage.position[2]
        return Solid(self.name, Shape.BOX, place, *_sizes(self._hull, ground), self._hull.albedo), rate

    def _straightened(self, carriage: Carriage) -> SE3:
        """What legs take back of the ground's tilt, about the point on the ground."""
        level = SE3.from_se2(SE2(0.0, 0.0, carriage.to_se2().yaw))
        tilt = level.inverse() @ SE3((0.0, 0.0, 0.0), carriage.rotation)
        return SE3((0.0, 0.0, 0.0), SE3().interpolate(tilt.inverse(), self._upright).rotation)

    def _pose(self, carriage: Carriage) -> SE3:
        self._carriage = carriage
        pose = SE3(carriage.position, carriage.rotation)
        return pose if self._gait is None else pose @ self.lean


def _sizes(solid: Solid, ground: float) -> tuple[float, float, float, float]:
    return (solid.size_x, solid.size_y, ground + solid.z_min, ground + solid.z_max)


def _hull_of(name: str, robot: SimRobot) -> Solid:
    """The box around a robot as others see it, in its base frame. It reaches over its own scanners, as if a band of cloth hung there
    that only others see: robots of one kind shall see each other."""
    low, high = robot.model.footprint.min(axis=0), robot.model.footprint.max(axis=0)
    (x, y), (length, width) = (0.5 * (low + high)).tolist(), (high - low).tolist()
    return Solid(name, Shape.BOX, SE2(x, y, 0.0), length, width, robot.body_bottom, robot.visible_height, 0.5)
