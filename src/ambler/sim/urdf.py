"""Simulated robots from URDF files: what `robots.urdf` reads, and the noise, mass and gait that only a simulator needs."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element

from ambler.core.errors import BadInputError
from ambler.robots.urdf import imu_elements, override, read_robot, scalar, spec_of
from ambler.robots.urdf_tree import UrdfTree, label
from ambler.sim.camera import FRONT_CAMERA, CameraSpec, PictureNoise
from ambler.sim.sensors import (
    D430,
    HUMANOID,
    ICM_40609,
    LEG_ODOMETRY,
    MEMS_IMU,
    MEMS_IMU_200,
    MID_360,
    OS_64,
    SAFETY_270,
    SCANNER_360,
    TRANSDUCER_30,
    TROT,
    VLP_16,
    WHEEL_ODOMETRY,
    DepthCameraSpec,
    GaitSpec,
    ImuSpec,
    LidarSpec,
    OdometrySpec,
    UltrasonicSpec,
)
from ambler.sim.sim_robot import SimRobot

T = TypeVar("T")

LIDARS: dict[str, LidarSpec] = {
    "scanner_360": SCANNER_360,
    "safety_270": SAFETY_270,
    "vlp_16": VLP_16,
    "os_64": OS_64,
    "mid_360": MID_360,
}
IMUS: dict[str, ImuSpec] = {"mems": MEMS_IMU, "mems_200": MEMS_IMU_200, "icm_40609": ICM_40609}
ULTRASONICS: dict[str, UltrasonicSpec] = {"transducer_30": TRANSDUCER_30}
DEPTH_CAMERAS: dict[str, DepthCameraSpec] = {"d430": D430}
ODOMETRIES: dict[str, OdometrySpec] = {"wheels": WHEEL_ODOMETRY, "legs": LEG_ODOMETRY}
GAITS: dict[str, GaitSpec] = {"trot": GaitSpec(), "small_trot": TROT, "two_legs": HUMANOID}


def load_urdf(path: Path) -> SimRobot:
    """Load a robot; raises BadInputError in one sentence that names the file and the element."""
    read = read_robot(path)
    tree, extension, chassis = read.tree, read.extension, read.description.chassis
    odometry, gait = extension.find("odometry"), extension.find("gait")

    def named(tag: str) -> dict[str, Element]:
        return {e.get("link", ""): e for e in extension.findall(tag)}

    return SimRobot(
        read.description.model,
        {name: spec_of(tree, e, LIDARS, "scanner_360") for name, e in named("lidar").items()},
        {e.get("link", ""): spec_of(tree, e, IMUS, "mems") for e in imu_elements(extension)},
        spec_of(
            tree,
            odometry if odometry is not None else Element("odometry"),
            ODOMETRIES,
            "wheels" if chassis.wheel_radius > 0 else "legs",
        ),
        read.mass,
        **asdict(chassis),
        strafe_loss=scalar(tree, extension, "strafe_loss", 0.0),
        gait=spec_of(tree, gait, GAITS, "trot") if gait is not None else None,
        watchdog=scalar(tree, extension, "watchdog", 0.5),
        ultrasonics={n: spec_of(tree, e, ULTRASONICS, "transducer_30") for n, e in named("ultrasonic").items()},
        cameras={name: _camera(tree, e) for name, e in named("camera").items()},
        depth_cameras={n: spec_of(tree, e, DEPTH_CAMERAS, "d430") for n, e in named("depth").items()},
    )


def _camera(tree: UrdfTree, element: Element) -> CameraSpec:
    """Return the camera; values of its lens and of its picture's noise are attributes of the element, too."""
    rest = Element(element.tag, element.attrib)

    def taken(default: T) -> T:
        names = {f.name for f in fields(default)} - {"name"}  # type: ignore[arg-type]
        own = {key: rest.attrib.pop(key) for key in list(rest.attrib) if key in names}
        return override(tree, Element(element.tag, own), default)

    try:
        lens, noise = taken(FRONT_CAMERA), taken(PictureNoise())
    except ValueError as error:
        raise BadInputError(f"{tree.path}: {label(element)}: {error}") from None
    return replace(override(tree, rest, CameraSpec()), model=lens, picture=noise)
