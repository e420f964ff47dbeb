"""One robot alone in a world, stepped from outside without nodes: for measurements, examples and tests.

Truth is told in the frame `world`; `start_from_base` is the same in the frame of the robot's start.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ambler.core import messages as m
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.devices import SimulatedCamera, SimulatedDevice
from ambler.sim.ground_truth import GroundTruth
from ambler.sim.robot_devices import robot_devices
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec
from ambler.sim.world import BodySpec, SimulationConfig, World

__all__ = ["Simulation", "SimulationConfig", "SimulationOutput"]

NAME = "robot"


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
    images: list[m.Image] = field(default_factory=list)


class Simulation:
    """A world with one robot, whose devices are all open. Transport takes no time here: a step returns what was measured in it."""

    def __init__(
        self,
        world: WorldSpec,
        robot: SimRobot,
        config: SimulationConfig | None = None,
        start: SE2 | None = None,
        begin_ns: int = 0,
    ) -> None:
        self.running = World(world, [BodySpec(NAME, robot, start)], config)
        self.world, self.config = self.running.spec, self.running.config
        (self.body,) = self.running.bodies
        self.robot, self.battery = self.body.robot, self.body.battery
        self.devices = robot_devices(self.running, NAME)
        self.truth = GroundTruth(self.running, self.body)
        self.camera = next((c for c in self.devices.cameras if isinstance(c, SimulatedCamera)), None)
        d = self.devices
        parts = (d.base, *d.lidars, *d.imus, *d.ranges, *d.cameras, *d.depth_cameras, d.battery, self.truth)
        self._parts = [part for part in parts if isinstance(part, SimulatedDevice)]
        for part in self._parts:
            part.open()
        self.running.advance(begin_ns)

    @property
    def now_ns(self) -> int:
        """Time up to which the world has been simulated."""
        return self.running.now_ns

    @property
    def world_from_base(self) -> SE3:
        """The true pose of the base now."""
        return self.body.world_from_base

    @property
    def start_from_base(self) -> SE3:
        """The true pose of the base now in the frame of its start."""
        return SE3.from_se2(self.body.start).inverse() @ self.body.world_from_base

    def pose_at(self, stamp_ns: int) -> SE3:
        """The true pose of the base at an instant of the last quarter of a second."""
        return self.body.pose_at(stamp_ns - self.running.start_ns)

    def command(self, command: BodyVelocity) -> None:
        """Give the base a command; without a new one for `watchdog` seconds it stops by itself."""
        self.devices.base.command(command)

    def step(self, until_ns: int) -> SimulationOutput:
        """Advance by whole ticks, not beyond `until_ns`; returns what was measured and what truly happened."""
        self.running.sense_start()
        self.running.advance(until_ns)
        out = SimulationOutput()
        lists: dict[type, list[Any]] = {
            m.LaserScan: out.scans,
            m.PointCloud: out.clouds,
            m.Range: out.ranges,
            m.Imu: out.imus,
            m.Contact: out.contacts,
            m.BatteryState: out.batteries,
            m.Image: out.images,
        }
        for part in self._parts:
            odometry = out.true_poses if part is self.truth else out.odometry
            for message in part.take(self.running.now_ns):
                lists.get(type(message), odometry).append(message)
        for several in (out.scans, out.clouds, out.ranges, out.imus):
            several.sort(key=lambda message: int(message.stamp_ns))  # several devices
        return out

    def take_picture(self) -> m.Image:
        """Return what the camera sees now, stamped in the middle of its exposure; raises RuntimeError without a camera."""
        if self.camera is None:
            raise RuntimeError("the robot has no camera")
        return self.camera.take_picture()
