"""Writes a simulated robot as a URDF file that `sim.urdf` reads back to the same robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from ambler.robots.description import Chassis, RobotDescription
from ambler.robots.urdf_writer import differences, robot_tree, text_of, write_tree
from ambler.sim.camera import FRONT_CAMERA, CameraSpec, PictureNoise
from ambler.sim.sim_robot import SimRobot
from ambler.sim.urdf import DEPTH_CAMERAS, GAITS, IMUS, LIDARS, ODOMETRIES, ULTRASONICS


def save_urdf(robot: SimRobot, path: Path) -> None:
    """Write a robot with everything that the simulator knows of it."""
    chassis = Chassis(robot.body_bottom, robot.wheel_radius, robot.track, robot.wheel_base)
    root = robot_tree(RobotDescription(robot.model, chassis), robot.mass)
    extension = root.find("ambler")
    assert extension is not None
    for key, value in (("strafe_loss", robot.strafe_loss), ("watchdog", robot.watchdog)):
        if value:
            extension.set(key, text_of(value))
    for element in extension:
        said = _said(robot, element)
        if said is not None:
            kept: dict[str, str] = {k: v for k, v in element.attrib.items() if k in ("link", "window")}
            element.attrib.clear()
            element.attrib.update({**kept, **said})
    SubElement(extension, "odometry", _nearest(robot.odometry, ODOMETRIES))
    if robot.gait is not None:
        SubElement(extension, "gait", _nearest(robot.gait, GAITS))
    write_tree(root, path)


def _said(robot: SimRobot, element: Element) -> dict[str, str] | None:
    """The attributes of a sensor; None for what is no sensor."""
    frame = element.get("link", "")
    if element.tag == "lidar":
        return _nearest(robot.lidars[frame], LIDARS)
    if element.tag == "ultrasonic":
        return _nearest(robot.ultrasonics[frame], ULTRASONICS)
    if element.tag == "depth":
        return _nearest(robot.depth_cameras[frame], DEPTH_CAMERAS)
    if element.tag == "imu":
        return _nearest(robot.imus[frame], IMUS)
    return _camera(robot.cameras[frame]) if element.tag == "camera" else None


def _camera(spec: CameraSpec) -> dict[str, str]:
    lens, noise = replace(spec.model, name=FRONT_CAMERA.name), PictureNoise()
    return {
        **differences(replace(spec, model=FRONT_CAMERA, picture=noise), CameraSpec()),
        **differences(lens, FRONT_CAMERA),
        **differences(spec.picture, noise),
    }


def _nearest(spec: Any, known: Mapping[str, Any]) -> dict[str, str]:
    """Name the known specification with the fewest differences, and what differs."""
    name = min(known, key=lambda n: len(differences(spec, known[n])))
    return {"model": name, **differences(spec, known[name])}
