"""Poses, transforms, odometry, velocities and polygons as ROS 2 records.

Quaternions are (w, x, y, z) in SE3 and x y z w on the wire; here is the only place where they are reordered.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.core.se3 import SE3, Vector3
from ambler.wire.ros_types import record_class

NANOSECONDS = 1_000_000_000
COMMAND_FRAME = "base"

_Time = record_class("builtin_interfaces/msg/Time")
_Header = record_class("std_msgs/msg/Header")
_Point = record_class("geometry_msgs/msg/Point")
_Point32 = record_class("geometry_msgs/msg/Point32")
_Vector3 = record_class("geometry_msgs/msg/Vector3")
_Quaternion = record_class("geometry_msgs/msg/Quaternion")
_Pose = record_class("geometry_msgs/msg/Pose")
_PoseStamped = record_class("geometry_msgs/msg/PoseStamped")
_PointStamped = record_class("geometry_msgs/msg/PointStamped")
_Polygon = record_class("geometry_msgs/msg/Polygon")
_PolygonStamped = record_class("geometry_msgs/msg/PolygonStamped")
_PoseWithCovariance = record_class("geometry_msgs/msg/PoseWithCovariance")
_Twist = record_class("geometry_msgs/msg/Twist")
_TwistStamped = record_class("geometry_msgs/msg/TwistStamped")
_TwistWithCovariance = record_class("geometry_msgs/msg/TwistWithCovariance")
_Transform = record_class("geometry_msgs/msg/Transform")
_TransformStamped = record_class("geometry_msgs/msg/TransformStamped")
_TFMessage = record_class("tf2_msgs/msg/TFMessage")
_Odometry = record_class("nav_msgs/msg/Odometry")


def header_to_ros(stamp_ns: int, frame: str) -> Any:
    """Build a std_msgs/Header; times before 1970 have negative seconds and positive nanoseconds."""
    sec, nanosec = divmod(stamp_ns, NANOSECONDS)
    return _Header(_Time(sec, nanosec), frame)


def stamp_from_ros(header: Any) -> int:
    """Return the stamp of a std_msgs/Header in nanoseconds."""
    return int(header.stamp.sec) * NANOSECONDS + int(header.stamp.nanosec)


def point_to_ros(point: Vector3) -> Any:
    return _Point(*point)


def vector_to_ros(vector: Vector3) -> Any:
    return _Vector3(*vector)


def vector_from_ros(record: Any) -> Vector3:
    """Return (x, y, z) of a Point or a Vector3."""
    return (record.x, record.y, record.z)


def pose_to_ros(pose: SE3) -> Any:
    w, x, y, z = pose.rotation
    return _Pose(_Point(*pose.translation), _Quaternion(x, y, z, w))


def pose_from_ros(record: Any) -> SE3:
    q = record.orientation
    return SE3(vector_from_ros(record.position), (q.w, q.x, q.y, q.z))


def pose_stamped_to_ros(message: m.PoseStamped) -> Any:
    return _PoseStamped(header_to_ros(message.stamp_ns, message.frame), pose_to_ros(message.pose))


def pose_stamped_from_ros(record: Any) -> m.PoseStamped:
    return m.PoseStamped(stamp_from_ros(record.header), record.header.frame_id, pose_from_ros(record.pose))


def point_stamped_to_ros(message: m.PointStamped) -> Any:
    return _PointStamped(header_to_ros(message.stamp_ns, message.frame), point_to_ros(message.point))


def point_stamped_from_ros(record: Any) -> m.PointStamped:
    return m.PointStamped(stamp_from_ros(record.header), record.header.frame_id, vector_from_ros(record.point))


def polygon_to_ros(message: m.Polygon) -> Any:
    points = [_Point32(*p) for p in message.points.tolist()]
    return _PolygonStamped(header_to_ros(message.stamp_ns, message.frame), _Polygon(points))


def polygon_from_ros(record: Any) -> m.Polygon:
    points = np.array([vector_from_ros(p) for p in record.polygon.points], np.float32).reshape(-1, 3)
    return m.Polygon(stamp_from_ros(record.header), record.header.frame_id, points)


def odometry_to_ros(message: m.Odometry) -> Any:
    return _Odometry(
        header_to_ros(message.stamp_ns, message.frame),
        message.child,
        _PoseWithCovariance(pose_to_ros(message.pose), message.pose_covariance.reshape(36)),
        _TwistWithCovariance(
            _Twist(_Vector3(*message.linear), _Vector3(*message.angular)), message.twist_covariance.reshape(36)
        ),
    )


def odometry_from_ros(record: Any) -> m.Odometry:
    twist = record.twist.twist
    return m.Odometry(
        stamp_from_ros(record.header),
        record.header.frame_id,
        record.child_frame_id,
        pose_from_ros(record.pose.pose),
        vector_from_ros(twist.linear),
        vector_from_ros(twist.angular),
        np.array(record.pose.covariance, np.float64).reshape(6, 6),
        np.array(record.twist.covariance, np.float64).reshape(6, 6),
    )


def velocity_to_ros(message: m.VelocityCommand) -> Any:
    return _TwistStamped(
        header_to_ros(message.stamp_ns, COMMAND_FRAME),
        _Twist(_Vector3(message.vx, message.vy, 0.0), _Vector3(0.0, 0.0, message.wz)),
    )


def velocity_from_ros(record: Any) -> m.VelocityCommand:
    twist = record.twist
    return m.VelocityCommand(stamp_from_ros(record.header), twist.linear.x, twist.linear.y, twist.angular.z)


def transforms_to_ros(message: m.Transforms) -> Any:
    return _TFMessage([_transform_to_ros(edge) for edge in message.transforms])


def _transform_to_ros(edge: m.TransformStamped) -> Any:
    w, x, y, z = edge.parent_from_child.rotation
    return _TransformStamped(
        header_to_ros(edge.stamp_ns, edge.parent),
        edge.child,
        _Transform(_Vector3(*edge.parent_from_child.translation), _Quaternion(x, y, z, w)),
    )


def transforms_from_ros(record: Any) -> m.Transforms:
    """Read a TFMessage; it has no stamp of its own, so the newest of its edges is taken (0 when there is none)."""
    edges = tuple(_transform_from_ros(edge) for edge in record.transforms)
    return m.Transforms(max((e.stamp_ns for e in edges), default=0), edges)


def _transform_from_ros(record: Any) -> m.TransformStamped:
    q = record.transform.rotation
    pose = SE3(vector_from_ros(record.transform.translation), (q.w, q.x, q.y, q.z))
    return m.TransformStamped(stamp_from_ros(record.header), record.header.frame_id, record.child_frame_id, pose)
