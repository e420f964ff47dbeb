"""N scanners to one virtual 360° scan and one cloud, every point moved to a common time with the odometry.

Method: each beam is taken at its own instant, carried by the base's motion (constant twist between odometry knots) to the
common time, and drawn into the bins of the virtual scanner; the nearest surface of a bin wins, whichever scanner saw it.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion, MotionKnots
from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.messages import LaserScan, PointCloud
from ambler.kernels import scan_draw, scan_motion
from ambler.perception.array_pool import ArrayPool
from ambler.perception.merger_config import AngleWindow, MergerConfig, ScannerConfig
from ambler.perception.self_mask import SelfMask

__all__ = ["AngleWindow", "MergeResult", "MergerConfig", "ScanMerger", "ScannerConfig", "SourceReport", "SourceState"]

F64 = NDArray[np.float64]
NO_INTENSITY = np.zeros(0, np.float32)
FLOAT32_SLACK_NS = 1000  # a period told as float32 is not exact


class SourceState(enum.Enum):
    """What a source gave to a merged scan."""

    FRESH = "fresh"  # a scan that no merged scan held before
    REUSED = "reused"  # its newest scan again, moved to the new common time
    STALE = "stale"  # dropped: its newest scan is older than max_age
    SILENT = "silent"  # dropped: it never sent a scan
    NO_ODOMETRY = "no_odometry"  # dropped: the motion since its scan is not known


@dataclass(frozen=True, slots=True)
class SourceReport:
    """One source of one merged scan: age of its last beam at the common time (s, nan if silent) and where its beams went."""

    frame: str
    state: SourceState
    age: float
    returns: int = 0
    empty: int = 0
    masked: int = 0
    invalid: int = 0
    outside_window: int = 0

    @property
    def is_dropped(self) -> bool:
        return self.state not in (SourceState.FRESH, SourceState.REUSED)


@dataclass(frozen=True, slots=True)
class MergeResult:
    """One merged scan.

    `scan`: +inf where a scanner saw through to the end, NaN where nobody looked; all bins hold at the stamp, so its
    time_increment is 0. `cloud`: every return in the base frame at the stamp, moved already; `ring` is the index of its source, `time` when it
    was really measured. `free`: the ends of the rays without return, likewise. `bin_source` int16 (B,): source of
    each bin, -1 for none. `latency`: seconds from the end of the oldest fresh scan to the merge.
    """

    scan: LaserScan
    cloud: PointCloud
    free: PointCloud
    bin_source: NDArray[np.int16]
    sources: tuple[SourceReport, ...]
    latency: float


class _Source:
    """The state of one scanner: its newest scan, and tables that depend on the layout of its beams only."""

    def __init__(self, config: ScannerConfig) -> None:
        self.config = config
        self.offset = np.array(config.base_from_sensor.translation)
        self.scan: LaserScan | None = None
        self.begin_ns = 0
        self.end_ns = 0
        self.arrived_ns = 0
        self.is_fresh = False
        self._layout: tuple[int, float, float] | None = None

    def take(self, scan: LaserScan, now_ns: int) -> bool:
        """Keep a scan and say whether it is newer than the last one."""
        begin_ns = scan.stamp_ns - round(self.config.clock_offset * 1e9)
        if self.scan is not None and begin_ns == self.begin_ns:
            return False
        self.scan, self.begin_ns, self.arrived_ns, self.is_fresh = scan, begin_ns, now_ns, True
        self.end_ns = begin_ns + round(max(len(scan.ranges) - 1, 0) * scan.time_increment * 1e9)
        layout = (len(scan.ranges), scan.angle_min, scan.angle_increment)
        if layout != self._layout:
            self._layout = layout
            angles = scan.angle_min + np.arange(layout[0]) * scan.angle_increment
            rotation = self.config.base_from_sensor.matrix()[:3, :2]
            self.directions = (rotation @ np.stack([np.cos(angles), np.sin(angles)])).astype(np.float32)
            used = np.ones(layout[0], np.bool_)
            for window in self.config.windows:
                used &= window.keeps(angles)
            self.used = used.astype(np.uint8)
            self.columns = np.zeros((3, layout[0]), np.float32)
            self.scratch = np.zeros((2, layout[0]), np.uint8)
            self.kinds = np.zeros(layout[0], np.uint8)
        return True

    @property
    def period(self) -> float:
        """Seconds between two scans, as the scan says."""
        assert self.scan is not None
        return max(self.scan.scan_time, (self.end_ns - self.begin_ns) * 1e-9)


class ScanMerger:
    """Collects scans and odometry; `is_due` says when a merged scan should be made, `merge` makes it.

    It is due as soon as every live source has sent a new scan, or when a scan has waited one period of its scanner. A source
    that never sent anything is waited for before the first merged scan only.
    """

    def __init__(self, config: MergerConfig) -> None:
        self.config = config
        self.odometry = BaseMotion(span=max(2.0, 4.0 * config.max_age), max_extrapolation=0.1)
        self._sources = {s.frame: _Source(s) for s in config.scanners}
        self._mask = SelfMask(config.self_mask)
        angles = -math.pi + 2.0 * math.pi / config.bins * np.arange(config.bins)
        self._bin_directions = np.ascontiguousarray(np.column_stack([np.cos(angles), np.sin(angles)]))
        origin = config.base_from_origin
        self._origin = np.array([origin.x, origin.y, math.cos(origin.yaw), math.sin(origin.yaw)])
        self._joining = np.array([config.join_tolerance, config.join_gap])
        self._pool = ArrayPool()
        self._zeros = np.zeros(0, np.float32)
        self._last_stamp_ns: int | None = None

    def add_scan(self, scan: LaserScan, now_ns: int) -> None:
        """Take a scan of the source that its frame names; raises BadInputError for an unknown frame."""
        source = self._sources.get(scan.frame)
        if source is None:
            raise BadInputError(f"no scanner {scan.frame!r} in the merger, only {list(self._sources)}")
        source.take(scan, now_ns)

    def is_due(self, now_ns: int) -> bool:
        """Say whether a merged scan should be made now."""
        live = [s for s in self._sources.values() if not self._is_stale(s, now_ns)]
        fresh = [s for s in live if s.is_fresh]
        if not fresh:
            return False
        may_still_come = self._last_stamp_ns is None and any(s.scan is None for s in self._sources.values())
        if len(fresh) == len(live) and not may_still_come:
            return True
        return any(now_ns - s.arrived_ns >= s.period * 1e9 - FLOAT32_SLACK_NS for s in fresh)

    def merge(self, now_ns: int) -> MergeResult:
        """Make the merged scan; raises StaleInputError when no source, or no odometry, is fresh enough."""
        live = [s for s in self._sources.values() if not self._is_stale(s, now_ns)]
        if not live:
            raise StaleInputError(f"no scanner has sent a scan in the last {self.config.max_age} s")
        stamp_ns = self._common_time(live)
        begin_ns = min(*(s.begin_ns for s in live), stamp_ns)
        oldest_ns = self.odometry.oldest_ns
        if oldest_ns is not None and begin_ns < oldest_ns:
            begin_ns = min((s.begin_ns for s in live if s.begin_ns >= oldest_ns), default=begin_ns)
        knots = self.odometry.knots(begin_ns, max(s.end_ns for s in live), stamp_ns)
        drawing = _Drawing(self.config.bins, sum(len(s.kinds) for s in live), self._pool, self._intensities(live))
        range_max = self.config.range_max
        if range_max is None:
            range_max = min(s.scan.range_max for s in live if s.scan is not None)
        limits = np.array([self.config.range_min, range_max])
        reports = []
        for index, source in enumerate(self._sources.values()):
            report = self._draw(source, index, now_ns, stamp_ns, knots, begin_ns, limits, drawing)
            reports.append(report)
        if all(r.is_dropped for r in reports):
            raise StaleInputError("the odometry does not cover any of the newest scans")
        waits = [now_ns - s.end_ns for s in live if s.is_fresh]
        for source in live:
            source.is_fresh = False
        self._last_stamp_ns = stamp_ns
        return self._result(stamp_ns, limits, drawing, live, tuple(reports), max(waits, default=0) * 1e-9)

    def _is_stale(self, source: _Source, now_ns: int) -> bool:
        return source.scan is None or now_ns - source.end_ns > self.config.max_age * 1e9

    def _common_time(self, live: list[_Source]) -> int:
        """The end of the newest scan, but not later than the newest odometry; always later than the last merged scan."""
        stamp_ns = max(s.end_ns for s in live)
        newest_ns = self.odometry.newest_ns
        if newest_ns is None:
            raise StaleInputError("no odometry yet")
        stamp_ns = min(stamp_ns, newest_ns)
        if self._last_stamp_ns is not None and stamp_ns <= self._last_stamp_ns:
            stamp_ns = max(*(s.end_ns for s in live), self._last_stamp_ns + 1)
        return stamp_ns

    def _draw(
        self,
        source: _Source,
        index: int,
        now_ns: int,
        stamp_ns: int,
        knots: MotionKnots,
        begin_ns: int,
        limits: F64,
        drawing: _Drawing,
    ) -> SourceReport:
        frame, scan = source.config.frame, source.scan
        if scan is None:
            return SourceReport(frame, SourceState.SILENT, math.nan)
        age = (stamp_ns - source.end_ns) * 1e-9
        if self._is_stale(source, now_ns):
            return SourceReport(frame, SourceState.STALE, age)
        if source.begin_ns < begin_ns:
            return SourceReport(frame, SourceState.NO_ODOMETRY, age)
        timing = np.array([(source.begin_ns - stamp_ns) * 1e-9, scan.time_increment])
        counts = np.zeros(5, np.int64)
        scan_motion.move_beams(
            *(scan.ranges, source.directions, source.used, np.array([scan.range_min, scan.range_max]), timing),
            *(source.offset, knots.times, knots.poses, knots.twists),
            *(self._mask.vertices, self._mask.starts, self._mask.reach, source.columns, source.kinds, counts),
        )
        intensity = NO_INTENSITY if drawing.intensity is None else drawing.intensity
        drawing.rows = scan_motion.gather_rays(
            *(source.columns, source.kinds, scan_motion.RETURN, scan.ranges, source.directions, source.offset),
            *(scan.intensities, timing, index, drawing.rows),
            *(drawing.points, intensity, drawing.time, drawing.source),
        )
        drawing.take_free(source, scan, timing, index, int(counts[scan_motion.EMPTIES]))
        scan_draw.draw_scan(
            *(source.columns, source.kinds, self._origin, self._bin_directions, limits, self._joining),
            *(index, source.scratch, drawing.ranges, drawing.free, drawing.sources, drawing.beams),
        )
        state = SourceState.FRESH if source.is_fresh else SourceState.REUSED
        return SourceReport(frame, state, age, *(int(c) for c in counts))

    def _result(
        self,
        stamp_ns: int,
        limits: F64,
        drawing: _Drawing,
        live: list[_Source],
        reports: tuple[SourceReport, ...],
        latency: float,
    ) -> MergeResult:
        config, rows = self.config, drawing.rows
        ranges = np.empty(config.bins, np.float32)
        scan_draw.finish_scan(drawing.ranges, drawing.free, ranges)
        scan = LaserScan(
            stamp_ns,
            config.frame,
            angle_min=-math.pi,
            angle_increment=2.0 * math.pi / config.bins,
            time_increment=0.0,
            scan_time=max(s.period for s in live),
            range_min=config.range_min,
            range_max=float(limits[1]),
            ranges=ranges,
            intensities=self._bin_intensities(drawing),
        )
        cloud = PointCloud(
            stamp_ns,
            config.base_frame,
            drawing.points[:rows],
            self._no_values(rows) if drawing.intensity is None else drawing.intensity[:rows],
            drawing.time[:rows],
            drawing.source[:rows],
        )
        free = drawing.free_rays(stamp_ns, config.base_frame, self._no_values)
        return MergeResult(scan, cloud, free, drawing.sources, reports, latency)

    def _intensities(self, live: list[_Source]) -> NDArray[np.float32] | None:
        """Return room for the intensities of the cloud, zeros; None when no source measures any."""
        scans = [s.scan for s in live if s.scan is not None]
        if not any(len(scan.intensities) == len(scan.ranges) > 0 for scan in scans):
            return None
        return np.zeros(sum(len(scan.ranges) for scan in scans), np.float32)

    def _no_values(self, rows: int) -> NDArray[np.float32]:
        """Return zeros float32 (rows,), which all clouds share."""
        if len(self._zeros) < rows:
            self._zeros = np.zeros(rows, np.float32)
            self._zeros.flags.writeable = False
        return self._zeros[:rows]

    def _bin_intensities(self, drawing: _Drawing) -> NDArray[np.float32]:
        """Intensity of the beam that won each bin, 0 where none; empty when no source measures intensities."""
        if drawing.intensity is None:
            return np.zeros(0, np.float32)
        scans = [s.scan for s in self._sources.values()]
        out = np.zeros(self.config.bins, np.float32)
        for index, scan in enumerate(scans):
            won = drawing.sources == index
            if scan is not None and won.any() and len(scan.intensities) == len(scan.ranges):
                out[won] = scan.intensities[drawing.beams[won]]
        return out


class _Drawing:
    """The arrays that one merge fills; `intensity` is None when no source measures intensities."""

    def __init__(self, bins: int, beams: int, pool: ArrayPool, intensity: NDArray[np.float32] | None) -> None:
        self.ranges = np.full(bins, np.inf)
        self.free = np.zeros(bins, np.uint8)
        self.sources = np.full(bins, -1, np.int16)
        self.beams = np.zeros(bins, np.int32)
        self.points: NDArray[np.float32] = pool.take((beams, 3), np.float32)
        self.intensity = intensity
        self.time: NDArray[np.float32] = pool.take((beams,), np.float32)
        self.source: NDArray[np.uint16] = pool.take((beams,), np.uint16)
        self.rows = 0
        self._free: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]] = []

    def take_free(self, source: _Source, scan: LaserScan, timing: F64, index: int, count: int) -> None:
        """Keep the rays of a source that met nothing; there are few."""
        if count == 0:
            return
        points, time = np.empty((count, 3), np.float32), np.empty(count, np.float32)
        which = np.empty(count, np.uint16)
        scan_motion.gather_rays(
            *(source.columns, source.kinds, scan_motion.EMPTY, scan.ranges, source.directions, source.offset),
            *(NO_INTENSITY, timing, index, 0, points, NO_INTENSITY, time, which),
        )
        self._free.append((points, time, which))

    def free_rays(self, stamp_ns: int, frame: str, zeros: Callable[[int], NDArray[np.float32]]) -> PointCloud:
        """Return the rays that met nothing as a cloud of their ends."""
        if not self._free:
            none = np.zeros(0, np.float32)
            return PointCloud(stamp_ns, frame, np.zeros((0, 3), np.float32), none, none, np.zeros(0, np.uint16))
        points, time, which = (np.concatenate(column) for column in zip(*self._free, strict=True))
        return PointCloud(stamp_ns, frame, points, zeros(len(points)), time, which)
