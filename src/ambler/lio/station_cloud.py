"""Stations: while a robot holds still, the registered clouds of its odometry grow into one dense cloud.

A station begins when the base is at rest by its odometry, ends after the time that was asked for, and ends early when the base moves. Its points lie in the base
as it stood, so that a later correction of its pose takes them along.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Odometry, PointCloud
from ambler.core.se3 import SE3
from ambler.core.units import Radians
from ambler.lio.thin_cloud import first_in_cells

F32 = NDArray[np.float32]
GROWTH = 1.25  # of the cells when memory is full
MERGED = 20  # scans after which the points so far are thinned out
SMOOTHING = 0.1  # seconds over which velocities are averaged: a gyroscope's noise is no motion


@dataclass(frozen=True, slots=True)
class StationCloudConfig:
    """When a base is at rest: for `rest_time` s slower than `speed_most` (m/s) and `turn_most` (rad/s); it has moved when it is faster, or `shift_most` m or
    `twist_most` rad away from where the station began. A robot that is not at rest after `patience` s gets no station, one that is moved after less than `least` s
    leaves none. Clouds keep a point per cube of `cell` m; when all stations together hold more than `points_most`, cubes grow for all."""

    rest_time: float = 0.5
    speed_most: float = 0.04
    turn_most: Radians = 0.04
    shift_most: float = 0.03
    twist_most: Radians = 0.02
    patience: float = 6.0
    least: float = 1.0
    cell: float = 0.02
    points_most: int = 8_000_000

    def __post_init__(self) -> None:
        for name in ("rest_time", "speed_most", "turn_most", "shift_most", "twist_most", "patience", "cell"):
            if not getattr(self, name) > 0.0:
                raise BadInputError(f"stations {name}: must be positive, is {getattr(self, name)}")
        if self.points_most < 1000:
            raise BadInputError(f"stations points_most: must be at least 1000, is {self.points_most}")


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A dense cloud: `points` float32 (N, 3) in the base as it stood at `stamp_ns`, one per cube of `cell` m, with `intensity` float32 (N,); `odom_from_base` is where that was by the
    odometry. It held for `seconds` and saw `scans`; `density` is how many times as many points it has as one of them (in cubes of the same size, on average)."""

    stamp_ns: int
    level: int
    odom_from_base: SE3
    seconds: float
    scans: int
    density: float
    cell: float
    points: F32
    intensity: F32


class RestWatch:
    """Says since when a base has been at rest, by the velocities of its odometry, averaged over `SMOOTHING` seconds."""

    def __init__(self, config: StationCloudConfig) -> None:
        self._config = config
        self._mean = np.zeros(6)
        self._last_ns: int | None = None
        self.since_ns: int | None = None
        """None: it moves, or nothing is known."""

    def add(self, odometry: Odometry) -> None:
        """Take the odometry of a later instant."""
        twist = np.array([*odometry.linear, *odometry.angular])
        dt = math.inf if self._last_ns is None else 1e-9 * (odometry.stamp_ns - self._last_ns)
        self._last_ns = odometry.stamp_ns
        self._mean += (1.0 - math.exp(-dt / SMOOTHING)) * (twist - self._mean)
        c = self._config
        is_slow = np.linalg.norm(self._mean[:3]) <= c.speed_most and np.linalg.norm(self._mean[3:]) <= c.turn_most
        if not is_slow or dt > 5.0 * SMOOTHING:  # nothing is known of what was not told
            self.since_ns = None
        if is_slow and self.since_ns is None:
            self.since_ns = odometry.stamp_ns


class ScanState(enum.Enum):
    """What a station is doing."""

    WAITING = "waiting for rest"
    HOLDING = "holding"
    OVER = "over"


@dataclass(slots=True)
class _Part:
    stamp_ns: int
    points: F32
    intensity: F32


@dataclass(slots=True)
class StationScan:
    """One station while it is made: give it odometry (`move`) and registered clouds in the odometry's frame (`see`) as they come, and the time (`tick`), until
    its state is OVER. `code` then is SUCCEEDED, or NOT_AT_REST, MOVED, LOST or STALE_INPUT with one sentence."""

    config: StationCloudConfig
    hold: float
    level: int
    cell: float
    begun_ns: int
    state: ScanState = ScanState.WAITING
    code: str = ""
    text: str = ""
    scans: int = 0
    _held: Odometry | None = None
    _newest_ns: int | None = None
    _seconds: float = 0.0
    _scan_points: int = 0
    _parts: deque[_Part] = field(default_factory=deque)

    @property
    def seconds(self) -> float:
        """How long it has held, s."""
        return self._seconds

    def move(self, odometry: Odometry, rest: RestWatch) -> None:
        """Take the newest odometry, which `rest` has taken, too."""
        self._newest_ns = odometry.stamp_ns
        if self.state is ScanState.WAITING:
            is_at_rest = rest.since_ns is not None and odometry.stamp_ns - rest.since_ns >= self.config.rest_time * 1e9
            if is_at_rest and odometry.stamp_ns >= self.begun_ns:
                self._held, self.state = odometry, ScanState.HOLDING
        elif self.state is ScanState.HOLDING and self._held is not None:
            away = self._held.pose.inverse() @ odometry.pose
            shift, twist = math.hypot(*away.translation), 2.0 * math.acos(min(1.0, abs(away.rotation[0])))
            if rest.since_ns is None or shift > self.config.shift_most or twist > self.config.twist_most:
                self._give_back(odometry.stamp_ns - round(self.config.rest_time * 1e9))
                self._end("MOVED", f"the robot was moved after {self._seconds:.1f} of {self.hold:g} s")
                return
            self._seconds = 1e-9 * (odometry.stamp_ns - self._held.stamp_ns)
            if self._seconds >= self.hold:
                self._end("SUCCEEDED", "")

    def see(self, cloud: PointCloud) -> None:
        """Take a registered cloud whose scan has ended at its stamp; kept is what was seen while the base held still."""
        if self.state is not ScanState.HOLDING or self._held is None or cloud.stamp_ns < self._held.stamp_ns:
            return
        points = np.asarray(self._held.pose.inverse().transform(cloud.points), np.float32)
        kept = first_in_cells(points, self.cell)
        self._parts.append(_Part(cloud.stamp_ns, points[kept], cloud.intensity[kept]))
        self.scans += 1
        self._scan_points += len(kept)
        if len(self._parts) > MERGED:
            self._merge(cloud.stamp_ns - round(self.config.rest_time * 1e9))

    def tick(self, now_ns: int, *, is_lost: bool = False) -> None:
        """Look at the clock, and at whether the odometry has lost its map."""
        if self.state is ScanState.OVER:
            return
        newest_ns = self.begun_ns if self._newest_ns is None else self._newest_ns
        if is_lost:
            self._end("LOST", "the scans do not fit the map")
        elif now_ns - newest_ns > self.config.rest_time * 1e9:
            self._end("STALE_INPUT", f"no odometry for {self.config.rest_time:g} s")
        elif self.state is ScanState.WAITING and now_ns - self.begun_ns > self.config.patience * 1e9:
            self._end("NOT_AT_REST", f"the robot did not come to rest within {self.config.patience:g} s")

    def station(self) -> Station | None:
        """Return what it gave; None where that is nothing, or the base was moved too soon."""
        is_whole = self.code == "SUCCEEDED" or (self.code == "MOVED" and self._seconds >= self.config.least)
        if self._held is None or not self._parts or not is_whole:
            return None
        self._merge(self._parts[-1].stamp_ns)
        part, scan_points = self._parts[0], self._scan_points / self.scans
        density = len(part.points) / max(1.0, scan_points)
        told = (self._held.stamp_ns, self.level, self._held.pose, self._seconds, self.scans, density, self.cell)
        return Station(*told, part.points, part.intensity)

    def _end(self, code: str, text: str) -> None:
        self.state, self.code, self.text = ScanState.OVER, code, text

    def _give_back(self, since_ns: int) -> None:
        """Leave out what was seen after an instant: the base may have moved already."""
        while self._parts and self._parts[-1].stamp_ns > since_ns:
            part = self._parts.pop()
            self.scans -= 1
            self._scan_points -= len(part.points)
        if self._held is not None:
            self._seconds = max(0.0, 1e-9 * (since_ns - self._held.stamp_ns))

    def _merge(self, until_ns: int) -> None:
        """Thin out together all that was seen until an instant."""
        old = [part for part in self._parts if part.stamp_ns <= until_ns]
        if not old:
            return
        points, intensity = np.concatenate([p.points for p in old]), np.concatenate([p.intensity for p in old])
        kept = first_in_cells(points, self.cell)
        while len(kept) > self.config.points_most:
            self.cell *= GROWTH
            kept = first_in_cells(points, self.cell)
        merged = _Part(old[-1].stamp_ns, points[kept], intensity[kept])
        self._parts = deque([merged, *(part for part in self._parts if part.stamp_ns > until_ns)])


class StationClouds:
    """All stations of a run, within `points_most`; `cell` is how large the cubes are now."""

    def __init__(self, config: StationCloudConfig) -> None:
        self._config = config
        self.cell = config.cell
        self.stations: list[Station] = []

    def add(self, station: Station) -> None:
        """Keep a station; where that is too much, all are thinned out."""
        self.cell = max(self.cell, station.cell)
        self.stations = [_thinned(s, self.cell) for s in (*self.stations, station)]
        while sum(len(s.points) for s in self.stations) > self._config.points_most:
            self.cell *= GROWTH
            self.stations = [_thinned(s, self.cell) for s in self.stations]


def _thinned(station: Station, cell: float) -> Station:
    """Return a station with one point per cube of `cell` m; itself when it has no more."""
    if station.cell >= cell:
        return station
    kept = first_in_cells(station.points, cell)
    return replace(station, cell=cell, points=station.points[kept], intensity=station.intensity[kept])
