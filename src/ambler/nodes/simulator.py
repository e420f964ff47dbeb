"""The simulator as a device: a timer steps the world, measurements leave when a real sensor would have sent them."""

from __future__ import annotations

from collections.abc import Callable

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.protocols import BodyVelocity
from ambler.runtime import topics
from ambler.runtime.node import Node
from ambler.runtime.tasks import CAMERA_PICTURES, STOP_CHARGING, Nothing, PicturesRequest
from ambler.sim.simulation import Simulation
from ambler.sim.truth import truth_grid

STEP_PERIOD = 0.01
CAMERA_LATENCY = 0.04
MAP_RESOLUTION = 0.05


class SimulatorNode(Node):
    """Publishes sensors, the wheels' odometry, mounts and ground truth of a `Simulation`; drives it with the velocity command.

    In a world with docks it tells the battery, and takes pictures while a lease of `camera_pictures` lasts.
    The scans of one planar scanner go to `scan`, those of several to `scanners`, from where the merger takes them.
    """

    name = "simulator"
    inputs = (topics.VELOCITY_COMMAND,)
    outputs = (
        topics.SCAN,
        topics.CLOUD,
        topics.RANGES,
        topics.IMU,
        topics.WHEEL_ODOMETRY,
        topics.STATIC_TRANSFORMS,
        topics.TRUE_POSE,
        topics.CONTACT,
        topics.TRUE_MAP,
    )
    latency = 1e-6

    def __init__(self, simulation: Simulation, calibration: CameraModel | None = None) -> None:
        """`calibration`: what the camera is said to be, in place of what it is."""
        self._simulation = simulation
        self._calibration = calibration
        self._transport = max(spec.latency for spec in simulation.robot.lidars.values())
        self._echo = max((spec.latency for spec in simulation.robot.ultrasonics.values()), default=0.0)
        self._scan_topic = topics.SCAN if len(simulation.robot.model.scanners) <= 1 else topics.SCANNERS
        camera = (topics.IMAGE, topics.CAMERA_INFO) if simulation.camera is not None else ()
        battery = (topics.BATTERY,) if simulation.battery is not None else ()
        sensors = tuple(self._scan_topic if t is topics.SCAN else t for t in type(self).outputs)
        self.outputs = (*sensors, *camera, *battery)
        pictures = (CAMERA_PICTURES,) if camera else ()
        self.serves = (*pictures, *((STOP_CHARGING,) if battery else ()))
        self._pictures_until_ns = self._next_picture_ns = 0

    def start(self) -> None:
        self._simulation.start_at(self.ctx.now_ns)
        self.ctx.subscribe(topics.VELOCITY_COMMAND, self._on_command)
        self._publish_mounts()
        self._publish_true_map()
        if self._simulation.camera is not None:
            camera = self._simulation.camera
            info = m.CameraInfo(self.ctx.now_ns, camera.mount.frame, self._calibration or camera.spec.model)
            self.ctx.publish(topics.CAMERA_INFO, info)
            self.ctx.serve(CAMERA_PICTURES, self._on_pictures)
        if self._simulation.battery is not None:
            self.ctx.serve(STOP_CHARGING, self._on_stop_charging)
        self.ctx.timer(STEP_PERIOD, self._step)

    def _on_command(self, command: m.VelocityCommand) -> None:
        self._simulation.command(BodyVelocity(command.vx, command.vy, command.wz))

    def _on_pictures(self, request: PicturesRequest) -> Nothing:
        self._pictures_until_ns = self.ctx.now_ns + round(request.seconds * 1e9)
        return Nothing()

    def _on_stop_charging(self, request: Nothing) -> Nothing:
        if self._simulation.battery is not None:
            self._simulation.battery.stop_charging()
        return Nothing()

    def _step(self) -> None:
        out = self._simulation.step(self.ctx.now_ns)
        for imu in out.imus:
            self.ctx.publish(topics.IMU, imu)
        for odometry in out.odometry:
            self.ctx.publish(topics.WHEEL_ODOMETRY, odometry)
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
        for battery in out.batteries:
            self.ctx.publish(topics.BATTERY, battery)
        self._take_picture()

    def _take_picture(self) -> None:
        """Pictures cost much and are taken only while somebody wants them."""
        camera, now_ns = self._simulation.camera, self.ctx.now_ns
        if camera is None or now_ns > self._pictures_until_ns or now_ns < self._next_picture_ns:
            return
        self._next_picture_ns = now_ns + round(1e9 / camera.spec.rate_hz)
        self.ctx.after(CAMERA_LATENCY, self._later(topics.IMAGE, self._simulation.take_picture()))

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
