"""Clouds that come in small parts, as packet drivers and Livox send them (100 to 1000 a second), joined into scans.

A filter that is updated by every part sees a few hundred points of one corner each time, and is tens of times less exact. Whole clouds go through at once, unchanged.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from ambler.core.messages import PointCloud

PART_NS = 40_000_000  # clouds that are shorter, and come as often, are parts
LEAST_NS = 50_000_000  # of points are a scan
MOST_NS = 100_000_000
APART_NS = 50_000_000  # between two parts, or by which they overlap, that are not of one scan
MANY = 12  # spacings of clouds that show how often they come


class PartJoiner:
    """Feed it the clouds of one topic, their points in the order of time, as their stamps increase; it gives back whole ones, and scans of 50 to 100 ms of parts.

    `spacing` is how many seconds lie between two clouds; None: the first dozen shows it, and is not joined.
    """

    def __init__(self, spacing: float | None = None) -> None:
        told = [] if spacing is None else [min(round(spacing * 1e9), MOST_NS)] * MANY
        self._spacings_ns = deque[int](told, maxlen=MANY)
        self._last_ns: int | None = None
        self._parts: list[PointCloud] = []
        self._span_ns = (0, 0)

    def add(self, cloud: PointCloud) -> list[PointCloud]:
        """Take a cloud; returns what is complete with it."""
        if self._last_ns is not None:
            self._spacings_ns.append(min(cloud.stamp_ns - self._last_ns, MOST_NS))
        self._last_ns = cloud.stamp_ns
        begin_ns, end_ns = span_ns(cloud)
        if not self._is_part(end_ns - begin_ns):
            return [*self.end(), cloud]
        done = [] if self._belongs(cloud, begin_ns, end_ns) else self.end()
        self._span_ns = (
            (min(self._span_ns[0], begin_ns), max(self._span_ns[1], end_ns)) if self._parts else (begin_ns, end_ns)
        )
        self._parts.append(cloud)
        is_long = self._span_ns[1] - self._span_ns[0] + self._spacing_ns() // 2 >= LEAST_NS
        return [*done, *self.end()] if is_long else done

    def end(self) -> list[PointCloud]:
        """Return the scan of the parts that wait, if any do."""
        parts, self._parts = self._parts, []
        return [joined(parts)] if parts else []

    def _spacing_ns(self) -> int:
        return sum(self._spacings_ns) // len(self._spacings_ns)

    def _is_part(self, long_ns: int) -> bool:
        return long_ns < PART_NS and len(self._spacings_ns) == MANY and self._spacing_ns() < PART_NS

    def _belongs(self, cloud: PointCloud, begin_ns: int, end_ns: int) -> bool:
        """Say whether a part goes on from those that wait, within a scan's length."""
        if not self._parts or cloud.frame != self._parts[0].frame:
            return False
        return abs(begin_ns - self._span_ns[1]) <= APART_NS and end_ns - self._span_ns[0] <= MOST_NS


def joined(parts: list[PointCloud]) -> PointCloud:
    """Return clouds as one of the first one's stamp, its points in the order of time."""
    first = parts[0]
    if len(parts) == 1:
        return first
    time = np.concatenate([part.time + 1e-9 * (part.stamp_ns - first.stamp_ns) for part in parts])
    order = np.argsort(time, kind="stable")
    return replace(
        first,
        points=np.concatenate([part.points for part in parts])[order],
        intensity=np.concatenate([part.intensity for part in parts])[order],
        time=time.astype(np.float32)[order],
        ring=np.concatenate([part.ring for part in parts])[order],
    )


def span_ns(cloud: PointCloud) -> tuple[int, int]:
    """Return when the first and the last point were taken, ns."""
    if len(cloud.time) == 0:
        return cloud.stamp_ns, cloud.stamp_ns
    first, last = (round(float(cloud.time[k]) * 1e9) for k in (0, -1))
    return cloud.stamp_ns + first, cloud.stamp_ns + last


def mean_spacing(stamps_ns: list[int]) -> float | None:
    """Return how many seconds lie between clouds, what is missing counted as little; None where no stamp follows another."""
    steps = np.diff(stamps_ns)
    steps = steps[steps > 0]
    return 1e-9 * float(np.minimum(steps, max(MOST_NS, 3.0 * np.median(steps))).mean()) if len(steps) else None


def scans_of_parts(clouds: int, seconds: float, spacing: float | None) -> tuple[int, tuple[str, ...]]:
    """Return into about how many scans clouds of so many `seconds` are joined, and a note that says so where they are parts."""
    if spacing is None or not max(seconds, spacing) < 1e-9 * PART_NS:
        return clouds, ()
    each = math.ceil((1e-9 * LEAST_NS - 0.5 * spacing) / spacing)
    note = f"clouds come in parts, {1.0 / spacing:.0f} in a second: each {each} are joined into a scan"
    return math.ceil(clouds / each), (note,)
