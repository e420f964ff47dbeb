"""The range layer: two echoes mark, free cones clear, old cells decay, light clears nothing; the kernel equals its slow twin."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.grid import GridSpec
from ambler.costmap.layer import Moment
from ambler.costmap.range_layer import RangeCone, RangeConfig, RangeLayer
from ambler.kernels import range_layer as kernels

SPEC = GridSpec(0.05, 60, 50, -0.5, -1.25)
HALF = math.radians(15.0)


def cone(echo: float = math.inf, free: float | None = None, **place: float) -> RangeCone:
    at = {"x": 0.0, "y": 0.0, "yaw": 0.0} | place
    return RangeCone(at["x"], at["y"], at["yaw"], HALF, min(echo, 3.0) if free is None else free, echo)


def slow_twin(
    log_odds: np.ndarray, spec: GridSpec, row: np.ndarray, model: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """The same sums cell by cell, written from the model's formula."""
    x0, y0, yaw, half, free, echo = row
    hit, miss, thickness, far, fade = model
    out = log_odds.astype(np.float64)
    for iy, ix in np.ndindex(*spec.shape):
        x, y = spec.center_of(iy, ix)
        d = math.dist((x, y), (x0, y0))
        off = abs(math.remainder(math.atan2(y - y0, x - x0) - yaw, 2 * math.pi))
        off /= max(half, math.atan(0.75 * spec.resolution / d))
        if off >= 1.0:
            continue
        sure = (1 - off**2) * (1 - (1 + math.tanh((d - far) / fade)) / 2)
        if abs(d - echo) <= thickness:
            out[iy, ix] += hit * sure
        elif d < free:
            out[iy, ix] -= miss * sure
    return np.clip(out, *limits).astype(np.float32)


@given(
    x=st.floats(-0.4, 2.0), y=st.floats(-1.0, 1.0), yaw=st.floats(-3.1, 3.1),
    half=st.floats(0.1, 0.6), echo=st.one_of(st.floats(0.05, 2.5), st.just(math.inf)), seed=st.integers(0, 999),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_the_kernel_equals_its_twin(x: float, y: float, yaw: float, half: float, echo: float, seed: int) -> None:
    before = np.random.default_rng(seed).uniform(-0.9, 2.9, SPEC.shape).astype(np.float32)
    row = np.array([x, y, yaw, half, min(echo - 0.04, 2.5), echo])
    model, limits = np.array([1.0, 0.5, 0.035, 1.5, 0.5]), np.array([-1.0, 3.0])
    grid, touched = before.copy(), np.full(SPEC.shape, kernels.UNSEEN)
    kernels.draw_cone(grid, touched, SPEC.origin_x, SPEC.origin_y, SPEC.resolution, row, model, limits, 7.0)
    expected = slow_twin(before, SPEC, row, model, limits)
    np.testing.assert_allclose(grid, expected, atol=1e-5)
    assert (touched[np.abs(grid - before) > 1e-6] == 7.0).all()


def say(layer: RangeLayer, cones: list[RangeCone], now: float) -> None:
    layer.add(cones, now)
    layer.update(SPEC, Moment())


def test_one_echo_does_not_mark_and_the_second_marks_its_arc() -> None:
    layer = RangeLayer(RangeConfig())
    say(layer, [cone(1.02)], 0.0)
    assert not (layer.cells == 254).any()
    say(layer, [cone(1.02)], 0.1)
    marked = SPEC.centers_of(np.argwhere(layer.cells == 254))
    assert len(marked) >= 5
    np.testing.assert_allclose(np.hypot(*marked.T), 1.02, atol=0.04)
    assert (np.abs(np.arctan2(marked[:, 1], marked[:, 0])) < HALF).all()
    assert layer.cells[SPEC.cell_of(0.5, 0.0)] == 0, "before the echo it is free"
    assert layer.cells[SPEC.cell_of(1.3, 0.0)] == 255, "behind it nothing is known"
    assert layer.cells[SPEC.cell_of(-0.3, 0.0)] == 255, "behind the transducer, too"


@pytest.mark.parametrize("half", [0.0, 0.005, math.radians(1.0)])
@pytest.mark.parametrize("y", [0.0, 0.012, 0.025])
def test_a_cone_narrower_than_a_cell_passes_between_none(half: float, y: float) -> None:
    layer = RangeLayer(RangeConfig())
    for k in range(5):
        say(layer, [RangeCone(0.0, y, 0.0, half, 0.95, 1.02)], 0.1 * k)
    marked = SPEC.centers_of(np.argwhere(layer.cells == 254))
    assert 1 <= len(marked) <= 4
    np.testing.assert_allclose(marked, [[1.02, y]] * len(marked), atol=0.04)
    assert (layer.cells[SPEC.cell_of(0.5, y)] == 0).all()


def test_free_cones_clear_what_echoes_marked() -> None:
    layer = RangeLayer(RangeConfig())
    for k in range(10):
        say(layer, [cone(1.02)], 0.1 * k)
    for k in range(9):
        say(layer, [cone()], 1.0 + 0.1 * k)
    assert layer.cells[SPEC.cell_of(1.02, 0.0)] == 0
    assert layer.cells[SPEC.cell_of(0.5, 0.0)] == 0


def test_an_explained_echo_proves_free_space_and_marks_nothing() -> None:
    layer = RangeLayer(RangeConfig())
    for _ in range(5):
        say(layer, [cone(math.inf, free=1.0)], 0.0)
    assert not (layer.cells == 254).any()
    assert layer.cells[SPEC.cell_of(0.5, 0.0)] == 0
    assert layer.cells[SPEC.cell_of(1.3, 0.0)] == 255


def test_echoes_beyond_the_obstacle_range_only_clear() -> None:
    layer = RangeLayer(RangeConfig(obstacle_range=0.8))
    for _ in range(5):
        say(layer, [cone(1.02)], 0.0)
    assert not (layer.cells == 254).any()
    assert layer.cells[SPEC.cell_of(0.5, 0.0)] == 0


def test_old_cells_decay() -> None:
    layer = RangeLayer(RangeConfig(decay=2.0))
    for k in range(3):
        say(layer, [cone(1.02)], 0.1 * k)
    say(layer, [], 2.1)
    assert (layer.cells == 254).any()
    say(layer, [], 2.3)
    assert (layer.cells == 255).all()


def test_the_window_moves_with_what_it_holds_and_the_footprint_is_forgotten() -> None:
    layer = RangeLayer(RangeConfig())
    for _ in range(3):
        say(layer, [cone(1.02)], 0.0)
    before = {tuple(p) for p in SPEC.centers_of(np.argwhere(layer.cells == 254)).round(6)}
    moved = GridSpec(0.05, 60, 50, 0.0, -1.0)
    layer.add([], 0.0)
    layer.update(moved, Moment())
    assert {tuple(p) for p in moved.centers_of(np.argwhere(layer.cells == 254)).round(6)} == before
    footprint = np.array([[0.9, -0.3], [1.2, -0.3], [1.2, 0.3], [0.9, 0.3]])
    layer.update(moved, Moment(footprint=footprint))
    layer.add([], 0.0)
    layer.update(moved, Moment())
    assert not (layer.cells == 254).any()
    layer.clear()
    assert layer.cells is None


@pytest.mark.parametrize("segment", [(0.01, 0.01, 1.9, 0.9), (1.0, -1.0, 1.0, 1.0), (0.3, 0.3, 0.3, 0.3)])
def test_a_drawn_segment_has_no_gap_and_stays_on_its_line(segment: tuple[float, ...]) -> None:
    grid = np.zeros(SPEC.shape, np.uint8)
    kernels.draw_segments(grid, SPEC.origin_x, SPEC.origin_y, SPEC.resolution, np.array([segment]), 254)
    a, b = np.array(segment[:2]), np.array(segment[2:])
    t = np.linspace(0, 1, 500)[:, None]
    cells = SPEC.cells_of(a + t * (b - a))
    assert (grid[cells[:, 0], cells[:, 1]] == 254).mean() > 0.97
    steps = np.unique(cells[np.sort(np.unique(cells @ [1000, 1], return_index=True)[1])], axis=0)
    assert np.count_nonzero(grid) <= len(steps)
