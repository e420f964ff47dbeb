"""The ROS 2 types that Ambler speaks: the Jazzy type store of rosbags plus the package `ambler_msgs` (folder `msg/`).

CDR inside Ambler is always that of this store; other distributions exist at the edge only.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

OWN_PACKAGE = "ambler_msgs"
_QUATERNION = "MSG: geometry_msgs/Quaternion\n"


def _load_store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    folder = resources.files("ambler.wire") / "msg"
    for file in sorted(folder.iterdir(), key=lambda f: f.name):
        if file.name.endswith(".msg"):
            name = f"{OWN_PACKAGE}/msg/{file.name.removesuffix('.msg')}"
            store.register(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    return store


STORE = _load_store()


def record_class(ros_type: str) -> Any:
    """Return the generated dataclass of a ROS type such as `sensor_msgs/msg/Imu`; raises KeyError."""
    return STORE.types[ros_type]


@cache
def message_definition(ros_type: str) -> str:
    """Return the concatenated `.msg` text (encoding `ros2msg`) of a type and everything it contains.

    The defaults of Quaternion (x y z 0, w 1), which the type store drops, are put back: viewers compare texts.
    """
    text = STORE.generate_msgdef(ros_type, ros_version=2)[0]
    head, found, tail = text.partition(_QUATERNION)
    if not found:
        return text
    for name, default in (("x", 0), ("y", 0), ("z", 0), ("w", 1)):
        tail = tail.replace(f"float64 {name}\n", f"float64 {name} {default}\n", 1)
    return head + found + tail


@cache
def type_hash(ros_type: str) -> str:
    """Return the RIHS01 hash of a type, as `metadata.yaml` of rosbag2 wants it."""
    return STORE.hash_rihs01(ros_type)
