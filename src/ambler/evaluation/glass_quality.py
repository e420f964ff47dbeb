"""How much of a world's glass was found, and how much was invented."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.sim.solids import Solid

F64 = NDArray[np.float64]
STEP = 0.05


@dataclass(frozen=True, slots=True)
class GlassQuality:
    """`found_ratio`: share of the true panes' length within `near` metres of a segment. `invented_m`: length of segments farther than `near`
    from any pane. `true_m`: length of all panes."""

    found_ratio: float
    invented_m: float
    true_m: float


def compare_glass(
    segments: NDArray[np.floating], solids: Sequence[Solid], world_from_map: SE2, near: float = 0.15
) -> GlassQuality:
    """Compare segments (N, 4) in the map frame with the panes among `solids`, which stand in the world."""
    panes = np.array([_middle_line(s) for s in solids if s.is_glass]).reshape(-1, 4)
    told = world_from_map.transform(np.asarray(segments, np.float64).reshape(-1, 2)).reshape(-1, 4)
    true_points, found_points = _samples(panes), _samples(told)
    found = _distances(true_points, told) <= near
    invented = _distances(found_points, panes) > near
    ratio = float(found.mean()) if len(found) else math.nan
    return GlassQuality(
        ratio, float(np.count_nonzero(invented) * STEP), float(np.hypot(*(panes[:, 2:] - panes[:, :2]).T).sum())
    )


def _middle_line(pane: Solid) -> list[float]:
    """The line along the longer side of a box."""
    along = (0.5 * pane.size_x, 0.0) if pane.size_x >= pane.size_y else (0.0, 0.5 * pane.size_y)
    ends = pane.world_from_solid.transform(np.array([along, (-along[0], -along[1])]))
    return [float(v) for v in ends.ravel()]


def _samples(segments: F64) -> F64:
    """Points on segments about every `STEP` metres, float64 (M, 2)."""
    out = [np.zeros((0, 2))]
    for x0, y0, x1, y1 in segments:
        n = max(1, round(math.hypot(x1 - x0, y1 - y0) / STEP))
        t = (np.arange(n) + 0.5)[:, None] / n
        out.append(np.array([x0, y0]) * (1 - t) + np.array([x1, y1]) * t)
    return np.concatenate(out)


def _distances(points: F64, segments: F64) -> F64:
    """Distance of every point to the nearest segment; inf without any."""
    best = np.full(len(points), np.inf)
    for x0, y0, x1, y1 in segments:
        a, along = np.array([x0, y0]), np.array([x1 - x0, y1 - y0])
        t = np.clip((points - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        best = np.minimum(best, np.hypot(*(points - a - t[:, None] * along).T))
    return best
