"""What turns MCAP files into a rosbag2 folder: the QoS profiles of channels and `metadata.yaml` (version 9, Jazzy)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from ambler.wire.atomic_file import write_whole
from ambler.wire.ros_types import type_hash

METADATA_FILE = "metadata.yaml"
_VERSION = 9
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """A recorded topic: its ROS name and type, whether it is latched, and how many messages it has."""

    name: str
    ros_type: str
    is_latched: bool
    count: int


@dataclass(frozen=True, slots=True)
class FileSummary:
    """A recorded file: its name inside the folder, first and last log time (nanoseconds), number of messages."""

    name: str
    start_ns: int
    end_ns: int
    count: int


def qos_profiles(is_latched: bool) -> list[dict[str, Any]]:
    """Return the profile that the topic was offered with: reliable; latched topics are transient-local with depth 1."""
    return [
        {
            "history": "keep_last",
            "depth": 1 if is_latched else 10,
            "reliability": "reliable",
            "durability": "transient_local" if is_latched else "volatile",
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }
    ]


@cache
def qos_text(is_latched: bool) -> str:
    """Return the profile as the YAML text of the channel metadata `offered_qos_profiles`."""
    return yaml.safe_dump(qos_profiles(is_latched), sort_keys=False).strip()


@cache
def is_latched_text(text: str) -> bool:
    """Say whether the YAML text of a channel offers transient-local (by name, or 1 in older files)."""
    profiles = yaml.safe_load(text) or []
    return any(profile.get("durability") in ("transient_local", 1) for profile in profiles)


def write_metadata(folder: Path, files: list[FileSummary], topics: list[TopicSummary]) -> None:
    """Write `metadata.yaml` atomically; its presence says that the recording was finished."""
    start = min((f.start_ns for f in files if f.count), default=0)
    end = max((f.end_ns for f in files if f.count), default=0)
    information = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(f.count for f in files),
        "topics_with_message_count": [_topic_entry(topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [f.name for f in files],
        "files": [_file_entry(f) for f in files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    write_whole(folder / METADATA_FILE, yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False))


def _topic_entry(topic: TopicSummary) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.ros_type,
            "serialization_format": "cdr",
            "offered_qos_profiles": qos_profiles(topic.is_latched),
            "type_description_hash": type_hash(topic.ros_type),
        },
        "message_count": topic.count,
    }


def _file_entry(file: FileSummary) -> dict[str, Any]:
    return {
        "path": file.name,
        "starting_time": {"nanoseconds_since_epoch": file.start_ns},
        "duration": {"nanoseconds": file.end_ns - file.start_ns},
        "message_count": file.count,
    }
