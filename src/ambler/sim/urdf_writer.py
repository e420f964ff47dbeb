"""Writes a simulated robot as a URDF file that `sim.urdf` reads back to the same robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ambler.core.robot import SensorKind, VelocityLimits
from ambler.core.se3 import SE3
from ambler.sim.camera import FRONT_CAMERA, CameraSpec, PictureNoise
from ambler.sim.sim_robot import SimRobot
from ambler.sim.urdf import GAITS, IMUS, LIDARS, ODOMETRIES, ULTRASONICS
from ambler.wire.atomic_file import write_whole

WHEEL_WIDTH = 0.06


def save_urdf(robot: SimRobot, path: Path) -> None:
    """Write a robot: its body as a box around the footprint, wheels, a link per sensor, and the rest in `<ambler>`."""
    root = Element("robot", name=robot.model.name)
    _body(root, robot)
    _wheels(root, robot)
    for mount in robot.model.sensors:
        SubElement(root, "link", name=mount.frame)
        _joint(root, mount.frame, "fixed", mount.base_from_sensor)
    _extension(root, robot)
    ElementTree.indent(root)
    write_whole(path, ElementTree.tostring(root, encoding="unicode", xml_declaration=False) + "\n")


def _text(*values: float) -> str:
    return " ".join(repr(float(v)) for v in values)


def _body(root: Element, robot: SimRobot) -> None:
    low, high = robot.model.footprint.min(axis=0), robot.model.footprint.max(axis=0)
    (x, y), z = (0.5 * (low + high)).tolist(), 0.5 * (robot.body_bottom + robot.model.body_height)
    length, width = (high - low).tolist()
    height = robot.model.body_height - robot.body_bottom
    link = SubElement(root, "link", name="base_link")
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_text(x, y, z))
    SubElement(inertial, "mass", value=_text(robot.mass))
    k = robot.mass / 12.0
    moments = {
        "ixx": k * (width**2 + height**2),
        "iyy": k * (length**2 + height**2),
        "izz": k * (length**2 + width**2),
        **dict.fromkeys(("ixy", "ixz", "iyz"), 0.0),
    }
    SubElement(inertial, "inertia", {key: _text(value) for key, value in moments.items()})
    for tag in ("visual", "collision"):
        shape = SubElement(link, tag)
        SubElement(shape, "origin", xyz=_text(x, y, z))
        SubElement(SubElement(shape, "geometry"), "box", size=_text(length, width, height))


def _wheels(root: Element, robot: SimRobot) -> None:
    r, y, x = robot.wheel_radius, 0.5 * robot.track, 0.5 * robot.wheel_base
    places = {"wheel_left": (0.0, y), "wheel_right": (0.0, -y)} if robot.has_two_wheels else {}
    if robot.has_mecanum_wheels:
        places = {"wheel_fl": (x, y), "wheel_fr": (x, -y), "wheel_rl": (-x, y), "wheel_rr": (-x, -y)}
    for name, (wx, wy) in places.items():
        shape = SubElement(SubElement(root, "link", name=name), "visual")
        SubElement(shape, "origin", rpy=_text(0.5 * math.pi, 0.0, 0.0))
        SubElement(
            SubElement(shape, "geometry"),
            "cylinder",
            radius=_text(r),
            length=_text(min(WHEEL_WIDTH, 0.5 * robot.track)),
        )
        joint = _joint(root, name, "continuous", SE3((wx, wy, r)))
        SubElement(joint, "axis", xyz="0 1 0")


def _joint(root: Element, child: str, kind: str, pose: SE3) -> Element:
    joint = SubElement(root, "joint", name=f"{child}_joint", type=kind)
    SubElement(joint, "parent", link="base_link")
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=_text(*pose.translation), rpy=_text(*_rpy(pose)))
    return joint


def _rpy(pose: SE3) -> tuple[float, float, float]:
    m = pose.matrix()
    pitch = math.asin(float(np.clip(-m[2, 0], -1.0, 1.0)))
    if abs(m[2, 0]) > 1.0 - 1e-12:
        return 0.0, pitch, math.atan2(-m[0, 1], m[1, 1])
    return math.atan2(m[2, 1], m[2, 2]), pitch, math.atan2(m[1, 0], m[0, 0])


def _extension(root: Element, robot: SimRobot) -> None:
    model = robot.model
    scalars = {
        "floor": 0.0,
        "body_bottom": robot.body_bottom,
        "body_height": model.body_height,
        "wheel_radius": robot.wheel_radius,
        "track": robot.track,
        "wheel_base": robot.wheel_base,
        "strafe_loss": robot.strafe_loss,
        "watchdog": robot.watchdog,
    }
    extension = SubElement(
        root, "ambler", {"drive": model.drive.value, **{k: _text(v) for k, v in scalars.items() if v or k == "floor"}}
    )
    SubElement(extension, "footprint", points=_text(*model.footprint.ravel()))
    SubElement(extension, "limits", _differences(model.limits, VelocityLimits(), every=True))
    for frame, spec in robot.lidars.items():
        element = SubElement(extension, "lidar", {"link": frame, **_nearest(spec, LIDARS)})
        if model.sensor(frame).kind is SensorKind.SCAN and model.sensor(frame).azimuth != (-math.pi, math.pi):
            element.set("window", _text(*model.sensor(frame).azimuth))
    for frame, transducer in robot.ultrasonics.items():
        SubElement(extension, "ultrasonic", {"link": frame, **_nearest(transducer, ULTRASONICS)})
    for mount in model.sensors:
        if mount.kind is SensorKind.IMU:
            SubElement(extension, "imu", {"link": mount.frame, **_nearest(robot.imus[mount.frame], IMUS)})
        elif mount.kind is SensorKind.CAMERA:
            SubElement(extension, "camera", {"link": mount.frame, **_camera(robot.cameras[mount.frame])})
    SubElement(extension, "odometry", _nearest(robot.odometry, ODOMETRIES))
    if robot.gait is not None:
        SubElement(extension, "gait", _nearest(robot.gait, GAITS))


def _camera(spec: CameraSpec) -> dict[str, str]:
    lens, noise = replace(spec.model, name=FRONT_CAMERA.name), PictureNoise()
    return {
        **_differences(replace(spec, model=FRONT_CAMERA, picture=noise), CameraSpec()),
        **_differences(lens, FRONT_CAMERA),
        **_differences(spec.picture, noise),
    }


def _nearest(spec: Any, known: Mapping[str, Any]) -> dict[str, str]:
    """Name the known specification with the fewest differences, and what differs."""
    name = min(known, key=lambda n: len(_differences(spec, known[n])))
    return {"model": name, **_differences(spec, known[name])}


def _differences(spec: Any, other: Any, *, every: bool = False) -> dict[str, str]:
    out = {}
    for f in fields(spec):
        value = getattr(spec, f.name)
        if every or value != getattr(other, f.name):
            out[f.name] = _text(*value) if isinstance(value, tuple) else repr(value)
    return out
