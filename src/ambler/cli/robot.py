"""`ambler robot`: the simulated robots as URDF files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb and its sub-verbs."""
    text = "simulated robots and URDF files"
    parser: argparse.ArgumentParser = subparsers.add_parser("robot", help=text, description=text)
    members = parser.add_subparsers(dest="robot_verb", metavar="WHAT", required=True)
    export = members.add_parser("export", help="write a robot as URDF")
    export.add_argument("name", help="a built-in robot, or a URDF file to be written anew")
    export.add_argument("file", type=Path, help="the file to write")
    export.set_defaults(run=run_export)
    show = members.add_parser("show", help="print what the simulator and the algorithms make of a robot")
    show.add_argument("name", help="a built-in robot or a URDF file")
    show.set_defaults(run=run_show)


def run_export(args: argparse.Namespace) -> int:
    """Write the file."""
    from ambler.sim.robots import robot_named
    from ambler.sim.urdf_writer import save_urdf

    robot = robot_named(args.name)
    save_urdf(robot, args.file)
    print(f"{robot.model.name} is written to {args.file}")
    return 0


def run_show(args: argparse.Namespace) -> int:
    """Print the robot."""
    from ambler.sim.robots import robot_named

    robot = robot_named(args.name)
    model = robot.model
    length, width = model.footprint.max(axis=0) - model.footprint.min(axis=0)
    print(f"{model.name}: {model.drive.value} drive, {length:.2f} x {width:.2f} m, {robot.mass:.0f} kg")
    if robot.wheel_radius > 0:
        kind = "mecanum wheels" if robot.has_mecanum_wheels else "wheels"
        print(
            f"  {kind} of {robot.wheel_radius:.3f} m radius, track {robot.track:.3f} m, wheel base {robot.wheel_base:.3f} m"
        )
    for mount in model.sensors:
        x, y, z = mount.base_from_sensor.translation
        print(f"  {mount.kind:6} {mount.frame}: at ({x:.3f}, {y:.3f}, {z:.3f}) m")
    return 0
