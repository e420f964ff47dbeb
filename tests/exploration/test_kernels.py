"""Kernels of exploration against twins in NumPy and OpenCV, which are slow and plain."""

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, Frontier, FrontierState
from ambler.exploration.choice import ChoiceConfig, find_again
from ambler.exploration.survey import Survey
from ambler.kernels.frontier import has_any_around, spread_steps, towards_free

NOWHERE = CostGrid(0, "map", GridSpec(0.05, 2, 2, 0.0, 0.0), np.zeros((2, 2), np.uint8))
CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


def around(cells: np.ndarray, shape: tuple[int, int], reach: int) -> list[tuple[np.ndarray, np.ndarray, int, int]]:
    iy, ix = np.divmod(cells, shape[1])
    offsets = range(-reach, reach + 1)
    return [
        (np.clip(iy + dy, 0, shape[0] - 1), np.clip(ix + dx, 0, shape[1] - 1), dy, dx)
        for dy in offsets
        for dx in offsets
    ]


@pytest.mark.parametrize("seed", range(5))
def test_offsets_to_free_cells_and_marks_around(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(3, 20)), int(rng.integers(3, 20)))
    occupancy = rng.choice(np.array([-1, 0, 30, 100], np.int8), shape)
    marks = np.where(rng.random(shape) < 0.1, rng.integers(0, 256, shape), 0).astype(np.uint8)
    cells = np.sort(rng.choice(occupancy.size, 6, replace=False))
    bits, reach = (1 << rng.integers(0, 8, 6)).astype(np.uint8), int(rng.integers(1, 4))
    down, right, has_any = np.empty(6, np.int64), np.empty(6, np.int64), np.empty(6, np.bool_)
    towards_free(occupancy, cells, reach, 50, down, right)
    has_any_around(marks, cells, reach, bits, has_any)
    dy_sum, dx_sum, any_sum = np.zeros(6, int), np.zeros(6, int), np.zeros(6, bool)
    for y, x, dy, dx in around(cells, shape, reach):
        value = occupancy[y, x]
        weight = ((value >= 0) & (value < 50)).astype(int) - (value < 0)
        dy_sum, dx_sum, any_sum = dy_sum + dy * weight, dx_sum + dx * weight, any_sum | ((marks[y, x] & bits) > 0)
    np.testing.assert_array_equal(down, dy_sum)
    np.testing.assert_array_equal(right, dx_sum)
    np.testing.assert_array_equal(has_any, any_sum)


@pytest.mark.parametrize("seed", range(5))
def test_steps_spread_as_dilations_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    passable = (rng.random((30, 40)) < 0.7).astype(np.uint8)
    reached = np.zeros_like(passable)
    seeds = rng.choice(passable.size, 3, replace=False)
    reached.ravel()[seeds] = 1
    wanted = reached.copy()
    for _ in range(7):
        wanted |= np.asarray(cv2.dilate(wanted, CROSS)) & passable
    spread_steps(seeds, reached, passable, 7)
    np.testing.assert_array_equal(reached, wanted)
    assert reached.sum() > 20


def test_a_target_is_found_again_as_by_looking_at_all_frontiers() -> None:
    rng, config, found = np.random.default_rng(1), ChoiceConfig(), 0
    for _ in range(100):
        frontiers = [
            Frontier((rng.uniform(0, 3, 2) + rng.normal(0, 0.2, (8, 2))).astype(np.float32), (0, 0), None, 1.0, state)
            for state in (FrontierState.OPEN, FrontierState.OPEN, FrontierState.OPEN, FrontierState.UNREACHABLE)
        ]
        moved = frontiers[int(rng.integers(4))].cells + rng.normal(0.0, 0.15, 2).astype(np.float32)
        target = Frontier(moved, (0, 0), None, 1.0, FrontierState.OPEN)
        shares = []
        for frontier in frontiers:
            tree, cells = cKDTree(moved.astype(float)), frontier.cells.astype(float)
            near = np.isfinite(tree.query(cells, distance_upper_bound=config.match_distance)[0]).sum()
            fits = frontier.state is FrontierState.OPEN and near >= config.match_ratio * 8
            shares.append(near / (16 - near) if fits else 0.0)
        wanted = int(np.argmax(shares)) if max(shares) > 0.0 else None
        survey = Survey(tuple(frontiers), np.ones(4), (0, 1, 2), 1.0, 1.0, NOWHERE)
        assert find_again(target, survey, config) == wanted
        found += wanted is not None
    assert 10 < found < 90
