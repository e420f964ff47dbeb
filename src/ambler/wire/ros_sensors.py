"""Scans, clouds and inertial measurements as ROS 2 records; bit-exact both ways."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core import messages as m
from ambler.wire.cloud_columns import INTENSITY, RING, column, point_times
from ambler.wire.ros_geometry import header_to_ros, stamp_from_ros, vector_from_ros, vector_to_ros
from ambler.wire.ros_types import record_class

_LaserScan = record_class("sensor_msgs/msg/LaserScan")
_PointCloud2 = record_class("sensor_msgs/msg/PointCloud2")
_PointField = record_class("sensor_msgs/msg/PointField")
_Imu = record_class("sensor_msgs/msg/Imu")
_NavSatFix = record_class("sensor_msgs/msg/NavSatFix")
_NavSatStatus = record_class("sensor_msgs/msg/NavSatStatus")
_Range = record_class("sensor_msgs/msg/Range")
_Quaternion = record_class("geometry_msgs/msg/Quaternion")
_Joy = record_class("sensor_msgs/msg/Joy")

# The layout that Velodyne's drivers publish: packed, 22 bytes per point.
_POINT = np.dtype(
    {
        "names": ["xyz", "intensity", "ring", "time"],
        "formats": [("<f4", (3,)), "<f4", "<u2", "<f4"],
        "offsets": [0, 12, 16, 18],
        "itemsize": 22,
    }
)
_FLOAT32, _UINT16 = 7, 4
_FIELDS = [
    _PointField("x", 0, _FLOAT32, 1),
    _PointField("y", 4, _FLOAT32, 1),
    _PointField("z", 8, _FLOAT32, 1),
    _PointField("intensity", 12, _FLOAT32, 1),
    _PointField("ring", 16, _UINT16, 1),
    _PointField("time", 18, _FLOAT32, 1),
]
# sensor_msgs/PointField datatypes 1..8.
_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_ULTRASOUND = 0
_NO_COVARIANCE = np.zeros(9)
_NO_ORIENTATION = np.array([-1.0] + [0.0] * 8)


def laser_scan_to_ros(message: m.LaserScan) -> Any:
    return _LaserScan(
        header_to_ros(message.stamp_ns, message.frame),
        message.angle_min,
        message.angle_min + (len(message.ranges) - 1) * message.angle_increment,
        message.angle_increment,
        message.time_increment,
        message.scan_time,
        message.range_min,
        message.range_max,
        message.ranges,
        message.intensities,
    )


def laser_scan_from_ros(record: Any) -> m.LaserScan:
    return _scan(record, np.array(record.ranges, np.float32), np.array(record.intensities, np.float32))


def multi_echo_scan_from_ros(record: Any) -> m.LaserScan:
    """Keep the first echo of each beam, the nearest thing that returned any light; inf where none did."""
    return _scan(record, _first_echoes(record.ranges, math.inf), _first_echoes(record.intensities, 0.0))


def _scan(record: Any, ranges: NDArray[np.float32], intensities: NDArray[np.float32]) -> m.LaserScan:
    return m.LaserScan(
        stamp_from_ros(record.header),
        record.header.frame_id,
        record.angle_min,
        record.angle_increment,
        record.time_increment,
        record.scan_time,
        record.range_min,
        record.range_max,
        ranges,
        intensities,
    )


def _first_echoes(beams: Iterable[Any], none: float) -> NDArray[np.float32]:
    return np.array([beam.echoes[0] if len(beam.echoes) else none for beam in beams], np.float32)


def range_to_ros(message: m.Range) -> Any:
    """A variance of zero means that it is unknown, as sensor_msgs/Range wants it."""
    return _Range(
        header_to_ros(message.stamp_ns, message.frame),
        _ULTRASOUND,
        message.field_of_view,
        message.range_min,
        message.range_max,
        message.range,
        0.0,
    )


def range_from_ros(record: Any) -> m.Range:
    return m.Range(
        stamp_from_ros(record.header),
        record.header.frame_id,
        record.field_of_view,
        record.min_range,
        record.max_range,
        record.range,
    )


def cloud_to_ros(message: m.PointCloud) -> Any:
    count = len(message.points)
    packed = np.empty(count, _POINT)
    packed["xyz"] = message.points
    packed["intensity"] = message.intensity
    packed["ring"] = message.ring
    packed["time"] = message.time
    return _PointCloud2(
        header_to_ros(message.stamp_ns, message.frame),
        1,
        count,
        _FIELDS,
        False,
        _POINT.itemsize,
        _POINT.itemsize * count,
        packed.view(np.uint8),
        True,
    )


def cloud_from_ros(record: Any) -> m.PointCloud:
    """Read any PointCloud2 that has x, y and z, with the columns that drivers add (`cloud_columns`); what is absent becomes zeros."""
    order = ">" if record.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": [f.name for f in record.fields],
            "formats": [
                (order + _FORMATS[f.datatype], (f.count,)) if f.count > 1 else order + _FORMATS[f.datatype]
                for f in record.fields
            ],
            "offsets": [f.offset for f in record.fields],
            "itemsize": record.point_step,
        }
    )
    data, row = np.asarray(record.data, np.uint8), record.width * record.point_step
    # Some drivers tell the size of the whole cloud, or 0, as that of a row: then rows follow one another without gaps.
    step = row if len(data) == record.height * row else record.row_step
    packed = np.ascontiguousarray(data.reshape(record.height, step)[:, :row]).reshape(-1).view(layout)
    points = np.empty((len(packed), 3), np.float32)
    for k, axis in enumerate("xyz"):
        points[:, k] = packed[axis]
    return m.PointCloud(
        stamp_from_ros(record.header),
        record.header.frame_id,
        points,
        column(packed, INTENSITY, np.dtype(np.float32)),
        point_times(packed, stamp_from_ros(record.header)),
        column(packed, RING, np.dtype(np.uint16)),
    )


def imu_to_ros(message: m.Imu) -> Any:
    """Orientation is not measured: its covariance starts with -1, as sensor_msgs/Imu wants it."""
    return _Imu(
        header_to_ros(message.stamp_ns, message.frame),
        _Quaternion(0.0, 0.0, 0.0, 1.0),
        _NO_ORIENTATION,
        vector_to_ros(message.angular_velocity),
        _NO_COVARIANCE,
        vector_to_ros(message.linear_acceleration),
        _NO_COVARIANCE,
    )


def gnss_to_ros(message: m.GnssFix) -> Any:
    """A position that is not finite becomes STATUS_NO_FIX; the covariance has a known diagonal."""
    has_fix = math.isfinite(message.latitude + message.longitude)
    return _NavSatFix(
        header_to_ros(message.stamp_ns, message.frame),
        _NavSatStatus(0 if has_fix else -1, 1),
        message.latitude,
        message.longitude,
        message.altitude,
        np.diag(message.variance).ravel(),
        2,
    )


def gnss_from_ros(record: Any) -> m.GnssFix:
    has_fix = record.status.status >= 0
    covariance = record.position_covariance
    return m.GnssFix(
        stamp_from_ros(record.header),
        record.header.frame_id,
        record.latitude if has_fix else math.nan,
        record.longitude if has_fix else math.nan,
        record.altitude if has_fix else math.nan,
        (float(covariance[0]), float(covariance[4]), float(covariance[8])),
    )


def imu_from_ros(record: Any) -> m.Imu:
    return m.Imu(
        stamp_from_ros(record.header),
        record.header.frame_id,
        vector_from_ros(record.angular_velocity),
        vector_from_ros(record.linear_acceleration),
    )


def joystick_to_ros(message: m.JoystickState) -> Any:
    header = header_to_ros(message.stamp_ns, message.frame)
    return _Joy(header, message.axes, message.buttons.astype(np.int32))


def joystick_from_ros(record: Any) -> m.JoystickState:
    axes, buttons = np.array(record.axes, np.float32), np.array(record.buttons, np.int32).astype(np.uint8)
    return m.JoystickState(stamp_from_ros(record.header), record.header.frame_id, axes, buttons)
