"""How well a built map agrees with the true one: coverage, nearest-neighbour errors and structural similarity.

After the evaluation of an autonomous exploration with Cartographer: occupied cells of both maps are thinned to lines of
one cell, aligned by ICP (rigid, no scale), and compared. SSIM (Wang et al. 2004) uses a Gaussian window of 11 x 11 cells,
sigma 1.5, K1 = 0.01, K2 = 0.03, on pictures of the thinned lines (0 and 255) at 5 cm in the box of the true map plus 1 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.evaluation.alignment import align

Occupancy = NDArray[np.int8]
Mask = NDArray[np.bool_]
FREE_UP_TO, OCCUPIED_FROM = 25, 65
COMPARE_RESOLUTION = 0.05
COMPARE_MARGIN = 1.0
REACHED = 2
BLOCK_CELLS = 250_000
REACH = 5  # pixels from the middle of the window of SSIM to its border
RED, BLUE, BOTH, FREE_TINT = (214, 39, 40), (31, 119, 180), (60, 20, 90), (238, 238, 238)
_TINTS = np.array([(255, 255, 255), FREE_TINT, RED, RED, BLUE, BLUE, BOTH, BOTH], np.uint8)
"""By 1 for free, 2 for a line of the truth, 4 for one of the built map, added."""


@dataclass(frozen=True, slots=True, eq=False)
class MapQuality:
    """Agreement of a built map with the truth.

    `coverage_ratio`: |built free and truly free| / |truly free|. `false_free_ratio`: share of the built free cells whose centre
    lies in a cell of the truth that is not free. `nne_cells`: mean distance of the true lines' cells to the nearest built one,
    `nne_reverse_cells` the other way, both in cells of the truth. `overlay` is an RGB picture uint8 (H, W, 3), first row on
    top: the truth red, the built map blue, free space of both grey.
    """

    coverage_ratio: float
    false_free_ratio: float
    nne_cells: float
    nne_reverse_cells: float
    ssim: float
    truth_from_built: SE2
    overlay: NDArray[np.uint8]


def compare_maps(
    built: tuple[GridSpec, Occupancy],
    truth: tuple[GridSpec, Occupancy],
    *,
    truth_from_built: SE2 | None = None,
) -> MapQuality:
    """Compare a built map with the truth, both (spec, int8 [iy, ix]); the alignment may be given instead of found.

    Raises BadInputError when one of them has no free or too few occupied cells.
    """
    built_spec, built_occupancy = built
    truth_spec, truth_occupancy = truth
    built_lines, truth_lines = thin(is_occupied(built_occupancy)), thin(is_occupied(truth_occupancy))
    built_points, truth_points = points_of(built_spec, built_lines), points_of(truth_spec, truth_lines)
    if truth_from_built is None:
        truth_from_built = align(built_points, truth_points).target_from_source
    moved = truth_from_built.transform(built_points)
    built_free, truth_free = is_free(built_occupancy), is_free(truth_occupancy)
    if not built_free.any() or not truth_free.any():
        raise BadInputError("a map without free cells cannot be compared")
    seen = _share((truth_spec, truth_free), (built_spec, built_free), truth_from_built.inverse())
    right = _share((built_spec, built_free), (truth_spec, truth_free), truth_from_built)
    box = comparison_spec(truth_spec, truth_occupancy)
    built_picture, truth_picture = draw_points(box, moved), draw_points(box, truth_points)
    return MapQuality(
        coverage_ratio=seen,
        false_free_ratio=1.0 - right,
        nne_cells=nearest_neighbour_error(truth_points, moved) / truth_spec.resolution,
        nne_reverse_cells=nearest_neighbour_error(moved, truth_points) / truth_spec.resolution,
        ssim=structural_similarity(truth_picture, built_picture),
        truth_from_built=truth_from_built,
        overlay=_overlay(
            truth_picture,
            built_picture,
            _drawn(box, truth_from_built, blocks_of(built_spec, built_free))
            & _drawn(box, SE2(), blocks_of(truth_spec, truth_free, truth_from_built.transform(_corners(built_spec)))),
        ),
    )


def reachable_coverage(
    built: tuple[GridSpec, Occupancy],
    truth: tuple[GridSpec, Occupancy],
    truth_from_built: SE2,
    truth_from_start: SE2,
    robot_radius: float,
) -> float:
    """Return the share of the cells that the robot's centre can reach in truth that are free in the built map.

    Reachable are true free cells at least `robot_radius` (m) from everything else and 8-connected to the start. Unlike
    `coverage_ratio` this does not depend on which cells a wall's surface falls into. Raises BadInputError when the start is not free.
    """
    spec, occupancy = truth
    clearance = cv2.distanceTransform(is_free(occupancy).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.multiply(clearance, spec.resolution, out=clearance)
    floor = (clearance > robot_radius).astype(np.uint8)
    iy, ix = spec.cell_of(truth_from_start.x, truth_from_start.y)
    if not spec.contains_cell(iy, ix) or floor[iy, ix] == 0:
        raise BadInputError("the start is not free in the true map")
    cv2.floodFill(floor, None, (ix, iy), REACHED, flags=8)
    return floor_coverage(built, (spec, np.asarray(floor == REACHED)), truth_from_built)


def floor_coverage(built: tuple[GridSpec, Occupancy], floor: tuple[GridSpec, Mask], truth_from_built: SE2) -> float:
    """Return the share of the cells of a true floor (bool [iy, ix]) that are free in the built map. Raises BadInputError for no floor."""
    if not floor[1].any():
        raise BadInputError("there is no floor that the robot could reach")
    return _share(floor, (built[0], is_free(built[1])), truth_from_built.inverse())


def is_free(occupancy: Occupancy) -> Mask:
    """Return which cells count as free."""
    return (occupancy >= 0) & (occupancy <= FREE_UP_TO)


def is_occupied(occupancy: Occupancy) -> Mask:
    """Return which cells count as occupied."""
    return np.asarray(occupancy >= OCCUPIED_FROM)


def thin(mask: Mask) -> Mask:
    """Thin an occupied mask to lines of one cell (Zhang and Suen 1984).

    That method eats diagonal stairs two cells wide to nothing; what it left no line beside is thinned after Guo and Hall (1989).
    """
    lines = np.asarray(cv2.ximgproc.thinning(mask.astype(np.uint8) * 255) > 0)
    beside = cv2.dilate(lines.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    eaten = (mask & ~beside).astype(np.uint8) * 255
    if not eaten.any():
        return lines
    return np.asarray(lines | (cv2.ximgproc.thinning(eaten, thinningType=cv2.ximgproc.THINNING_GUOHALL) > 0))


def points_of(spec: GridSpec, mask: Mask) -> NDArray[np.float64]:
    """Return the centres of a mask's cells, float64 (N, 2), metres."""
    return spec.centers_of(np.argwhere(mask))


def blocks_of(spec: GridSpec, mask: Mask, near: NDArray[np.float64] | None = None) -> Iterator[NDArray[np.float64]]:
    """Yield `points_of` in blocks of about `BLOCK_CELLS` cells, so that the memory for a map of any size is bounded; only those in the box
    around the points `near` (N, 2), where they are given."""
    y0, x0, y1, x1 = 0, 0, spec.height, spec.width
    if near is not None:
        cells = spec.cells_of(near)
        y0, x0 = np.maximum(cells.min(axis=0) - 1, 0).tolist()
        y1, x1 = np.maximum(np.minimum(cells.max(axis=0) + 2, spec.shape), 0).tolist()
    rows = max(1, BLOCK_CELLS // max(1, x1 - x0))
    for begin in range(y0, y1, rows):
        cells = np.argwhere(mask[begin : min(begin + rows, y1), x0:x1])
        if len(cells):
            yield spec.centers_of(cells + np.array([begin, x0]))


def _corners(spec: GridSpec) -> NDArray[np.float64]:
    """Return the corners of a grid, float64 (4, 2), metres."""
    x1, y1 = spec.origin_x + spec.width * spec.resolution, spec.origin_y + spec.height * spec.resolution
    return np.array([(x, y) for x in (spec.origin_x, x1) for y in (spec.origin_y, y1)])


def _share(of: tuple[GridSpec, Mask], within: tuple[GridSpec, Mask], within_from_of: SE2) -> float:
    """Return the share of a mask's cells whose centres lie in cells of another mask."""
    near = within_from_of.inverse().transform(_corners(within[0]))
    blocks = blocks_of(*of, near)
    hits = sum(np.count_nonzero(sample(*within, within_from_of.transform(points))) for points in blocks)
    return float(hits) / float(np.count_nonzero(of[1]))


def sample(spec: GridSpec, mask: Mask, points: NDArray[np.float64]) -> Mask:
    """Return the mask's values at points (N, 2), nearest neighbour; False outside the grid."""
    cells = spec.cells_of(points)
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < spec.height) & (cells[:, 1] < spec.width)
    out = np.zeros(len(points), np.bool_)
    out[inside] = mask[cells[inside, 0], cells[inside, 1]]
    return out


def nearest_neighbour_error(from_points: NDArray[np.float64], to_points: NDArray[np.float64]) -> float:
    """Return the mean distance of each point (N, 2) to the nearest of the others (M, 2)."""
    return float(np.mean(cKDTree(to_points).query(from_points)[0]))


def comparison_spec(spec: GridSpec, occupancy: Occupancy) -> GridSpec:
    """Return the grid of the comparison: the box of the truth's known cells plus a margin, on the truth's own cell borders."""
    rows, columns = np.nonzero((occupancy >= 0).any(axis=1))[0], np.nonzero((occupancy >= 0).any(axis=0))[0]
    resolution = COMPARE_RESOLUTION
    margin = math.ceil(COMPARE_MARGIN / resolution - 1e-9) * resolution
    width = (columns[-1] + 1 - columns[0]) * spec.resolution + 2 * margin
    height = (rows[-1] + 1 - rows[0]) * spec.resolution + 2 * margin
    return GridSpec(
        resolution,
        math.ceil(width / resolution - 1e-6),
        math.ceil(height / resolution - 1e-6),
        float(spec.origin_x + columns[0] * spec.resolution - margin),
        float(spec.origin_y + rows[0] * spec.resolution - margin),
    )


def draw_points(spec: GridSpec, points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return a picture of the grid, 255 in each cell that holds a point; points outside are left out."""
    out = np.zeros(spec.shape, np.uint8)
    cells = spec.cells_of(points)
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < spec.height) & (cells[:, 1] < spec.width)
    out[cells[inside, 0], cells[inside, 1]] = 255
    return out


def structural_similarity(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Return the mean SSIM of two pictures, without the border that the window does not fit into."""
    height, width = a.shape
    rows = max(8 * REACH, BLOCK_CELLS // 2 // max(1, width))  # of a dozen numbers each
    total, count = 0.0, 0
    for begin in range(REACH, height - REACH, rows):
        end = min(begin + rows, height - REACH)
        strip = slice(begin - REACH, end + REACH)
        similarity = _similarity(a[strip], b[strip])[REACH:-REACH, REACH:-REACH]
        total, count = total + float(similarity.sum()), count + similarity.size
    return total / count if count else math.nan


def _similarity(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the SSIM around every pixel."""

    def blur(picture: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.GaussianBlur(picture, (2 * REACH + 1,) * 2, 1.5, borderType=cv2.BORDER_REFLECT))

    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    x, y = a.astype(np.float64), b.astype(np.float64)
    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    return np.asarray((2 * mx * my + c1) * (2 * vxy + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2)))


def _drawn(box: GridSpec, box_from_points: SE2, blocks: Iterable[NDArray[np.float64]]) -> Mask:
    """Return which cells of the box hold a point."""
    out = np.zeros(box.shape, np.bool_)
    for points in blocks:
        cells = box.cells_of(box_from_points.transform(points))
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < box.height) & (cells[:, 1] < box.width)
        out[cells[inside, 0], cells[inside, 1]] = True
    return out


def _overlay(truth_lines: NDArray[np.uint8], built_lines: NDArray[np.uint8], free: Mask) -> NDArray[np.uint8]:
    kinds = free.astype(np.uint8)
    kinds[truth_lines > 0] += 2
    kinds[built_lines > 0] += 4
    return np.ascontiguousarray(_TINTS[kinds[::-1]])
