"""A robot with everything that the simulator must know and its algorithms need not."""

from __future__ import annotations

from dataclasses import dataclass, field

from ambler.core.robot import RobotModel
from ambler.sim.camera import CameraSpec
from ambler.sim.sensors import DepthCameraSpec, GaitSpec, ImuSpec, LidarSpec, OdometrySpec, UltrasonicSpec


@dataclass(frozen=True)
class SimRobot:
    """`lidars`, `imus`, `ultrasonics`, `cameras` and `depth_cameras` map sensor frames of the model to what sits there.

    `wheel_radius` (0: legs) and `track` describe driven wheels; with a `wheel_base` (distance of the axles) there are four
    mecanum wheels, else two. `strafe_loss` is the share of a sideways motion that the rollers lose and the encoders count.
    Odometry and command refer to the base frame, which stands on the floor below the body and leans with it.
    """

    model: RobotModel
    lidars: dict[str, LidarSpec]
    imus: dict[str, ImuSpec]
    odometry: OdometrySpec
    mass: float
    body_bottom: float
    wheel_radius: float = 0.0
    track: float = 0.0
    wheel_base: float = 0.0
    strafe_loss: float = 0.0
    gait: GaitSpec | None = None
    watchdog: float = 0.5
    ultrasonics: dict[str, UltrasonicSpec] = field(default_factory=dict)
    cameras: dict[str, CameraSpec] = field(default_factory=dict)
    depth_cameras: dict[str, DepthCameraSpec] = field(default_factory=dict)

    @property
    def sensor_height(self) -> float:
        """Height of the main scanner above the floor, metres: where the ground-truth map cuts the world."""
        return self.model.sensor(next(iter(self.lidars))).base_from_sensor.translation[2]

    @property
    def visible_height(self) -> float:
        """Height up to which other robots' rays meet it, metres: over its body, and a little over its own scanners."""
        tops = [self.model.sensor(frame).base_from_sensor.translation[2] + 0.05 for frame in self.lidars]
        return max(self.model.body_height, *tops) if tops else self.model.body_height

    @property
    def faulty_frames(self) -> tuple[str, ...]:
        """What can fail to send: scanners, then transducers, then depth cameras."""
        return (*self.lidars, *self.ultrasonics, *self.depth_cameras)

    @property
    def has_two_wheels(self) -> bool:
        return self.wheel_radius > 0 and self.wheel_base == 0

    @property
    def has_mecanum_wheels(self) -> bool:
        return self.wheel_radius > 0 and self.wheel_base > 0
