"""Exhaustive correlation recovers known perturbations and equals a NumPy twin."""

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import correlation
from ambler.registration.correlative import Window, angular_step, correlate
from ambler.registration.planar_scan import filter_voxels_adaptively
from tests.registration.mapped import GRID_FROM_ROOM, room_grid
from tests.registration.room import random_pose, scan_at

CELL = 0.05


UNKNOWN = 0.3


def probability_at(cells: np.ndarray, frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the probability of the cell under each point (N, 2) of the grid's frame, `UNKNOWN` where unknown or outside."""
    ix, iy = np.floor((points - frame[1:]) * (1.0 / frame[0])).astype(int).T
    inside = (ix >= 0) & (iy >= 0) & (ix < cells.shape[1]) & (iy < cells.shape[0])
    value = np.where(inside, cells[np.where(inside, iy, 0), np.where(inside, ix, 0)], 0).astype(float)
    return np.asarray(0.1 + 0.8 / 32766 * np.where(value == 0, round((UNKNOWN - 0.1) * 32766 / 0.8), value))


def test_the_kernel_equals_the_twin_over_the_whole_window() -> None:
    rng = np.random.default_rng(0)
    for _ in range(6):
        cells = rng.integers(0, 32768, (14, 17)).astype(np.uint16)
        cells[rng.random(cells.shape) < 0.4] = 0
        frame = np.array([CELL, *rng.uniform(-0.6, 0.0, 2)])
        points = rng.uniform(-0.6, 0.6, (25, 2)).astype(np.float32)
        center = rng.uniform(-0.1, 0.1, 3)
        weights = rng.uniform(0.0, 1.0, 2)
        half, half_angles, step = 3, 2, 0.11
        best, sums = np.empty(4), np.empty((7, 7), np.int32)
        correlation.correlate(
            cells, frame, points, center, np.array([half, half_angles, step]), weights, UNKNOWN, sums, best
        )
        found = (-1.0, SE2())
        for a in range(-half_angles, half_angles + 1):
            for iy in range(-half, half + 1):
                for ix in range(-half, half + 1):
                    pose = SE2(center[0] + ix * CELL, center[1] + iy * CELL, center[2] + a * step)
                    at = SE2(center[0], center[1], pose.yaw).transform(points.astype(float)) + CELL * np.array([ix, iy])
                    cost = weights[0] * CELL * math.hypot(ix, iy) + weights[1] * abs(a * step)
                    score = float(probability_at(cells, frame, at).mean() * math.exp(-cost * cost))
                    if score > found[0]:
                        found = (score, pose)
        assert best[3] == pytest.approx(found[0], abs=1e-9)
        assert best[:3] == pytest.approx(found[1].as_array(), abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_known_perturbations_are_recovered(seed: int) -> None:
    """To one cell and one and a half angular steps: the winner is a sample of a lattice, and its two errors trade for each other."""
    rng = np.random.default_rng(seed)
    for _ in range(10):
        room_from_base = random_pose(rng)
        true = GRID_FROM_ROOM @ room_from_base
        points = filter_voxels_adaptively(scan_at(room_from_base, rng=rng).points, 0.5, 200)
        away, turn = rng.uniform(-0.28, 0.28, 2), float(rng.uniform(-0.3, 0.3))
        start = SE2(true.x + away[0], true.y + away[1], true.yaw + turn)
        found = correlate(room_grid(), points, start, Window(0.3, math.radians(20.0)))
        assert abs(found.grid_from_base.x - true.x) < CELL
        assert abs(found.grid_from_base.y - true.y) < CELL
        assert abs(wrap_angle(found.grid_from_base.yaw - true.yaw)) < 1.5 * angular_step(points, CELL, 0.9)
        assert found.score > 0.6


def test_what_lies_outside_the_window_is_not_found() -> None:
    pose = SE2(-0.4, 0.3, 0.2)
    points, start = scan_at(pose).points, GRID_FROM_ROOM @ pose @ SE2(0.4, 0.0, 0.0)
    found = correlate(room_grid(), points, start, Window(0.1, 0.05)).grid_from_base
    assert max(abs(found.x - start.x), abs(found.y - start.y)) < 0.1 + 1e-9
    assert abs(found.yaw - start.yaw) < 0.05 + angular_step(points, CELL, 0.9)


def test_the_penalty_keeps_an_uninformed_match_at_its_start() -> None:
    rng = np.random.default_rng(1)
    cells = np.zeros((40, 40), np.uint16)
    points = rng.uniform(-0.5, 0.5, (50, 2)).astype(np.float32)

    class Empty:
        def __init__(self) -> None:
            self.cells = cells
            self.frame = np.array([CELL, -1.0, -1.0])

    start = SE2(0.1, -0.1, 0.3)
    assert correlate(Empty(), points, start, Window(0.2, 0.2)).grid_from_base == start


def test_the_angular_step_moves_the_farthest_point_by_one_cell() -> None:
    points = np.array([[4.0, 0.0], [0.0, 2.0], [1.0, 0.0]], np.float32)
    step = angular_step(points, CELL)
    assert np.hypot(*(SE2(0.0, 0.0, step).transform(points[:1])[0] - points[0])) == pytest.approx(CELL, rel=2e-3)
    near = np.array([[0.01, 0.0]], np.float32)
    assert angular_step(near, CELL) == pytest.approx(1.0 / 3.0, rel=0.01)
