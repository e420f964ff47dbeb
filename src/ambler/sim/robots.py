"""The simulated robots: `diff`, a two-wheeled base with a 360° scanner, and `spot`, a walking base with a VLP-16."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.robot import DriveKind, RobotModel, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.sim.sensors import (
    LEG_ODOMETRY,
    MEMS_IMU,
    SCANNER_360,
    VLP_16,
    WHEEL_ODOMETRY,
    GaitSpec,
    ImuSpec,
    LidarSpec,
    OdometrySpec,
)


@dataclass(frozen=True)
class SimRobot:
    """A robot with everything the simulator must know and its algorithms need not.

    `lidars` maps sensor frames of the model to scanners; `wheel_radius`, `track` describe driven wheels (0: legs). Odometry
    and command refer to the base frame, which stands on the floor below the body and leans with it.
    """

    model: RobotModel
    lidars: dict[str, LidarSpec]
    imu: ImuSpec
    odometry: OdometrySpec
    mass: float
    body_bottom: float
    wheel_radius: float = 0.0
    track: float = 0.0
    gait: GaitSpec | None = None
    watchdog: float = 0.5

    @property
    def sensor_height(self) -> float:
        """Height of the main scanner above the floor, metres: where the ground-truth map cuts the world."""
        return self.model.sensor(next(iter(self.lidars))).base_from_sensor.translation[2]


def robot_names() -> tuple[str, ...]:
    """Return the names of the simulated robots."""
    return ("diff", "spot")


def robot_named(name: str) -> SimRobot:
    """Return a simulated robot; raises BadInputError with the known names."""
    if name == "diff":
        return _diff()
    if name == "spot":
        return _spot()
    raise BadInputError(f"no simulated robot {name!r}; there are {', '.join(robot_names())}")


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
            SensorMount("laser", "scan", SE3((0.08, 0.0, 0.28)), range_min=SCANNER_360.range_min),
            SensorMount("imu", "imu", SE3((-0.05, 0.0, 0.12))),
        ),
        body_height=0.25,
    )
    return SimRobot(
        model,
        lidars={"laser": SCANNER_360},
        imu=MEMS_IMU,
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
                "cloud",
                SE3((-0.10, 0.0, 0.78)),
                range_min=VLP_16.range_min,
                elevation=(VLP_16.elevations[0], VLP_16.elevations[-1]),
            ),
            SensorMount("imu", "imu", SE3((0.0, 0.0, 0.50))),
        ),
        body_height=0.65,
    )
    return SimRobot(
        model,
        lidars={"velodyne": VLP_16},
        imu=MEMS_IMU,
        odometry=LEG_ODOMETRY,
        mass=35.0,
        body_bottom=0.08,
        gait=GaitSpec(),
    )
