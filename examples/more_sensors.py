"""A robot with two more sensors: a second inertial unit and a camera on `diff`. Run it: `python examples/more_sensors.py`."""

from __future__ import annotations

import math
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

from ambler.apps.judgement import judge
from ambler.apps.robot import Parts
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.robot import SensorKind, SensorMount
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.steps import NavigateStep
from ambler.runtime.tasks import CAMERA_PICTURES, PicturesRequest
from ambler.sim.camera import CameraSpec
from ambler.sim.robots import robot_named
from ambler.sim.sensors import MEMS_IMU_200
from ambler.sim.sim_robot import SimRobot
from ambler.wire.mcap_reader import read_recording


def robot() -> SimRobot:
    """Return `diff` with an inertial unit at 200 Hz on its tail and a camera that looks ahead."""
    plain = robot_named("diff")
    imu = SensorMount("rear_imu", SensorKind.IMU, SE3((-0.2, 0.0, 0.15)))
    ahead = SE3.from_rpy((0.25, 0.0, 0.2), -0.5 * math.pi, 0.0, -0.5 * math.pi)
    camera = SensorMount("front_camera", SensorKind.CAMERA, ahead)
    model = replace(plain.model, name="diff_plus", sensors=(*plain.model.sensors, imu, camera))
    imus, cameras = {**plain.imus, "rear_imu": MEMS_IMU_200}, {"front_camera": CameraSpec(rate_hz=5.0)}
    return replace(plain, model=model, imus=imus, cameras=cameras)


def main(out: Path) -> dict[str, object]:
    """Drive 2 m; returns the result with the number of messages of each sensor."""
    options = RunOptions((NavigateStep(SE2(2.0, 0.5, 0.0)),), "lab_empty", "diff", port=None, time_limit=60.0)
    run = SimulatedRun(options, RunFolder(out), parts=Parts(robot=robot()))
    try:
        run.executor.call(CAMERA_PICTURES, PicturesRequest(3.0))  # cameras take pictures while somebody wants them
        run.run()
        told = Counter(message.topic for message in read_recording(run.robot.folder.recording))
        return {**judge(run).fields, **{topic: told[topic] for topic in ("/imu", "/imu/rear_imu", "/camera/image")}}
    finally:
        run.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        result = main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder))
        print({name: result[name] for name in ("ended", "collisions", "/imu", "/imu/rear_imu", "/camera/image")})
