"""The built-in robots: `diff`, a two-wheeled base with a 360° scanner, `porter`, the same with shelves, `spot`, a walking base with a VLP-16, `amr_omni`, an
industrial base on mecanum wheels with three safety scanners, and those of `robots.spatial_robots`; and any robot by its name or its URDF
file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.robot import MERGED_FRAME, DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.robots.depth import with_depth_cameras
from ambler.robots.description import Chassis, RobotDescription
from ambler.robots.ring import with_transducer_ring
from ambler.robots.sensors import SCANNERS
from ambler.robots.spatial_robots import g1, go2, mecanum, tilted
from ambler.robots.urdf import read_robot

ULTRASONIC, TILTED, DEPTH = "ultrasonic", "tilted", "depth"
OPTIONS = (ULTRASONIC, TILTED, DEPTH)


def robot_names() -> tuple[str, ...]:
    """Return the names of the built-in robots."""
    return tuple(_MAKERS)


def split_options(name: str) -> tuple[str, frozenset[str]]:
    """Split `NAME+ultrasonic+depth` and the like into the name and its options (`OPTIONS`); raises BadInputError for others, and for a tilt of
    what is not a level Mid-360."""
    base, *options = name.split("+")
    for option in options:
        if option not in OPTIONS:
            raise BadInputError(
                f"robot {name!r}: no option {option!r}; there are +ultrasonic, as in diff+ultrasonic, +tilted, and +depth"
            )
    if TILTED in options and base != "mecanum":
        raise BadInputError(f"robot {name!r}: only mecanum has a level Mid-360 that could be tilted")
    return base, frozenset(options)


def is_urdf(name: str) -> bool:
    """Tell whether a robot's name is that of a URDF file."""
    return name.endswith((".urdf", ".xml"))


def robot_model(name: str) -> RobotModel:
    """Return a robot's model by its name, or from a URDF file; `+ultrasonic` after it adds a ring of transducers, `+depth` depth cameras, `+tilted`
    tilts the LiDAR of `mecanum`. Raises BadInputError with the known names."""
    base, options = split_options(name)
    model = read_robot(Path(base)).description.model if is_urdf(base) else robot_description(base).model
    model = tilted(model) if TILTED in options else model
    model = with_depth_cameras(model) if DEPTH in options else model
    return with_transducer_ring(model) if ULTRASONIC in options else model


def robot_description(name: str) -> RobotDescription:
    """Return a built-in robot; raises BadInputError with the known names."""
    if name not in _MAKERS:
        raise BadInputError(f"no robot {name!r}; there are {', '.join(robot_names())}, or give a .urdf file")
    return _MAKERS[name]()


def _diff() -> RobotDescription:
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
        limits=VelocityLimits(vx_max=0.8, vx_min=-0.3, wz_max=1.5, ax_max=1.0, az_max=2.5, ax_brake=1.5, ax_stop=3.5),
        sensors=(
            SCANNERS["scanner_360"].mount("laser", SE3((0.08, 0.0, 0.28))),
            SensorMount("imu", SensorKind.IMU, SE3((-0.05, 0.0, 0.12))),
        ),
        body_height=0.25,
    )
    return RobotDescription(model, Chassis(body_bottom=0.05, wheel_radius=0.09, track=0.34))


def _porter() -> RobotDescription:
    """A base like `diff` that carries shelves to 1.15 m, as robots that serve hospitals and hotels do: table tops and signs meet it high
    above its scanner. It brakes gently, being tall."""
    low = _diff().model
    limits = VelocityLimits(vx_max=0.7, vx_min=-0.2, wz_max=1.2, ax_max=0.7, az_max=2.0, ax_brake=1.0, ax_stop=2.0)
    model = replace(low, name="porter", limits=limits, body_height=1.15)
    return RobotDescription(model, Chassis(body_bottom=0.05, wheel_radius=0.09, track=0.34))


def _spot() -> RobotDescription:
    limits = VelocityLimits(vx_max=0.8, vx_min=-0.4, vy_max=0.4, wz_max=1.2)
    model = RobotModel(
        name="spot",
        drive=DriveKind.OMNI,
        footprint=np.array([[0.55, -0.25], [0.55, 0.25], [-0.55, 0.25], [-0.55, -0.25]]),
        limits=replace(limits, ax_max=1.0, ay_max=1.0, az_max=2.5, ax_brake=1.5, ay_brake=1.5),
        sensors=(
            SCANNERS["vlp_16"].mount("velodyne", SE3((-0.10, 0.0, 0.78))),
            SensorMount("imu", SensorKind.IMU, SE3((0.0, 0.0, 0.50))),
        ),
        body_height=0.65,
    )
    return RobotDescription(model, Chassis(body_bottom=0.08))


def _amr_omni() -> RobotDescription:
    """1.2 x 0.8 m. As in source 002, §4.2.1, scanners sit at the corners of the body; 264 of their 270 degrees are used, from 1 to
    265 degrees after the first beam, which runs along the robot's side (mirrored on the front left)."""
    first, last = math.radians(1.0 - 135.0), math.radians(265.0 - 135.0)
    corners = {
        "front_right": (0.6, -0.4, -45.0, (first, last)),
        "front_left": (0.6, 0.4, 45.0, (-last, -first)),
        "rear_left": (-0.6, 0.4, 135.0, (first, last)),
    }
    scanners = (
        SCANNERS["safety_270"].mount(frame, SE3.from_rpy((x, y, 0.18), 0.0, 0.0, math.radians(yaw)), window)
        for frame, (x, y, yaw, window) in corners.items()
    )
    ahead = SE3.from_rpy((0.58, 0.0, 0.32), -0.5 * math.pi, 0.0, -0.5 * math.pi)
    limits = VelocityLimits(vx_max=1.0, vx_min=-0.4, vy_max=0.5, wz_max=1.0)
    model = RobotModel(
        name="amr_omni",
        drive=DriveKind.OMNI,
        footprint=np.array([[0.6, -0.4], [0.6, 0.4], [-0.6, 0.4], [-0.6, -0.4]]),
        limits=replace(limits, ax_max=0.8, ay_max=0.8, az_max=1.5, ax_brake=1.2, ay_brake=1.2),
        sensors=(
            *scanners,
            SensorMount(MERGED_FRAME, SensorKind.SCAN, SE3((0.0, 0.0, 0.18))),
            SensorMount("imu", SensorKind.IMU, SE3((0.0, 0.0, 0.15))),
            SensorMount("camera", SensorKind.CAMERA, ahead),
        ),
        body_height=0.35,
    )
    return RobotDescription(model, Chassis(body_bottom=0.04, wheel_radius=0.1, track=0.6, wheel_base=0.8))


_MAKERS: dict[str, Callable[[], RobotDescription]] = {
    "diff": _diff,
    "spot": _spot,
    "amr_omni": _amr_omni,
    "porter": _porter,
    "mecanum": mecanum,
    "go2": go2,
    "g1": g1,
}
