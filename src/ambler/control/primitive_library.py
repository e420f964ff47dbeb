"""The library of motion primitives: 343 paths of 3 m, cubic splines in polar coordinates that fan out three times (navigation reference 1.4).

A path is (r cos phi(r), r sin phi(r)). Over the first metre phi grows in proportion, to one of seven bearings: the seven groups. At 2 m and
at 3 m it has turned by one of seven angles more, each fan narrower than the one before; a not-a-knot spline goes through all of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

F64 = NDArray[np.float64]

LENGTH = 3.0  # metres of a path at scale 1
START = 1.0  # metres that all the paths of a group share
GROUPS = 7
PATHS = GROUPS**3
DIRECTIONS = 36
_STEP = 0.01  # metres between two points of a path
_FAN = 27.0  # degrees to either side of the first fan
_NARROWS = 0.65  # by which each further fan is narrower


@dataclass(frozen=True, slots=True)
class PrimitiveLibrary:
    """Points float64 (343, 301, 2) in the frame of the start, x along it; headings of the tangents (343, 301); the group of each path (343,);
    and where it ends up going, radians (343,): twice the bearing of its end, as if it were an arc."""

    points: F64
    headings: F64
    groups: NDArray[np.int64]
    end_directions: F64

    def start(self, group: int) -> F64:
        """Return the first metre, float64 (101, 2), that all paths of a group share."""
        first = int(np.argmax(self.groups == group))
        return self.points[first, : round(START / _STEP) + 1]


@lru_cache(maxsize=1)
def primitive_library() -> PrimitiveLibrary:
    """Generate the library; once per process."""
    r = np.arange(round(LENGTH / _STEP) + 1) * _STEP
    near = r[: round(START / _STEP) + 1]
    knots = np.concatenate((near, [2.0, LENGTH - 0.001, LENGTH]))
    fan = np.linspace(-1.0, 1.0, GROUPS) * _FAN
    bearings = np.empty((PATHS, len(r)))
    slopes = np.empty_like(bearings)
    k = 0
    for first in fan:
        for second in first + _NARROWS * fan:
            for third in second + _NARROWS**2 * fan:
                spline = CubicSpline(knots, np.concatenate((first * near, [second, third, third])))
                bearings[k], slopes[k] = np.radians(spline(r)), np.radians(spline(r, 1))
                k += 1
    points = np.stack((r * np.cos(bearings), r * np.sin(bearings)), axis=-1)
    headings = bearings + np.arctan2(r * slopes, 1.0)
    groups = np.repeat(np.arange(GROUPS), GROUPS**2)
    ends = 2.0 * np.arctan2(points[:, -1, 1], points[:, -1, 0])
    for array in (points, headings, groups, ends):
        array.flags.writeable = False
    return PrimitiveLibrary(points, headings, groups, ends)
