"""Inertial measurements in the order of their time, cut and interpolated to the intervals that the filter walks through."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Imu

F64 = NDArray[np.float64]


class InertialBuffer:
    """Samples as rows (time, rate, specific force): seconds after `origin_ns`, which is the first sample's stamp, rad/s, m/s².

    Samples that are not finite or do not come later than the one before are counted in `refused` and left out. `scale` multiplies forces.
    """

    def __init__(self) -> None:
        self.origin_ns: int | None = None
        self.refused = 0
        self.scale = 1.0
        self._rows: list[tuple[float, ...]] = []
        self._times: list[float] = []

    def add(self, samples: Iterable[Imu]) -> None:
        """Take new samples."""
        for sample in samples:
            if self.origin_ns is None:
                self.origin_ns = sample.stamp_ns
            row = (self.seconds(sample.stamp_ns), *sample.angular_velocity, *sample.linear_acceleration)
            if not all(map(math.isfinite, row)) or (self._times and row[0] <= self._times[-1]):
                self.refused += 1
                continue
            self._rows.append(row)
            self._times.append(row[0])

    def copy(self) -> InertialBuffer:
        """Return a buffer with the same samples that forgets by itself."""
        out = InertialBuffer()
        out.origin_ns, out.scale, out._rows, out._times = self.origin_ns, self.scale, [*self._rows], [*self._times]
        return out

    def seconds(self, stamp_ns: int) -> float:
        """Return the time of a stamp in this buffer."""
        return 1e-9 * (stamp_ns - (self.origin_ns or 0))

    @property
    def last(self) -> float:
        """The time of the newest sample; -inf without any."""
        return self._times[-1] if self._times else -math.inf

    def __len__(self) -> int:
        return len(self._rows)

    def rows(self) -> F64:
        """Return all samples, float64 (K, 7), forces scaled."""
        return self._scaled(0, len(self._rows))

    def _scaled(self, first: int, end: int) -> F64:
        out = np.array(self._rows[first:end], np.float64).reshape(-1, 7)
        out[:, 4:] *= self.scale
        return out

    def between(self, begin: float, end: float) -> F64:
        """Return rows from `begin` to `end`, float64 (K, 7) with K >= 2: both ends interpolated, or held where no sample lies beyond."""
        inside = self._scaled(bisect_right(self._times, begin), bisect_left(self._times, end))
        out = np.empty((len(inside) + 2, 7))
        out[0], out[1:-1], out[-1] = self._at(begin), inside, self._at(end)
        return out

    def _at(self, time: float) -> tuple[float, ...]:
        """Return the row at a time, its force scaled: interpolated, or the nearest one held where no sample lies beyond."""
        k = bisect_right(self._times, time) - 1
        here = self._rows[min(max(k, 0), len(self._rows) - 1)]
        fx, fy, fz = (self.scale * force for force in here[4:])
        row = (*here[1:4], fx, fy, fz)
        if 0 <= k < len(self._rows) - 1 and here[0] != time:
            there, span, part = self._rows[k + 1], self._times[k + 1] - here[0], time - here[0]
            fx, fy, fz = (self.scale * force for force in there[4:])
            row = tuple((b - a) / span * part + a for a, b in zip(row, (*there[1:4], fx, fy, fz), strict=True))
        return (time, *row)

    def longest_gap(self, begin: float, end: float) -> float:
        """Return the longest time (s) between `begin` and `end` that no two samples enclose more closely, samples beyond the ends included."""
        first = max(0, bisect_right(self._times, begin) - 1)
        near = np.array(self._times[first : bisect_left(self._times, end) + 1])
        edges = np.concatenate([[begin] if near[0] > begin else [], near, [end] if near[-1] < end else []])
        return float(np.diff(edges).max())

    def longest_hole(self, begin: float, end: float) -> float:
        """Return the longest time (s) between `begin` and `end` in which there is no sample."""
        inside = self._times[bisect_right(self._times, begin) : bisect_left(self._times, end)]
        return float(np.diff([begin, *inside, max(begin, end)]).max())

    def forget(self, before: float) -> None:
        """Drop what is older than a time, but the last sample before it."""
        keep = max(0, bisect_right(self._times, before) - 1)
        del self._rows[:keep], self._times[:keep]
