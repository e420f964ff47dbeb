"""Scan insertion: the kernel against its slow twin, growth, cropping, repetition."""

import math

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ambler.core.se2 import SE2
from ambler.grids.probability import update_table
from ambler.grids.probability_grid import Inserter, InsertionConfig, ProbabilityGrid
from ambler.kernels import submap as kernels
from tests.grids.slow_twin import Cell, cells_of_segment, clipped_length, in_cells, insert_slowly
from tests.registration.room import random_pose, scan_at

CONFIG = InsertionConfig()
NONE = np.zeros((0, 2), np.float32)
SEEDS = st.integers(0, 10**6)
QUARTERS = st.integers(0, 48).map(lambda k: 0.25 * k)


def random_scan(rng: np.random.Generator, spread: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return origin, points and free points anywhere within `spread` metres."""
    origin = rng.uniform(-0.5 * spread, 0.5 * spread, 2)
    points = rng.uniform(-spread, spread, (int(rng.integers(0, 25)), 2)).astype(np.float32)
    free_points = rng.uniform(-spread, spread, (int(rng.integers(0, 8)), 2)).astype(np.float32)
    return origin, points, free_points


def known_cells(grid: ProbabilityGrid) -> dict[Cell, int]:
    """Return the known cells by their place on the lattice through the frame's origin."""
    corner = np.rint(grid.frame[1:] / grid.frame[0]).astype(int)
    assert np.abs(corner * grid.frame[0] - grid.frame[1:]).max() < 1e-9
    rows, columns = np.nonzero(grid.cells)
    return {
        (int(iy + corner[1]), int(ix + corner[0])): int(grid.cells[iy, ix])
        for iy, ix in zip(rows, columns, strict=True)
    }


def cleared_cells(start: tuple[float, float], end: tuple[float, float], size: int = 16) -> set[Cell]:
    """Return the cells that a single ray without return changes, in a grid of 1 m cells whose corner is the origin."""
    cells = np.zeros((size, size), np.uint16)
    table = update_table(CONFIG.p_miss)
    ends = np.array([end], np.float32)
    frame = np.array([1.0, 0.0, 0.0])
    kernels.insert_scan(
        *(cells, np.array([start]), np.array([start]), NONE, ends, NONE, 0),
        *(np.zeros(0), np.zeros(0), frame, table, table),
        np.empty(size * size, np.int64),
    )
    return {(int(iy), int(ix)) for iy, ix in zip(*np.nonzero(cells), strict=True)}


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_insertion_equals_the_slow_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inserter, grid, twin = Inserter(CONFIG), ProbabilityGrid(0.05, (0.0, 0.0), 5.0), ProbabilityGrid(0.05, (0, 0), 5.0)
    for _ in range(3):
        scan = random_scan(rng, 2.0)
        changed = inserter.insert(grid, *scan)
        assert grid.cells.shape == twin.cells.shape
        assert changed == len(insert_slowly(twin, CONFIG, *scan))
        assert np.array_equal(grid.cells, twin.cells)


def test_insertion_in_the_room_equals_the_slow_twin() -> None:
    rng = np.random.default_rng(0)
    inserter, grid, twin = Inserter(CONFIG), ProbabilityGrid(0.05, (0, 0), 20.0), ProbabilityGrid(0.05, (0, 0), 20.0)
    for _ in range(2):
        pose = random_pose(rng)
        points = pose.transform(scan_at(pose).points).astype(np.float32)
        origin = np.array([pose.x, pose.y])
        inserter.insert(grid, origin, points, NONE)
        insert_slowly(twin, CONFIG, origin, points, NONE)
    assert np.array_equal(grid.cells, twin.cells)
    assert (grid.cells < 32768).all()


@settings(max_examples=150, deadline=None)
@given(QUARTERS, QUARTERS, QUARTERS, QUARTERS)
@example(3.0, 2.5, 3.0, 9.5)  # along a border, up
@example(3.0, 9.5, 3.0, 2.5)  # down
@example(2.5, 4.0, 9.5, 4.0)
@example(9.5, 4.0, 2.5, 4.0)
@example(0.0, 0.0, 12.0, 12.0)  # through corners only
def test_rays_on_borders_and_corners_clear_what_they_touch(x0: float, y0: float, x1: float, y1: float) -> None:
    start, end = np.array([x0, y0]), np.array([x1, y1])
    cells = cleared_cells((x0, y0), (x1, y1))
    end_cell = (math.floor(y1), math.floor(x1))
    begin = (math.floor(y0), math.floor(x0))
    assert end_cell not in cells
    assert len(cells) == abs(end_cell[0] - begin[0]) + abs(end_cell[1] - begin[1])
    for iy in range(16):
        for ix in range(16):
            if (iy, ix) == end_cell:
                continue
            if clipped_length(start, end, (iy, ix), -1e-9) > 1e-9:  # through the inside
                assert (iy, ix) in cells
            if clipped_length(start, end, (iy, ix), 1e-9) < 0.0:  # not even its border
                assert (iy, ix) not in cells


@settings(max_examples=100, deadline=None)
@given(SEEDS)
def test_rays_nearly_along_the_lattice_clear_just_what_they_cross(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = rng.uniform(20.0, 80.0, 2)
    angle = rng.choice([0.0, 0.5, 1.0, 1.5]) * np.pi + rng.choice([0.0, 0.25]) * np.pi + rng.normal(0.0, 1e-3)
    end = (start + 19.0 * np.array([np.cos(angle), np.sin(angle)])).astype(np.float32)
    cells = cleared_cells((start[0], start[1]), (end[0], end[1]), 101)
    assert cells == set(cells_of_segment(start, end.astype(np.float64)))


def test_a_cell_hit_and_crossed_by_one_scan_counts_as_hit_once() -> None:
    grid = ProbabilityGrid(0.05, (0.0, 0.0), 4.0)
    points = np.array(
        [[0.52, 0.02], [0.53, 0.03], [1.02, 0.02]], np.float32
    )  # the third ray crosses the first one's cell
    Inserter(CONFIG).insert(grid, np.array([0.02, 0.02]), points, NONE)
    cells = known_cells(grid)
    hit, miss = int(update_table(CONFIG.p_hit)[0]), int(update_table(CONFIG.p_miss)[0])
    assert cells == {(0, k): miss for k in range(20)} | {(0, 10): hit, (0, 20): hit}


@settings(max_examples=25, deadline=None)
@given(SEEDS)
@example(155)
def test_growth_and_cropping_move_no_cell(seed: int) -> None:
    """For points in general position: one within 1e-13 m of a border falls to either side, as the corner's rounding has it."""
    rng = np.random.default_rng(seed)
    center = rng.uniform(-3.0, 3.0, 2)
    inserter = Inserter(CONFIG)
    small, large = ProbabilityGrid(0.05, (center[0], center[1]), 0.5), ProbabilityGrid(0.05, (0.0, 0.0), 22.0)
    shape = large.cells.shape
    for _ in range(4):
        scan = random_scan(rng, float(rng.uniform(0.2, 9.0)))
        inserter.insert(small, *scan)
        inserter.insert(large, *scan)
        assert known_cells(small) == known_cells(large)
        if rng.random() < 0.3:
            small.crop(int(rng.integers(0, 4)))
            assert known_cells(small) == known_cells(large)
    assert large.cells.shape == shape


def test_cropping_leaves_just_the_margin_and_empty_grids_alone() -> None:
    grid = ProbabilityGrid(0.05, (0.0, 0.0), 4.0)
    before = grid.cells.shape
    grid.crop()
    assert grid.cells.shape == before
    Inserter(CONFIG).insert(grid, np.array([0.02, 0.02]), np.array([[0.52, 0.32]], np.float32), NONE)
    grid.crop(3)
    assert grid.cells.shape == (7 + 6, 11 + 6)
    assert grid.spec.cell_of(0.02, 0.02) == (3, 3)
    assert grid.spec.cell_of(0.52, 0.32) == (9, 13)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_growth_contains_all_points_with_a_margin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = ProbabilityGrid(0.05, (0.0, 0.0), 1.0)
    points = rng.uniform(-20.0, 20.0, (3, 2))
    grid.grow_to(points, NONE)
    cells = in_cells(points, grid.frame)
    assert cells.min() >= 4.0
    assert (cells.max(axis=0) <= np.array(grid.cells.shape[::-1]) - 4).all()
    frame, cells_before = grid.frame.copy(), grid.cells
    grid.grow_to(points)
    assert np.array_equal(grid.frame, frame)
    assert grid.cells is cells_before


def test_repetition_makes_cells_surer_up_to_the_clamps() -> None:
    pose = SE2(0.3, -0.4, 0.2)
    points, origin = pose.transform(scan_at(pose).points).astype(np.float32), np.array([0.3, -0.4])
    inserter, grid = Inserter(CONFIG), ProbabilityGrid(0.05, (0.0, 0.0), 20.0)
    inserter.insert(grid, origin, points, NONE)
    first = grid.cells.astype(int)
    before = first
    is_hit, is_miss = first > 16384, (first > 0) & (first < 16384)
    for _ in range(80):
        inserter.insert(grid, origin, points, NONE)
        now = grid.cells.astype(int)
        assert (now[is_hit] >= before[is_hit]).all()
        assert (now[is_miss] <= before[is_miss]).all()
        assert (now[first == 0] == 0).all()
        before = now
    assert (before[is_hit] == 32767).all()
    assert (before[is_miss] == 1).all()


def test_a_scan_that_counts_three_times_is_that_scan_inserted_three_times() -> None:
    inserter = Inserter(CONFIG)
    once, thrice = ProbabilityGrid(0.05, (0.0, 0.0), 5.0), ProbabilityGrid(0.05, (0.0, 0.0), 5.0)
    points = np.array([[1.02, 0.33], [0.72, -0.91]], np.float32)
    inserter.insert(once, np.array([0.02, 0.02]), points, NONE, times=3)
    for _ in range(3):
        inserter.insert(thrice, np.array([0.02, 0.02]), points, NONE)
    assert np.array_equal(once.cells == 0, thrice.cells == 0)
    assert np.abs(once.cells.astype(int) - thrice.cells.astype(int)).max() <= 3  # the table rounds
    assert once.cells.max() > 22000


def test_surfaces_fill_only_cells_that_nothing_was_measured_of() -> None:
    inserter, grid = Inserter(CONFIG), ProbabilityGrid(0.05, (0.0, 0.0), 5.0)
    origin, point = np.array([0.02, 0.02]), np.array([[1.02, 0.02]], np.float32)
    inserter.insert(grid, origin, point, NONE)
    before = grid.cells.copy()
    free, unknown = np.array([0.52, 0.02]), np.array([0.52, 0.52])
    inserter.insert(grid, origin, NONE, NONE, surfaces=np.array([free, unknown], np.float32), sure=2)
    (iy, ix), (jy, jx) = (((p - grid.frame[1:]) / 0.05).astype(int)[::-1] for p in (free, unknown))
    assert grid.cells[iy, ix] == before[iy, ix] != 0
    assert grid.cells[jy, jx] > 16384
    assert (grid.cells != before).sum() == 1


def test_rays_along_a_wall_make_none_of_its_cells_free() -> None:
    """A wall at y = 1.03 m: rays that meet it at 3 m pass through the nearer half of its cells before that."""
    inserter, origin = Inserter(CONFIG), np.array([0.02, 0.02])
    far = np.array([[3.01, 1.03]], np.float32)
    wall = np.column_stack((np.arange(2.5, 3.0, 0.025), np.full(20, 1.03))).astype(np.float32)

    def cells(between: np.ndarray, sure: int, seen: int) -> np.ndarray:
        """Return the wall's cells from 2.7 m to 2.9 m after they were `seen` from near, and passed often since."""
        grid = ProbabilityGrid(0.05, (0.0, 0.0), 8.0)
        for x in np.arange(2.52, 3.0, 0.05):
            for _ in range(seen):
                inserter.insert(grid, np.array([x, 0.5]), np.array([[x, 1.03]], np.float32), NONE)
        for _ in range(200):
            inserter.insert(grid, origin, far, NONE, surfaces=between, sure=sure)
        ix, iy = ((np.array([2.92, 1.03]) - grid.frame[1:]) / 0.05).astype(int)
        return grid.cells[iy, ix - 4 : ix + 1].astype(int)

    assert cells(NONE, 0, 5).min() < 1000  # what would happen
    assert (cells(wall, len(wall), 1) > 16384).all()
    assert (cells(wall, 0, 5) > 24576).all()
    assert (cells(wall, 0, 1) > 15000).all()  # what was seen once may be doubted there, but not denied


def test_what_is_only_likely_makes_nothing_occupied() -> None:
    grid, thing = ProbabilityGrid(0.05, (0.0, 0.0), 5.0), np.array([[0.52, 0.52], [0.52, 0.02]], np.float32)
    Inserter(CONFIG).insert(grid, np.array([0.02, 0.02]), np.array([[1.02, 0.02]], np.float32), NONE, surfaces=thing)
    for x, y in thing.tolist():
        ix, iy = ((np.array([x, y]) - grid.frame[1:]) / 0.05).astype(int)
        assert grid.cells[iy, ix] <= 16384


def test_rays_that_pass_over_a_thing_do_not_erase_it() -> None:
    inserter, origin = Inserter(CONFIG), np.array([0.02, 0.02])
    table, wall = np.array([[1.02, 0.02]], np.float32), np.array([[3.02, 0.02]], np.float32)

    def p_occupied(x: float, lows: tuple[np.ndarray, np.ndarray] | None, seen: int = 2) -> int:
        """Return the cell at x after a thing was `seen` at 1 m, another at 2.9 m, and a wall behind them often."""
        grid = ProbabilityGrid(0.05, (0.0, 0.0), 10.0)
        for point in (table, np.array([[2.92, 0.02]], np.float32)):
            for _ in range(seen):
                inserter.insert(grid, origin, point, NONE)
        for _ in range(60):
            inserter.insert(grid, origin, wall, NONE, lows=lows)
        iy, ix = ((np.array([x, 0.02]) - grid.frame[1:]) / 0.05).astype(int)[::-1]
        return int(grid.cells[iy, ix])

    none = np.zeros(0)
    assert p_occupied(1.02, None) < 16384
    assert p_occupied(1.02, (np.array([2.0]), none)) > 16384  # the ray is low from 2 m on
    assert p_occupied(1.02, (np.array([0.8]), none)) < 16384
    assert (
        p_occupied(1.02, (np.array([2.0]), none), seen=1) < 16384
    )  # a torn beam meets nothing: it stands for no table
    assert p_occupied(0.52, (np.array([2.0]), none)) < 16384  # nothing was seen there
    assert p_occupied(2.92, (np.array([np.inf]), none)) < 16384  # right before its end a ray is as low as what it met
