"""The simulated robots: those of `robots.catalog`, or of URDF files, with the noise of their sensors, their mass and their gait."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ambler.core.robot import RobotModel
from ambler.robots.catalog import DEPTH, TILTED, ULTRASONIC, is_urdf, robot_description, robot_names, split_options
from ambler.robots.spatial_robots import IMU_FRAME, LIDAR_FRAME, tilted
from ambler.sim.camera import CameraSpec
from ambler.sim.depth_camera import with_simulated_depth_cameras
from ambler.sim.sensors import (
    HUMANOID,
    ICM_40609,
    LEG_ODOMETRY,
    MEMS_IMU,
    MEMS_IMU_200,
    MID_360,
    SAFETY_270,
    SCANNER_360,
    TROT,
    VLP_16,
    WHEEL_ODOMETRY,
    GaitSpec,
)
from ambler.sim.sim_robot import SimRobot
from ambler.sim.ultrasonic import with_ultrasonic_ring
from ambler.sim.urdf import load_urdf

__all__ = ["SimRobot", "robot_named", "robot_names"]


def robot_named(name: str) -> SimRobot:
    """Return a simulated robot by its name, or from a URDF file; `+ultrasonic` after it adds a ring of transducers, `+depth` depth cameras,
    `+tilted` tilts the LiDAR of `mecanum`.

    Raises BadInputError with the known names.
    """
    base, options = split_options(name)
    robot = load_urdf(Path(base)) if is_urdf(base) else _built_in(base)
    robot = replace(robot, model=tilted(robot.model)) if TILTED in options else robot
    robot = with_simulated_depth_cameras(robot) if DEPTH in options else robot
    return with_ultrasonic_ring(robot) if ULTRASONIC in options else robot


def _built_in(name: str) -> SimRobot:
    described = robot_description(name)
    model, chassis = described.model, asdict(described.chassis)
    if name in ("diff", "porter"):
        mass = 30.0 if name == "diff" else 45.0
        return SimRobot(model, {"laser": SCANNER_360}, {"imu": MEMS_IMU}, WHEEL_ODOMETRY, mass=mass, **chassis)
    if name == "spot":
        lidars = {"velodyne": VLP_16}
        return SimRobot(model, lidars, {"imu": MEMS_IMU}, LEG_ODOMETRY, mass=35.0, gait=GaitSpec(), **chassis)
    if name in ("mecanum", "go2", "g1"):
        return _with_mid_360(name, model, chassis)
    # The scanners turn on their own: nobody starts them together.
    phases = {"front_right": 0.0, "front_left": 0.025, "rear_left": 0.055}
    return SimRobot(
        model,
        lidars={frame: replace(SAFETY_270, phase=phase) for frame, phase in phases.items()},
        imus={"imu": MEMS_IMU_200},
        odometry=WHEEL_ODOMETRY,
        mass=150.0,
        strafe_loss=0.03,
        cameras={"camera": CameraSpec(rate_hz=12.5, exposure=0.005, samples=2)},
        **chassis,
    )


def _with_mid_360(name: str, model: RobotModel, chassis: dict[str, Any]) -> SimRobot:
    lidars, imus = {LIDAR_FRAME: MID_360}, {IMU_FRAME: ICM_40609}
    if name == "mecanum":
        return SimRobot(model, lidars, imus, WHEEL_ODOMETRY, mass=25.0, strafe_loss=0.03, **chassis)
    gait, mass = (TROT, 15.0) if name == "go2" else (HUMANOID, 35.0)
    return SimRobot(model, lidars, imus, LEG_ODOMETRY, mass=mass, gait=gait, **chassis)
