"""The files that only a reader of the documents has, made by our own simulator: bags of a walk and of drives, pictures of a board and of a marker."""

import math
from pathlib import Path
from typing import Any

import cv2

from ambler.calibration.camera_calibration import Checkerboard
from ambler.cli import calibrate_camera, calibrate_range
from ambler.core.messages import LaserScan, Odometry, Transforms
from ambler.core.se3 import SE3
from ambler.evaluation.robot_calibration import simulate_robot_drive
from ambler.lio.config import LioConfig
from ambler.lio.offline import run_offline
from ambler.runtime.topics import WHEEL_ODOMETRY
from ambler.sim.camera import FRONT_CAMERA
from ambler.sim.robots import robot_named
from ambler.wire.bags import open_bag
from ambler.wire.camera_info import save_camera_info
from ambler.wire.cloud_files import write_cloud
from tests.cli import test_calibrate, test_calibrate_others
from tests.docs.commands import ROOT
from tests.docs.stand_ins import first_yaml
from tests.lio import carried

BEGAN = (1.5, -2.0, 0.0)  # where the walk begins in `my_map`, turned by 90 degrees
TAPED = {0.5: "near", 1.0: "mid", 1.5: "more", 1.75: "last", 2.0: "far"}  # metres before the camera


def walk(folder: Path) -> None:
    """A bag of a LiDAR and an IMU that were carried through a hall, the truth, and the clouds alone."""
    carried.save_recording(folder / "my_walk", folder / "truth.tum")
    carried.save_clouds(folder / "my_clouds", carried.walk()[1][:60])


def map_of_the_walk(folder: Path) -> None:
    """The cloud of the same hall from another day: the walk begins somewhere in it."""
    rig, scans = carried.walk()
    result = run_offline(carried.scans_of(scans), LioConfig(), rig.told_mount)
    map_from_walk = SE3.from_rpy(BEGAN, 0.0, 0.0, math.pi / 2.0)
    (folder / "my_map").mkdir()
    write_cloud(folder / "my_map" / "cloud.pcd", map_from_walk.transform(result.cloud))


def board(folder: Path) -> None:
    """Pictures of a checkerboard that somebody holds before the camera."""
    for k, image in enumerate(calibrate_camera._simulated(Checkerboard(7, 5, 0.04), seed=0)):
        cv2.imwrite(str(folder / f"board_{k:02d}.png"), image)


def camera(folder: Path) -> None:
    """The calibration of the robots' camera."""
    save_camera_info(folder / "camera.yaml", FRONT_CAMERA)


def marker(folder: Path) -> None:
    """Pictures of a marker at distances that a tape has measured, named to the centimetre."""
    pictures = dict(zip(calibrate_range.SIMULATED, calibrate_range._simulated(0)[2], strict=True))
    for metres, name in TAPED.items():
        cv2.imwrite(str(folder / f"{name}.png"), pictures[metres].image)


def drive_of_three_scanners(folder: Path) -> None:
    """A minute of an `amr_omni`, whose scanners sit beside their drawing."""
    drive = simulate_robot_drive(robot_named("amr_omni"), seed=3, seconds=40.0)
    scans = [(f"/{frame}/scan", scan) for frame, scans in drive.scans.items() for scan in scans]
    messages: list[tuple[str, Any]] = [*scans, *(("/odom", o) for o in drive.odometry)]
    test_calibrate.write_bag(folder / "RECORDING", sorted(messages, key=lambda m: m[1].stamp_ns))


def drive_past_reflectors(folder: Path) -> None:
    """A `diff` that passes three strips and knows its pose."""
    test_calibrate_others.drive(folder / "RECORDING")


def planar_bag(folder: Path) -> None:
    """The small recording as the bag of a robot that has two scanners."""
    messages: list[tuple[str, Any]] = []
    with open_bag(ROOT / "examples" / "lab_empty" / "recording") as bag:
        for topic, message, _ in bag.messages(types=(LaserScan, Odometry, Transforms)):
            if isinstance(message, LaserScan):
                messages += [("/front/scan", message), ("/rear/scan", message)]
            elif topic in (WHEEL_ODOMETRY.ros_name, "/tf_static"):
                messages.append((topic, message))
    test_calibrate.write_bag(folder / "my_bag", messages)


def route(folder: Path) -> None:
    """The route of docs/driving.md."""
    (folder / "route.yaml").write_text(first_yaml("driving"))


def space(folder: Path) -> None:
    """The study of docs/tuning.md."""
    (folder / "space.yaml").write_text(first_yaml("tuning"))
