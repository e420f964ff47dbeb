"""Every kernel of the footprint and the rollout against a slow twin."""

import math
from collections import deque

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from ambler.control.local_window import LocalWindow, covering_circles
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.kernels import footprint, rollout
from tests.control.closed_loop import DIFF, SPOT, step_velocity

RES = 0.05
OCTAGON = np.array(
    [[0.25, 0.14], [0.19, 0.2], [-0.19, 0.2], [-0.25, 0.14], [-0.25, -0.14], [-0.19, -0.2], [0.19, -0.2], [0.25, -0.14]]
)
SHAPES = {"octagon": OCTAGON, "spot": SPOT.footprint, "triangle": np.array([[0.4, 0.0], [-0.2, 0.3], [-0.3, -0.25]])}
SEEDS = st.integers(0, 10_000)


def random_costs(seed: int, share: float, shape: tuple[int, int] = (40, 50)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, 254, shape).astype(np.uint8)
    costs[rng.random(shape) < share] = COST_LETHAL
    return costs


def prepared(costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sums = np.zeros((costs.shape[0], costs.shape[1] + 1), np.int32)
    distance = np.zeros(costs.shape)
    footprint.lethal_row_sums(costs, COST_LETHAL, sums)
    footprint.lethal_distance(sums, RES, distance)
    return sums, distance


def inside(points: np.ndarray, polygon: np.ndarray, padding: float) -> np.ndarray:
    """Slow twin: every edge of the counter-clockwise polygon, moved outwards, has the point on its left."""
    result = np.ones(len(points), bool)
    for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        d = (q - p) / np.hypot(*(q - p))
        result &= d[0] * (points[:, 1] - p[1]) - d[1] * (points[:, 0] - p[0]) >= -padding
    return result


@given(SEEDS, st.sampled_from([0.0, 0.002, 0.05, 0.5, 1.0]))
@settings(max_examples=25, deadline=None)
def test_distance_is_the_euclidean_one(seed: int, share: float) -> None:
    costs = random_costs(seed, share)
    sums, distance = prepared(costs)
    assert np.array_equal(np.diff(sums, axis=1) > 0, costs == COST_LETHAL)
    if (costs == COST_LETHAL).any():
        assert np.allclose(distance, distance_transform_edt(costs != COST_LETHAL) * RES, atol=1e-9)
    else:
        assert distance.min() > 1e5


@given(SEEDS, st.floats(-0.3, 2.8), st.floats(-0.3, 2.3), st.floats(-4, 4), st.sampled_from(sorted(SHAPES)))
@settings(max_examples=150, deadline=None)
def test_cells_inside_the_filled_footprint(seed: int, x: float, y: float, yaw: float, name: str) -> None:
    costs = random_costs(seed, 0.1)
    sums, _ = prepared(costs)
    normals, offsets = footprint.footprint_edges(SHAPES[name], 0.03)
    count = footprint.lethal_cells_inside(sums, RES, x, y, math.cos(yaw), math.sin(yaw), normals, offsets)
    cells = np.argwhere(costs == COST_LETHAL)
    points = SE2(x, y, yaw).inverse().transform((cells[:, ::-1] + 0.5) * RES)
    low = inside(points, SHAPES[name], 0.03 - 1e-9).sum()
    high = inside(points, SHAPES[name], 0.03 + 1e-9).sum()
    assert low <= count <= high


def test_an_obstacle_in_the_middle_of_the_footprint_is_seen() -> None:
    window = LocalWindow(SPOT, 0.0)
    costs = np.zeros((60, 60), np.uint8)
    costs[30, 30] = COST_LETHAL
    window.update(costs, GridSpec(RES, 60, 60, -1.5, -1.5))
    assert window.lethal_cells(SE2(0.02, 0.02, 0.7)) == 1
    assert window.lethal_cells(SE2(0.02, 0.32, 0.0)) == 0


def test_edges_refuse_what_is_no_convex_polygon() -> None:
    with pytest.raises(ValueError, match="convex"):
        footprint.footprint_edges(SPOT.footprint[::-1], 0.0)
    with pytest.raises(ValueError, match="convex"):
        footprint.footprint_edges(np.array([[0.0, 0.0], [1.0, 0.0], [0.2, 0.2], [0.0, 1.0]]), 0.0)
    with_midpoint = np.array([[0.5, -0.5], [0.5, 0.0], [0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5]])
    assert len(footprint.footprint_edges(with_midpoint, 0.0)[0]) == 4


@given(st.sampled_from(sorted(SHAPES)), st.floats(0.0, 0.1), SEEDS)
@settings(max_examples=30, deadline=None)
def test_circles_cover_the_footprint(name: str, padding: float, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-0.8, 0.8, (400, 2))
    points = points[inside(points, SHAPES[name], padding)]
    circles = covering_circles(*footprint.footprint_edges(SHAPES[name], padding))
    away = np.hypot(points[:, None, 0] - circles[None, :, 0], points[:, None, 1] - circles[None, :, 1])
    assert (away <= circles[None, :, 2] + 1e-9).any(axis=1).all()


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_spreading_is_a_breadth_first_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = random_costs(seed, 0.03)
    _, distance = prepared(costs)
    path = rng.integers(-2, 42, (12, 2)).astype(np.int32)
    steps, label = np.empty(costs.shape, np.int32), np.empty(costs.shape, np.int32)
    rollout.spread_path(path, distance, 0.12, steps, label, np.empty(costs.size, np.int32))
    twin = np.full(costs.shape, -1)
    queue: deque[tuple[int, int]] = deque()
    for iy, ix in path:
        if 0 <= iy < 40 and 0 <= ix < 50 and twin[iy, ix] < 0:
            twin[iy, ix] = 0
            queue.append((iy, ix))
    while queue:
        iy, ix = queue.popleft()
        for ny, nx in ((iy + 1, ix), (iy - 1, ix), (iy, ix + 1), (iy, ix - 1)):
            if 0 <= ny < 40 and 0 <= nx < 50 and twin[ny, nx] < 0 and distance[ny, nx] >= 0.12:
                twin[ny, nx] = twin[iy, ix] + 1
                queue.append((ny, nx))
    assert np.array_equal(steps, twin)
    assert np.array_equal(label >= 0, steps >= 0)
    reached = np.argwhere(steps >= 0)
    near = np.abs(path[label[steps >= 0]] - reached).sum(axis=1)
    assert (near <= steps[steps >= 0]).all()


def roll(samples: np.ndarray, start: np.ndarray, v0: np.ndarray, costs: np.ndarray, stop: float = 1e9) -> np.ndarray:
    sums, distance = prepared(costs)
    window = LocalWindow(DIFF, 0.0)
    path = np.stack((np.linspace(0.5, 2.4, 39), np.full(39, 1.0), np.linspace(0.0, 1.9, 39), np.zeros(39)), axis=1)
    cells = np.floor(path[:, [1, 0]] / RES).astype(np.int32)
    steps, label = np.empty(costs.shape, np.int32), np.empty(costs.shape, np.int32)
    rollout.spread_path(cells, distance, 0.2, steps, label, np.empty(costs.size, np.int32))
    out = np.empty((len(samples), rollout.COLUMNS))
    plan = np.array([1.0, stop, 0.02, window.radius, 9.0, 0.0, 9.0])
    rates = np.array([1.0, 1.0, 2.5, 1.5, 1.5, 2.5])
    cells, guide = footprint.LethalCells(sums, distance, RES), rollout.Guide(path, steps, label)
    marks = np.empty((len(samples), rollout.MARKS_MAX, 3))
    rollout.roll_out(samples, start, v0, rates, plan, cells, window.outline, guide, np.zeros((0, 6)), out, marks)
    for way, places in zip(out, marks, strict=True):
        rollout.look_along(places, guide, RES, np.empty(3), way)
    return out


@given(st.floats(-0.8, 0.8), st.floats(-1.5, 1.5), st.floats(0.0, 0.8), st.floats(-1.0, 1.0), SEEDS)
@example(-0.75, 0.75, 0.3203125, 0.0, 313)
@settings(max_examples=60, deadline=None)
def test_a_trajectory_is_the_integral_of_its_velocities(vx: float, wz: float, v0: float, w0: float, seed: int) -> None:
    costs = random_costs(seed, 0.004)
    start = np.array([1.2, 1.0, 0.3])
    out = roll(np.array([[vx, 0.0, wz]]), start, np.array([v0, 0.0, w0]), costs)[0]
    window = LocalWindow(DIFF, 0.03)  # as wide as the two integrations may differ, else a grazed cell decides
    window.update(costs, GridSpec(RES, 50, 40, 0.0, 0.0))
    pose, v = SE2(1.2, 1.0, 0.3), BodyVelocity(v0, 0.0, w0)
    counts = [window.lethal_cells(pose)]
    for _ in range(500):
        v = step_velocity(v, BodyVelocity(vx, 0.0, wz), DIFF.limits, 0.002)
        pose = pose @ SE2.exp(np.array([v.vx, 0.0, v.wz]) * 0.002)
        counts.append(window.lethal_cells(pose))
    if max(counts) == 0:
        assert out[0] == 1.0
        assert math.hypot(out[1] - pose.x, out[2] - pose.y) < 0.03
        assert abs(math.remainder(out[3] - pose.yaw, 2 * math.pi)) < 0.03
    if out[0] == 0.0:
        assert max(counts) > 0


def test_a_robot_in_contact_may_only_leave() -> None:
    costs = np.zeros((40, 50), np.uint8)
    costs[:, 28:32] = COST_LETHAL  # x from 1.40 to 1.60: 5 cm inside the front
    start, samples = np.array([1.2, 1.0, 0.0]), np.array([[0.3, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.0, 0.0, 1.0]])
    out = roll(samples, start, np.zeros(3), costs)
    assert out[0, 0] == 0.0
    assert out[1, 0] == 1.0


def test_a_trajectory_ends_where_the_path_ends() -> None:
    out = roll(
        np.array([[0.8, 0.0, 0.0]]),
        np.array([0.5, 1.0, 0.0]),
        np.array([0.8, 0.0, 0.0]),
        np.zeros((40, 50), np.uint8),
        0.3,
    )
    assert math.isclose(out[0, 1], 0.8, abs_tol=1e-9)
    assert math.isclose(out[0, rollout.ALONG], 0.3, abs_tol=1e-9)
    assert out[0, rollout.OFF_PATH] < 1e-9


def test_turning_and_sliding_stop_before_a_wall() -> None:
    costs = np.zeros((80, 80), np.uint8)
    costs[:, 60] = COST_LETHAL  # wall at x = 1.0 to 1.05
    window = LocalWindow(SPOT, 0.0)
    window.update(costs, GridSpec(RES, 80, 80, -2.0, -2.0))
    assert math.isclose(window.free_slide(SE2(), 0.0, 1.0), 1.025 - 0.55, abs_tol=0.025)
    assert window.free_slide(SE2(), math.pi, 1.0) == 1.0
    assert window.free_turn(SE2(0.3, 0.0, 0.0), math.pi) == math.pi
    beside = SE2(0.7, 0.0, math.pi / 2)
    turn = window.free_turn(beside, math.pi)
    assert 0.0 < turn < 1.0
    corner = beside.transform(SPOT.footprint)
    assert corner[:, 0].max() < 1.0
