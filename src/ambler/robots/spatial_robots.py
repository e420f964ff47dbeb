"""Robots for three dimensions, each with a Livox Mid-360 and the inertial unit inside it: `mecanum`, `go2` and `g1`.

Bodies, masses and limits are of the classes of the CMU mecanum platform, the Unitree Go2 (0.70 x 0.31 x 0.40 m standing, 15 kg) and the
Unitree G1 (1.32 x 0.45 x 0.20 m, 35 kg); speeds are those of careful driving, not what a sheet promises.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.robot import DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.robots.description import Chassis, RobotDescription
from ambler.robots.sensors import SCANNERS

LIDAR_FRAME, IMU_FRAME = "livox", "imu"
LIDAR_FROM_IMU = SE3(
    (0.011, 0.02329, -0.04412)
)  # Livox, Mid-360 user manual: the unit's place in the frame of the points
TILT = math.radians(
    28.0
)  # forwards and down, as the original deployment has it on its Go2: the ground ahead comes into view


def mecanum() -> RobotDescription:
    """A low platform on four wheels of 15 cm, its LiDAR level on a short mast."""
    limits = VelocityLimits(vx_max=1.5, vx_min=-0.8, vy_max=0.8, wz_max=1.4, ax_max=1.2, ay_max=1.2, az_max=2.5)
    model = RobotModel(
        name="mecanum",
        drive=DriveKind.OMNI,
        footprint=_rectangle(0.60, 0.50),
        limits=replace(limits, ax_brake=1.5, ay_brake=1.5),
        sensors=_mid_360((0.0, 0.0, 0.62), 0.0),
        body_height=0.30,
    )
    return RobotDescription(model, Chassis(body_bottom=0.05, wheel_radius=0.076, track=0.44, wheel_base=0.40))


def go2() -> RobotDescription:
    """A walking base of the Go2's size with its LiDAR over the shoulders, tilted forwards."""
    limits = VelocityLimits(vx_max=1.5, vx_min=-0.5, vy_max=0.5, wz_max=1.5, ax_max=1.5, ay_max=1.5, az_max=3.0)
    model = RobotModel(
        name="go2",
        drive=DriveKind.OMNI,
        footprint=_rectangle(0.70, 0.31),
        limits=replace(limits, ax_brake=1.8, ay_brake=1.8),
        sensors=_mid_360((0.18, 0.0, 0.47), TILT),
        body_height=0.40,
    )
    return RobotDescription(model, Chassis(body_bottom=0.10))


def g1() -> RobotDescription:
    """A walker on two legs of the G1's size with its LiDAR in the head, tilted forwards."""
    limits = VelocityLimits(vx_max=1.2, vx_min=-0.4, vy_max=0.4, wz_max=1.2, ax_max=1.0, ay_max=1.0, az_max=2.5)
    model = RobotModel(
        name="g1",
        drive=DriveKind.OMNI,
        footprint=_rectangle(0.40, 0.46),
        limits=replace(limits, ax_brake=1.5, ay_brake=1.5),
        sensors=_mid_360((0.06, 0.0, 1.26), math.radians(20.0)),
        body_height=1.22,
    )
    return RobotDescription(model, Chassis(body_bottom=0.10))


def tilted(model: RobotModel) -> RobotModel:
    """Return the robot with its Mid-360, and the unit inside it, tilted forwards as on the `go2`; raises KeyError without one."""
    x, y, z = model.sensor(LIDAR_FRAME).base_from_sensor.translation
    moved = {mount.frame: mount for mount in _mid_360((x, y, z), TILT)}
    return replace(model, sensors=tuple(moved.get(mount.frame, mount) for mount in model.sensors))


def _rectangle(length: float, width: float) -> NDArray[np.float64]:
    return np.asarray(0.5 * np.array([[length, -width], [length, width], [-length, width], [-length, -width]]))


def _mid_360(place: tuple[float, float, float], pitch: float) -> tuple[SensorMount, SensorMount]:
    base_from_lidar = SE3.from_rpy(place, 0.0, pitch, 0.0)
    return (
        SCANNERS["mid_360"].mount(LIDAR_FRAME, base_from_lidar),
        SensorMount(IMU_FRAME, SensorKind.IMU, base_from_lidar @ LIDAR_FROM_IMU),
    )
