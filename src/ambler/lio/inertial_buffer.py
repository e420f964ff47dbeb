"""Inertial measurements in the order of their time, cut and interpolated to the intervals that the filter walks through."""

from __future__ import annotations

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

    def add(self, samples: Iterable[Imu]) -> None:
        """Take new samples."""
        for sample in samples:
            if self.origin_ns is None:
                self.origin_ns = sample.stamp_ns
            row = (self.seconds(sample.stamp_ns), *sample.angular_velocity, *sample.linear_acceleration)
            if not np.isfinite(row).all() or (self._rows and row[0] <= self._rows[-1][0]):
                self.refused += 1
                continue
            self._rows.append(row)

    def seconds(self, stamp_ns: int) -> float:
        """Return the time of a stamp in this buffer."""
        return 1e-9 * (stamp_ns - (self.origin_ns or 0))

    @property
    def last(self) -> float:
        """The time of the newest sample; -inf without any."""
        return self._rows[-1][0] if self._rows else -np.inf

    def __len__(self) -> int:
        return len(self._rows)

    def rows(self) -> F64:
        """Return all samples, float64 (K, 7), forces scaled."""
        out = np.array(self._rows, np.float64).reshape(-1, 7)
        out[:, 4:] *= self.scale
        return out

    def between(self, begin: float, end: float) -> F64:
        """Return rows from `begin` to `end`, float64 (K, 7) with K >= 2: both ends interpolated, or held where no sample lies beyond."""
        rows = self.rows()
        times = rows[:, 0]
        inside = rows[(times > begin) & (times < end)]
        ends = np.array([begin, end])
        edges = np.column_stack([ends, *(np.interp(ends, times, rows[:, j]) for j in range(1, 7))])
        return np.ascontiguousarray(np.vstack([edges[:1], inside, edges[1:]]))

    def longest_gap(self, begin: float, end: float) -> float:
        """Return the longest time (s) between `begin` and `end` that no two samples enclose more closely, samples beyond the ends included."""
        times = np.array([row[0] for row in self._rows])
        first = max(0, int(np.searchsorted(times, begin, side="right")) - 1)
        near = times[first : int(np.searchsorted(times, end, side="left")) + 1]
        edges = np.concatenate([[begin] if near[0] > begin else [], near, [end] if near[-1] < end else []])
        return float(np.diff(edges).max())

    def forget(self, before: float) -> None:
        """Drop what is older than a time, but the last sample before it."""
        times = [row[0] for row in self._rows]
        keep = max(0, int(np.searchsorted(times, before, side="right")) - 1)
        del self._rows[:keep]
