"""Name profiles: the ROS names under which streams are told to others, where those expect others than ours.

A profile renames for viewers alone; a recording always has our names, because replay and judgement find things by them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from ambler.runtime.topics import Topic

NameProfile = Literal["own", "original"]

# The original deployment on CMU's stack; what is not here has the same name there (/cmd_vel, /joy, /terrain_map, /way_point, /stop, /speed ...).
_ORIGINAL: Mapping[str, str] = {
    "odometry": "/state_estimation",
    "registered_view": "/registered_scan",
    "imu": "/imu/data",
    "image": "/camera/color/image_raw",
    "camera_info": "/camera/color/camera_info",
    "depth": "/camera/depth/image_rect_raw",
    "depth_info": "/camera/depth/camera_info",
    "local_path": "/path",
    "visibility_graph": "/viz_graph_topic",
}
PROFILES: Mapping[NameProfile, Mapping[str, str]] = {"own": {}, "original": _ORIGINAL}


def named(topic: Topic[Any], profile: NameProfile) -> Topic[Any]:
    """Return a topic under the name that a profile gives it; a device's instance keeps its ending."""
    name = PROFILES[profile].get(topic.table_name)
    if name is None:
        return topic
    return replace(topic, ros_name=f"{name}/{topic.instance}" if topic.instance else name)
