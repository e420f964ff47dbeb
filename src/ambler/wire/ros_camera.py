"""Pictures, grey or of depth (REP 118: 16UC1 in millimetres, 32FC1 in metres), and what cameras project as ROS 2 records."""

from __future__ import annotations

from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.wire.ros_geometry import header_to_ros, stamp_from_ros
from ambler.wire.ros_types import record_class

_Image = record_class("sensor_msgs/msg/Image")
_CameraInfo = record_class("sensor_msgs/msg/CameraInfo")
_RegionOfInterest = record_class("sensor_msgs/msg/RegionOfInterest")

_GREY = ("mono8", "8UC1")
_DEPTH, _DEPTH_METRES = ("16UC1", "mono16"), "32FC1"
_FARTHEST = 65.535  # metres that a depth can tell
_MODELS = {"plumb_bob": 5, "rational_polynomial": 8}


def image_to_ros(message: m.Image) -> Any:
    height, width = message.data.shape
    is_depth = message.is_depth
    encoding, step = (_DEPTH[0], 2 * width) if is_depth else (_GREY[0], width)
    data = np.ascontiguousarray(message.data, "<u2" if is_depth else np.uint8).reshape(-1).view(np.uint8)
    return _Image(header_to_ros(message.stamp_ns, message.frame), height, width, encoding, 0, step, data)


def image_from_ros(record: Any) -> m.Image:
    """Read a picture, grey or of depth; raises ValueError for other encodings."""
    rows = np.array(record.data, np.uint8).reshape(record.height, record.step)
    stamp_ns, frame, width = stamp_from_ros(record.header), record.header.frame_id, int(record.width)
    if record.encoding in _GREY:
        return m.Image(stamp_ns, frame, np.ascontiguousarray(rows[:, :width]))
    order = ">" if record.is_bigendian else "<"
    if record.encoding in _DEPTH:
        depth = np.ascontiguousarray(rows[:, : 2 * width]).view(f"{order}u2")
        return m.Image(stamp_ns, frame, depth.astype(np.uint16))
    if record.encoding != _DEPTH_METRES:
        known = ", ".join((*_GREY, *_DEPTH, _DEPTH_METRES))
        raise ValueError(f"pictures must be grey or of depth ({known}), not {record.encoding}")
    metres = np.ascontiguousarray(rows[:, : 4 * width]).view(f"{order}f4").astype(np.float64)
    is_told = np.isfinite(metres) & (metres > 0.0) & (metres <= _FARTHEST)
    return m.Image(stamp_ns, frame, np.rint(1000.0 * np.where(is_told, metres, 0.0)).astype(np.uint16))


def camera_info_to_ros(message: m.CameraInfo) -> Any:
    camera = message.model
    names = {count: name for name, count in _MODELS.items()}
    projection = np.column_stack((camera.matrix, np.zeros(3)))
    return _CameraInfo(
        header_to_ros(message.stamp_ns, message.frame),
        camera.height,
        camera.width,
        names[len(camera.distortion)],
        np.array(camera.distortion, np.float64),
        camera.matrix.reshape(-1),
        np.eye(3).reshape(-1),
        projection.reshape(-1),
        0,
        0,
        _RegionOfInterest(0, 0, 0, 0, False),
    )


def camera_info_from_ros(record: Any) -> m.CameraInfo:
    """Read a projection; raises ValueError for a model of distortion that Ambler does not know. The name is the frame's."""
    if len(record.d) != _MODELS.get(record.distortion_model):
        raise ValueError(f"distortion {record.distortion_model!r} with {len(record.d)} coefficients is not supported")
    k = [float(v) for v in record.k]
    distortion = tuple(float(v) for v in record.d)
    frame = record.header.frame_id
    model = CameraModel(frame, int(record.width), int(record.height), k[0], k[4], k[2], k[5], distortion)
    return m.CameraInfo(stamp_from_ros(record.header), frame, model)
