"""The one place that says on which topics a kind of sensor is told and which node reads it.

Planar scanners: `scan` for the only one, `scanners` for several together, from where the merger takes them. Clouds, inertial units,
cameras and depth cameras: the first on the plain topic, further ones on instances of it, named by their frames. All transducers share `ranges`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ambler.core.camera import CameraModel
from ambler.core.devices import RobotDevices
from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel, SensorKind, SensorMount
from ambler.nodes.devices.base import BaseNode
from ambler.nodes.devices.battery import BatteryNode
from ambler.nodes.devices.camera import CameraNode
from ambler.nodes.devices.joystick import JoystickConfig, JoystickNode
from ambler.nodes.devices.legs import LegsNode
from ambler.nodes.devices.mounts import MountsNode
from ambler.nodes.devices.node import DeviceNode
from ambler.nodes.devices.sensors import ImuNode, LidarNode, RangesNode
from ambler.runtime import topics
from ambler.runtime.node import Node
from ambler.runtime.topics import Topic


@dataclass(frozen=True, slots=True)
class SensorRow:
    """A kind of sensor: its topics, the one that several share (None: further ones are instances), and the node that reads it."""

    topics: tuple[Topic[Any], ...]
    shared: Topic[Any] | None
    node: type[DeviceNode]


SENSORS: Mapping[SensorKind, SensorRow] = {
    SensorKind.SCAN: SensorRow((topics.SCAN,), topics.SCANNERS, LidarNode),
    SensorKind.CLOUD: SensorRow((topics.CLOUD,), None, LidarNode),
    SensorKind.RANGE: SensorRow((topics.RANGES,), topics.RANGES, RangesNode),
    SensorKind.IMU: SensorRow((topics.IMU,), None, ImuNode),
    SensorKind.CAMERA: SensorRow((topics.IMAGE, topics.CAMERA_INFO), None, CameraNode),
    SensorKind.DEPTH: SensorRow((topics.DEPTH, topics.DEPTH_INFO), None, CameraNode),
}


def topics_of(robot: RobotModel, mount: SensorMount) -> tuple[Topic[Any], ...]:
    """Return the topics on which a sensor of a robot is told."""
    row = SENSORS[mount.kind]
    frames = _frames(robot, mount.kind)
    if row.shared is not None:
        return (row.shared,) if len(frames) > 1 else row.topics
    return row.topics if frames[0] == mount.frame else tuple(t.of(mount.frame) for t in row.topics)


def topics_of_kind(robot: RobotModel, kind: SensorKind) -> tuple[Topic[Any], ...]:
    """Return the topics of all sensors of a kind, each once; of a camera the pictures first."""
    mounts = (robot.sensor(frame) for frame in _frames(robot, kind))
    return tuple(dict.fromkeys(topic for mount in mounts for topic in topics_of(robot, mount)))


def device_names(robot: RobotModel) -> frozenset[str]:
    """Return the names of the nodes that a robot's devices may have, by which a recording tells who wrote."""
    sensors = {f"{prefix}_{m.frame}" for m in robot.sensors for prefix in ("lidar", "imu", "camera")}
    return frozenset({"mounts", "base", "ranges", "battery", "joystick", "legs", *sensors})


def device_nodes(
    robot: RobotModel,
    devices: RobotDevices,
    *,
    calibration: CameraModel | None = None,
    joystick: JoystickConfig | None = None,
) -> list[Node]:
    """Return the nodes of a robot's devices and mounts. `calibration` replaces what the first camera says of its projection.

    Raises BadInputError when a device has a frame that the robot does not mount.
    """
    nodes: list[Node] = [MountsNode(robot), BaseNode(devices.base)]
    nodes += [LidarNode(lidar, _topics(robot, lidar)[0]) for lidar in devices.lidars]
    nodes += [ImuNode(imu, _topics(robot, imu)[0]) for imu in devices.imus]
    if devices.ranges:
        nodes.append(RangesNode(devices.ranges))
    for k, camera in enumerate(devices.cameras):
        image, info = _topics(robot, camera)
        nodes.append(CameraNode(camera, image, info, calibration if k == 0 else None, is_always_on=k > 0))
    for camera in devices.depth_cameras:
        image, info = _topics(robot, camera)
        nodes.append(CameraNode(camera, image, info, is_always_on=True))
    if devices.battery is not None:
        nodes.append(BatteryNode(devices.battery))
    if devices.joystick is not None:
        nodes.append(JoystickNode(devices.joystick, robot.limits, joystick))
    if devices.legs is not None:
        nodes.append(LegsNode(devices.legs))
    return nodes


def _frames(robot: RobotModel, kind: SensorKind) -> list[str]:
    """Frames of a kind's sensors that are devices; the virtual scanner is none."""
    mounts = robot.scanners if kind is SensorKind.SCAN else robot.of_kind(kind)
    return [mount.frame for mount in mounts]


def _topics(robot: RobotModel, device: Any) -> tuple[Topic[Any], ...]:
    try:
        return topics_of(robot, robot.sensor(device.frame))
    except KeyError as error:
        raise BadInputError(f"device {device.name}: {error.args[0]}") from error
