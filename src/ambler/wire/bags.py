"""ROS 1 bags and ROS 2 bags (SQLite and MCAP; files or folders) as messages of Ambler, in the order of their log times.

Reads laser scans (of several echoes the first), clouds (PointCloud2 and Livox' own message), inertial measurements, satellite fixes, odometry, transforms, poses and occupancy grids, with the definitions that
the bag carries, else with those of Jazzy. Other topics are listed and skipped.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import apsw
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError as Reader1Error
from rosbags.rosbag2 import ReaderError as Reader2Error
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.wire import ros_geometry, ros_grids, ros_livox, ros_sensors
from ambler.wire.cut_bags import index_copy, is_whole_bag, is_whole_database, rescue_rows
from ambler.wire.mcap_reader import finish_copy, is_finished
from ambler.wire.ros_types import STORE

_FromRos = Callable[[Any], m.Message]
_READINGS: dict[str, tuple[type[m.Message], _FromRos]] = {
    "sensor_msgs/msg/LaserScan": (m.LaserScan, ros_sensors.laser_scan_from_ros),
    "sensor_msgs/msg/MultiEchoLaserScan": (m.LaserScan, ros_sensors.multi_echo_scan_from_ros),
    "sensor_msgs/msg/PointCloud2": (m.PointCloud, ros_sensors.cloud_from_ros),
    "livox_ros_driver/msg/CustomMsg": (m.PointCloud, ros_livox.livox_from_ros),
    "livox_ros_driver2/msg/CustomMsg": (m.PointCloud, ros_livox.livox_from_ros),
    "sensor_msgs/msg/Imu": (m.Imu, ros_sensors.imu_from_ros),
    "sensor_msgs/msg/NavSatFix": (m.GnssFix, ros_sensors.gnss_from_ros),
    "nav_msgs/msg/Odometry": (m.Odometry, ros_geometry.odometry_from_ros),
    "tf2_msgs/msg/TFMessage": (m.Transforms, ros_geometry.transforms_from_ros),
    "tf/msg/tfMessage": (m.Transforms, ros_geometry.transforms_from_ros),
    "geometry_msgs/msg/PoseStamped": (m.PoseStamped, ros_geometry.pose_stamped_from_ros),
    "nav_msgs/msg/OccupancyGrid": (m.OccupancyGrid, ros_grids.occupancy_grid_from_ros),
}
_MAGIC = {b"#ROSBAG V2.0": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\x00": ".db3"}
_KINDS = {".bag": "ROS 1 bag", ".mcap": "MCAP file", ".db3": "SQLite bag"}
# By kind: has a file its end, and a finished copy of what lies before the cut.
_CUTS: dict[str, tuple[Callable[[Path], bool], Callable[[Path, Path], int]]] = {
    ".bag": (is_whole_bag, index_copy),
    ".mcap": (is_finished, finish_copy),
    ".db3": (is_whole_database, rescue_rows),
}
# What opening or reading foreign bytes may raise, found by fuzzing (tests/wire/test_bags.py).
_DAMAGE = (
    *(AnyReaderError, Reader1Error, Reader2Error, SerdeError, TypesysError, apsw.Error, sqlite3.Error, struct.error),
    *(ValueError, LookupError, TypeError, AttributeError, OverflowError, AssertionError, OSError, EOFError),
    *(RuntimeError, MemoryError, RecursionError),
)


class BagMessage(NamedTuple):
    """One message of a bag: its topic, the message, and when it was logged (ns)."""

    topic: str
    message: m.Message
    log_ns: int


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a bag: `message_class` None means that its type is skipped."""

    name: str
    ros_type: str
    count: int
    message_class: type[m.Message] | None


class BagReader:
    """An open bag; use it as a context manager, or close it."""

    def __init__(self, path: Path, reader: AnyReader, resources: ExitStack, notes: tuple[str, ...]) -> None:
        self.path = path
        self.notes = notes
        """What its reader must know: which files were cut off."""
        self._reader = reader
        self._resources = resources

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all files."""
        self._resources.close()

    def topics(self) -> tuple[BagTopic, ...]:
        """Return all topics by name; a topic that was written by several publishers is one."""
        counts: dict[tuple[str, str], int] = {}
        for connection in self._reader.connections:
            key = (connection.topic, connection.msgtype)
            counts[key] = counts.get(key, 0) + connection.msgcount
        return tuple(
            BagTopic(n, t, c, _READINGS[t][0] if t in _READINGS else None) for (n, t), c in sorted(counts.items())
        )

    @property
    def start_ns(self) -> int:
        """Log time of the first message."""
        return int(self._reader.start_time)

    @property
    def end_ns(self) -> int:
        """Log time just after the last message."""
        return int(self._reader.end_time)

    def messages(
        self, topics: Collection[str] | None = None, types: Collection[type[m.Message]] | None = None
    ) -> Iterator[BagMessage]:
        """Yield the messages of the topics (None: all) and classes (None: all) by log time.

        Raises BadInputError for a topic that the bag does not have or that cannot be read, and for damage on the way.
        """
        known = {t.name: t for t in self.topics()}
        for name in topics or ():
            if name not in known:
                raise BadInputError(f"{self.path}: no topic {name!r}, only {', '.join(known) or 'none'}")
            if known[name].message_class is None:
                raise BadInputError(
                    f"{self.path}: topic {name!r} is {known[name].ros_type}, which Ambler does not read"
                )
        wanted = [
            c
            for c in self._reader.connections
            if c.msgtype in _READINGS
            and (topics is None or c.topic in topics)
            and (types is None or _READINGS[c.msgtype][0] in types)
        ]
        return self._read(wanted)

    def _read(self, connections: list[Any]) -> Iterator[BagMessage]:
        if not connections:
            return
        try:
            decoders = {c.msgtype: self._decoder(c.msgtype) for c in connections}
            for connection, log_ns, data in self._reader.messages(connections):
                message = self._decode(connection, data, decoders[connection.msgtype])
                yield BagMessage(connection.topic, message, log_ns)
        except _DAMAGE as error:
            raise BadInputError(f"{self.path}: damaged: {_first_line(error)}") from error

    def _decoder(self, ros_type: str) -> Callable[[bytes], m.Message]:
        """Return what reads the bytes of a type: through the record that the bag defines, clouds of Livox' drivers without."""
        reader, from_ros = self._reader, _READINGS[ros_type][1]
        is_livox = from_ros is ros_livox.livox_from_ros
        if is_livox and ros_livox.has_drivers_layout(reader.typestore, ros_type, is_cdr=reader.is2):
            return ros_livox.livox_from_cdr if reader.is2 else ros_livox.livox_from_ros1
        return lambda data: from_ros(reader.deserialize(data, ros_type))

    def _decode(self, connection: Any, data: bytes, decoder: Callable[[bytes], m.Message]) -> m.Message:
        try:
            return decoder(data)
        except _DAMAGE as error:
            text = f"{len(data)} bytes on {connection.topic} are no {connection.msgtype}: {_first_line(error)}"
            raise BadInputError(f"{self.path}: damaged: {text}") from error


def open_bag(path: Path | str) -> BagReader:
    """Open a bag: a `.bag`, `.mcap` or `.db3` file, or a folder with them (rosbag2 folders, or split recordings).

    A SQLite bag that was not closed (its `-wal` file holds data) and a file that was cut off, or has no index, are completed in a temporary copy; the
    original, which may lie on a read-only file system, is never written to. Raises BadInputError that names what is wrong with the file.
    """
    path = Path(path)
    if not path.exists():
        raise BadInputError(f"{path}: no such file or folder")
    resources = ExitStack()
    try:
        files = _find_files(path)
        cut = [file for file in files if not _CUTS[file.suffix][0](file)]
        paths = _finished(files, cut, resources) if cut else _complete(path, files, resources)
        reader = AnyReader(paths, default_typestore=STORE)
        reader.open()
        resources.callback(reader.close)
        if reader.message_count == 0:
            raise BadInputError(f"{path}: holds no messages")
    except _DAMAGE as error:
        resources.close()
        raise BadInputError(f"{path}: cannot be read: {_first_line(error)}") from error
    except BadInputError:
        resources.close()
        raise
    return BagReader(path, reader, resources, tuple(f"{file} is cut off: read up to the cut" for file in cut))


def _find_files(path: Path) -> list[Path]:
    """Return the storage files of a bag, checked by their first bytes."""
    if path.is_file():
        files = [path]
    else:
        files = sorted(f for f in path.iterdir() if f.suffix in _KINDS)
        if not files:
            packed = next((f.name for f in path.iterdir() if f.suffix == ".zstd"), None)
            if packed is not None and (path / "metadata.yaml").exists():
                return []
            raise BadInputError(f"{path}: no bag in this folder (no .bag, .mcap or .db3 file)")
        if len({f.suffix for f in files}) > 1:
            raise BadInputError(f"{path}: bags of several kinds in one folder: {', '.join(f.name for f in files)}")
    for file in files:
        _check_kind(file)
    return files


def _check_kind(file: Path) -> None:
    with file.open("rb") as stream:
        head = stream.read(16)
    if not head:
        raise BadInputError(f"{file}: is empty")
    if head.startswith(b"#ROSBAG V") and not head.startswith(b"#ROSBAG V2.0"):
        raise BadInputError(
            f"{file}: ROS 1 bags of version {head[9:12].decode(errors='replace')} are not supported, only 2.0"
        )
    suffix = next((s for magic, s in _MAGIC.items() if head.startswith(magic)), None)
    if suffix is None:
        raise BadInputError(f"{file}: is no ROS 1 bag, MCAP file or SQLite bag (its first bytes are {head[:8]!r})")
    if suffix != file.suffix:
        raise BadInputError(f"{file}: is a {_KINDS[suffix]} by its content; rename it to end in {suffix}")


def _complete(path: Path, files: list[Path], resources: ExitStack) -> list[Path]:
    """Return what to open: the folder when it has its metadata, else the files; copies where write-ahead logs hold data."""
    is_folder = path.is_dir() and (path / "metadata.yaml").exists()
    logged = {f for f in files if f.suffix == ".db3" and _has_data(_log_of(f))}
    if not logged:
        return [path] if is_folder else files
    folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="ambler-bag-")))
    copies = []
    for file in files:
        copy = folder / file.name
        if file in logged:
            shutil.copyfile(file, copy)
            shutil.copyfile(_log_of(file), _log_of(copy))
            _checkpoint(copy)
        else:
            copy.symlink_to(file.resolve())
        copies.append(copy)
    if is_folder:
        shutil.copyfile(path / "metadata.yaml", folder / "metadata.yaml")
        return [folder]
    return copies


def _finished(files: list[Path], cut: list[Path], resources: ExitStack) -> list[Path]:
    """Return the files, those that were cut off as finished copies; one that holds no message before the cut is left out."""
    folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="ambler-bag-")))
    out = []
    for file in files:
        if file not in cut:
            out.append(file)
        elif _CUTS[file.suffix][1](file, folder / file.name) > 0:
            out.append(folder / file.name)
    if not out:
        raise BadInputError(f"{files[0]}: is cut off before its first message")
    return out


def _log_of(file: Path) -> Path:
    return file.with_name(file.name + "-wal")


def _has_data(file: Path) -> bool:
    return file.exists() and file.stat().st_size > 0


def _checkpoint(file: Path) -> None:
    """Move the write-ahead log of a SQLite file into it."""
    connection = sqlite3.connect(file)
    try:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.execute("PRAGMA journal_mode=DELETE")
    finally:
        connection.close()


def _first_line(error: BaseException) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__
