"""Who came to the robot by himself: of what a scanner cannot see, only that may be forgotten without being looked through.

What the robot itself drove up to stays where it is. What moves by itself is told from it by scans of a moment ago: they looked through its place, or,
where that was beside their sector, through that of what is seen of it now. Without this, somebody
who once touched the side of a robot would hold it for ever.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import looks as kernels

F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

LOOKS = 8  # scans that are kept
SPACING = (0.1, 0.5)  # metres of the outermost corner, and seconds, between two of them: at rest the last ones stay
DRIVEN = 1.0  # metres of the outermost corner after which odometry has drifted too far for a scan to tell
AGE = 0.3  # seconds after which a scan tells what was there before
INSIDE = 0.05  # metres within the robot's outline: what odometry may have drifted meanwhile
NEAR = 0.3  # metres around a remembered point: who stands there is wider than what a scanner cannot see of him
TOLERANCES = (math.radians(1.0), 0.1, 0.15, NEAR)
"""Of the directions in which all returns must lie behind a place to prove it empty (rad), and by how much (m); around a place of which a scan says nothing
(m), in which nothing may have stood, and what is seen of the same thing now."""
RIM = 0.15  # metres around the robot that its scanners must look at, all of it: nobody is narrower


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """A scan: its returns by azimuth, in the scanner's frame, where that was, and in which azimuths and ranges it can tell (`kernels.testimony`)."""

    seconds: float
    travel: float
    sensor_from_odom: SE2
    azimuth: F64
    ranges: F64
    points: F64
    limits: F64


class Visitors:
    """Keeps some scans of one planar scanner, and where the robot's `footprint` (M, 2), convex and counter-clockwise, was then: nothing stood there. All places (N, 2) are in the odom
    frame, m."""

    def __init__(self, footprint: F64 | None = None) -> None:
        self._looks: deque[_Look] = deque(maxlen=LOOKS)
        self._stood: deque[tuple[float, float, SE2]] = deque(maxlen=LOOKS)
        self._footprint = np.zeros((0, 2)) if footprint is None else footprint

    def stand(self, seconds: float, travel: float, odom_from_base: SE2) -> None:
        """Take where the robot is, when that is due."""
        if not self._stood or (
            travel - self._stood[-1][1] >= SPACING[0] and seconds - self._stood[-1][0] >= SPACING[1]
        ):
            self._stood.append((seconds, travel, odom_from_base.inverse()))

    def look(
        self,
        seconds: float,
        travel: float,
        odom_from_sensor: SE2,
        polar: tuple[F64, F64],
        sector: tuple[float, float],
        reach: tuple[float, float],
    ) -> None:
        """Take a scan's returns (`polar`: ranges, azimuths, each (N,)) of a scanner that tells of places between the ranges `reach` (m) when that is due; `travel` is how far (m) the outermost corner has come."""
        if self._looks:
            last = self._looks[-1]
            if travel - last.travel < SPACING[0] or seconds - last.seconds < SPACING[1]:
                return
        order = np.argsort(polar[1], kind="stable")
        ranges, azimuth = polar[0][order], polar[1][order]
        points = ranges[:, None] * np.column_stack((np.cos(azimuth), np.sin(azimuth)))
        middle, half = 0.5 * (sector[0] + sector[1]), 0.5 * (sector[1] - sector[0])
        limits = np.array(((middle, half), (reach[0] + TOLERANCES[1], reach[1])))
        self._looks.append(_Look(seconds, travel, odom_from_sensor.inverse(), azimuth, ranges, points, limits))

    def came(self, places: F64, returns: F64, seconds: float, travel: float) -> Flags:
        """Return bool (N,): whether a scan that was kept looked through a place, or saw nothing there but through one of the `returns` (M, 2) of now that lie
        near it; and nothing stood there."""
        out, asked = np.zeros(len(places), np.uint8), np.empty(len(returns), np.uint8)
        if len(places) > 0:
            for look in self._looks:
                if seconds - look.seconds >= AGE and travel - look.travel <= DRIVEN:
                    there = (look.sensor_from_odom.transform(p) for p in (places, returns))
                    kernels.mark_comers(
                        *(look.azimuth, look.ranges, look.points, look.limits, TOLERANCES, *there, asked, out)
                    )
        return np.asarray(out == kernels.CAME) | self._was_under(places, seconds, travel)

    def agree_that_came(self, places: F64, seconds: float, travel: float, least: F64) -> Flags:
        """Return bool (N,): whether scans that were kept, from at least so many metres (N,), looked through a place until somebody came, and none found anything there before or looked through it after: what is
        seen now and then only, because the robot nods, was there all the time."""
        came, stood, is_odd = (np.zeros(len(places), np.bool_) for _ in range(3))
        nothing, asked = np.empty((0, 2)), np.empty(0, np.uint8)
        for look in self._looks:
            if len(places) == 0 or seconds - look.seconds < AGE or travel - look.travel > DRIVEN:
                continue
            there, out = look.sensor_from_odom.transform(places), np.zeros(len(places), np.uint8)
            kernels.mark_comers(
                *(look.azimuth, look.ranges, look.points, look.limits, TOLERANCES, there, nothing, asked, out)
            )
            counts = np.hypot(*there.T) >= least
            was_free, was_not = counts & (out == kernels.CAME), counts & (out == kernels.WAS_THERE)
            is_odd |= (was_free & stood) | (was_not & ~came)
            came |= was_free
            stood |= was_not
        return np.asarray(came & ~is_odd)

    def _was_under(self, places: F64, seconds: float, travel: float) -> Flags:
        """Return bool (N,): whether the robot itself stood on a place a moment ago."""
        out = np.zeros(len(places), np.bool_)
        for at, way, base_from_odom in self._stood:
            if len(self._footprint) > 0 and seconds - at >= AGE and travel - way <= DRIVEN:
                out |= _are_within(base_from_odom.transform(places), self._footprint, INSIDE)
        return out


def rim_of(footprint: F64) -> F64:
    """Return points (N, 2) `RIM` metres outside a convex, counter-clockwise footprint (M, 2): along its sides and beyond its corners."""
    edge = np.roll(footprint, -1, axis=0) - footprint
    normals = np.column_stack((edge[:, 1], -edge[:, 0])) / np.hypot(*edge.T)[:, None]
    share = np.linspace(0.0, 1.0, 25)[:, None, None]
    sides = (footprint + share * edge + RIM * normals).reshape(-1, 2)
    outward = normals + np.roll(normals, 1, axis=0)
    return np.concatenate((sides, footprint + RIM * outward / np.hypot(*outward.T)[:, None]))


def _are_within(points: F64, outline: F64, margin: float) -> Flags:
    """Return bool (N,): which points (N, 2) lie at least `margin` metres inside a convex, counter-clockwise outline (M, 2)."""
    edge = np.roll(outline, -1, axis=0) - outline
    inward = np.column_stack((-edge[:, 1], edge[:, 0])) / np.hypot(*edge.T)[:, None]
    depth = ((points[:, None] - outline[None]) * inward[None]).sum(axis=2)
    return np.asarray((depth >= margin).all(axis=1))
