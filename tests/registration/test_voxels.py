"""Voxel filters: one point per square voxel, the middle one in the order of the scan; the adaptive one keeps enough points with large voxels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.registration.planar_scan import filter_voxels, filter_voxels_adaptively
from tests.registration.room import random_pose, scan_at

SEEDS = st.integers(0, 10**6)


def voxels_of(points: np.ndarray, size: float) -> list[tuple[int, int]]:
    return [(int(x), int(y)) for x, y in np.floor(points.astype(float) / size)]


def rows_of(points: np.ndarray, size: float) -> list[list[int]]:
    """The rows of the points of each voxel."""
    rows: dict[tuple[int, int], list[int]] = {}
    for i, voxel in enumerate(voxels_of(points, size)):
        rows.setdefault(voxel, []).append(i)
    return list(rows.values())


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.floats(0.02, 2.0))
def test_the_middle_point_of_each_voxel_stays(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, rng.choice([0.1, 1.0, 10.0]), (int(rng.integers(0, 300)), 2)).astype(np.float32)
    row_of = {tuple(p): i for i, p in enumerate(points.tolist())}
    kept = [row_of[tuple(p)] for p in filter_voxels(points, size).tolist()]
    voxels = rows_of(points, size)
    assert kept == sorted(kept)
    assert len(kept) == len(voxels)
    for rows in voxels:
        (row,) = set(kept) & set(rows)
        assert row in {rows[(len(rows) - 1) // 2], rows[len(rows) // 2]}


def slope_of_a_wall(choose) -> tuple[float, float]:
    """Mean slope of the line through what is chosen of noisy scans of a wall at right angles ahead, and the standard error of that mean."""
    rng, angles = np.random.default_rng(6), np.linspace(-1.2, 1.2, 481)
    slopes = []
    for _ in range(300):
        ranges = 2.0 / np.cos(angles) + rng.normal(0.0, 0.02, len(angles))
        points = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles))).astype(np.float32)
        points += np.float32(rng.uniform(0.0, 0.3))  # voxels lie anywhere
        x, y = choose(points).T
        slopes.append(np.polyfit(y, x, 1)[0])
    return float(np.mean(slopes)), float(np.std(slopes) / np.sqrt(len(slopes)))


def test_what_is_chosen_turns_no_wall() -> None:
    """The first points of voxels do: noise of the range brings a beam early into the next one, too near on one side of the foot and too far on the other."""
    first, first_error = slope_of_a_wall(lambda p: p[sorted(rows[0] for rows in rows_of(p, 0.3))])
    mean, error = slope_of_a_wall(lambda p: filter_voxels(p, 0.3))
    assert abs(first) > 10.0 * first_error, "the case is none"
    assert abs(mean) < 3.0 * error
    assert abs(mean) < 0.1 * abs(first)


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
