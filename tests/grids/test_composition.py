"""The global map's kernels against NumPy: each cell reads the submap cell under its centre; thresholds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.grids.probability import log_odds_table
from ambler.kernels import submap as kernels


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_composition_reads_the_cell_under_each_centre(seed: int) -> None:
    rng = np.random.default_rng(seed)
    h, w = (int(v) for v in rng.integers(3, 40, 2))
    cells = (rng.integers(1, 32768, (h, w)) * (rng.random((h, w)) < 0.7)).astype(np.uint16)
    frame = np.array([0.05, *rng.uniform(-2.0, 0.5, 2)])
    spec = GridSpec(float(rng.choice([0.05, 0.1, 0.03])), 60, 50, -1.5, -1.2)
    map_from_submap = SE2.from_array(rng.uniform((-1.0, -1.0, -math.pi), (1.0, 1.0, math.pi)))
    evidence, known = rng.normal(size=spec.shape).astype(np.float32), np.zeros(spec.shape, np.uint8)
    before, table = evidence.copy(), log_odds_table()
    target = np.array([spec.resolution, spec.origin_x, spec.origin_y])
    kernels.compose(cells, frame, map_from_submap.as_array(), table, 1.0, target, evidence, known)

    iy, ix = (a.ravel() for a in np.indices(spec.shape))
    at = (map_from_submap.inverse().transform(spec.centers_of(np.column_stack((iy, ix)))) - frame[1:]) / frame[0]
    sure = (np.abs(at - np.rint(at)) > 1e-6).all(axis=1)  # a centre on a border may read either side
    jx, jy = np.floor(at).astype(int).T
    inside = (jx >= 0) & (jy >= 0) & (jx < w) & (jy < h)
    value = np.where(inside, cells[np.clip(jy, 0, h - 1), np.clip(jx, 0, w - 1)], 0)
    assert sure.mean() > 0.99
    assert np.array_equal(known.ravel()[sure], (value > 0)[sure])
    added = evidence.ravel() - before.ravel()
    assert added[sure] == pytest.approx(table[value][sure], abs=1e-5)


def test_submaps_add_their_evidence() -> None:
    cells = np.full((4, 4), 32767, np.uint16)
    frame = np.array([0.05, 0.0, 0.0])
    evidence, known = np.zeros((4, 4), np.float32), np.zeros((4, 4), np.uint8)
    for _ in range(3):
        kernels.compose(cells, frame, np.zeros(3), log_odds_table(), 0.3, frame, evidence, known)
    assert evidence == pytest.approx(np.full((4, 4), 3.0 * math.log(9.0)), abs=1e-5)


def test_walls_a_cell_apart_do_not_wipe_each_other_out() -> None:
    """Two submaps see the same wall from one side, in cells 2 and 3: both cells stay, free space stays free."""
    free, wall = np.uint16(1), np.uint16(32767)
    frame = np.array([0.05, 0.0, 0.0])
    known, occupancy = np.zeros((3, 6), np.uint8), np.empty((3, 6), np.int8)
    for beside, expected in ((1.0, [0, 0, -1, 100, -1, -1]), (0.3, [0, 0, 100, 100, -1, -1])):
        evidence = np.zeros((3, 6), np.float32)
        for at in (2, 3):
            cells = np.zeros((3, 6), np.uint16)
            cells[:, :at], cells[:, at] = free, wall
            kernels.compose(cells, frame, np.zeros(3), log_odds_table(), beside, frame, evidence, known)
        kernels.to_occupancy(evidence, known, 0.0, 0.0, (0, 3, 0, 6), (0, 0), occupancy)
        assert occupancy[1].tolist() == expected


def test_thresholds_leave_a_band_undecided() -> None:
    evidence = np.array([[-2.0, -0.1, 0.0, 0.1, 2.0, 5.0]], np.float32)
    known = np.array([[1, 1, 1, 1, 1, 0]], np.uint8)
    occupancy = np.empty((1, 6), np.int8)
    kernels.to_occupancy(evidence, known, -0.5, 0.5, (0, 1, 0, 6), (0, 0), occupancy)
    assert occupancy.tolist() == [[0, -1, -1, -1, 100, -1]]
    kernels.to_occupancy(evidence, known, 0.0, 0.0, (0, 1, 0, 6), (0, 0), occupancy)
    assert occupancy.tolist() == [[0, 0, -1, 100, 100, -1]]
    part = np.full((1, 3), 7, np.int8)
    kernels.to_occupancy(evidence, known, 0.0, 0.0, (0, 1, 3, 5), (0, 2), part)
    assert part.tolist() == [[7, 100, 100]], "only the part is told, where it lies from the corner on"


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_the_known_box_is_tight(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = (rng.random((12, 9)) < rng.choice([0.0, 0.02, 0.2])).astype(np.uint16)
    box = np.empty(4, np.int64)
    kernels.known_box(cells, box)
    rows, columns = np.nonzero(cells)
    if len(rows) == 0:
        assert box[0] > box[1]
    else:
        assert box.tolist() == [rows.min(), rows.max(), columns.min(), columns.max()]
