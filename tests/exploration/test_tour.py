"""Tours: the exact ones are the best of all orders, the searched ones are close, and small things on the way are not left behind."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ambler.kernels.tour import COST, add_up, change, change_saving, near_tour_costs, tour_costs

F64 = NDArray[np.float64]


def places(seed: int, n: int) -> tuple[F64, F64, F64]:
    """Random points in a square of 10 m: distances from the origin, between them, and weights of sum 1."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 10, (n, 2))
    weights = rng.uniform(0.1, 1.0, n)
    between = np.ascontiguousarray(np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)))
    return np.hypot(*points.T), between, weights / weights.sum()


def exact(first: F64, between: F64, weights: F64, urgency: float) -> F64:
    n = len(first)
    out = np.empty(n)
    tour_costs(first, between, weights, urgency, np.empty(1 << n), np.empty((1 << n, n)), out)
    return out


def searched(first: F64, between: F64, weights: F64, urgency: float, sweeps: int = 2) -> F64:
    out = np.empty(len(first))
    near_tour_costs(first, between, weights, urgency, sweeps, np.empty((3, len(first)), np.int64), out)
    return out


def twin(order: tuple[int, ...], first: F64, between: F64, weights: F64, urgency: float) -> float:
    """Length plus urgency times the mean distance after which weight is visited."""
    at = np.cumsum([first[order[0]], *(between[a, b] for a, b in itertools.pairwise(order))])
    return float(at[-1] + urgency * np.dot(weights[list(order)], at))


@given(seed=st.integers(0, 1000), n=st.integers(1, 6), urgency=st.sampled_from([0.0, 0.3, 2.0]))
@settings(max_examples=40, deadline=None)
def test_exact_tours_are_the_best_of_all_orders(seed: int, n: int, urgency: float) -> None:
    first, between, weights = places(seed, n)
    out = exact(first, between, weights, urgency)
    for i in range(n):
        orders = (o for o in itertools.permutations(range(n)) if o[0] == i)
        assert out[i] == pytest.approx(min(twin(o, first, between, weights, urgency) for o in orders))


@given(seed=st.integers(0, 1000), urgency=st.sampled_from([0.0, 0.3, 2.0]))
@settings(max_examples=40, deadline=None)
def test_the_cost_of_an_order_is_its_length_plus_urgent_waiting(seed: int, urgency: float) -> None:
    first, between, weights = places(seed, 7)
    order = np.random.default_rng(seed).permutation(7)
    legs, sums = np.zeros((8, 8)), np.empty((4, 8))
    legs[:7, :7], legs[7, :7] = between, first
    add_up(order, legs, weights, urgency, sums)
    assert sums[COST, -1] == pytest.approx(twin(tuple(order), first, between, weights, urgency))


@given(seed=st.integers(0, 10_000), n=st.integers(2, 9), urgency=st.sampled_from([0.0, 0.3, 2.0]))
@settings(max_examples=150, deadline=None)
def test_what_a_change_saves_is_the_difference_of_the_costs(seed: int, n: int, urgency: float) -> None:
    rng = np.random.default_rng(seed)
    first, between, weights = places(seed, n)
    legs, sums = np.zeros((n + 1, n + 1)), np.empty((4, n + 1))
    legs[:n, :n], legs[n, :n] = between, first
    order = rng.permutation(n)
    add_up(order, legs, weights, urgency, sums)
    length = int(rng.integers(1, n + 1))
    begin = int(rng.integers(0, n - length + 1))
    stretch, rest = list(order[begin : begin + length]), [*order[:begin], *order[begin + length :]]
    to = int(rng.integers(-1, n - length + 1))
    assume(to != begin)
    changed = [*order[:begin], *stretch[::-1], *order[begin + length :]]
    if to >= 0:
        changed = [*rest[:to], *stretch, *rest[to:]]
    cost = twin(tuple(order), first, between, weights, urgency)
    saving = change_saving(order, begin, length, to, legs, urgency, sums)
    assert saving == pytest.approx(cost - twin(tuple(changed), first, between, weights, urgency), abs=1e-9)
    change(order, begin, length, to, np.empty(n, np.int64))
    assert list(order) == changed


@pytest.mark.parametrize("urgency", [0.0, 0.3, 2.0])
def test_searched_tours_are_never_shorter_than_the_exact_ones_and_mostly_equal(urgency: float) -> None:
    ratios = []
    for seed in range(30):
        first, between, weights = places(seed, 10)
        best = exact(first, between, weights, urgency)
        found = searched(first, between, weights, urgency)
        assert (found >= best - 1e-9).all()
        ratios.append(found / best)
    assert np.mean(ratios) < 1.01
    assert np.max(ratios) < 1.2


def test_a_leftover_beside_the_robot_comes_before_a_great_unknown_far_away() -> None:
    """On a line: a leftover 2 m behind the robot, great unknowns 10 m and 15 m ahead. Coming back would cost more than going now."""
    x = np.array([-2.0, 10.0, 15.0])
    weights = np.array([0.25, 5.0, 5.0])
    between = np.abs(x[:, None] - x)
    assert int(np.argmin(exact(np.abs(x), between, weights / weights.sum(), 0.3))) == 0
    x = np.array([-8.0, 10.0, 15.0])
    assert int(np.argmin(exact(np.abs(x), np.abs(x[:, None] - x), weights / weights.sum(), 2.0))) == 1
