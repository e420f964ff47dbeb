"""Panes of glass in a planar scan, found by their specular peak (after Wang and Wang 2017).

Light passes a pane except where it meets it squarely: there a few beams come back, brighter than any painted surface could be, from
points on a line that is perpendicular to the brightest beam, while beams beside them see what stands behind the line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan
from ambler.core.se2 import wrap_angle
from ambler.core.se3 import SE3
from ambler.core.units import Radians

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
BRIGHT_MOST = 0.4  # of a scanner's returns, if white paint counts 1: two panes in the corner of a court are a sixth
TOLD_LEAST = 30.0  # returns before a scanner's unit is judged
TOLD_FADE = 0.99  # by which what it told counts less with each scan: a glance at nothing but a pane does not change what is known
FLATTEST = 1.4  # radians off the normal up to which the line of a pane is followed


@dataclass(frozen=True, slots=True)
class SpecularConfig:
    """`intensity_min` is what no painted surface reaches: the unit is that of white paint met squarely (1 in the simulator; measure it for a
    real scanner); above `intensity_max` shines retro-reflecting film, not glass. Returns count as on the pane within `tolerance` (m) of its line and as behind it from `behind` (m) on. At least
    `near_points` returns within `near` (rad) of the peak must lie on the line, `near_share` of all there; beams between `sides` (rad) on
    at least one side must pass, `through_share` of all there. `pane_angle` is the farthest from the normal at which panes reflect."""

    intensity_min: float = 1.5
    intensity_max: float = 30.0
    tolerance: float = 0.04
    behind: float = 0.25
    near: Radians = math.radians(2.5)
    near_points: int = 3
    near_share: float = 0.6
    sides: tuple[float, float] = (math.radians(14.0), math.radians(30.0))
    through_share: float = 0.6
    pane_angle: Radians = math.radians(13.0)
    range_max: float = 8.0


@dataclass(frozen=True, slots=True)
class SpecularPeak:
    """One pane as one scan shows it, in the sensor frame: the beam that meets it squarely (index, angle), its distance, and how far along the
    pane (m, to the right and to the left of that beam, seen from the sensor) its returns reach."""

    beam: int
    angle: float
    distance: float
    right: float
    left: float
    intensity: float

    @property
    def foot(self) -> F64:
        """Where the beam meets the pane, (2,) in the sensor frame."""
        return np.array([self.distance * math.cos(self.angle), self.distance * math.sin(self.angle)])

    @property
    def along(self) -> F64:
        """The direction of the pane to the left, (2,) in the sensor frame."""
        return np.array([-math.sin(self.angle), math.cos(self.angle)])


class SpecularDetector:
    """`detect` panes in the raw scan of one scanner."""

    def __init__(self, config: SpecularConfig | None = None) -> None:
        self.config = config if config is not None else SpecularConfig()
        # Of each scanner: its returns of late, and how many of them outshone white paint.
        self._told: dict[str, tuple[float, float]] = {}

    def detect(self, scan: LaserScan, *, is_seen_through: bool = True) -> tuple[SpecularPeak, ...]:
        """Return the panes in the order of their beams; none for a scan without intensities, or of a scanner of whose returns of late so many were bright that it tells them in another unit.
        Not `is_seen_through`: also what shines like a pane, though no beam beside it is seen to pass; the frame of a pane far away is as near to it as those."""
        if len(scan.intensities) != len(scan.ranges):
            return ()
        ranges = np.asarray(scan.ranges, np.float64)
        intensities = np.asarray(scan.intensities, np.float64)
        is_return = np.isfinite(ranges)
        if not self._counts_paint(scan.frame, intensities[is_return]):
            return ()
        angles: F64 = scan.angle_min + np.arange(len(ranges), dtype=np.float64) * scan.angle_increment
        is_glass = (intensities >= self.config.intensity_min) & (intensities <= self.config.intensity_max)
        bright = is_return & is_glass & (ranges <= self.config.range_max)
        found = (self._judge(k, ranges, intensities, angles, is_seen_through) for k in _peaks(bright, intensities))
        peaks: list[SpecularPeak] = []
        for peak in found:  # the beams of one pane may lie on both sides of the scan's seam
            if peak is not None and all(abs(wrap_angle(peak.angle - p.angle)) > self.config.near for p in peaks):
                peaks.append(peak)
        return tuple(peaks)

    def without_panes(self, scan: LaserScan) -> LaserScan:
        """Return the scan without the returns of panes (NaN): they show a few centimetres of something that is much larger."""
        peaks = self.detect(scan)
        if not peaks:
            return scan
        ranges = scan.ranges.copy()
        angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
        for peak in peaks:
            off = (angles - peak.angle + math.pi) % (2.0 * math.pi) - math.pi
            line = peak.distance / np.cos(np.clip(off, -FLATTEST, FLATTEST))
            ranges[(np.abs(off) <= self.config.pane_angle) & (np.abs(ranges - line) <= 2.0 * self.config.tolerance)] = (
                np.nan
            )
        return replace(scan, ranges=ranges)

    def _counts_paint(self, scanner: str, intensities: F64) -> bool:
        """Say whether a scanner seems to tell intensities in units of white paint, from those of its returns up to now."""
        returns, bright = self._told.get(scanner, (0.0, 0.0))
        returns = TOLD_FADE * returns + len(intensities)
        bright = TOLD_FADE * bright + np.count_nonzero(intensities >= self.config.intensity_min)
        self._told[scanner] = (returns, bright)
        return bool(returns >= TOLD_LEAST and bright <= BRIGHT_MOST * returns)

    def _judge(self, k: int, ranges: F64, intensities: F64, angles: F64, is_seen_through: bool) -> SpecularPeak | None:
        c = self.config
        normal = self._normal(k, ranges, intensities, angles)
        off = (angles - normal + math.pi) % (2.0 * math.pi) - math.pi
        near = np.abs(off) <= c.near
        along_normal = ranges[near] * np.cos(off[near])
        distance = float(np.median(along_normal[np.isfinite(along_normal)]))
        line = distance / np.cos(np.clip(off, -FLATTEST, FLATTEST))
        on_pane = np.abs(ranges - line) <= c.tolerance
        if np.count_nonzero(on_pane & near) < max(c.near_points, c.near_share * np.count_nonzero(near)):
            return None
        sides = (_side(off, c.sides), _side(-off, c.sides))
        if is_seen_through and not any(self._passes(side, ranges, line) for side in sides):
            return None
        run = off[on_pane & (np.abs(off) <= c.pane_angle)]
        right, left = distance * math.tan(-float(run.min())), distance * math.tan(float(run.max()))
        return SpecularPeak(k, wrap_angle(normal), distance, right, left, float(intensities[k]))

    def _normal(self, k: int, ranges: F64, intensities: F64, angles: F64) -> float:
        """The angle of the peak, finer than the beams: the mean of the angles around it, weighed by their intensity."""
        off = (angles - angles[k] + math.pi) % (2.0 * math.pi) - math.pi
        around = (np.abs(off) <= 2.0 * self.config.near) & (np.abs(ranges - ranges[k]) <= 0.1)
        weight = np.where(around, intensities, 0.0)
        return float(angles[k] + np.sum(weight * off) / np.sum(weight))

    def _passes(self, side: Bools, ranges: F64, line: F64) -> bool:
        """Whether enough of the beams of one side see what stands behind the pane's line; lost beams say nothing."""
        seen = side & ~np.isnan(ranges)
        count = np.count_nonzero(seen)
        through = np.count_nonzero(seen & (ranges > line + self.config.behind))
        return bool(count >= 5 and through >= self.config.through_share * count)


def is_upside_down(base_from_sensor: SE3) -> bool:
    """Say whether a planar scanner hangs head down: its beams run clockwise."""
    return bool(base_from_sensor.rotate((0.0, 0.0, 1.0))[2] < 0.0)


def upright(scan: LaserScan, base_from_sensor: SE3) -> LaserScan:
    """Return a scan as the same scanner would tell it if it stood upright at its place, with its x axis where it is; one that hangs head down runs backwards then, from its last beam on."""
    if not is_upside_down(base_from_sensor):
        return scan
    last = len(scan.ranges) - 1
    return replace(
        scan,
        stamp_ns=scan.stamp_ns + round(last * scan.time_increment * 1e9),
        angle_min=-(scan.angle_min + last * scan.angle_increment),
        time_increment=-scan.time_increment,
        ranges=scan.ranges[::-1],
        intensities=scan.intensities[::-1],
    )


def _side(off: F64, limits: tuple[float, float]) -> Bools:
    return np.asarray((off >= limits[0]) & (off <= limits[1]))


def _peaks(bright: Bools, intensities: F64) -> list[int]:
    """Return the brightest beam of every run of bright ones; dark gaps of up to three beams do not part a run."""
    beams = np.flatnonzero(bright)
    if len(beams) == 0:
        return []
    runs = np.split(beams, np.flatnonzero(np.diff(beams) > 4) + 1)
    return [int(run[np.argmax(intensities[run])]) for run in runs]
