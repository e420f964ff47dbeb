"""Every message of the bus to and from ROS 2 CDR (little-endian XCDR1, as all ROS 2 middlewares exchange it).

`decode(type(m), encode(m))` gives back exactly what a sensor, odometry, transform, goal or status said. Lossy by design:
cost grids (see `ros_grids`), the yaw of a path (up to rounding), and frontiers, which become markers and are not read back.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from rosbags.serde import SerdeError

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.wire import (
    ros_camera,
    ros_echoes,
    ros_fast,
    ros_geometry,
    ros_glass,
    ros_grids,
    ros_markers,
    ros_paths,
    ros_sensors,
    ros_status,
)
from ambler.wire.ros_types import STORE, message_definition

__all__ = [
    "codec_of",
    "decode",
    "decode_any",
    "encode",
    "is_decodable",
    "message_class_of",
    "message_definition",
    "ros_type_of",
]

M = TypeVar("M", bound=m.Message)

# What parsing foreign bytes may raise, found by fuzzing (tests/wire/test_ros_messages.py).
DAMAGE = (SerdeError, struct.error, ValueError, IndexError, KeyError, TypeError, OverflowError, AssertionError)


@dataclass(frozen=True, slots=True)
class Codec:
    """How a message class travels: its ROS type, to and from its record, and a faster way to the bytes where there is one."""

    ros_type: str
    to_ros: Callable[[Any], Any]
    from_ros: Callable[[Any], m.Message] | None
    encode: Callable[[Any], bytes] | None = None


_CODECS: dict[type[m.Message], Codec] = {
    m.LaserScan: Codec("sensor_msgs/msg/LaserScan", ros_sensors.laser_scan_to_ros, ros_sensors.laser_scan_from_ros),
    m.Range: Codec("sensor_msgs/msg/Range", ros_sensors.range_to_ros, ros_sensors.range_from_ros),
    m.JudgedEcho: Codec("ambler_msgs/msg/JudgedEcho", ros_echoes.echo_to_ros, ros_echoes.echo_from_ros),
    m.GlassWalls: Codec("visualization_msgs/msg/Marker", ros_glass.glass_to_ros, ros_glass.glass_from_ros),
    m.PointCloud: Codec("sensor_msgs/msg/PointCloud2", ros_sensors.cloud_to_ros, ros_sensors.cloud_from_ros),
    m.Imu: Codec("sensor_msgs/msg/Imu", ros_sensors.imu_to_ros, ros_sensors.imu_from_ros, ros_fast.encode_imu),
    m.GnssFix: Codec("sensor_msgs/msg/NavSatFix", ros_sensors.gnss_to_ros, ros_sensors.gnss_from_ros),
    m.Image: Codec("sensor_msgs/msg/Image", ros_camera.image_to_ros, ros_camera.image_from_ros),
    m.CameraInfo: Codec("sensor_msgs/msg/CameraInfo", ros_camera.camera_info_to_ros, ros_camera.camera_info_from_ros),
    m.BatteryState: Codec("sensor_msgs/msg/BatteryState", ros_status.battery_to_ros, ros_status.battery_from_ros),
    m.Odometry: Codec(
        "nav_msgs/msg/Odometry", ros_geometry.odometry_to_ros, ros_geometry.odometry_from_ros, ros_fast.encode_odometry
    ),
    m.JoystickState: Codec("sensor_msgs/msg/Joy", ros_sensors.joystick_to_ros, ros_sensors.joystick_from_ros),
    m.VelocityCommand: Codec(
        "geometry_msgs/msg/TwistStamped",
        ros_geometry.velocity_to_ros,
        ros_geometry.velocity_from_ros,
        ros_fast.encode_velocity,
    ),
    m.Transforms: Codec(
        "tf2_msgs/msg/TFMessage",
        ros_geometry.transforms_to_ros,
        ros_geometry.transforms_from_ros,
        ros_fast.encode_transforms,
    ),
    m.OccupancyGrid: Codec(
        "nav_msgs/msg/OccupancyGrid", ros_grids.occupancy_grid_to_ros, ros_grids.occupancy_grid_from_ros
    ),
    m.CostGrid: Codec("nav_msgs/msg/OccupancyGrid", ros_grids.cost_grid_to_ros, ros_grids.cost_grid_from_ros),
    m.Path: Codec("nav_msgs/msg/Path", ros_paths.path_to_ros, ros_paths.path_from_ros, ros_paths.encode_path),
    m.PoseStamped: Codec(
        "geometry_msgs/msg/PoseStamped", ros_geometry.pose_stamped_to_ros, ros_geometry.pose_stamped_from_ros
    ),
    m.PointStamped: Codec(
        "geometry_msgs/msg/PointStamped", ros_geometry.point_stamped_to_ros, ros_geometry.point_stamped_from_ros
    ),
    m.Polygon: Codec("geometry_msgs/msg/PolygonStamped", ros_geometry.polygon_to_ros, ros_geometry.polygon_from_ros),
    m.Frontiers: Codec(
        "visualization_msgs/msg/MarkerArray", ros_markers.frontiers_to_ros, None, ros_markers.encode_frontiers
    ),
    m.VisibilityGraphView: Codec(
        *("visualization_msgs/msg/MarkerArray", ros_markers.visibility_graph_to_ros, None),
        ros_markers.encode_visibility_graph,
    ),
    m.GroundLevels: Codec(
        "ambler_msgs/msg/GroundLevels", ros_status.ground_levels_to_ros, ros_status.ground_levels_from_ros
    ),
    m.SlamHealth: Codec("ambler_msgs/msg/SlamHealth", ros_status.slam_health_to_ros, ros_status.slam_health_from_ros),
    m.Contact: Codec("ambler_msgs/msg/Contact", ros_status.contact_to_ros, ros_status.contact_from_ros),
    m.GateStatus: Codec("ambler_msgs/msg/GateStatus", ros_status.gate_status_to_ros, ros_status.gate_status_from_ros),
    m.OutsideCall: Codec(
        "ambler_msgs/msg/OutsideCall", ros_status.outside_call_to_ros, ros_status.outside_call_from_ros
    ),
    m.Number: Codec("std_msgs/msg/Float32", ros_status.number_to_ros, ros_status.number_from_ros),
    m.Code: Codec("std_msgs/msg/Int8", ros_status.code_to_ros, ros_status.code_from_ros),
    m.Text: Codec("std_msgs/msg/String", ros_status.text_to_ros, ros_status.text_from_ros),
    m.Status: Codec("ambler_msgs/msg/Status", ros_status.status_to_ros, ros_status.status_from_ros),
}
# The first class declared for a ROS type is its default reading: OccupancyGrid, not CostGrid.
_CLASS_OF_TYPE: dict[str, type[m.Message]] = {}
for _cls, _codec in _CODECS.items():
    _CLASS_OF_TYPE.setdefault(_codec.ros_type, _cls)


def codec_of(message_class: type[m.Message]) -> Codec:
    """Return how a message class travels; raises KeyError."""
    return _CODECS[message_class]


def ros_type_of(message_class: type[m.Message]) -> str:
    """Return the ROS 2 type of a message class, such as `sensor_msgs/msg/LaserScan`; raises KeyError."""
    return codec_of(message_class).ros_type


def message_class_of(ros_type: str) -> type[m.Message]:
    """Return the message class that a ROS type is read as by default; raises KeyError."""
    return _CLASS_OF_TYPE[ros_type]


def is_decodable(message_class: type[m.Message]) -> bool:
    """Say whether `decode` can read this class back (frontiers cannot)."""
    return _CODECS[message_class].from_ros is not None


def encode(message: m.Message) -> bytes:
    """Return the message as CDR with its four header bytes."""
    codec = _CODECS[type(message)]
    if codec.encode is not None:
        return codec.encode(message)
    return bytes(STORE.serialize_cdr(codec.to_ros(message), codec.ros_type))


def decode(message_class: type[M], data: bytes | memoryview) -> M:
    """Read CDR bytes as a message of the class; raises BadInputError when they are not one."""
    codec = _CODECS[message_class]
    if codec.from_ros is None:
        raise BadInputError(f"{message_class.__name__} cannot be read back from {codec.ros_type}")
    try:
        message = codec.from_ros(STORE.deserialize_cdr(data, codec.ros_type))
    except DAMAGE as error:
        raise BadInputError(f"{len(data)} bytes are no {codec.ros_type}: {error}") from error
    assert isinstance(message, message_class)
    return message


def decode_any(ros_type: str, data: bytes | memoryview) -> m.Message:
    """Read CDR bytes by their ROS type; raises BadInputError for unknown types and damaged bytes."""
    try:
        message_class = _CLASS_OF_TYPE[ros_type]
    except KeyError:
        raise BadInputError(f"no message of Ambler is a {ros_type}") from None
    return decode(message_class, data)
