"""Health, contacts, gate, status and outside calls as records of the own package `ambler_msgs` (definitions in `msg/`), the battery and
plain texts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.wire.ros_geometry import header_to_ros, point_to_ros, stamp_from_ros, vector_from_ros
from ambler.wire.ros_types import record_class

_SlamHealth = record_class("ambler_msgs/msg/SlamHealth")
_GroundLevels = record_class("ambler_msgs/msg/GroundLevels")
_Pose2D = record_class("geometry_msgs/msg/Pose2D")
_Contact = record_class("ambler_msgs/msg/Contact")
_GateStatus = record_class("ambler_msgs/msg/GateStatus")
_Status = record_class("ambler_msgs/msg/Status")
_OutsideCall = record_class("ambler_msgs/msg/OutsideCall")
_BatteryState = record_class("sensor_msgs/msg/BatteryState")
_Float32 = record_class("std_msgs/msg/Float32")
_Int8 = record_class("std_msgs/msg/Int8")
_String = record_class("std_msgs/msg/String")


def slam_health_to_ros(message: m.SlamHealth) -> Any:
    return _SlamHealth(
        header_to_ros(message.stamp_ns, ""),
        message.score,
        message.inlier_ratio,
        message.degeneracy,
        message.covariance.reshape(9),
        message.submaps,
        message.nodes,
        message.loop_closures,
    )


def slam_health_from_ros(record: Any) -> m.SlamHealth:
    return m.SlamHealth(
        stamp_from_ros(record.header),
        record.score,
        record.inlier_ratio,
        record.degeneracy,
        np.array(record.covariance, np.float64).reshape(3, 3),
        record.submaps,
        record.nodes,
        record.loop_closures,
    )


def contact_to_ros(message: m.Contact) -> Any:
    return _Contact(
        header_to_ros(message.stamp_ns, ""),
        message.robot_geom,
        message.other_geom,
        point_to_ros(message.position),
        message.speed,
        message.force,
        math.nan if message.approach is None else message.approach,
    )


def contact_from_ros(record: Any) -> m.Contact:
    return m.Contact(
        stamp_from_ros(record.header),
        record.robot_geom,
        record.other_geom,
        vector_from_ros(record.position),
        record.speed,
        record.force,
        None if math.isnan(record.approach) else record.approach,
    )


def gate_status_to_ros(message: m.GateStatus) -> Any:
    return _GateStatus(header_to_ros(message.stamp_ns, ""), int(message.state), message.reason, message.source)


def gate_status_from_ros(record: Any) -> m.GateStatus:
    return m.GateStatus(stamp_from_ros(record.header), m.GateState(record.state), record.reason, record.source)


def status_to_ros(message: m.Status) -> Any:
    return _Status(header_to_ros(message.stamp_ns, ""), message.node, message.code, message.text, message.fields_json)


def status_from_ros(record: Any) -> m.Status:
    return m.Status(stamp_from_ros(record.header), record.node, record.code, record.text, record.fields_json)


def text_to_ros(message: m.Text) -> Any:
    return _String(message.text)


def text_from_ros(record: Any) -> m.Text:
    return m.Text(0, record.data)


def number_to_ros(message: m.Number) -> Any:
    return _Float32(message.value)


def number_from_ros(record: Any) -> m.Number:
    return m.Number(0, float(record.data))


def code_to_ros(message: m.Code) -> Any:
    return _Int8(message.value)


def code_from_ros(record: Any) -> m.Code:
    return m.Code(0, int(record.data))


def outside_call_to_ros(message: m.OutsideCall) -> Any:
    data = np.frombuffer(message.data, np.uint8)
    return _OutsideCall(header_to_ros(message.stamp_ns, ""), int(message.kind), message.name, message.number, data)


def outside_call_from_ros(record: Any) -> m.OutsideCall:
    kind = m.OutsideKind(record.kind)
    return m.OutsideCall(stamp_from_ros(record.header), kind, record.name, record.number, record.data.tobytes())


def battery_to_ros(message: m.BatteryState) -> Any:
    """What is not measured is NaN or UNKNOWN, as sensor_msgs/BatteryState wants it."""
    nan, none = math.nan, np.empty(0, np.float32)
    return _BatteryState(
        header_to_ros(message.stamp_ns, message.frame),
        message.voltage,
        nan,
        message.current,
        *(nan, nan, nan),
        message.share,
        int(message.supply),
        *(0, 0),
        True,
        *(none, none),
        *("", ""),
    )


def battery_from_ros(record: Any) -> m.BatteryState:
    return m.BatteryState(
        stamp_from_ros(record.header),
        record.header.frame_id,
        record.voltage,
        record.current,
        record.percentage,
        m.PowerSupply(record.power_supply_status),
    )


def ground_levels_to_ros(message: m.GroundLevels) -> Any:
    passages = message.passages
    ends = passages[:, :2].astype(np.uint32)
    poses = [_Pose2D(*pose) for pose in passages[:, 2:].tolist()]
    header = header_to_ros(message.stamp_ns, message.frame)
    return _GroundLevels(header, message.active, message.count, ends[:, 0].copy(), ends[:, 1].copy(), poses)


def ground_levels_from_ros(record: Any) -> m.GroundLevels:
    if not len(record.from_levels) == len(record.to_levels) == len(record.passages):
        raise ValueError("levels from, levels to and passages differ in number")
    poses = np.array([(p.x, p.y, p.theta) for p in record.passages]).reshape(-1, 3)
    passages = np.column_stack((record.from_levels, record.to_levels, poses)).astype(np.float64)
    return m.GroundLevels(
        stamp_from_ros(record.header), record.header.frame_id, record.active, record.count, passages.reshape(-1, 5)
    )
