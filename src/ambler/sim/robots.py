"""The simulated robots: `diff`, a two-wheeled base with a 360° scanner, `spot`, a walking base with a VLP-16, and `amr_omni`, an
industrial base on mecanum wheels with three safety scanners."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.robot import MERGED_FRAME, DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.sim.camera import CameraSpec
from ambler.sim.sensors import (
    LEG_ODOMETRY,
    MEMS_IMU,
    MEMS_IMU_200,
    SAFETY_270,
    SCANNER_360,
    VLP_16,
    WHEEL_ODOMETRY,
    GaitSpec,
)
from ambler.sim.sim_robot import SimRobot
from ambler.sim.ultrasonic import with_ultrasonic_ring
from ambler.sim.urdf import load_urdf

__all__ = ["SimRobot", "robot_named", "robot_names"]


def robot_names() -> tuple[str, ...]:
    """Return the names of the simulated robots."""
    return ("diff", "spot", "amr_omni")


def robot_named(name: str) -> SimRobot:
    """Return a simulated robot by its name, or from a URDF file; `+ultrasonic` after it adds a ring of transducers.

    Raises BadInputError with the known names.
    """
    base, plus, option = name.partition("+")
    if plus:
        if option != "ultrasonic":
            raise BadInputError(f"robot {name!r}: no option {option!r}; there is +ultrasonic, as in diff+ultrasonic")
        return with_ultrasonic_ring(robot_named(base))
    if name.endswith((".urdf", ".xml")):
        return load_urdf(Path(name))
    if name == "diff":
        return _diff()
    if name == "spot":
        return _spot()
    if name == "amr_omni":
        return _amr_omni()
    raise BadInputError(f"no simulated robot {name!r}; there are {', '.join(robot_names())}, or give a .urdf file")


def _diff() -> SimRobot:
    corner, half_x, half_y = 0.06, 0.25, 0.20
    inner_x, inner_y = half_x - corner, half_y - corner
    quadrant = [(half_x, inner_y), (inner_x, half_y)]
    footprint = [
        *quadrant,
        *[(-x, y) for x, y in reversed(quadrant)],
        *[(-x, -y) for x, y in quadrant],
        *[(x, -y) for x, y in reversed(quadrant)],
    ]
    model = RobotModel(
        name="diff",
        drive=DriveKind.DIFFERENTIAL,
        footprint=np.array(footprint),
        limits=VelocityLimits(vx_max=0.8, vx_min=-0.3, wz_max=1.5, ax_max=1.0, az_max=2.5, ax_brake=1.5),
        sensors=(
            SensorMount("laser", SensorKind.SCAN, SE3((0.08, 0.0, 0.28)), range_min=SCANNER_360.range_min),
            SensorMount("imu", SensorKind.IMU, SE3((-0.05, 0.0, 0.12))),
        ),
        body_height=0.25,
    )
    return SimRobot(
        model,
        lidars={"laser": SCANNER_360},
        imus={"imu": MEMS_IMU},
        odometry=WHEEL_ODOMETRY,
        mass=30.0,
        body_bottom=0.05,
        wheel_radius=0.09,
        track=0.34,
    )


def _spot() -> SimRobot:
    model = RobotModel(
        name="spot",
        drive=DriveKind.OMNI,
        footprint=np.array([[0.55, -0.25], [0.55, 0.25], [-0.55, 0.25], [-0.55, -0.25]]),
        limits=VelocityLimits(
            vx_max=0.8,
            vx_min=-0.4,
            vy_max=0.4,
            wz_max=1.2,
            ax_max=1.0,
            ay_max=1.0,
            az_max=2.5,
            ax_brake=1.5,
            ay_brake=1.5,
        ),
        sensors=(
            SensorMount(
                "velodyne",
                SensorKind.CLOUD,
                SE3((-0.10, 0.0, 0.78)),
                range_min=VLP_16.range_min,
                elevation=(VLP_16.elevations[0], VLP_16.elevations[-1]),
            ),
            SensorMount("imu", SensorKind.IMU, SE3((0.0, 0.0, 0.50))),
        ),
        body_height=0.65,
    )
    return SimRobot(
        model,
        lidars={"velodyne": VLP_16},
        imus={"imu": MEMS_IMU},
        odometry=LEG_ODOMETRY,
        mass=35.0,
        body_bottom=0.08,
        gait=GaitSpec(),
    )


def _amr_omni() -> SimRobot:
    """1.2 x 0.8 m. As in source 002, §4.2.1, scanners sit at the corners of the body; 264 of their 270 degrees are used, from 1 to
    265 degrees after the first beam, which runs along the robot's side (mirrored on the front left)."""
    first, last = math.radians(1.0 - 135.0), math.radians(265.0 - 135.0)
    corners = {
        "front_right": (0.6, -0.4, -45.0, (first, last)),
        "front_left": (0.6, 0.4, 45.0, (-last, -first)),
        "rear_left": (-0.6, 0.4, 135.0, (first, last)),
    }
    scanners = (
        SensorMount(
            frame,
            SensorKind.SCAN,
            SE3.from_rpy((x, y, 0.18), 0.0, 0.0, math.radians(yaw)),
            range_min=SAFETY_270.range_min,
            azimuth=window,
        )
        for frame, (x, y, yaw, window) in corners.items()
    )
    model = RobotModel(
        name="amr_omni",
        drive=DriveKind.OMNI,
        footprint=np.array([[0.6, -0.4], [0.6, 0.4], [-0.6, 0.4], [-0.6, -0.4]]),
        limits=VelocityLimits(
            vx_max=1.0,
            vx_min=-0.4,
            vy_max=0.5,
            wz_max=1.0,
            ax_max=0.8,
            ay_max=0.8,
            az_max=1.5,
            ax_brake=1.2,
            ay_brake=1.2,
        ),
        sensors=(
            *scanners,
            SensorMount(MERGED_FRAME, SensorKind.SCAN, SE3((0.0, 0.0, 0.18))),
            SensorMount("imu", SensorKind.IMU, SE3((0.0, 0.0, 0.15))),
            SensorMount(
                "camera", SensorKind.CAMERA, SE3.from_rpy((0.58, 0.0, 0.32), -0.5 * math.pi, 0.0, -0.5 * math.pi)
            ),
        ),
        body_height=0.35,
    )
    # The scanners turn on their own: nobody starts them together.
    phases = {"front_right": 0.0, "front_left": 0.025, "rear_left": 0.055}
    return SimRobot(
        model,
        lidars={frame: replace(SAFETY_270, phase=phase) for frame, phase in phases.items()},
        imus={"imu": MEMS_IMU_200},
        odometry=WHEEL_ODOMETRY,
        mass=150.0,
        body_bottom=0.04,
        wheel_radius=0.1,
        track=0.6,
        wheel_base=0.8,
        strafe_loss=0.03,
        cameras={"camera": CameraSpec(rate_hz=12.5, exposure=0.005, samples=2)},
    )
