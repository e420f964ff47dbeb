"""The devices of a robot out of a recording, in the place where a running one has simulated or real ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ambler.core.devices import RobotDevices
from ambler.core.errors import DeviceError
from ambler.core.messages import CameraInfo
from ambler.core.robot import RobotModel, SensorKind, SensorMount
from ambler.nodes.devices.table import topics_of
from ambler.recordings.devices import (
    RecordedBase,
    RecordedBattery,
    RecordedCamera,
    RecordedImu,
    RecordedJoystick,
    RecordedLidar,
    RecordedRangeSensor,
)
from ambler.recordings.message_source import MessageSource
from ambler.runtime.topics import BATTERY, JOYSTICK, WHEEL_ODOMETRY
from ambler.wire.mcap_reader import read_recording

READ_PERIOD = 0.005
"""Seconds; divides the reading periods of all simulated devices, so that each message is published at the instant at which it was."""


def recorded_devices(path: Path, robot: RobotModel, prefix: str = "") -> RobotDevices:
    """Return the recorded devices of a robot, none of them open; sensors, battery and joystick of which nothing was recorded are left
    out. `prefix` goes before the ROS names, as in recordings of several robots. Raises DeviceError without base or recording."""
    source = MessageSource(path)
    if prefix + WHEEL_ODOMETRY.ros_name not in source.topics:
        raise DeviceError(f"{path} holds no {prefix}{WHEEL_ODOMETRY.ros_name}: no devices were recorded there")

    def mounts(*kinds: SensorKind) -> Iterator[tuple[SensorMount, str]]:
        """Mounts of which something was recorded, with the ROS names of their (first) topics."""
        for mount in robot.sensors:
            if mount.kind in kinds and mount.frame in _device_frames(robot):
                name = prefix + topics_of(robot, mount)[0].ros_name
                if name in source.topics:
                    yield mount, name

    scans = mounts(SensorKind.SCAN, SensorKind.CLOUD)
    battery, joystick = prefix + BATTERY.ros_name, prefix + JOYSTICK.ros_name
    return RobotDevices(
        base=RecordedBase(source, prefix + WHEEL_ODOMETRY.ros_name, poll_period=READ_PERIOD),
        lidars=tuple(RecordedLidar(source, n, frame=m.frame, name=m.frame, poll_period=READ_PERIOD) for m, n in scans),
        imus=tuple(
            RecordedImu(source, n, frame=m.frame, name=m.frame, poll_period=READ_PERIOD)
            for m, n in mounts(SensorKind.IMU)
        ),
        ranges=tuple(
            RecordedRangeSensor(source, n, frame=m.frame, name=m.frame, poll_period=READ_PERIOD)
            for m, n in mounts(SensorKind.RANGE)
        ),
        cameras=tuple(_camera(source, robot, m, n, prefix) for m, n in mounts(SensorKind.CAMERA)),
        depth_cameras=tuple(_camera(source, robot, m, n, prefix) for m, n in mounts(SensorKind.DEPTH)),
        battery=RecordedBattery(source, battery, poll_period=READ_PERIOD) if battery in source.topics else None,
        joystick=RecordedJoystick(source, joystick, poll_period=READ_PERIOD) if joystick in source.topics else None,
    )


def _device_frames(robot: RobotModel) -> frozenset[str]:
    """Frames of sensors that are devices; the virtual scanner that several are merged into is none."""
    virtual = {m.frame for m in robot.of_kind(SensorKind.SCAN)} - {m.frame for m in robot.scanners}
    return frozenset(m.frame for m in robot.sensors) - virtual


def _camera(source: MessageSource, robot: RobotModel, mount: SensorMount, name: str, prefix: str) -> RecordedCamera:
    """Return a recorded camera that projects as it was said to when it was recorded."""
    info = prefix + topics_of(robot, mount)[1].ros_name
    for recorded in read_recording(source.path, {info}):
        model = recorded.decode_as(CameraInfo).model
        return RecordedCamera(source, name, model, frame=mount.frame, name=mount.frame, poll_period=READ_PERIOD)
    raise DeviceError(f"{source.path} holds pictures on {name} and no {info}")
