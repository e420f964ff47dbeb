"""How far a made map is bent: how far its own keyframes lie from where their scans match it.

A wall that was seen on several visits lies where the map says, and nowhere exactly where each visit saw it. So scans of one place agree with
each other to a millimetre and are all off by centimetres from the pose that SLAM gave to whoever was there before: an error that no
number of beams or scans lessens, and that residuals hardly show. The keyframes of the finished map are a sample of it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2, wrap_angle
from ambler.localization.matcher import MatcherConfig, ScanMatcher
from ambler.localization.surface_map import SurfaceMap

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
PLACE = 30.0  # metres of a map whose keyframes are matched together
BORDER = 3.0  # metres around what these see: more than `REACH` of a surface, and the walls that its line is fitted to
LEAST = 20  # keyframes; fewer tell nothing
SCORE_LEAST = 0.5  # share of a scan's points that its map explains
FIRST_SCALE = 0.1  # metres: width of the robust loss of the first step; the pose is known to centimetres
DEPTH_CELLS = 0.3  # spread of how far the real surfaces lie behind the mapped ones


@dataclass(frozen=True, slots=True)
class MapBend:
    """Standard deviations of where a map is, against the keyframes from which it was made: `position` (m, along each axis), `yaw` (rad)."""

    position: float = 0.0
    yaw: float = 0.0


def measure_bend(cells: NDArray[np.int8], spec: GridSpec, scans: Sequence[tuple[F32, SE2]]) -> MapBend:
    """Match the scans of keyframes, points float32 (N, 2) in the base frame with their poses, to the map int8 [iy, ix] that was made of them.

    Scans that do not determine the whole pose are left out; nothing is told by fewer than `LEAST`. Of a large map only the part around a place is prepared at a time.
    Raises BadInputError where the map does not fit its geometry.
    """
    if cells.shape != spec.shape:
        raise BadInputError(f"the map has {cells.shape} cells, its description says {spec.shape}")
    offsets = []
    places: defaultdict[tuple[int, int], list[tuple[F32, SE2]]] = defaultdict(list)
    for points, pose in scans:
        if len(points) >= LEAST:
            places[math.floor(pose.x / PLACE), math.floor(pose.y / PLACE)].append((points, pose))
    for near in places.values():
        part = _part_around(cells, spec, np.concatenate([pose.transform(points) for points, pose in near]))
        if part[0].size == 0:
            continue
        try:
            matcher = ScanMatcher(SurfaceMap.from_occupancy(*part), MatcherConfig())
        except BadInputError:  # no wall there
            continue
        offsets += [offset for points, pose in near if (offset := _offset_of(matcher, points, pose)) is not None]
    if len(offsets) < LEAST:
        return MapBend()
    squares = np.mean(np.square(offsets), axis=0)
    return MapBend(float(np.sqrt(0.5 * (squares[0] + squares[1]))), float(np.sqrt(squares[2])))


def _offset_of(matcher: ScanMatcher, points: F32, map_from_base: SE2) -> tuple[float, float, float] | None:
    """Return how far (m, m, rad) a keyframe lies from where its scan matches the map; None where that is not determined."""
    thinned = matcher.thin(points)
    if len(thinned) < LEAST:
        return None
    depth_variance = (DEPTH_CELLS * matcher.map.spec.resolution) ** 2
    start = np.append(map_from_base.as_array(), 0.0)
    match = matcher.match(thinned, start[None], depth_variance, FIRST_SCALE)
    if match.determined < 3 or match.score < SCORE_LEAST:
        return None
    x, y, yaw = match.state[:3] - start[:3]
    return float(x), float(y), wrap_angle(float(yaw))


def _part_around(cells: NDArray[np.int8], spec: GridSpec, points: F64) -> tuple[NDArray[np.int8], GridSpec]:
    """Return the part of a map that holds points (N, 2) and all that has a say in their surfaces, and its geometry."""
    corners = spec.cells_of(np.stack((points.min(axis=0) - BORDER, points.max(axis=0) + BORDER)))
    (y0, x0), (y1, x1) = np.clip(corners + np.array([[0], [1]]), 0, spec.shape).tolist()
    origin = spec.origin_x + x0 * spec.resolution, spec.origin_y + y0 * spec.resolution
    return cells[y0:y1, x0:x1], GridSpec(spec.resolution, x1 - x0, y1 - y0, *origin)
