"""One scan of a recording, ready for 2-D SLAM, and the scans of a CARMEN log."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import scan_points
from ambler.recordings.no_return import beam_numbers, find_no_return, is_exceeded
from ambler.registration.planar_scan import PlanarScan
from ambler.wire.carmen import CarmenLog, LaserLine
from ambler.wire.carmen_scanners import mount_parameter, side_of

F64 = NDArray[np.float64]

_NO_RETURN_RATIO = 0.98
_STEP_NS = 1000
_SAME_POSE = 1e-6  # m and rad between two poses of an odometry that tells nothing
_SEEN_ELSEWHERE = 0.2  # m by which half of the readings differ from those of the first scan where the scanner has moved
_MOVED_SHARE = 0.05  # of the scans must show it: people pass in front of a robot that stands, and doors open
DEAD_ODOMETRY = "odometry: its poses never change although the scans do, so it counts as none"
_NO_FLOOR = np.array([-np.inf, 0.0])  # of a planar log nothing is known of how the body leaned


@dataclass(frozen=True, slots=True)
class LogScanConfig:
    """Which ranges of a log count as returns, and how far a ray without return is taken as free, metres."""

    range_min: float = 0.1
    range_max: float = 30.0
    free_length: float = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class LogScan:
    """One scan of a recording and the odometry that is new since the scan before, up to this scan's last beam.

    `ranges` float32 (N,); `beam` float64 (3,) is (angle_min, angle_increment, time_increment); `limits` float64 (3,) is
    (range_min, range_max, free_length); `base_from_laser` the upper (3, 4) of a homogeneous matrix; `odometry` holds
    (stamp_ns, odom_from_base). The stamps of a recording's scans strictly increase.
    """

    stamp_ns: int
    ranges: NDArray[np.float32]
    beam: F64
    limits: F64
    base_from_laser: F64
    odometry: tuple[tuple[int, SE2], ...]

    @property
    def duration(self) -> float:
        """Seconds from the first beam to the last."""
        return max(0.0, (len(self.ranges) - 1) * float(self.beam[2]))

    def to_planar(self, sweep: F64) -> PlanarScan:
        """Return the points in the base frame of the stamp; `sweep` (K, 4) is the base's motion during the scan (`BaseMotion.sweep`)."""
        n = len(self.ranges)
        points, free_points = np.empty((n, 2), np.float32), np.empty((n, 2), np.float32)
        beams, counts = np.empty((2, n), np.int32), np.empty(2, np.int64)
        scan_points.beams_to_points(
            *(self.ranges, self.beam, self.limits, _NO_FLOOR, self.base_from_laser[None], 1.0, sweep, np.empty((3, 4))),
            *(points, free_points, beams[0], beams[1], counts),
        )
        origin = float(self.base_from_laser[0, 3]), float(self.base_from_laser[1, 3])
        return PlanarScan(self.stamp_ns, points[: counts[0]].copy(), free_points[: counts[1]].copy(), origin)


class OdometryFeed:
    """Hands out a track of (stamp_ns, odom_from_base) in step with the scans: to each what is new, and one more to interpolate."""

    def __init__(self, track: Sequence[tuple[int, SE2]]) -> None:
        self._track = sorted(track, key=lambda entry: entry[0])
        self._times = np.array([stamp_ns for stamp_ns, _ in self._track], np.int64)
        self._given = 0

    def until(self, stamp_ns: int) -> tuple[tuple[int, SE2], ...]:
        """Return what no scan before has got, up to the instant and the first one behind it."""
        end = max(self._given, int(np.searchsorted(self._times, stamp_ns, side="right")) + 1)
        given, self._given = tuple(self._track[self._given : end]), min(end, len(self._track))
        return given


def has_dead_odometry(scans: Iterable[LogScan]) -> bool:
    """Say whether all poses of the odometry are the same although the scans show that the robot moved."""
    first_pose: SE2 | None = None
    first_ranges: dict[tuple[int, bytes], NDArray[np.float32]] = {}
    compared = moved = 0
    for scan in scans:
        for _, pose in scan.odometry:
            first_pose = first_pose or pose
            if first_pose.distance_to(pose) > _SAME_POSE or abs(wrap_angle(pose.yaw - first_pose.yaw)) > _SAME_POSE:
                return False
        if first_pose is None:
            continue
        scanner = len(scan.ranges), scan.base_from_laser.tobytes()
        before = first_ranges.setdefault(scanner, scan.ranges)
        near, far, _ = scan.limits
        both = (before > near) & (before < far) & (scan.ranges > near) & (scan.ranges < far)
        compared += 1
        moved += bool(both.any() and np.median(np.abs(scan.ranges[both] - before[both])) > _SEEN_ELSEWHERE)
    return first_pose is not None and moved > _MOVED_SHARE * compared


def without_dead_odometry(scans: tuple[LogScan, ...], notes: list[str]) -> tuple[LogScan, ...]:
    """Return the scans, without their odometry where it is dead (`has_dead_odometry`), which `notes` then say."""
    if not has_dead_odometry(scans):
        return scans
    notes.append(DEAD_ODOMETRY)
    return tuple(replace(scan, odometry=()) for scan in scans)


def mounting(lines: list[LaserLine], parameters: dict[str, str]) -> SE2:
    """Return base_from_laser of one laser: the median of odom^-1 * laser when it is constant over the log.

    In logs whose laser column holds a corrected pose it is not, and RAWLASER lines have none; then the offset comes from the parameter
    (metres along x) or is zero.
    """
    pairs = [(e.odom_from_base, e.odom_from_laser) for e in lines]
    relative = np.array(
        [(base.inverse() @ laser).as_array() for base, laser in pairs if base is not None and laser is not None]
    )
    if len(relative):
        middle = np.median(relative, axis=0)
        yaw = math.atan2(float(np.sin(relative[:, 2]).mean()), float(np.cos(relative[:, 2]).mean()))
        off = np.hypot(relative[:, 0] - middle[0], relative[:, 1] - middle[1])
        turned = np.abs([wrap_angle(float(a) - yaw) for a in relative[:, 2]])
        if np.mean((off < 0.02) & (turned < math.radians(2.0))) > 0.9 and math.hypot(middle[0], middle[1]) < 3.0:
            return SE2(float(middle[0]), float(middle[1]), yaw)
    name = lines[0].name
    return SE2(mount_parameter(name, parameters) or 0.0, 0.0, math.pi if side_of(name) == "rear" else 0.0)


class CarmenScans:
    """The scans of a CARMEN log, once or as often as wanted, in file order; stamps that do not increase are moved just behind the one
    before. `notes` say what was found out about the scanners and what is uncertain.

    `base_from_laser` tells the mount of the only scanner instead of the log; raises BadInputError where there are several.
    """

    def __init__(self, log: CarmenLog, config: LogScanConfig | None = None, base_from_laser: SE2 | None = None) -> None:
        self._log = log
        self._config = config or LogScanConfig()
        self._has_odometry = True
        self._reach: dict[str, float] = {}
        self._mounts: dict[str, F64] = {}
        self.notes: list[str] = list(log.notes)
        names = sorted({line.name for line in log.lasers})
        if base_from_laser is not None and len(names) > 1:
            raise BadInputError(f"one mount for several scanners ({', '.join(names)}); it can be told of a single one")
        for name in names:
            lines = [line for line in log.lasers if line.name == name]
            self._mounts[name] = planar_matrix(base_from_laser or mounting(lines, log.parameters))
            self._reach[name] = self._find_reach(name, lines)
        if log.lasers[0].odom_from_base is None:
            self.notes.append(f"odometry: {len(log.odometry)} ODOM lines, because RAWLASER lines carry no pose")
        if has_dead_odometry(self):
            self._has_odometry = False
            self.notes.append(DEAD_ODOMETRY)

    def __iter__(self) -> Iterator[LogScan]:
        stamp_ns = -1
        feed = OdometryFeed([(round(line.stamp * 1e9), line.odom_from_base) for line in self._log.odometry])
        for line in self._log.lasers:
            stamp_ns = max(round(line.stamp * 1e9), stamp_ns + _STEP_NS)
            far = self._reach[line.name]
            yield LogScan(
                stamp_ns,
                line.ranges,
                np.array([line.angle_min, line.angle_increment, 0.0]),
                np.array([self._config.range_min, far, min(self._config.free_length, far)]),
                self._mounts[line.name],
                self._odometry(line, stamp_ns, feed),
            )

    def _odometry(self, line: LaserLine, stamp_ns: int, feed: OdometryFeed) -> tuple[tuple[int, SE2], ...]:
        if not self._has_odometry:
            return ()
        return feed.until(stamp_ns) if line.odom_from_base is None else ((stamp_ns, line.odom_from_base),)

    def _find_reach(self, name: str, lines: list[LaserLine]) -> float:
        """Return up to where readings of a scanner may be returns: by what the log tells of it, unless many readings lie beyond that, and by the readings."""
        ranges = np.concatenate([line.ranges for line in lines])
        found = find_no_return(ranges, beam_numbers(line.ranges for line in lines))
        told = float(np.median([line.max_range for line in lines]))
        if is_exceeded(told, ranges if found is None else ranges[ranges < found]):
            self.notes.append(
                f"{name}: many readings lie beyond the {told:g} m that the log tells as range: they count"
            )
            told = math.inf
        reach = min(_NO_RETURN_RATIO * told, self._config.range_max)
        if found is None or found >= reach:
            return reach
        share = 100.0 * float(np.mean(ranges >= found))
        self.notes.append(f"{name}: {share:.1f} % of the readings pile up from {found:.2f} m on and count as no return")
        return found


def planar_matrix(base_from_laser: SE2) -> F64:
    """Return the upper (3, 4) of the homogeneous matrix of a level mount at height 0."""
    c, s = math.cos(base_from_laser.yaw), math.sin(base_from_laser.yaw)
    return np.array([[c, -s, 0.0, base_from_laser.x], [s, c, 0.0, base_from_laser.y], [0.0, 0.0, 1.0, 0.0]])
