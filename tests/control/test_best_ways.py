"""The best of many ways along a path, and places on it, against slow twins that look at everything."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.control.config import RolloutConfig
from ambler.core.errors import BadInputError
from ambler.kernels import path_place, rollout

RES = 0.05
SEEDS = st.integers(0, 10_000)


def winding_path(rng: np.random.Generator, points: int) -> np.ndarray:
    """Return a path (P, 4) of steps of 5 cm from the middle of a grid of 3 m."""
    heading = np.cumsum(rng.normal(0.0, 0.25, points))
    xy = 1.5 + np.cumsum(RES * np.column_stack((np.cos(heading), np.sin(heading))), axis=0)
    return np.ascontiguousarray(np.column_stack((xy, RES * np.arange(points), heading)))


def spread(path: np.ndarray) -> rollout.Guide:
    cells, steps, label = np.empty((len(path), 2), np.int32), np.empty((60, 60), np.int32), np.empty((60, 60), np.int32)
    path_place.cells_of_path(path, RES, cells)
    rollout.spread_path(cells, np.full((60, 60), 9.0), 0.1, steps, label, np.empty(3600, np.int32))
    return rollout.Guide(path, steps, label)


@given(SEEDS)
@settings(max_examples=60, deadline=None)
def test_the_best_way_is_that_of_all_looked_at(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 60
    guide = spread(winding_path(rng, 30))
    samples = rng.uniform(-0.5, 0.5, (n, 3)).round(1)  # some alike: of equal ones the first is the best
    marks = rng.uniform(0.0, 3.0, (n, rollout.MARKS_MAX, 3)).round(1)
    results = rng.uniform(0.0, 0.5, (n, rollout.COLUMNS)).round(1)
    results[:, rollout.FREE] = rng.random(n) < 0.7
    results[:, rollout.ALONG] = rng.uniform(0.0, 1.5, n).round(1)
    results[:, rollout.MARKS] = rng.integers(1, rollout.MARKS_MAX + 1, n)
    results[:, rollout.OFF_PATH] = results[:, rollout.OFF_HEADING] = rollout.UNSEEN
    w, end, before, gain, turn = rng.uniform(0.0, 2.0, 9), 1.45, 1.3, 0.02, 0.1
    seen = results.copy()
    for way, places in zip(seen, marks, strict=True):
        rollout.look_along(places, guide, RES, np.empty(3), way)
    left = end - seen[:, rollout.ALONG]
    off_path, clear, gap = (seen[:, k] for k in (rollout.OFF_PATH, rollout.CLEARANCE, rollout.MOVER_GAP))
    cost = w[0] * left + w[1] * off_path + w[2] * seen[:, rollout.OFF_HEADING]
    cost += w[3] * np.maximum(0.0, w[6] - clear) + w[4] * np.abs(samples[:, 2] - turn) + w[5] * np.abs(samples[:, 1])
    cost += w[7] * np.maximum(0.0, w[8] - gap) - 0.05 * samples[:, 0]
    cost[(seen[:, rollout.FREE] == 0.0) | ~(left + min(1.0, w[1]) * off_path < before - gain)] = np.inf
    for _ in range(5):  # the best, and the next ones when it is refused
        best = rollout.best_sample(samples, results, marks, guide, RES, w, end, before, gain, turn)
        if not np.isfinite(cost).any():
            assert best == -1
            return
        assert math.isclose(cost[best], cost.min(), abs_tol=1e-9)
        assert best == np.flatnonzero(cost <= cost.min() + 1e-12)[0]
        results[best, rollout.FREE] = 0.0
        cost[best] = np.inf


@given(SEEDS, st.booleans())
@settings(max_examples=80, deadline=None)
def test_a_place_on_a_path_is_the_nearest_within_reach(seed: int, is_located: bool) -> None:
    rng = np.random.default_rng(seed)
    path = winding_path(rng, int(rng.integers(1, 80)))
    x, y, near = *rng.uniform(0.5, 2.5, 2), float(rng.uniform(0.0, path[-1, 2]))
    along = path_place.place_on_path(path, x, y, RES, near, 1.0 if is_located else math.inf)
    away = np.hypot(path[:, 0] - x, path[:, 1] - y)
    if is_located:
        away[np.abs(path[:, 2] - near) > 1.0] = np.inf
    at = int(np.argmin(away))
    assert path[at, 2] - 1e-9 <= along <= path[min(at + 1, len(path) - 1), 2] + 1e-9
    fine = np.linspace(path[at, 2], path[min(at + 1, len(path) - 1), 2], 50)
    ends = [np.interp(fine, path[:, 2], path[:, k]) for k in (0, 1)]
    best = fine[np.argmin(np.hypot(ends[0] - x, ends[1] - y))]
    assert abs(along - best) < 0.002


@given(SEEDS)
@settings(max_examples=80, deadline=None)
def test_a_stretch_ends_where_it_turns_back_or_is_long_enough(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = winding_path(rng, int(rng.integers(1, 80)))
    first, until = int(rng.integers(0, len(path))), float(rng.uniform(0.0, 4.0))
    seen = float(rng.uniform(0.0, 2.0))
    turned = np.abs(np.cumsum((np.diff(path[first:, 3]) + np.pi) % (2.0 * np.pi) - np.pi))
    is_end = (path[first + 1 :, 2] > until) | ((turned > 1.0) & (path[first + 1 :, 2] > seen))
    end = first + 1 + int(np.argmax(is_end)) if is_end.any() else len(path)
    assert path_place.end_of_stretch(path, first, until, 1.0, seen) == end


@given(SEEDS)
@settings(max_examples=60, deadline=None)
def test_a_path_is_blocked_where_one_of_its_cells_lies_too_near(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = winding_path(rng, 60) - (1.0, 1.0, 0.0, 0.0)  # part of it lies outside
    distance = rng.uniform(0.15, 1.2, (40, 40))
    iy, ix = np.floor(path[:, 1] / RES).astype(int), np.floor(path[:, 0] / RES).astype(int)
    is_inside = (iy >= 0) & (iy < 40) & (ix >= 0) & (ix < 40)
    is_near = bool((distance[iy[is_inside], ix[is_inside]] < 0.2).any())
    assert path_place.leads_too_near(path, distance, RES, 0.2) == is_near


@pytest.mark.parametrize("name", [name for name in RolloutConfig.__slots__ if name.startswith("weight_")])
@pytest.mark.parametrize("value", [-0.1, math.nan])
def test_ways_that_cannot_be_the_best_are_found_only_with_weights_that_are_no_rewards(name: str, value: float) -> None:
    with pytest.raises(BadInputError, match=name):
        RolloutConfig(**{name: value})
    RolloutConfig(**{name: 0.0})
