"""Voxel filters: one point per square voxel, the first one; the adaptive one keeps enough points with large voxels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.registration.planar_scan import filter_voxels, filter_voxels_adaptively
from tests.registration.room import random_pose, scan_at

SEEDS = st.integers(0, 10**6)


def voxels_of(points: np.ndarray, size: float) -> list[tuple[int, int]]:
    return [(int(x), int(y)) for x, y in np.floor(points.astype(float) / size)]


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.floats(0.02, 2.0))
def test_the_first_point_of_each_voxel_stays(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, rng.choice([0.1, 1.0, 10.0]), (int(rng.integers(0, 300)), 2)).astype(np.float32)
    first: dict[tuple[int, int], int] = {}
    for i, voxel in enumerate(voxels_of(points, size)):
        first.setdefault(voxel, i)
    assert np.array_equal(filter_voxels(points, size), points[list(first.values())])


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_filtering_twice_changes_nothing(seed: int) -> None:
    points = scan_at(random_pose(np.random.default_rng(seed))).points
    once = filter_voxels(points, 0.2)
    assert np.array_equal(filter_voxels(once, 0.2), once)
    assert 10 < len(once) < len(points)


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.integers(1, 400), st.floats(0.1, 2.0))
def test_the_adaptive_filter_keeps_enough_but_not_many(seed: int, wanted: int, max_size: float) -> None:
    rng = np.random.default_rng(seed)
    points = scan_at(random_pose(rng)).points
    kept = filter_voxels_adaptively(points, max_size, wanted)
    assert {tuple(p) for p in kept.tolist()} <= {tuple(p) for p in points.tolist()}
    if wanted >= len(points):
        assert np.array_equal(kept, points)
        return
    finest = filter_voxels(points, max_size / 128)  # closer points than this are one
    assert len(kept) >= min(wanted, len(finest))
    largest = filter_voxels(points, max_size)
    assert len(kept) >= len(largest)
    if len(largest) >= wanted:
        assert np.array_equal(kept, largest)


def test_the_adaptive_voxel_is_nearly_the_largest_possible() -> None:
    points = np.column_stack((np.linspace(0.0, 10.0, 1000), np.zeros(1000))).astype(np.float32)
    # Voxels of 10 cm keep 100 points; 10 % less voxel keeps at most about 10 % more.
    assert len(filter_voxels_adaptively(points, 2.0, 100)) == pytest.approx(105, abs=7)
