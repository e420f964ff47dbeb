"""Writes a robot as URDF: its body as a box around the footprint, wheels, a link per sensor, and the rest in `<ambler>`."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ambler.core.robot import MERGED_FRAME, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.robots.description import RobotDescription
from ambler.wire.atomic_file import write_whole

WHEEL_WIDTH = 0.06
EVERYWHERE = (-math.pi, math.pi)


def save_robot(robot: RobotDescription, path: Path, mass: float = 0.0) -> None:
    """Write a robot, which `robots.urdf` reads back to the same; without a mass nobody can simulate it."""
    write_tree(robot_tree(robot, mass), path)


def write_tree(root: Element, path: Path) -> None:
    """Write a file whole or not at all."""
    ElementTree.indent(root)
    write_whole(path, ElementTree.tostring(root, encoding="unicode", xml_declaration=False) + "\n")


def robot_tree(robot: RobotDescription, mass: float) -> Element:
    """Return the whole file; others may add attributes to the sensors in its `<ambler>` element."""
    root = Element("robot", name=robot.model.name)
    _body(root, robot, mass)
    _wheels(root, robot)
    for mount in robot.model.sensors:
        SubElement(root, "link", name=mount.frame)
        _joint(root, mount.frame, "fixed", mount.base_from_sensor)
    _extension(root, robot)
    return root


def text_of(*values: float) -> str:
    """Return numbers as the file holds them, to the last bit."""
    return " ".join(repr(float(v)) for v in values)


def differences(spec: Any, other: Any, *, every: bool = False) -> dict[str, str]:
    """Return the attributes in which two records differ (`every`: all of them)."""
    out = {}
    for f in fields(spec):
        value = getattr(spec, f.name)
        if every or value != getattr(other, f.name):
            out[f.name] = text_of(*value) if isinstance(value, tuple) else repr(value)
    return out


def _body(root: Element, robot: RobotDescription, mass: float) -> None:
    low, high = robot.model.footprint.min(axis=0), robot.model.footprint.max(axis=0)
    (x, y), z = (0.5 * (low + high)).tolist(), 0.5 * (robot.chassis.body_bottom + robot.model.body_height)
    length, width = (high - low).tolist()
    height = robot.model.body_height - robot.chassis.body_bottom
    link = SubElement(root, "link", name="base_link")
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=text_of(x, y, z))
    SubElement(inertial, "mass", value=text_of(mass))
    k = mass / 12.0
    moments = {
        "ixx": k * (width**2 + height**2),
        "iyy": k * (length**2 + height**2),
        "izz": k * (length**2 + width**2),
        **dict.fromkeys(("ixy", "ixz", "iyz"), 0.0),
    }
    SubElement(inertial, "inertia", {key: text_of(value) for key, value in moments.items()})
    for tag in ("visual", "collision"):
        shape = SubElement(link, tag)
        SubElement(shape, "origin", xyz=text_of(x, y, z))
        SubElement(SubElement(shape, "geometry"), "box", size=text_of(length, width, height))


def _wheels(root: Element, robot: RobotDescription) -> None:
    chassis = robot.chassis
    r, y, x = chassis.wheel_radius, 0.5 * chassis.track, 0.5 * chassis.wheel_base
    places = {"wheel_left": (0.0, y), "wheel_right": (0.0, -y)} if chassis.has_two_wheels else {}
    if chassis.has_mecanum_wheels:
        places = {"wheel_fl": (x, y), "wheel_fr": (x, -y), "wheel_rl": (-x, y), "wheel_rr": (-x, -y)}
    for name, (wx, wy) in places.items():
        shape = SubElement(SubElement(root, "link", name=name), "visual")
        SubElement(shape, "origin", rpy=text_of(0.5 * math.pi, 0.0, 0.0))
        SubElement(
            SubElement(shape, "geometry"),
            "cylinder",
            radius=text_of(r),
            length=text_of(min(WHEEL_WIDTH, 0.5 * chassis.track)),
        )
        joint = _joint(root, name, "continuous", SE3((wx, wy, r)))
        SubElement(joint, "axis", xyz="0 1 0")


def _joint(root: Element, child: str, kind: str, pose: SE3) -> Element:
    joint = SubElement(root, "joint", name=f"{child}_joint", type=kind)
    SubElement(joint, "parent", link="base_link")
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=text_of(*pose.translation), rpy=text_of(*_rpy(pose)))
    return joint


def _rpy(pose: SE3) -> tuple[float, float, float]:
    m = pose.matrix()
    pitch = math.asin(float(np.clip(-m[2, 0], -1.0, 1.0)))
    if abs(m[2, 0]) > 1.0 - 1e-12:
        return 0.0, pitch, math.atan2(-m[0, 1], m[1, 1])
    return math.atan2(m[2, 1], m[2, 2]), pitch, math.atan2(m[1, 0], m[0, 0])


def _extension(root: Element, robot: RobotDescription) -> None:
    model, chassis = robot.model, robot.chassis
    scalars = {
        "floor": 0.0,
        "body_bottom": chassis.body_bottom,
        "body_height": model.body_height,
        "wheel_radius": chassis.wheel_radius,
        "track": chassis.track,
        "wheel_base": chassis.wheel_base,
    }
    said = {k: text_of(v) for k, v in scalars.items() if v or k == "floor"}
    extension = SubElement(root, "ambler", {"drive": model.drive.value, **said})
    SubElement(extension, "footprint", points=text_of(*model.footprint.ravel()))
    SubElement(extension, "limits", differences(model.limits, VelocityLimits(), every=True))
    for mount in model.sensors:
        if mount.frame != MERGED_FRAME:
            _sensor(extension, mount)


def _sensor(extension: Element, mount: SensorMount) -> None:
    tags = {SensorKind.SCAN: "lidar", SensorKind.CLOUD: "lidar", SensorKind.RANGE: "ultrasonic"}
    element = SubElement(extension, tags.get(mount.kind, mount.kind.value), link=mount.frame)
    if mount.kind is SensorKind.SCAN and mount.azimuth != EVERYWHERE:
        element.set("window", text_of(*mount.azimuth))
    if mount.kind is SensorKind.CLOUD:
        element.set("model", "vlp_16")
        element.set("elevations", text_of(*mount.elevation))
    if mount.kind is SensorKind.DEPTH:
        element.set("range_max", text_of(mount.range_max))
    if mount.kind in (SensorKind.SCAN, SensorKind.CLOUD, SensorKind.RANGE, SensorKind.DEPTH):
        element.set("range_min", text_of(mount.range_min))
