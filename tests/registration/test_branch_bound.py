"""Branch and bound finds what brute force finds, with fewer looks; its stack bounds every window from above."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import branch_bound
from ambler.registration.branch_bound import BranchBoundMatcher
from ambler.registration.correlative import Window, angular_step
from ambler.registration.planar_scan import filter_voxels_adaptively
from tests.registration.mapped import GRID_FROM_ROOM, room_grid
from tests.registration.room import random_pose, scan_at


def brute_force(
    level0: np.ndarray,
    frame: np.ndarray,
    points: np.ndarray,
    center: np.ndarray,
    half: int,
    half_angles: int,
    step: float,
) -> dict[tuple[int, int, int], int]:
    """Return the sum of cells under the points for every (angle, dy, dx) of the window; outside counts nothing."""
    h, w = level0.shape
    sums = {}
    for a in range(-half_angles, half_angles + 1):
        at = SE2(center[0], center[1], center[2] + a * step).transform(points.astype(float))
        ix, iy = np.floor((at - frame[1:]) * (1.0 / frame[0])).astype(int).T
        for dy in range(-half, half + 1):
            for dx in range(-half, half + 1):
                ok = (ix + dx >= 0) & (iy + dy >= 0) & (ix + dx < w) & (iy + dy < h)
                sums[a, dy, dx] = int(level0[iy[ok] + dy, ix[ok] + dx].astype(int).sum())
    return sums


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_branch_and_bound_equals_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    h, w = (int(v) for v in rng.integers(6, 40, 2))
    cells = (rng.integers(0, 32768, (h, w)) * (rng.random((h, w)) < rng.choice([0.05, 0.5]))).astype(np.uint16)
    frame = np.array([0.1, *rng.uniform(-3.0, 1.0, 2)])
    reach = rng.choice([0.3, 2.0])  # within the grid, and beyond it
    points = rng.uniform(-reach, reach, (int(rng.integers(1, 100)), 2)).astype(np.float32)
    center, half, half_angles, step = rng.uniform(-1.0, 1.0, 3), int(rng.integers(0, 11)), int(rng.integers(0, 3)), 0.07
    depth = int(rng.integers(1, 6))
    pad = (1 << (depth - 1)) - 1
    stack = np.empty((depth, h + pad, w + pad), np.uint8)
    branch_bound.build_stack(cells, stack)
    best = np.empty(4)
    sums = brute_force(stack[0, pad:, pad:], frame, points, center, half, half_angles, step)
    top = max(sums.values())
    window = np.array([half, half_angles, step, int(rng.integers(0, depth))])
    branch_bound.search(stack, frame, points, center, window, -1, best)
    assert best[3] == top
    winner = (
        round((best[2] - center[2]) / step),
        round((best[1] - center[1]) / frame[0]),
        round((best[0] - center[0]) / frame[0]),
    )
    assert sums[winner] == top
    branch_bound.search(stack, frame, points, center, window, top, best)
    assert best[3] == -1.0
    if top > 0:
        branch_bound.search(stack, frame, points, center, window, top - 1, best)
        assert best[3] == top


def test_the_stack_holds_the_maxima_of_growing_windows() -> None:
    cells = np.random.default_rng(4).integers(0, 32768, (13, 10)).astype(np.uint16)
    stack = np.empty((4, 13 + 7, 10 + 7), np.uint8)
    branch_bound.build_stack(cells, stack)
    padded = np.zeros((13 + 7, 10 + 7), int)
    padded[7:, 7:] = np.rint(cells / 32767 * 255)
    for level in range(4):
        for iy in range(20):
            for ix in range(17):
                assert stack[level, iy, ix] == padded[iy : iy + (1 << level), ix : ix + (1 << level)].max()


@pytest.mark.parametrize("seed", range(3))
def test_a_lost_scan_is_found_in_a_large_window(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matcher = BranchBoundMatcher(room_grid())
    for _ in range(3):
        room_from_base = random_pose(rng)
        true = GRID_FROM_ROOM @ room_from_base
        points = filter_voxels_adaptively(scan_at(room_from_base, rng=rng).points, 0.9, 100)
        away = rng.uniform(-1.9, 1.9, 2)
        start = SE2(true.x + away[0], true.y + away[1], true.yaw + float(rng.uniform(-0.5, 0.5)))
        found = matcher.match(points, start, Window(2.0, math.radians(30.0)), 0.5)
        assert found is not None
        assert found.grid_from_base.distance_to(true) < 0.08
        assert abs(wrap_angle(found.grid_from_base.yaw - true.yaw)) < 2.0 * angular_step(points, 0.05, 0.8)
        candidates = 81 * 81 * (2 * math.ceil(math.radians(30.0) / angular_step(points, 0.05, 0.8)) + 1)
        assert found.scored < 0.1 * candidates


def test_below_the_asked_score_there_is_no_match() -> None:
    points = scan_at(SE2(0.2, 0.1, 0.0)).points
    far = Window(0.5, 0.1)
    assert BranchBoundMatcher(room_grid()).match(points, GRID_FROM_ROOM @ SE2(30.0, 0.0, 0.0), far, 0.2) is None
    assert BranchBoundMatcher(room_grid()).match(points, GRID_FROM_ROOM @ SE2(0.2, 0.1, 0.0), far, 0.89) is None


@pytest.mark.parametrize("coarseness", [1, 4])
def test_known_free_ground_draws_a_scan_unless_only_walls_count(coarseness: int) -> None:
    """A corner of which the grid shows a third, beside a field that was seen to be likely free: more points lie on the field than the corner has."""
    cells = np.zeros((200, 200), np.uint16)
    cells[40:60, 100] = cells[40, 100:120] = 29000
    cells[:, 160:] = 12000
    grid = SimpleNamespace(cells=cells, frame=np.array([0.05, 0.0, 0.0]))
    along = np.arange(0.025, 3.0, 0.05)
    points = np.concatenate([np.c_[np.zeros_like(along), along], np.c_[along, np.zeros_like(along)]]).astype(np.float32)
    window, truth = Window(2.0, 0.02), SE2(5.025, 2.025, 0.0)
    found = {
        only_walls: BranchBoundMatcher(grid, 5, coarseness, only_walls=only_walls).match(
            points, SE2(6.6, 2.6, 0.0), window, 0.11
        )
        for only_walls in (True, False)
    }
    assert all(found.values())
    assert found[True].grid_from_base.distance_to(truth) < 0.05 * coarseness + 0.08
    assert found[False].grid_from_base.distance_to(truth) > 0.5
