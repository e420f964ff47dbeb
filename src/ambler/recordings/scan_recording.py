"""Opens whatever holds planar scans: CARMEN logs, the Wean Hall log, ROS 1 bags and ROS 2 bags.

What a bag offers is chosen by what is unambiguous, and every choice is told: the scan topic, the odometry (a topic, else the transform
odom -> base), the base frame (the odometry's child) and the scanner's mount (from the transforms).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import TypeVar

import numpy as np

from ambler.core.errors import BadInputError, TransformError
from ambler.core.messages import LaserScan, Odometry, Transforms
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.recordings.bag_content import (
    BASE_FRAMES,
    ODOM_FRAME,
    RecordedFrames,
    Track,
    choose_topic,
    listed_topics,
    plain_frame,
    usable_pose,
)
from ambler.recordings.cloud_scan import BEFORE_NS
from ambler.recordings.lag import LagFinder, with_later_odometry
from ambler.recordings.log_scans import (
    F64,
    CarmenScans,
    LogScan,
    LogScanConfig,
    OdometryFeed,
    planar_matrix,
    without_dead_odometry,
)
from ambler.recordings.no_return import beam_numbers, find_no_return
from ambler.recordings.sweep import Sweep, SweepFinder, swept
from ambler.wire.bags import BagReader, open_bag
from ambler.wire.carmen import load_carmen
from ambler.wire.wean import read_wean_log

NO_TOPIC = "none"
_BAG_MAGIC = (b"#ROSBAG", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
_BAG_SUFFIXES = (".bag", ".mcap", ".db3")
# Many drivers report range_max, not more, where nothing came back.
_NO_RETURN_RATIO = 0.999

_Stamped = TypeVar("_Stamped", LaserScan, Odometry)


@dataclass(frozen=True, slots=True)
class Choices:
    """What the user decides: topic names (None: the only one; `none` as odometry: without), the mount (None: from the transforms),
    the order of the beams in time, and by how many seconds scans are stamped later than odometry (None: asked of the recording)."""

    scan_topic: str | None = None
    odom_topic: str | None = None
    base_from_laser: SE2 | None = None
    sweep: Sweep = Sweep.AUTO
    lag: float | None = None


@dataclass(frozen=True, slots=True)
class ScanRecording:
    """The scans of a recording in the order in which they are mapped; `stamps` are their times in seconds, `notes` say what was chosen
    and what was left out."""

    scans: Iterable[LogScan]
    stamps: tuple[float, ...]
    notes: tuple[str, ...]


def open_recording(
    path: Path,
    choices: Choices | None = None,
    config: LogScanConfig | None = None,
    find_sweep: SweepFinder | None = None,
    find_lag: LagFinder | None = None,
) -> ScanRecording:
    """Read a recording, whatever its format. Who chooses `Sweep.AUTO` gives `find_sweep`, such as
    `ambler.slam2d.sweep_search.find_sweep`; without it the beams are taken forward, as messages promise. Who tells no lag gives `find_lag`,
    such as `ambler.slam2d.lag_search.find_lag`; without it all stamps count as those of one clock.

    Raises BadInputError that names the line, byte or topic.
    """
    choices, config = choices or Choices(), config or LogScanConfig()
    recording = _read(path, choices, config)
    notes = list(recording.notes)
    scans = _on_one_clock(recording.scans, choices.lag, find_lag, notes)
    scans = _in_order_of_beams(scans, choices.sweep, find_sweep, notes)
    return replace(recording, scans=scans, notes=tuple(notes))


def _read(path: Path, choices: Choices, config: LogScanConfig) -> ScanRecording:
    """Return the scans as they stand in the file."""
    if path.is_dir() or path.suffix in _BAG_SUFFIXES or _head(path).startswith(_BAG_MAGIC):
        with open_bag(path) as bag:
            return _from_bag(bag, choices, config)
    if choices != Choices(base_from_laser=choices.base_from_laser, lag=choices.lag):
        raise BadInputError(f"{path}: is no ROS bag; topics and sweep can be chosen in bags only")
    if _head(path).startswith((b"L ", b"O ")):
        log = read_wean_log(path)
        scans = [m for m in log.messages if isinstance(m, LaserScan)]
        track = [(m.stamp_ns, m.pose.to_se2()) for m in log.messages if isinstance(m, Odometry)]
        matrix = planar_matrix(choices.base_from_laser or log.base_from_laser)
        return _recording(scans, track, matrix, config, ["format: Wean Hall log"])
    carmen = load_carmen(path)
    cut = () if carmen.cut_line is None else (f"{path} is cut off in line {carmen.cut_line}: read up to there",)
    try:
        carmen_scans = CarmenScans(carmen, config, choices.base_from_laser)
    except BadInputError as error:
        raise BadInputError(f"{path}: {error}") from error
    return ScanRecording(carmen_scans, tuple(line.stamp for line in carmen.lasers), (*cut, *carmen_scans.notes))


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(64)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _from_bag(bag: BagReader, choices: Choices, config: LogScanConfig) -> ScanRecording:
    scan_topic = choose_topic(bag, LaserScan, choices.scan_topic, "--scan-topic")
    if scan_topic is None:
        raise BadInputError(f"{bag.path}: no topic with laser scans, only {listed_topics(bag)}")
    odom_topic = None
    if choices.odom_topic != NO_TOPIC:
        odom_topic = choose_topic(bag, Odometry, choices.odom_topic, "--odom-topic")
    scans: list[LaserScan] = []
    odometry: list[Odometry] = []
    frames = RecordedFrames()
    scan_log_ns: list[int] = []
    odometry_log_ns: list[int] = []
    wanted = {t.name for t in bag.topics() if t.message_class is Transforms} | {scan_topic, odom_topic or scan_topic}
    for topic, message, log_ns in bag.messages(wanted):
        if isinstance(message, LaserScan):
            scans.append(message)
            scan_log_ns.append(log_ns)
        elif isinstance(message, Odometry):
            odometry.append(message)
            odometry_log_ns.append(log_ns)
        elif isinstance(message, Transforms):
            frames.add(message, is_static=topic.endswith("tf_static"))
    all_scans, whole = len(scans), [_has_angles(scan) for scan in scans]
    scans, scan_log_ns = list(compress(scans, whole)), list(compress(scan_log_ns, whole))
    if not scans:
        raise BadInputError(f"{bag.path}: none of the {all_scans} scans of {scan_topic} tells the angles of its beams")
    notes = [
        *bag.notes,
        f"scans: {scan_topic}, {len(scans)} of {len(scans[0].ranges)} beams in frame {scans[0].frame!r}",
    ]
    if len(scans) < all_scans:
        notes.append(f"left out: {all_scans - len(scans)} scans without beams, or that do not tell their angles")
    scans = _stamped(scans, scan_log_ns, scan_topic, notes)
    track: Track = []
    base = None
    if odom_topic is not None and odometry:
        base, track = _track_of(_stamped(odometry, odometry_log_ns, odom_topic, notes), odom_topic, frames, notes)
    elif choices.odom_topic is None:
        base, track = frames.odometry_track()
        source = f"transforms {ODOM_FRAME} -> {base}, {len(track)} poses" if track else "none in the recording"
        notes.append(f"odometry: {source}")
    if choices.base_from_laser is not None:
        matrix, text = planar_matrix(choices.base_from_laser), "as given"
    else:
        matrix, text = _mount(frames, base, scans, has_odometry=bool(track))
    notes += frames.notes
    return _recording(scans, track, matrix, config, [*notes, f"mount: {text}"])


def _track_of(
    odometry: list[Odometry], topic: str, frames: RecordedFrames, notes: list[str]
) -> tuple[str | None, Track]:
    """Return the base frame, None where no message names one and no transform hangs one under `odom`, and its poses."""
    track = [(m.stamp_ns, pose.to_se2()) for m in odometry if (pose := usable_pose(m.pose)) is not None]
    base = next((name for m in odometry if (name := plain_frame(m.child))), None)
    if base is not None:
        notes.append(f"odometry: {topic}, {len(track)} poses of {base!r}")
    else:
        base = frames.odometry_track()[0]
        of_base = "the base" if base is None else repr(base)
        notes.append(f"odometry: {topic}, {len(track)} poses that name no frame, taken for those of {of_base}")
    if len(track) < len(odometry):
        notes.append(
            f"left out: {len(odometry) - len(track)} of {len(odometry)} messages of {topic} that are no pose"
            " (not finite, or no rotation)"
        )
    return base, track


def _stamped(messages: list[_Stamped], log_ns: list[int], topic: str, notes: list[str]) -> list[_Stamped]:
    """Return the messages of a topic, under the times at which they were recorded if all of them bear one and the same stamp, and without those of
    a driver that had no clock yet and stamped with zero."""
    if len({m.stamp_ns for m in messages}) > 1 or (len(messages) == 1 and messages[0].stamp_ns > 0):
        first_ns = min(m.stamp_ns for m in messages if m.stamp_ns != 0)
        stamped = messages if first_ns <= BEFORE_NS else [m for m in messages if m.stamp_ns != 0]
        if len(stamped) < len(messages):
            notes.append(
                f"left out: {len(messages) - len(stamped)} of {len(messages)} messages of {topic} that bear no stamp"
            )
        return stamped
    notes.append(
        f"{topic}: all {len(messages)} messages bear the stamp {messages[0].stamp_ns * 1e-9:g} s; the times at which they were"
        " recorded are taken instead, which are later by an unknown delay"
    )
    return [replace(m, stamp_ns=ns) for m, ns in zip(messages, log_ns, strict=True)]


def _mount(frames: RecordedFrames, base: str | None, scans: list[LaserScan], *, has_odometry: bool) -> tuple[F64, str]:
    """Return the scanner's (3, 4) matrix in the base frame and how it was found."""
    laser = plain_frame(scans[0].frame)
    missing = ""
    for candidate in (base,) if base is not None else BASE_FRAMES:
        for stamp_ns in (scans[len(scans) // 2].stamp_ns, None):
            try:
                pose = frames.lookup(candidate, laser, stamp_ns)
            except TransformError as error:
                missing = missing or str(error)
                continue
            return _matrix(pose), f"{laser!r} at {_told(pose)} in {candidate!r}"
    if base is None and has_odometry:
        return _matrix(SE3()), "unknown; the scanner is taken to sit at the base (--mount tells otherwise)"
    if base is None:
        return _matrix(SE3()), f"unknown; the trajectory is that of the scanner {laser!r}"
    return _matrix(SE3()), f"unknown ({missing}); the scanner is taken to sit at {base!r} (--mount tells otherwise)"


def _matrix(pose: SE3) -> F64:
    return np.ascontiguousarray(pose.matrix()[:3])


def _told(pose: SE3) -> str:
    x, y, z = pose.translation
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m, {math.degrees(pose.to_se2().yaw):.1f} deg"


def _recording(
    scans: list[LaserScan], track: Track, matrix: F64, config: LogScanConfig, notes: list[str]
) -> ScanRecording:
    """Order by stamps; scans whose stamp another scan has already are left out, and that is told."""
    ordered: list[LaserScan] = []
    for scan in sorted(scans, key=lambda s: s.stamp_ns):
        if not ordered or scan.stamp_ns > ordered[-1].stamp_ns:
            ordered.append(scan)
    if len(ordered) < len(scans):
        notes.append(f"left out: {len(scans) - len(ordered)} scans with a stamp that another scan has")
    track = sorted(track, key=lambda t: t[0])
    if track:
        first, last = track[0][0], track[-1][0]
        outside = sum(not first <= s.stamp_ns <= last for s in ordered)
        if outside:
            notes.append(f"odometry does not cover {outside} of {len(ordered)} scans")
    reach = _reach_of_unknown_range(ordered, config, notes)
    stamps = tuple(s.stamp_ns * 1e-9 for s in ordered)
    prepared = without_dead_odometry(tuple(_with_odometry(ordered, track, matrix, config, reach)), notes)
    return ScanRecording(prepared, stamps, tuple(notes))


def _on_one_clock(
    scans: Iterable[LogScan], lag: float | None, find_lag: LagFinder | None, notes: list[str]
) -> Iterable[LogScan]:
    """Return the scans with their odometry at the instants at which they count by the scans' stamps."""
    if lag is not None:
        notes.append(f"lag: scans are taken as stamped {lag:.2f} s later than odometry, as given")
        return with_later_odometry(tuple(scans), lag) if lag else scans
    if find_lag is None:
        return scans
    scans = tuple(scans)
    found = find_lag(scans)
    if found is None:
        return scans
    notes.append(
        f"lag: scans are stamped {found.seconds:.2f} s later than odometry, which is moved to their clock (the turns that both tell differ by"
        f" {math.degrees(found.miss):.2f} deg instead of {math.degrees(found.miss_before):.2f}; --lag 0 leaves it)"
    )
    return with_later_odometry(scans, found.seconds)


def _in_order_of_beams(
    scans: Iterable[LogScan], sweep: Sweep, find_sweep: SweepFinder | None, notes: list[str]
) -> Iterable[LogScan]:
    if sweep is Sweep.AUTO and find_sweep is not None:
        scans = tuple(scans)
        sweep, on_walls = find_sweep(scans)
        if on_walls:
            shares = ", ".join(f"{s.value} {100 * share:.1f} %" for s, share in on_walls.items())
            notes.append(f"beams in time: {sweep.value} (returns on walls where it turns most: {shares})")
    return scans if sweep in (Sweep.AUTO, Sweep.FORWARD) else tuple(swept(scan, sweep) for scan in scans)


def _has_angles(scan: LaserScan) -> bool:
    return len(scan.ranges) > 0 and math.isfinite(scan.angle_min + scan.angle_increment) and scan.angle_increment != 0.0


def _has_range(scan: LaserScan) -> bool:
    return math.isfinite(scan.range_max) and scan.range_max > max(0.0, scan.range_min)


def _reach_of_unknown_range(scans: list[LaserScan], config: LogScanConfig, notes: list[str]) -> float:
    """Return up to where readings may be returns in scans that tell no range (0, not finite, or below the least one), metres."""
    silent = [scan for scan in scans if not _has_range(scan)]
    if not silent:
        return config.range_max
    ranges = [np.asarray(scan.ranges, np.float32) for scan in silent]
    found = find_no_return(np.concatenate(ranges), beam_numbers(ranges))
    reach = config.range_max if found is None else min(config.range_max, found)
    odd = [scan.range_max for scan in silent if not math.isinf(scan.range_max)]
    if odd or reach < config.range_max:
        tells = f"range_max: {odd[0]:g} m" if odd else "range_max: none"
        notes.append(
            f"{tells} in {len(silent)} of {len(scans)} scans; readings up to {reach:.2f} m count as returns there"
        )
    return reach


def _with_odometry(
    scans: list[LaserScan], track: Track, matrix: F64, config: LogScanConfig, reach: float
) -> Iterator[LogScan]:
    """Yield the scans with their odometry; `reach` is the range of those that tell none, metres."""
    feed = OdometryFeed(track)
    for scan in scans:
        end_ns = scan.stamp_ns + int(len(scan.ranges) * max(0.0, scan.time_increment) * 1e9)
        far = min(config.range_max, _NO_RETURN_RATIO * scan.range_max) if _has_range(scan) else reach
        near = max(config.range_min, scan.range_min) if scan.range_min < far else config.range_min
        yield LogScan(
            scan.stamp_ns,
            np.ascontiguousarray(scan.ranges, np.float32),
            np.array([scan.angle_min, scan.angle_increment, scan.time_increment]),
            np.array([near, far, min(config.free_length, far)]),
            matrix,
            feed.until(end_ns),
        )
