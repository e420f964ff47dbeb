"""The voxel map against brute force: neighbours, planes, insertion, eviction, and memory that does not grow."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ambler.kernels import voxel_map as kernels
from ambler.lio.config import VoxelMapConfig
from ambler.lio.voxel_map import VoxelMap

SMALL = VoxelMapConfig(voxels_most=1 << 12, radius=30.0)


def wall(count: int, seed: int = 0) -> np.ndarray:
    """Points of the plane x = 5.4 with a centimetre of noise."""
    rng = np.random.default_rng(seed)
    return np.column_stack([5.4 + rng.normal(0.0, 0.01, count), rng.uniform(-4.0, 4.0, (count, 2))])


def test_planes_are_those_through_the_five_nearest_points() -> None:
    config = VoxelMapConfig(
        voxels_most=1 << 12, spacing=0.2, points_per_voxel=40, cells_visited=27, flatness=0.0, thickness=9.0, reach=1.0
    )
    grid = VoxelMap(config)
    grid.insert(np.random.default_rng(1).uniform(-3.0, 3.0, (3000, 3)))
    points = grid.points().astype(np.float64)
    queries = np.random.default_rng(2).uniform(-2.0, 2.0, (300, 3))
    planes, is_plane = grid.fit_planes(queries)
    tree = cKDTree(points)
    distances, near = tree.query(queries, k=5)
    has_five = distances[:, 4] < 1.0
    np.testing.assert_array_equal(is_plane, has_five)
    for k in np.flatnonzero(is_plane):
        five = points[near[k]]
        normal = np.linalg.svd(five - five.mean(axis=0))[2][2]
        # The largest column of the adjugate is the normal to first order only; its plane goes through the mean.
        assert float(planes[k, :3] @ five.mean(axis=0) + planes[k, 3]) == pytest.approx(0.0, abs=1e-9)
        spread = np.abs((five - five.mean(axis=0)) @ normal).max()
        if spread < 0.02:
            assert abs(float(normal @ planes[k, :3])) > 0.99


def test_a_wall_is_a_plane_and_a_ring_on_it_is_none() -> None:
    grid = VoxelMap(SMALL)
    grid.insert(wall(4000))
    planes, is_plane = grid.fit_planes(wall(200, 1))
    assert is_plane.mean() > 0.95
    assert np.abs(np.abs(planes[is_plane, 0]) - 1.0).max() < 0.02
    ring = VoxelMap(VoxelMapConfig(voxels_most=1 << 12, spacing=0.1, cells_visited=19))
    y = np.arange(-4.0, 4.0, 0.12)
    rng = np.random.default_rng(3)
    ring.insert(np.column_stack([5.0 + rng.normal(0, 0.005, len(y)), y, 1.0 + rng.normal(0, 0.005, len(y))]))
    assert not ring.fit_planes(np.column_stack([np.full(50, 5.0), np.linspace(-3, 3, 50), np.ones(50)]))[1].any()


def test_points_keep_their_distance_and_near_ones_are_averaged() -> None:
    grid = VoxelMap(SMALL)
    grid.insert(wall(20_000))
    points = grid.points()
    assert np.abs(points[:, 0] - 5.4).max() < 0.025
    assert points[:, 0].std() < 0.006  # single returns: 0.010
    cells = np.floor(points)
    for cell in np.unique(cells, axis=0)[:50]:
        inside = points[(cells == cell).all(axis=1)]
        assert len(inside) <= SMALL.points_per_voxel
        if len(inside) > 1:
            gaps = np.linalg.norm(inside[:, None] - inside[None], axis=2)[np.triu_indices(len(inside), 1)]
            assert gaps.min() > SMALL.spacing - 2.0 * SMALL.merge


def test_what_is_near_stays_and_is_found_and_what_is_far_is_forgotten() -> None:
    grid = VoxelMap(SMALL)
    rng = np.random.default_rng(4)
    grid.insert(rng.uniform(-60.0, 60.0, (3000, 3)))
    before = grid.points()
    grid.keep_near(np.zeros(3))
    grid.keep_near(np.array([10.5, 0.0, 0.0]))
    after = grid.points()
    assert len(after) < len(before)
    middles = np.floor(before) + 0.5
    stays = np.linalg.norm(middles - [10.5, 0.0, 0.0], axis=1) <= 30.0
    assert {tuple(p) for p in after} == {tuple(p) for p in before[stays]}
    keys = {kernels.cell_key(*(float(v) for v in p), 1.0) for p in after}
    assert all(kernels.find(*grid._table, key) >= 0 for key in keys)


def test_memory_stays_the_same_over_five_kilometres() -> None:
    grid = VoxelMap(SMALL)
    size, most = grid.memory_mb, 0
    for step in range(500):
        here = np.array([10.0 * step, 0.0, 0.0])
        grid.keep_near(here)
        grid.insert(here + np.random.default_rng(step).uniform(-20.0, 20.0, (300, 3)))
        most = max(most, len(grid))
    assert grid.memory_mb == size
    assert grid.lost == 0
    assert 500 < most < SMALL.voxels_most


def test_without_room_points_are_lost_and_counted_and_the_nearest_are_kept() -> None:
    grid = VoxelMap(VoxelMapConfig(voxels_most=256, radius=1000.0))
    grid.insert(np.random.default_rng(5).uniform(-50.0, 50.0, (1000, 3)))
    assert grid.lost > 0
    assert len(grid) == 256
    grid.keep_near(np.zeros(3))
    assert len(grid) <= 0.9 * 256


def test_what_is_no_point_is_left_out() -> None:
    grid = VoxelMap(SMALL)
    grid.insert(np.array([[np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0], [0.0, 1e9, 0.0], [0.5, 0.5, 0.5]]))
    assert len(grid.points()) == 1
    assert not grid.fit_planes(np.array([[np.nan, 0.0, 0.0], [1e9, 0.0, 0.0]]))[1].any()


def test_one_point_per_cell_is_taken() -> None:
    points = np.random.default_rng(6).uniform(-5.0, 5.0, (2000, 3)).astype(np.float32)
    points[7] = np.nan
    out = np.empty(2000, np.int64)
    count = kernels.thin_out(points, np.arange(2000), 0.5, np.empty(4096, np.int64), out)
    cells = np.floor(points / 0.5)
    good = np.isfinite(points).all(axis=1)
    assert count == len(np.unique(cells[good], axis=0))
    assert len(np.unique(cells[out[:count]], axis=0)) == count


def test_points_between_two_distances_are_chosen() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(-4.0, 4.0, (1000, 3)).astype(np.float32)
    times = rng.uniform(0.0, 0.1, 1000).astype(np.float32)
    points[3], times[5] = np.nan, np.nan
    out = np.empty(1000, np.int64)
    ranges = np.linalg.norm(points, axis=1)
    for step in (1, 3):
        inside = np.flatnonzero((ranges > 1.0) & (ranges < 3.0) & np.isfinite(times))[::step]
        count = kernels.choose_between(points, times, 1.0, 3.0, step, out)
        np.testing.assert_array_equal(out[:count], inside)
