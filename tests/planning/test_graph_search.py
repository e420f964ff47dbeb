"""The search kernel against SciPy's Dijkstra on the same graph: every cost equal, to the last unit."""

import numpy as np
import pytest

from ambler.kernels import graph_search as kernels
from ambler.planning.grid_planner import INT32_LIMIT, PlannerConfig, weight_table
from ambler.planning.oracle import scipy_costs
from ambler.studies.planner_worlds import WORLDS, inflated, make_world

TABLE = weight_table(PlannerConfig())
FREE = (np.arange(256) < 253).astype(np.uint16)


def weights_of(costs: np.ndarray) -> np.ndarray:
    weights = np.zeros((costs.shape[0] + 2, costs.shape[1] + 2), np.uint16)
    kernels.weigh(costs, TABLE, weights)
    return weights


def search(weights: np.ndarray, start: np.ndarray, goal: np.ndarray | None) -> tuple[int, np.ndarray, np.ndarray]:
    cost = np.full(weights.shape, INT32_LIMIT, np.int32)
    state = np.zeros(weights.shape, np.uint8)
    ends = (start[0] + 1, start[1] + 1, *((-1, -1) if goal is None else (goal[0] + 1, goal[1] + 1)))
    return kernels.search(weights, *ends, 50, 252, cost, state), cost[1:-1, 1:-1], state


def random_costs(rng: np.random.Generator, kind: str) -> np.ndarray:
    shape = tuple(rng.integers(3, 70, 2))
    if kind == "noise":
        return rng.integers(0, 256, shape).astype(np.uint8)
    cells = np.where(rng.random(shape) < (0.35 if kind == "maze" else 0.03), 254, 0).astype(np.uint8)
    return cells if kind == "maze" else inflated(cells, inscribed=0.06, radius=0.3)


@pytest.mark.parametrize("kind", ["noise", "maze", "inflated"])
@pytest.mark.parametrize("seed", range(12))
def test_every_cost_equals_dijkstras(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = random_costs(rng, kind)
    free = np.argwhere(costs < 253)
    start = free[rng.integers(len(free))]
    weights = weights_of(costs)
    expected = scipy_costs(TABLE[costs], (start[0], start[1]))
    status, cost, _ = search(weights, start, None)
    assert status == kernels.REACHED
    np.testing.assert_array_equal(np.where(cost < INT32_LIMIT, cost, np.inf), expected)
    for goal in free[rng.integers(len(free), size=8)]:
        status, cost, state = search(weights, start, goal)
        if not np.isfinite(expected[tuple(goal)]):
            assert status == kernels.UNREACHED
            continue
        assert status == kernels.REACHED
        assert cost[tuple(goal)] == expected[tuple(goal)]
        assert path_cost(weights, state, goal) == expected[tuple(goal)]


def path_cost(weights: np.ndarray, state: np.ndarray, goal: np.ndarray) -> int:
    """Add up the edges of the extracted path, checking that each is one of the graph."""
    y, x = kernels.path_points(state, goal[0] + 1, goal[1] + 1).astype(int).T
    total = 0
    for a, b, c, d in zip(y[:-1], x[:-1], y[1:], x[1:], strict=True):
        assert max(abs(a - c), abs(b - d)) == 1
        assert weights[a, d] > 0 < weights[c, b]
        length = kernels.DIAGONAL if a != c and b != d else kernels.STRAIGHT
        total += length * (int(weights[a, b]) + int(weights[c, d]))
    return total


@pytest.mark.parametrize("name", WORLDS)
def test_planner_worlds_at_small_size(name: str) -> None:
    costs = inflated(make_world(name, 300, np.random.default_rng(2)))
    start, goal = np.array([30, 30]), np.array([269, 269])
    expected = scipy_costs(TABLE[costs], (30, 30))
    _, cost, _ = search(weights_of(costs), start, None)
    np.testing.assert_array_equal(np.where(cost < INT32_LIMIT, cost, np.inf), expected)
    _, cost, _ = search(weights_of(costs), start, goal)
    assert cost[269, 269] == expected[269, 269]


def test_costs_beyond_32_bits_are_reported_and_then_found() -> None:
    costs = np.zeros((3, 400), np.uint8)
    weights = weights_of(costs)
    state = np.zeros(weights.shape, np.uint8)
    small = np.full(weights.shape, 100_000, np.int32)
    assert kernels.search(weights, 1, 1, 1, 400, 50, 252, small, state) == kernels.OVERFLOW
    large = np.full(weights.shape, 2**60, np.int64)
    assert kernels.search(weights, 1, 1, 1, 400, 50, 252, large, state) == kernels.REACHED
    assert large[1, 400] == 399 * 2 * 50 * kernels.STRAIGHT


@pytest.mark.parametrize("seed", range(8))
def test_distance_field_is_the_shortest_octile_length(seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = random_costs(rng, "maze" if seed % 2 else "inflated")
    free = np.argwhere(costs < 253)
    start = free[rng.integers(len(free))]
    out = np.empty(costs.shape, np.float32)
    kernels.distance_field(costs, start[0], start[1], 253, 0.05, out)
    expected = scipy_costs(FREE[costs], (start[0], start[1]), straight=0.5, diagonal=0.5 * np.sqrt(2.0)) * 0.05
    np.testing.assert_allclose(out, expected, rtol=1e-4, atol=1e-6)


def test_distance_field_leaves_an_inscribed_start_but_never_enters_one() -> None:
    costs = np.zeros((5, 9), np.uint8)
    costs[:, 2:4] = 253
    costs[:, 6] = 253
    out = np.empty(costs.shape, np.float32)
    kernels.distance_field(costs, 2, 3, 253, 1.0, out)
    assert out[2, 4] == pytest.approx(1.0)
    assert out[2, 1] == pytest.approx(2.0)
    assert np.isinf(out[:, 7:]).all()
