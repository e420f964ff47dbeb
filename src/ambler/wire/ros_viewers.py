"""The ROS 2 types that viewers know: Foxglove and Lichtblick load the definitions of Humble for every distribution since, and show an
alert for each type that a server defines in another way. So they get what Humble defines, and the bytes that go with it.
"""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores

from ambler.wire.ros_types import STORE, definition_in, load_store

DISTRIBUTION = "humble"
VIEWER_STORE = load_store(Stores.ROS2_HUMBLE)


@cache
def viewer_definition(ros_type: str) -> str:
    """Return the concatenated `.msg` text of a type as viewers know it; raises KeyError."""
    return definition_in(VIEWER_STORE, ros_type)


def viewer_bytes(ros_type: str, data: bytes) -> bytes:
    """Return the CDR of a message, given as our own CDR, without the fields that viewers do not know."""
    if not _has_other_fields(ros_type):
        return data
    record = STORE.deserialize_cdr(data, ros_type)
    fields = [getattr(record, name) for name, _ in VIEWER_STORE.fielddefs[ros_type][1]]
    return bytes(VIEWER_STORE.serialize_cdr(VIEWER_STORE.types[ros_type](*fields), ros_type))


@cache
def _has_other_fields(ros_type: str) -> bool:
    return STORE.fielddefs[ros_type][1] != VIEWER_STORE.fielddefs[ros_type][1]
