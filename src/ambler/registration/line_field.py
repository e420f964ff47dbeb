"""Where the returns of a submap lie, finer than its cells: lines through the points of small cells, and the fit of a scan to them.

A probability grid says where a wall is to a fraction of a cell, and rays that pass along it gnaw at it. The mean of the points themselves
is as good as the scanner. Point to line as in PLICP (Censi, ICRA 2008), lines from cell moments as in the NDT (Biber and Strasser, IROS
2003), each side of a wall for itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import line_field as kernels

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LineConfig:
    """Cell size (m); how many points a line needs; the standard deviation of a return beside the scatter about the line (m); as how many
    independent returns a scan counts; what the start is worth (standard deviations, m and rad); the least share of points on lines."""

    size: float = 0.1
    least_points: int = 8
    sigma: float = 0.01
    independent_points: float = 50.0
    start_sigma: tuple[float, float] = (0.03, 0.02)
    least_share: float = 0.5
    iterations: int = 6


@dataclass(frozen=True, slots=True, eq=False)
class LineFit:
    """Where a scan lies on lines: `grid_from_base`, which is the start unless `is_held`, the `share` of its points that lie on lines, their rms distance from these (`residual`, in
    standard deviations), and the `information` float64 (3, 3) about x, y, yaw in the grid frame that is in them."""

    grid_from_base: SE2
    information: F64
    share: float
    residual: float
    is_held: bool


@dataclass(frozen=True, slots=True, eq=False)
class PackedLines:
    """The `keys` int64 (N,) and `moments` float64 (N, 6) of a field's cells."""

    config: LineConfig
    keys: NDArray[np.int64]
    moments: F64


class LineField:
    """Moments of the returns that were added, in the frame of a submap."""

    def __init__(self, config: LineConfig) -> None:
        self._config = config
        self._keys = np.full(_capacity(0), kernels.EMPTY)
        self._moments = np.zeros((_capacity(0), 6))
        self._rows = 0

    def add(self, points: F32, starts: F64) -> None:
        """Add returns (N, 2) seen from `starts` (N, 2) or (1, 2)."""
        wanted = _capacity(self._rows + len(points))
        if wanted > len(self._keys):
            self._resize(wanted)
        self._rows += int(kernels.add_points(self._keys, self._moments, self._config.size, starts, points))

    def packed(self) -> PackedLines:
        """Return the moments without the room that the table keeps free."""
        is_taken = self._keys != kernels.EMPTY
        return PackedLines(self._config, self._keys[is_taken], self._moments[is_taken])

    @classmethod
    def of(cls, packed: PackedLines) -> LineField:
        """Return the field that was packed."""
        field = cls(packed.config)
        field._rows = len(packed.keys)
        field._keys, field._moments = packed.keys, packed.moments
        field._resize(_capacity(field._rows))
        return field

    def _resize(self, capacity: int) -> None:
        keys, moments = np.full(capacity, kernels.EMPTY), np.zeros((capacity, 6))
        kernels.rehash(self._keys, self._moments, keys, moments)
        self._keys, self._moments = keys, moments

    def fit(self, points: F32, origin: tuple[float, float], start: SE2, least_share: float | None = None) -> LineFit:
        """Find the pose near `start` at which points (N, 2) of the base frame, seen from `origin`, lie on the lines; `least_share` if not that of the configuration."""
        config = self._config
        pose, info = start.as_array(), np.zeros(2)
        linear, angular = config.start_sigma
        prior = np.array([linear**-2, linear**-2, angular**-2])
        options = np.array([config.least_points, config.sigma, config.independent_points, config.iterations], float)
        h = np.empty((3, 3))
        kernels.fit(
            *(self._keys, self._moments, config.size, points, np.array(origin), pose, prior, options),
            *(h, info),
        )
        share = float(info[0])
        is_held = share >= (config.least_share if least_share is None else least_share)
        return LineFit(SE2.from_array(pose) if is_held else start, h, share, float(info[1]), is_held)


def _capacity(rows: int) -> int:
    """Return the size of a table, a power of 2, in which at most half of the places are taken."""
    return int(max(1024, 1 << (2 * rows).bit_length()))
