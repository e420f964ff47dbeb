"""How far a made map is bent: how far its own keyframes lie from where their scans match it.

A wall that was seen on several visits lies where the map says, and nowhere exactly where each visit saw it. So scans of one place agree with
each other to a millimetre and are all off by centimetres from the pose that SLAM gave to whoever was there before: an error that no
number of beams or scans lessens, and that residuals hardly show. The keyframes of the finished map are a sample of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.localization.matcher import MatcherConfig, ScanMatcher
from ambler.localization.surface_map import SurfaceMap

F32 = NDArray[np.float32]
LEAST = 20  # keyframes; fewer tell nothing
SCORE_LEAST = 0.5  # share of a scan's points that its map explains
FIRST_SCALE = 0.1  # metres: width of the robust loss of the first step; the pose is known to centimetres
DEPTH_CELLS = 0.3  # spread of how far the real surfaces lie behind the mapped ones


@dataclass(frozen=True, slots=True)
class MapBend:
    """Standard deviations of where a map is, against the keyframes from which it was made: `position` (m, along each axis), `yaw` (rad)."""

    position: float = 0.0
    yaw: float = 0.0


def measure_bend(surfaces: SurfaceMap, scans: Sequence[tuple[F32, SE2]]) -> MapBend:
    """Match the scans of keyframes, points float32 (N, 2) in the base frame with their poses, to the map that was made of them.

    Scans that do not determine the whole pose are left out; nothing is told by fewer than `LEAST`.
    """
    matcher, offsets = ScanMatcher(surfaces, MatcherConfig()), []
    depth_variance = (DEPTH_CELLS * surfaces.spec.resolution) ** 2
    for points, map_from_base in scans:
        thinned = matcher.thin(points)
        if len(thinned) < LEAST:
            continue
        start = np.append(map_from_base.as_array(), 0.0)
        match = matcher.match(thinned, start[None], depth_variance, FIRST_SCALE)
        if match.determined == 3 and match.score >= SCORE_LEAST:
            offset = match.state[:3] - start[:3]
            offsets.append((offset[0], offset[1], wrap_angle(float(offset[2]))))
    if len(offsets) < LEAST:
        return MapBend()
    squares = np.mean(np.square(offsets), axis=0)
    return MapBend(float(np.sqrt(0.5 * (squares[0] + squares[1]))), float(np.sqrt(squares[2])))
