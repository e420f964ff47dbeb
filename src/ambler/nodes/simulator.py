"""The simulator as a device: a timer steps the world, measurements leave when a real sensor would have sent them."""

from __future__ import annotations

from collections.abc import Callable

from ambler.core import messages as m
from ambler.core.protocols import BodyVelocity
from ambler.runtime import topics
from ambler.runtime.node import Node
from ambler.sim.simulation import Simulation
from ambler.sim.truth import truth_grid

STEP_PERIOD = 0.01
MAP_RESOLUTION = 0.05


class SimulatorNode(Node):
    """Publishes sensors, odometry, transforms and ground truth of a `Simulation`; drives it with the velocity command.

    The scans of one planar scanner go to `scan`, those of several to `scanners`, from where the merger takes them.
    """

    name = "simulator"
    inputs = (topics.VELOCITY_COMMAND,)
    outputs = (
        topics.SCAN,
        topics.CLOUD,
        topics.RANGES,
        topics.IMU,
        topics.ODOMETRY,
        topics.TRANSFORMS,
        topics.STATIC_TRANSFORMS,
        topics.TRUE_POSE,
        topics.CONTACT,
        topics.TRUE_MAP,
    )
    latency = 1e-6

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._transport = max(spec.latency for spec in simulation.robot.lidars.values())
        self._echo = max((spec.latency for spec in simulation.robot.ultrasonics.values()), default=0.0)
        self._scan_topic = topics.SCAN if len(simulation.robot.model.scanners) <= 1 else topics.SCANNERS
        self.outputs = tuple(self._scan_topic if t is topics.SCAN else t for t in type(self).outputs)  # type: ignore[assignment, misc]

    def start(self) -> None:
        self._simulation.start_at(self.ctx.now_ns)
        self.ctx.subscribe(topics.VELOCITY_COMMAND, self._on_command)
        self._publish_mounts()
        self._publish_true_map()
        self.ctx.timer(STEP_PERIOD, self._step)

    def _on_command(self, command: m.VelocityCommand) -> None:
        self._simulation.command(BodyVelocity(command.vx, command.vy, command.wz))

    def _step(self) -> None:
        out = self._simulation.step(self.ctx.now_ns)
        for imu in out.imus:
            self.ctx.publish(topics.IMU, imu)
        for odometry in out.odometry:
            self.ctx.publish(topics.ODOMETRY, odometry)
            edge = m.TransformStamped(odometry.stamp_ns, odometry.frame, odometry.child, odometry.pose)
            self.ctx.publish(topics.TRANSFORMS, m.Transforms(odometry.stamp_ns, (edge,)))
        for pose in out.true_poses:
            self.ctx.publish(topics.TRUE_POSE, pose)
        for contact in out.contacts:
            self.ctx.publish(topics.CONTACT, contact)
        for scan in out.scans:
            self.ctx.after(self._transport, self._later(self._scan_topic, scan))
        for cloud in out.clouds:
            self.ctx.after(self._transport, self._later(topics.CLOUD, cloud))

        for measured in out.ranges:
            self.ctx.after(self._echo, self._later(topics.RANGES, measured))

    def _later(self, topic: topics.Topic[topics.M], message: topics.M) -> Callable[[], None]:
        return lambda: self.ctx.publish(topic, message)

    def _publish_mounts(self) -> None:
        now = self.ctx.now_ns
        edges = (
            m.TransformStamped(now, "base", s.frame, s.base_from_sensor) for s in self._simulation.robot.model.sensors
        )
        self.ctx.publish(topics.STATIC_TRANSFORMS, m.Transforms(now, tuple(edges)))

    def _publish_true_map(self) -> None:
        simulation = self._simulation
        spec, data = truth_grid(simulation.world, simulation.robot.sensor_height, MAP_RESOLUTION)
        self.ctx.publish(topics.TRUE_MAP, m.OccupancyGrid(self.ctx.now_ns, "map", spec, data))
