"""Where glass stands: lines in the map, with evidence for and against every 10 cm of them, gathered while the robot moves.

For: a specular peak of a scanner; an ultrasonic echo from the line where the laser sees nothing. Against: a beam that would have to
come back, because it meets the line squarely, and passes; a free ultrasonic cone across the line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.grid import OCC_FREE, GridSpec
from ambler.core.messages import JudgedEcho, LaserScan
from ambler.core.se2 import SE2, wrap_angle
from ambler.core.units import Radians
from ambler.kernels.range_layer import draw_segments
from ambler.perception.glass import SpecularPeak

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class GlassMapConfig:
    """A sighting belongs to a line within `join_distance` (m) and `join_angle` (rad) of it, if glass is known within `reach` (m) along it.
    A piece of a line is `bin` metres long. Evidence is counted between `least` and `most`, a beam
    that passes as `disproof`; from `believed` on it is glass. Pieces without any
    evidence between two of glass are bridged up to `bridge` metres; runs shorter than `length_min` are not told. An echo confirms a line
    within `echo_tolerance` metres. Beams within `square` radians of the normal must come back from glass."""

    join_distance: float = 0.15
    join_angle: Radians = math.radians(8.0)
    reach: float = 3.0
    bin: float = 0.1
    least: float = -6.0
    most: float = 10.0
    disproof: float = 2.0
    believed: float = 2.0
    bridge: float = 0.5
    length_min: float = 0.3
    echo_tolerance: float = 0.1
    square: Radians = math.radians(3.0)
    contradiction_range: float = 6.0
    through: float = 0.3
    memory: float = 60.0


@dataclass(slots=True)
class _Line:
    """`anchor` is a point of the line and `angle` its direction; both are means. `evidence` by piece, counted from the anchor."""

    anchor: F64
    angle: float
    weight: float = 1.0
    evidence: dict[int, float] = field(default_factory=dict)

    @property
    def along(self) -> F64:
        return np.array([math.cos(self.angle), math.sin(self.angle)])

    @property
    def normal(self) -> F64:
        return np.array([-math.sin(self.angle), math.cos(self.angle)])

    def coordinates(self, point: F64) -> tuple[float, float]:
        """Return how far along the line a point lies, and how far beside it."""
        offset = point - self.anchor
        return float(offset @ self.along), float(offset @ self.normal)

    def point(self, s: float) -> F64:
        return np.asarray(self.anchor + s * self.along)


def twist_of_sensor(base_from_sensor: SE2, twist: F64) -> F64:
    """Return the velocity (vx, vy, wz) of a sensor in its own frame, from that of the base."""
    vx, vy, wz = twist
    x, y = vx - wz * base_from_sensor.y, vy + wz * base_from_sensor.x
    c, s = math.cos(base_from_sensor.yaw), math.sin(base_from_sensor.yaw)
    return np.array([c * x + s * y, -s * x + c * y, wz])


class GlassMap:
    """Takes sightings in the map frame; `segments` returns what is believed."""

    def __init__(self, config: GlassMapConfig | None = None) -> None:
        self.config = config if config is not None else GlassMapConfig()
        self._lines: list[_Line] = []

    def add_peak(self, peak: SpecularPeak, map_from_sensor: SE2) -> None:
        """Take a specular peak, with the scanner's pose at the time of its beam."""
        foot = map_from_sensor.transform(peak.foot[None])[0]
        angle = wrap_angle(map_from_sensor.yaw + peak.angle + 0.5 * math.pi)
        line = self._find(foot, angle)
        if line is None:
            line = _Line(foot, angle)
            self._lines.append(line)
        else:
            self._refine(line, foot, angle)
        s, _ = line.coordinates(foot)
        left = 1.0 if math.cos(line.angle - angle) > 0 else -1.0
        ends = sorted((s - left * peak.right, s + left * peak.left))
        self._count(line, ends[0], ends[1], 1.0)

    def add_scan(self, scan: LaserScan, map_from_sensor: SE2, sensor_twist: F64) -> None:
        """Look for beams that meet a known line squarely and pass it; `sensor_twist` (vx, vy, wz) is the scanner's own velocity."""
        n = len(scan.ranges)
        for line in self._lines:
            angle, pose = 0.0, map_from_sensor
            for _ in range(2):  # the beam's index tells its time, its time the pose, the pose the index
                _, beside = line.coordinates(np.array([pose.x, pose.y]))
                angle = wrap_angle(line.angle - math.copysign(0.5 * math.pi, beside) - pose.yaw)
                k = round(((angle - scan.angle_min) % (2.0 * math.pi)) / scan.angle_increment)
                pose = map_from_sensor @ SE2.exp(sensor_twist * (min(k, n) * scan.time_increment))
            s, beside = line.coordinates(np.array([pose.x, pose.y]))
            distance = abs(beside)
            if 0.15 < distance < self.config.contradiction_range and self._sees_through(scan, angle, distance):
                half = max(0.5 * self.config.bin, distance * math.tan(0.5 * self.config.square))
                self._count(line, s - half, s + half, -self.config.disproof)

    def add_echo(self, echo: JudgedEcho, map_from_sensor: SE2) -> None:
        """Take a judged echo, with the transducer's pose at its stamp."""
        c, pose = self.config, map_from_sensor
        for line in self._lines:
            s, beside = line.coordinates(np.array([pose.x, pose.y]))
            off = wrap_angle(line.angle - math.copysign(0.5 * math.pi, beside) - pose.yaw)
            if abs(off) > math.radians(40.0):
                continue
            side = math.copysign(1.0, -beside)
            slant = math.copysign(
                max(0.0, abs(off) - echo.half_angle), off
            )  # of the ray nearest to the normal, away from it
            nearest = abs(beside) / math.cos(slant)
            at = s + side * abs(beside) * math.tan(slant)
            if echo.is_unexplained and abs(nearest - echo.distance) <= c.echo_tolerance:
                self._count(line, at - c.bin, at + c.bin, 1.0)
            elif abs(beside) > 0.1 and nearest < min(echo.free - 0.2, 2.0) and slant == 0.0:
                self._count(line, s - 0.5 * c.bin, s + 0.5 * c.bin, -1.0)

    def is_open(self, peak: SpecularPeak, map_from_sensor: SE2, points: F64) -> Bools:
        """Say which points (N, 2) of the map along the pane of a peak lie where beams passed: no pane goes on there. bool (N,)."""
        pose = map_from_sensor
        line = self._find(pose.transform(peak.foot[None])[0], wrap_angle(pose.yaw + peak.angle + 0.5 * math.pi))
        if line is None:
            return np.zeros(len(points), np.bool_)
        pieces = np.floor((points - line.anchor) @ line.along / self.config.bin)
        return np.array([line.evidence.get(int(k), 0.0) <= -self.config.believed for k in pieces], np.bool_)

    def fade(self) -> None:
        """Forget half of all evidence, and what is little after that: for a frame that drifts."""
        for line in self._lines:
            line.evidence = {k: 0.5 * v for k, v in line.evidence.items() if abs(v) >= 1.0}
        self._lines = [line for line in self._lines if line.evidence]

    def segments(self) -> tuple[F32, F32]:
        """Return the believed segments float32 (N, 4) of (x0, y0, x1, y1) and their confidence float32 (N,)."""
        rows, confidence = [], []
        for line in self._lines:
            for first, last, mean in self._runs(line):
                a, b = line.point(first * self.config.bin), line.point((last + 1) * self.config.bin)
                rows.append([*a, *b])
                confidence.append(1.0 - math.exp(-mean / 4.0))
        return np.array(rows, np.float32).reshape(-1, 4), np.array(confidence, np.float32)

    def _find(self, foot: F64, angle: float) -> _Line | None:
        c = self.config
        best, best_beside = None, c.join_distance
        for line in self._lines:
            s, beside = line.coordinates(foot)
            is_parallel = abs(math.sin(line.angle - angle)) <= math.sin(c.join_angle)
            bins = [k for k, v in line.evidence.items() if v > 0.0] or [0]
            gap = max(min(bins) * c.bin - s, s - (max(bins) + 1) * c.bin)
            if is_parallel and gap <= c.reach and abs(beside) <= best_beside:
                best, best_beside = line, abs(beside)
        return best

    def _refine(self, line: _Line, foot: F64, angle: float) -> None:
        """Move the line towards a sighting, about the middle of what is known of it."""
        line.weight = min(line.weight + 1.0, self.config.memory)
        gain = 1.0 / line.weight
        s, beside = line.coordinates(foot)
        line.anchor = line.anchor + gain * beside * line.normal
        turn = wrap_angle(2.0 * (angle - line.angle)) / 2.0
        pivot = line.point(s)
        line.angle = wrap_angle(line.angle + gain * turn)
        line.anchor = pivot - s * line.along

    def _count(self, line: _Line, first: float, last: float, change: float) -> None:
        c = self.config
        for k in range(math.floor(first / c.bin), math.floor(last / c.bin) + 1):
            line.evidence[k] = min(max(line.evidence.get(k, 0.0) + change, c.least), c.most)

    def _sees_through(self, scan: LaserScan, angle: float, distance: float) -> bool:
        """Whether nearly all beams about a direction go far beyond a distance; beams that see something nearer say nothing."""
        c = self.config
        increment = abs(scan.angle_increment)
        k = ((angle - scan.angle_min) % (2.0 * math.pi)) / scan.angle_increment
        half = 0.5 * c.square / increment
        beams = np.arange(math.ceil(k - half), math.floor(k + half) + 1)
        is_full = len(scan.ranges) * increment > 2.0 * math.pi - 1.5 * increment
        beams = beams % len(scan.ranges) if is_full else beams[(beams >= 0) & (beams < len(scan.ranges))]
        ranges = scan.ranges[beams]
        ranges = ranges[~np.isnan(ranges)]
        return bool(len(ranges) >= 3 and np.count_nonzero(ranges > distance + c.through) >= 0.8 * len(ranges))

    def _runs(self, line: _Line) -> list[tuple[int, int, float]]:
        """Return (first, last, mean evidence) of the believed runs of pieces."""
        c = self.config
        glass = sorted(k for k, v in line.evidence.items() if v >= c.believed)
        runs: list[list[int]] = []
        for k in glass:
            if runs and self._is_bridged(line, runs[-1][-1], k):
                runs[-1].append(k)
            else:
                runs.append([k])
        return [
            (run[0], run[-1], float(np.mean([line.evidence[k] for k in run])))
            for run in runs
            if (run[-1] - run[0] + 1) * c.bin >= c.length_min - 1e-9
        ]

    def _is_bridged(self, line: _Line, a: int, b: int) -> bool:
        c = self.config
        return (b - a - 1) * c.bin <= c.bridge + 1e-9 and all(line.evidence.get(k, 0.0) >= 0.0 for k in range(a + 1, b))


WAY = 0.8  # metres; a narrower opening beside a pane is a part of the pane that was not seen yet, not a way


def seen_through_glass(
    spec: GridSpec, occupancy: NDArray[np.int8], segments: F32, start: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.bool_]:
    """Return the cells bool [iy, ix] that the map calls free and whose only ways from `start`, at least `WAY` wide, lead through glass: they
    are known because they were seen through it."""
    free = (occupancy >= OCC_FREE) & (occupancy < 50)
    start_cell = spec.cell_of(*start)
    if len(segments) == 0 or not spec.contains_cell(*start_cell):
        return np.zeros(spec.shape, np.bool_)
    glass = np.zeros(spec.shape, np.uint8)
    draw_segments(glass, spec.origin_x, spec.origin_y, spec.resolution, np.array(segments, np.float64), 1)
    open_cells, radius = free & (glass == 0), 0.5 * WAY / spec.resolution
    with_glass, here = _regions(open_cells, start_cell, radius)
    without, everywhere = _regions(free, start_cell, radius)
    behind = (with_glass > 0) & (with_glass != here) & (without == everywhere)
    if here == 0 or not behind.any():
        return np.zeros(spec.shape, np.bool_)
    return np.asarray(open_cells & (ndimage.distance_transform_edt(~behind) <= radius))


def _regions(free: NDArray[np.bool_], start: tuple[int, int], radius: float) -> tuple[NDArray[np.int32], int]:
    """Return the regions int32 [iy, ix] that the centre of a disc can move in (0: nowhere), and that of the start."""
    clear = np.asarray(ndimage.distance_transform_edt(free)) > radius
    regions = np.asarray(ndimage.label(clear, np.ones((3, 3)))[0])
    near = np.where(
        clear, np.hypot(*np.ogrid[-start[0] : free.shape[0] - start[0], -start[1] : free.shape[1] - start[1]]), np.inf
    )
    nearest = np.unravel_index(int(np.argmin(near)), near.shape)
    return np.asarray(regions, np.int32), int(regions[nearest])
