"""Legs over weighted cells against a slow twin, and what pulling a path tight may and may not do."""

from itertools import pairwise

import numpy as np
import pytest

from ambler.kernels import any_angle as kernels
from ambler.kernels import gradient_path as gradient

F64 = np.ndarray


def random_weights(rng: np.random.Generator) -> np.ndarray:
    weights = np.zeros((42, 52), np.uint16)
    weights[1:-1, 1:-1] = rng.choice([50, 60, 120, 250], (40, 50), p=[0.6, 0.2, 0.1, 0.1])
    return weights


def sampled(weights: np.ndarray, a: F64, b: F64) -> tuple[float, int]:
    """Return the integral along a leg and its dearest weight from 20 000 samples."""
    cells = np.floor(a + (b - a) * ((np.arange(20_000) + 0.5) / 20_000)[:, None]).astype(int)
    values = weights[cells[:, 0], cells[:, 1]].astype(float)
    return float(values.mean() * np.hypot(*(b - a))), int(values.max())


@pytest.mark.parametrize("seed", range(10))
def test_the_integral_of_a_leg_is_that_of_its_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights = random_weights(rng)
    a, b = rng.uniform([1, 1], [41, 51], (2, 2))
    cost, dearest = kernels.segment_cost(weights, *a, *b, kernels.ANY_WEIGHT)
    expected, highest = sampled(weights, a, b)
    assert cost == pytest.approx(expected, rel=2e-3)
    assert dearest == highest
    assert kernels.segment_cost(weights, *a, *b, highest - 1)[0] == -1.0


def test_a_leg_through_a_corner_needs_both_cells_beside_it() -> None:
    weights = np.full((6, 6), 50, np.uint16)
    assert kernels.segment_cost(weights, 1.5, 1.5, 3.5, 3.5, 65535)[0] == pytest.approx(2.0 * np.sqrt(2.0) * 50)
    weights[2, 1] = 0
    assert kernels.segment_cost(weights, 1.5, 1.5, 3.5, 3.5, 65535)[0] == -1.0


def walk(rng: np.random.Generator) -> F64:
    """Return a random walk over cell centres that goes from left to right."""
    rows = np.clip(np.cumsum(rng.integers(-1, 2, 46)) + 20, 2, 38)
    return np.column_stack((rows, np.arange(3, 49))) + 0.5


@pytest.mark.parametrize("seed", range(10))
def test_a_path_pulled_tight_costs_less_keeps_its_ends_and_touches_nothing_dearer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights, points = random_weights(rng), walk(rng)
    before = points.copy()
    out = kernels.any_angle(weights, points, 50, 8.0, 20, 200)
    np.testing.assert_array_equal(points, before)
    np.testing.assert_array_equal(out[[0, -1]], points[[0, -1]])
    old = [kernels.segment_cost(weights, *a, *b, 65535) for a, b in pairwise(points)]
    new = [kernels.segment_cost(weights, *a, *b, 65535) for a, b in pairwise(out)]
    assert min(new)[0] >= 0.0
    assert sum(cost for cost, _ in new) < 0.97 * sum(cost for cost, _ in old)
    assert max(dearest for _, dearest in new) <= max(dearest for _, dearest in old)


def test_corners_go_around_what_is_dear_as_light_is_bent() -> None:
    """Two halves of weights 100 and 200: the least path obeys Snell's law at the border."""
    weights = np.zeros((102, 102), np.uint16)
    weights[1:51, 1:-1], weights[51:-1, 1:-1] = 100, 200
    points = np.array([[1.5 + k, 1.5 + k] for k in range(98)])
    out = kernels.any_angle(weights, points, 100, 8.0, 20, 200)
    cost = sum(kernels.segment_cost(weights, *a, *b, 65535)[0] for a, b in pairwise(out))
    crossings = np.linspace(1.5, 98.5, 100_000)
    best = (100 * np.hypot(49.5, crossings - 1.5) + 200 * np.hypot(47.5, 98.5 - crossings)).min()
    assert best <= cost <= best * 1.015  # the diagonal: 1.050


def test_the_potential_over_free_floor_is_the_distance() -> None:
    weights = np.zeros((62, 62), np.uint16)
    weights[1:-1, 1:-1] = 50
    levels = np.empty(weights.shape)
    gradient.potential(weights, 30, 30, levels)
    y, x = np.mgrid[1:61, 1:61]
    distance = np.hypot(y - 30, x - 30)
    far = distance > 15
    np.testing.assert_allclose(
        levels[1:-1, 1:-1][far] / 50, distance[far], rtol=0.06
    )  # of first order: too long off the axes
    assert (levels[1:-1, 1:-1] / 50 >= distance - 1e-9).all()
    out = np.empty((1000, 2))
    n = gradient.descend(levels, 5, 12, 30, 30, out)
    np.testing.assert_allclose(out[[0, n - 1]], [[5.5, 12.5], [30.5, 30.5]])
    assert np.hypot(*np.diff(out[:n], axis=0).T).sum() == pytest.approx(np.hypot(25, 18), rel=5e-3)


def test_a_path_around_what_is_dearer_never_cuts_through_it_even_where_that_is_cheaper() -> None:
    weights = np.zeros((42, 52), np.uint16)
    weights[1:-1, 1:-1] = 50
    weights[10:30, 10:41] = 60
    down, along = [(y, 5) for y in range(20, 8, -1)], [(8, x) for x in range(5, 46)]
    points = np.array([*down, *along, *[(y, 45) for y in range(9, 21)]]) + 0.5
    out = kernels.any_angle(weights, points, 50, 8.0, 20, 200)
    legs = [kernels.segment_cost(weights, *a, *b, 65535) for a, b in pairwise(out)]
    assert max(dearest for _, dearest in legs) == 50
    assert kernels.segment_cost(weights, *points[0], *points[-1], 65535)[0] < sum(cost for cost, _ in legs)
    assert sum(cost for cost, _ in legs) < 0.9 * 50 * (len(points) - 1)
