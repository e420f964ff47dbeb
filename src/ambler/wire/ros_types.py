"""The ROS 2 types that Ambler speaks: the Jazzy type store of rosbags, std_srvs/Trigger, and the package `ambler_msgs` (folders
`msg/`, `srv/` and `action/`). The parts of a service or action are types of their own, named as ROS names them.

CDR inside Ambler is always that of this store; other distributions exist at the edge only.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

OWN_PACKAGE = "ambler_msgs"
TRIGGER = "std_srvs/srv/Trigger"
_PARTS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
_EMPTY = "uint8 structure_needs_at_least_one_member\n"  # what ROS 2 puts into an empty definition
_QUATERNION = "MSG: geometry_msgs/Quaternion\n"


def load_store(distribution: Stores) -> Typestore:
    """Return the types of a distribution of ROS 2 together with our own."""
    store = get_typestore(distribution)
    for kind, parts in _PARTS.items():
        folder = resources.files("ambler.wire") / kind
        for file in sorted(folder.iterdir(), key=lambda f: f.name):
            name, _, ending = file.name.rpartition(".")
            if ending == kind:
                _register(store, f"{OWN_PACKAGE}/{kind}/{name}", parts, file.read_text(encoding="utf-8"))
    _register(store, TRIGGER, _PARTS["srv"], "---\nbool success\nstring message\n")
    return store


def _register(store: Typestore, name: str, parts: tuple[str, ...], text: str) -> None:
    for part, definition in zip(parts, text.split("---\n"), strict=True):
        is_empty = not any(line.strip() and not line.startswith("#") for line in definition.splitlines())
        fields = definition + _EMPTY if is_empty else definition
        (parsed,) = get_types_from_msg(fields, f"{OWN_PACKAGE}/msg/Any").values()
        store.register({name + part: parsed})


STORE = load_store(Stores.ROS2_JAZZY)


def record_class(ros_type: str) -> Any:
    """Return the generated dataclass of a ROS type such as `sensor_msgs/msg/Imu`; raises KeyError."""
    return STORE.types[ros_type]


@cache
def message_definition(ros_type: str) -> str:
    """Return the concatenated `.msg` text (encoding `ros2msg`) of a type and everything it contains; raises KeyError."""
    return definition_in(STORE, ros_type)


def definition_in(store: Typestore, ros_type: str) -> str:
    """Return the text of a type as `store` defines it.

    The defaults of Quaternion (x y z 0, w 1), which the type store drops, are put back: viewers compare texts.
    """
    text = store.generate_msgdef(ros_type, ros_version=2)[0]
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
