"""A saved cloud as a map to localize in: read and checked, thinned, its surfaces known by the way they face, prepared once.

Heights are along gravity, as `ambler lio` writes clouds. The map never changes afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt

from ambler.core.errors import BadInputError
from ambler.kernels import branch_bound, cloud_search, relocalization, voxel_map
from ambler.lio.config import CloudMapConfig, VoxelMapConfig
from ambler.lio.voxel_map import VoxelMap
from ambler.wire.cloud_files import read_cloud

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
POINTS_LEAST = 1000
DECK_CELL, DECKS_APART, DECKS_MOST = 1.0, 1.8, 4
SHARED_LEAST = 0.1  # of the smaller of two floors, above the other: they are decks
DECK_WALLS = (0.3, 2.2)  # metres over a floor between which its walls are seen from above
WALL_CELLS_LEAST = 10
IMAGE_MOST = 16_000_000  # cells; at 0.4 m some 1.6 km by 1.6 km


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """Walls from above: `stack` uint8 (D, H + pad, W + pad) as `branch_bound.build_stack` makes it, `standing` bool (H, W) where a sensor
    could be, and the (x, y) of the outer corner of cell [0, 0], metres."""

    stack: U8
    standing: NDArray[np.bool_]
    cell: float
    corner: tuple[float, float]


class CloudMap:
    """`points` float64 (N, 3) in the map's frame; raises BadInputError, which begins with `name`, for a cloud that nobody can localize in."""

    def __init__(
        self, points: NDArray[np.floating], config: CloudMapConfig | None = None, name: str = "the map"
    ) -> None:
        self.config = c = config or CloudMapConfig()
        finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
        if len(finite) < POINTS_LEAST:
            raise BadInputError(f"{name}: holds {len(finite)} finite points, a map has at least {POINTS_LEAST}")
        low, high = np.percentile(finite, 0.1, axis=0), np.percentile(finite, 99.9, axis=0)
        finite = finite[((finite > low - 50.0) & (finite < high + 50.0)).all(axis=1)]
        if not _fits(finite, c.image_cell):
            raise BadInputError(f"{name}: spreads over {np.ptp(finite, axis=0).round()} m; is its unit metres?")
        self.points = small_gicp.voxelgrid_sampling(finite, c.cell).points()[:, :3]
        self.target = small_gicp.PointCloud(self.points)
        self.tree = small_gicp.KdTree(self.target)
        small_gicp.estimate_normals_covariances(self.target, self.tree, c.neighbours)
        self.surfaces = _surfaces(self.points)
        planes, is_plane = self.surfaces.fit_planes(self.points)
        kinds = kinds_of(planes, is_plane)
        if np.count_nonzero(kinds) < POINTS_LEAST // 10:
            raise BadInputError(f"{name}: holds hardly any surface; is it a map, or a single scan?")
        self._enter(kinds, _cell_planes(finite, self.points, c))
        self.image = _image(self.points, kinds, c)
        self.decks = _decks(self.points, kinds, c)
        self.heights = float(self.points[:, 2].min()), float(self.points[:, 2].max())

    @classmethod
    def load(cls, path: Path, config: CloudMapConfig | None = None) -> CloudMap:
        """Read a PCD, PLY or BIN file; raises BadInputError that names it."""
        table = read_cloud(path)
        columns = [np.asarray(table[axis], np.float64).reshape(-1) for axis in "xyz"]
        return cls(np.column_stack(columns), config, str(path))

    def shares_at(self, points: F64, kinds: U8, pose: F64, low: float, count: int) -> F64:
        """Return the shares (H, 2) of walls and flats that find their kind with the sensor at (x, y, yaw) and heights from `low` on."""
        shares = np.empty((count, 2))
        c = self.config
        cloud_search.score_heights(
            *(*self._table, self._kinds, c.surface_cell, points, kinds, pose, low, c.height_step, shares)
        )
        return shares

    def blocked(self, origins: F64, ends: F64) -> int:
        """Return how many rays (N, 3) from origins to ends, in the map's frame, pass through a surface of the map."""
        c = self.config
        return int(
            cloud_search.count_blocked(
                *(*self._table, self._planes, c.surface_cell, np.ascontiguousarray(origins)),
                *(np.ascontiguousarray(ends), c.clear, c.cosine_least),
            )
        )

    def _enter(self, kinds: U8, planes: F64) -> None:
        count = int(np.count_nonzero(kinds))
        size = 1 << max(4, (4 * count - 1).bit_length())
        self._table = (np.full(size, voxel_map.EMPTY, np.int64), np.zeros(size, np.int32))
        self._kinds, self._planes = np.zeros(count, np.uint8), np.zeros((count, 4))
        cloud_search.fill_cells(
            *(*self._table, self.points, kinds, planes, self.config.surface_cell, self._kinds, self._planes)
        )


def kinds_of(planes: F64, is_plane: NDArray[np.bool_]) -> U8:
    """Return WALL, FLAT or 0 for planes float64 (N, 4), uint8 (N,)."""
    up = np.abs(planes[:, 2])
    kinds = np.where(up < 0.35, cloud_search.WALL, np.where(up > 0.8, cloud_search.FLAT, 0))
    return np.where(is_plane, kinds, 0).astype(np.uint8)


def _fits(points: F64, cell: float) -> bool:
    width, depth, height = np.ptp(points, axis=0)
    return bool(width * depth / cell**2 < IMAGE_MOST and height < 2000.0 and max(width, depth) > 2.0)


def _surfaces(points: F64) -> VoxelMap:
    """Return a voxel map that holds all points, to fit planes to."""
    # Points as near as those of the map: the two sides of a thin wall are two surfaces. They are single returns of many scans, hence thicker than a filter's.
    config = VoxelMapConfig(voxel=0.6, spacing=0.2, thickness=0.12, radius=1e6)
    cells = np.unique(np.floor(points / config.voxel).astype(np.int64), axis=0)
    surfaces = VoxelMap(replace(config, voxels_most=len(cells) + 16))
    surfaces.insert(points)
    return surfaces


def _cell_planes(points: F64, queries: F64, config: CloudMapConfig) -> F64:
    """Return the plane (n, d) float64 (M, 4) of all points in the cell of each query (M, 3); zeros where they do not lie on one."""
    cells, cell_of = np.unique(_keys(points, config.surface_cell), return_inverse=True)
    count = np.bincount(cell_of).astype(np.float64)
    mean = np.stack([np.bincount(cell_of, points[:, k]) for k in range(3)], axis=1) / count[:, None]
    off = points - mean[cell_of]
    scatter = np.empty((len(cells), 3, 3))
    for i in range(3):
        for j in range(3):
            scatter[:, i, j] = np.bincount(cell_of, off[:, i] * off[:, j]) / count
    spreads, axes = np.linalg.eigh(scatter)
    normals = axes[:, :, 0]
    planes = np.column_stack([normals, -np.einsum("ij,ij->i", normals, mean)])
    is_flat = (spreads[:, 0] < config.plane_sigma**2) & (spreads[:, 1] > 4.0 * config.plane_sigma**2)
    planes[~is_flat | (count < config.plane_points)] = 0.0
    # A thinned point is the mean of others and may lie in a cell that holds none of them.
    at = np.minimum(np.searchsorted(cells, keys := _keys(queries, config.surface_cell)), len(cells) - 1)
    return np.asarray(np.where((cells[at] == keys)[:, None], planes[at], 0.0))


def _keys(points: F64, cell: float) -> NDArray[np.int64]:
    i = np.floor(points / cell).astype(np.int64) + (1 << 20)
    return np.asarray((i[:, 0] << 42) | (i[:, 1] << 21) | i[:, 2])


def _decks(points: F64, kinds: U8, config: CloudMapConfig) -> tuple[Image, ...]:
    """Return an image of the walls over each floor where floors lie above one another, else none: seen together, the walls of one deck hide which place of another
    a robot is at."""
    corner = points[:, :2].min(axis=0)
    cells = np.floor((points[:, :2] - corner) / DECK_CELL).astype(np.int64)
    cells = cells[:, 1] * (cells[:, 0].max() + 1) + cells[:, 0]
    is_flat = kinds == cloud_search.FLAT
    flat_cells, flat_z = cells[is_flat], points[is_flat, 2]
    floors: dict[float, set[int]] = {}
    layers = np.round(flat_z / config.height_step).astype(np.int64)
    areas = {int(k): len(np.unique(flat_cells[layers == k])) for k in np.unique(layers)}
    for k in sorted(areas, key=lambda k: -areas[k]):
        z = k * config.height_step
        if len(floors) < DECKS_MOST and all(abs(z - other) >= DECKS_APART for other in floors):
            floors[z] = set(flat_cells[np.abs(flat_z - z) <= config.height_step].tolist())
    images = []
    for z, area in sorted(floors.items()):
        others = [own for other, own in floors.items() if other != z]
        shared = max((len(area & own) / max(1, min(len(area), len(own))) for own in others), default=0.0)
        is_over = (kinds == cloud_search.WALL) & (points[:, 2] > z + DECK_WALLS[0]) & (points[:, 2] < z + DECK_WALLS[1])
        if shared >= SHARED_LEAST and len(np.unique(cells[is_over])) >= WALL_CELLS_LEAST:
            images.append(_image(points, np.where(is_over | is_flat, kinds, 0).astype(np.uint8), config))
    return tuple(images) if len(images) > 1 else ()


def _image(points: F64, kinds: U8, config: CloudMapConfig) -> Image:
    cell, pad = config.image_cell, 4.0
    low = points[:, :2].min(axis=0) - pad
    shape = tuple(int(v) for v in np.ceil((points[:, :2].max(axis=0) + pad - low) / cell)[::-1])
    walls, flats = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    ij = np.floor((points[:, :2] - low) / cell).astype(np.int64)
    for image, kind in ((walls, cloud_search.WALL), (flats, cloud_search.FLAT)):
        own = ij[kinds == kind]
        image[own[:, 1], own[:, 0]] = True
    distance = (
        (distance_transform_edt(~walls) * cell).astype(np.float32) if walls.any() else np.full(shape, 1e3, np.float32)
    )
    cells = np.empty(shape, np.uint16)
    relocalization.score_cells(distance, config.image_sigma, 1, cells)
    margin = (1 << (config.depth - 1)) - 1
    stack = np.empty((config.depth, shape[0] + margin, shape[1] + margin), np.uint8)
    branch_bound.build_stack(cells, stack)
    standing = binary_dilation(flats, iterations=round(config.ground_near / cell))
    return Image(stack, standing, cell, (float(low[0]), float(low[1])))
