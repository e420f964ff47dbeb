"""Clouds of Livox' drivers, read from their bytes, are those that the records of rosbags give; damage is refused where rosbags refuses it."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.wire.bags import open_bag
from ambler.wire.ros_livox import livox_from_cdr, livox_from_ros, livox_from_ros1

POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
MESSAGE = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points\n"
)
PACKAGES = ("livox_ros_driver", "livox_ros_driver2")
STAMP_NS = 1_700_000_000_123_456_789


def store_of(distribution: Stores, point: str = POINT) -> Typestore:
    store = get_typestore(distribution)
    for package in PACKAGES:
        store.register(get_types_from_msg(point, f"{package}/msg/CustomPoint"))
        store.register(get_types_from_msg(MESSAGE, f"{package}/msg/CustomMsg"))
    return store


ROS1, ROS2 = store_of(Stores.ROS1_NOETIC), store_of(Stores.ROS2_HUMBLE)


@dataclass(frozen=True)
class Serializer:
    """A way to write a message, and the two ways to read it: as records of rosbags, and from its bytes."""

    store: Typestore
    write: Callable[[object, str], bytes]
    read: Callable[[bytes, str], object]
    fast: Callable[[bytes], m.PointCloud]


SERIALIZERS = {
    "ros1": Serializer(ROS1, lambda r, t: bytes(ROS1.serialize_ros1(r, t)), ROS1.deserialize_ros1, livox_from_ros1),
    "cdr little": Serializer(
        ROS2, lambda r, t: bytes(ROS2.serialize_cdr(r, t, little_endian=True)), ROS2.deserialize_cdr, livox_from_cdr
    ),
    "cdr big": Serializer(
        ROS2, lambda r, t: bytes(ROS2.serialize_cdr(r, t, little_endian=False)), ROS2.deserialize_cdr, livox_from_cdr
    ),
}


def record_of(store: Typestore, package: str, count: int, frame: str, *more: int) -> Any:
    """Return a message of random points, two of them no numbers."""
    rng = np.random.default_rng(count)
    xyz = rng.normal(0.0, 20.0, (count, 3)).astype(np.float32)
    xyz[1:2], xyz[2:3] = np.nan, np.inf
    late, bytes_ = rng.integers(0, 2**32, count), rng.integers(0, 256, (count, 3))
    make = store.types[f"{package}/msg/CustomPoint"]
    points = [make(int(t), *map(float, p), *map(int, b), *more) for t, p, b in zip(late, xyz, bytes_, strict=True)]
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(STAMP_NS, 10**9))
    number = (7,) if store.fielddefs["std_msgs/msg/Header"][1][0][0] == "seq" else ()
    header = store.types["std_msgs/msg/Header"](*number, stamp, frame)
    reserved = np.array([1, 2, 3], np.uint8)
    return store.types[f"{package}/msg/CustomMsg"](header, STAMP_NS + 5, count, 9, reserved, points)


def check_same(got: m.PointCloud, expected: m.PointCloud) -> None:
    assert (got.stamp_ns, got.frame) == (expected.stamp_ns, expected.frame)
    for name in ("points", "intensity", "time", "ring"):
        a, b = getattr(got, name), getattr(expected, name)
        assert (a.dtype, a.shape, a.flags.c_contiguous) == (b.dtype, b.shape, True), name
        np.testing.assert_array_equal(a, b, name)


@pytest.mark.parametrize("name", SERIALIZERS)
@pytest.mark.parametrize("package", PACKAGES)
def test_every_value_is_that_of_the_record(name: str, package: str) -> None:
    way, ros_type = SERIALIZERS[name], f"{package}/msg/CustomMsg"
    for count, frame in [(0, "lidar"), (1, "livox_frame"), (500, "livox"), *((3, "f" * n) for n in range(9))]:
        record = record_of(way.store, package, count, frame)
        data = way.write(record, ros_type)
        cloud = way.fast(data)
        check_same(cloud, livox_from_ros(way.read(data, ros_type)))
        assert (cloud.stamp_ns, cloud.frame, len(cloud.points)) == (STAMP_NS, frame, count)
        assert cloud.intensity.tolist() == [p.reflectivity for p in record.points]
        assert cloud.ring.tolist() == [p.line for p in record.points]


@pytest.mark.parametrize("name", SERIALIZERS)
def test_damage_is_refused_where_rosbags_refuses_it(name: str) -> None:
    """Cut at every byte, too long by up to five, and with every byte of the head and the first points changed."""
    way, ros_type = SERIALIZERS[name], "livox_ros_driver2/msg/CustomMsg"
    data = way.write(record_of(way.store, "livox_ros_driver2", 4, "lidar"), ros_type)
    damaged = [data[:size] for size in range(len(data))] + [data + bytes(more) for more in range(6)]
    for at in range(len(data)):
        damaged += [data[:at] + bytes([new]) + data[at + 1 :] for new in (0, 1, 200, data[at] ^ 128)]
    refused = 0
    for trial in damaged:
        try:
            expected = livox_from_ros(way.read(trial, ros_type))
        except SerdeError:
            refused += 1
            with pytest.raises((ValueError, struct.error)):
                way.fast(trial)
        else:
            check_same(way.fast(trial), expected)
    assert refused > len(data) - 4


def write_bag(kind: str, folder: Path, store: Typestore, records: list[bytes]) -> Path:
    path = folder / ("a.bag" if kind == "ros1" else "bag")
    storage = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if kind == "ros1" else Writer2(path, version=9, storage_plugin=storage) as writer:
        to = writer.add_connection("/livox/lidar", "livox_ros_driver2/msg/CustomMsg", typestore=store)
        for k, data in enumerate(records):
            writer.write(to, STAMP_NS + k, data)  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("kind", ["ros1", "db3", "mcap"])
def test_a_bag_of_the_drivers_is_read_without_records(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    way = SERIALIZERS["ros1" if kind == "ros1" else "cdr little"]
    ros_type = "livox_ros_driver2/msg/CustomMsg"
    data = way.write(record_of(way.store, "livox_ros_driver2", 50, "lidar"), ros_type)
    expected = livox_from_ros(way.read(data, ros_type))
    monkeypatch.delattr(AnyReader, "deserialize")
    with open_bag(write_bag(kind, tmp_path, way.store, [data, data[:-1]])) as bag:
        messages = bag.messages(types=[m.PointCloud])
        cloud = next(messages).message
        assert isinstance(cloud, m.PointCloud)
        check_same(cloud, expected)
        with pytest.raises(
            BadInputError, match=rf"{len(data) - 1} bytes on /livox/lidar are no {ros_type}: 50 points end"
        ):
            next(messages)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_definition_of_another_layout_is_followed(kind: str, tmp_path: Path) -> None:
    """As in drivers that somebody changed: here a point has one number more."""
    store = store_of(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE, POINT + "uint16 more\n")
    record = record_of(store, "livox_ros_driver2", 50, "lidar", 513)
    serialize = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
    data = bytes(serialize(record, "livox_ros_driver2/msg/CustomMsg"))
    with open_bag(write_bag(kind, tmp_path, store, [data])) as bag:
        cloud = next(bag.messages()).message
    assert isinstance(cloud, m.PointCloud)
    check_same(cloud, livox_from_ros(record))


def test_a_bag_that_defines_no_types_holds_clouds_of_the_drivers(tmp_path: Path) -> None:
    """SQLite bags of ROS 2 Humble and before."""
    record = record_of(ROS2, "livox_ros_driver2", 50, "lidar", 513)
    data = bytes(ROS2.serialize_cdr(record, "livox_ros_driver2/msg/CustomMsg"))
    path = write_bag("db3", tmp_path, ROS2, [data])
    for file in tmp_path.rglob("*.db3"):
        with sqlite3.connect(file) as table:
            assert table.execute("DELETE FROM message_definitions").rowcount > 0
    with open_bag(path) as bag:
        cloud = next(bag.messages()).message
    assert isinstance(cloud, m.PointCloud)
    check_same(cloud, livox_from_ros(record))
