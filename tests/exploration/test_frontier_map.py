"""The frontier search against a slow twin of the definition, and the incremental search against the full one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.grid import GridSpec
from ambler.exploration.frontier_map import Box, FrontierGroups, FrontierMap, changed_box


def random_map(rng: np.random.Generator, height: int, width: int) -> NDArray[np.int8]:
    """Blobs of free, unknown and occupied cells, plus single cells of noise."""
    smooth = ndimage.gaussian_filter(rng.normal(size=(height, width)), 2.0)
    occupancy = np.where(smooth > 0.02, 0, -1).astype(np.int8)
    occupancy[np.abs(smooth - 0.08) < 0.02] = 100
    noise = rng.random((height, width))
    occupancy[noise < 0.01] = -1
    occupancy[noise > 0.99] = 20
    return occupancy


def twin_mask(occupancy: NDArray[np.int8], free_below: int = 50) -> NDArray[np.bool_]:
    """The definition, read aloud: free, and one of the four neighbours is unknown; outside is unknown."""
    unknown = np.pad(occupancy < 0, 1, constant_values=True)
    beside = unknown[1:-1, :-2] | unknown[1:-1, 2:] | unknown[:-2, 1:-1] | unknown[2:, 1:-1]
    free = (occupancy >= 0) & (occupancy < free_below)
    return np.asarray(free & beside)


def spec_of(occupancy: NDArray[np.int8]) -> GridSpec:
    return GridSpec(0.05, occupancy.shape[1], occupancy.shape[0], -1.0, 2.0)


def as_sets(groups: FrontierGroups) -> list[set[int]]:
    return [set(groups.cells[a:b].tolist()) for a, b in zip(groups.starts[:-1], groups.starts[1:], strict=True)]


@given(seed=st.integers(0, 10_000), height=st.integers(1, 60), width=st.integers(1, 60))
@settings(max_examples=60, deadline=None)
def test_full_search_equals_the_definition(seed: int, height: int, width: int) -> None:
    occupancy = random_map(np.random.default_rng(seed), height, width)
    groups = FrontierMap().update(spec_of(occupancy), occupancy)
    mask = twin_mask(occupancy)
    labels, count = ndimage.label(mask, structure=np.ones((3, 3)))
    expected = [set(np.flatnonzero(labels.ravel() == k + 1).tolist()) for k in range(count)]
    assert as_sets(groups) == sorted(expected, key=min)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_incremental_search_equals_the_full_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupancy = random_map(rng, 70, 90)
    frontier_map = FrontierMap()
    frontier_map.update(spec_of(occupancy), occupancy)
    for _ in range(5):
        before = occupancy.copy()
        y, x = int(rng.integers(0, 70)), int(rng.integers(0, 90))
        h, w = int(rng.integers(0, 30)), int(rng.integers(0, 30))
        patch = occupancy[y : y + h, x : x + w]
        patch[...] = random_map(rng, 70, 90)[: patch.shape[0], : patch.shape[1]]
        changed = changed_box(before, occupancy)
        incremental = frontier_map.update(spec_of(occupancy), occupancy, changed or Box(0, 0, 0, 0))
        full = FrontierMap().update(spec_of(occupancy), occupancy)
        assert np.array_equal(incremental.cells, full.cells)
        assert np.array_equal(incremental.starts, full.starts)


def test_a_box_is_ignored_when_the_grid_itself_changed() -> None:
    rng = np.random.default_rng(1)
    small, large = random_map(rng, 20, 30), random_map(rng, 40, 50)
    frontier_map = FrontierMap()
    frontier_map.update(spec_of(small), small)
    groups = frontier_map.update(spec_of(large), large, Box(0, 0, 2, 2))
    assert np.array_equal(np.sort(groups.cells), np.flatnonzero(twin_mask(large).ravel()))


def test_groups_do_not_wrap_around_the_edge_of_the_grid() -> None:
    occupancy = np.full((4, 6), -1, np.int8)
    occupancy[1, 5] = 0
    occupancy[2, 0] = 0
    groups = FrontierMap().update(spec_of(occupancy), occupancy)
    assert as_sets(groups) == [{11}, {12}]


def test_changed_box_is_tight() -> None:
    before = np.zeros((50, 60), np.int8)
    assert changed_box(before, before) is None
    after = before.copy()
    after[10, 40] = -1
    after[20, 30] = 100
    assert changed_box(before, after) == Box(10, 30, 21, 41)


def test_points_are_cell_centres() -> None:
    occupancy = np.full((3, 3), -1, np.int8)
    occupancy[1, 2] = 0
    groups = FrontierMap().update(spec_of(occupancy), occupancy)
    assert groups.points()[0] == pytest.approx([-1.0 + 2.5 * 0.05, 2.0 + 1.5 * 0.05])
