"""The terrain layer: what it frees, charges and marks, and where."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_FREE, COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.costmap.layer import Moment, whole
from ambler.costmap.terrain_layer import TerrainLayer
from ambler.kernels.costmap import fill_squares

SPEC = GridSpec(0.05, 80, 80, -2.0, -2.0)


def drawn(layer: TerrainLayer, before: int) -> np.ndarray:
    master = np.full(SPEC.shape, before, np.uint8)
    layer.update(SPEC, Moment())
    layer.draw_into(master, SPEC, whole(SPEC))
    return master


def layer_of(*points: tuple[float, float, float, bool]) -> TerrainLayer:
    layer = TerrainLayer()
    rows = np.array([p[:3] for p in points])
    layer.set_terrain(rows[:, :2], rows[:, 2].astype(np.float32), np.array([p[3] for p in points]))
    return layer


def test_ground_is_free_whatever_a_height_band_says() -> None:
    master = drawn(layer_of((1.0, 0.5, 0.0, True)), COST_LETHAL)
    freed = np.argwhere(master == COST_FREE)
    assert len(freed) == 16  # 0.2 m
    assert np.allclose(SPEC.centers_of(freed).mean(axis=0), (1.0, 0.5))


def test_what_is_as_high_as_a_step_is_lethal_and_what_is_lower_costs_a_little() -> None:
    master = drawn(layer_of((1.0, 0.5, 0.05, True), (0.5, 0.5, 0.09, True), (0.0, 0.5, 0.4, False)), COST_UNKNOWN)
    assert 0 < master[SPEC.cell_of(1.0, 0.5)] < 100
    assert master[SPEC.cell_of(0.5, 0.5)] == COST_LETHAL
    assert (master == COST_LETHAL).sum() == 16 + 4  # a cell of ground, a voxel


def test_a_voxel_over_ground_stays_lethal() -> None:
    assert drawn(layer_of((1.0, 0.5, 0.3, False), (1.0, 0.5, 0.0, True)), 0)[SPEC.cell_of(1.0, 0.5)] == COST_LETHAL


def test_every_terrain_replaces_the_last() -> None:
    layer = layer_of((1.0, 0.5, 0.3, False))
    assert (drawn(layer, 0) == COST_LETHAL).any()
    layer.set_terrain(np.zeros((0, 2)), np.zeros(0, np.float32), np.zeros(0, np.bool_))
    box = layer.update(SPEC, Moment())
    assert box is not None
    y0, y1, x0, x1 = box
    iy, ix = SPEC.cell_of(1.0, 0.5)
    assert y0 <= iy < y1
    assert x0 <= ix < x1
    assert not (drawn(layer, 0) == COST_LETHAL).any()


def test_points_beyond_the_grid_are_left_out_and_bad_input_is_named() -> None:
    assert not drawn(layer_of((9.0, 9.0, 0.3, False)), 0).any()
    with pytest.raises(BadInputError, match="kinds"):
        TerrainLayer().set_terrain(np.zeros((2, 2)), np.zeros(2, np.float32), np.zeros(1, np.bool_))


def test_squares_are_filled_as_arrays_fill_them() -> None:
    rng = np.random.default_rng(3)
    points, values = rng.uniform(-3.0, 3.0, (500, 2)), rng.integers(0, 250, 500).astype(np.uint8)
    for across in (1, 2, 4):
        filled, expected = (np.full(SPEC.shape, COST_UNKNOWN, np.uint8) for _ in range(2))
        fill_squares(filled, SPEC.origin_x, SPEC.origin_y, SPEC.resolution, points, values, across)
        corner = np.round((points - (SPEC.origin_x, SPEC.origin_y)) / SPEC.resolution - 0.5 * across).astype(int)
        for dy in range(across):
            for dx in range(across):
                ix, iy = corner[:, 0] + dx, corner[:, 1] + dy
                inside = (ix >= 0) & (iy >= 0) & (ix < SPEC.width) & (iy < SPEC.height)
                expected[iy[inside], ix[inside]] = values[inside]
        assert (filled != COST_UNKNOWN).sum() > 200 * across
        np.testing.assert_array_equal(filled, expected)
