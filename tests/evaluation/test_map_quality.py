"""Map quality: an equal map is perfect, known motions are undone, and each number equals its definition."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity as skimage_ssim

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid
from ambler.core.se2 import SE2
from ambler.evaluation import map_quality
from ambler.evaluation.alignment import align, best_rigid_motion
from ambler.evaluation.exploration_run import KnownShare
from ambler.evaluation.map_quality import (
    BLUE,
    RED,
    compare_maps,
    nearest_neighbour_error,
    points_of,
    reachable_coverage,
    structural_similarity,
)
from ambler.evaluation.truth_frame import TruthFrame
from ambler.sim.truth import truth_grid
from ambler.sim.world_file import load_world
from tests.evaluation.plans import moved, office


def test_a_map_equals_itself() -> None:
    quality = compare_maps(office(), office())
    assert quality.coverage_ratio == 1.0
    assert quality.false_free_ratio == 0.0
    assert quality.nne_cells == pytest.approx(0.0, abs=1e-9)
    assert quality.nne_reverse_cells == pytest.approx(0.0, abs=1e-9)
    assert quality.ssim == pytest.approx(1.0, abs=1e-12)
    assert quality.truth_from_built.as_array() == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_shift_by_whole_cells_is_undone_exactly() -> None:
    spec, grid = office()
    shifted = GridSpec(spec.resolution, spec.width, spec.height, spec.origin_x + 0.3, spec.origin_y - 0.2)
    quality = compare_maps((shifted, grid), (spec, grid))
    assert quality.truth_from_built.as_array() == pytest.approx([-0.3, 0.2, 0.0], abs=1e-6)
    assert quality.ssim == pytest.approx(1.0, abs=1e-6)
    assert quality.coverage_ratio == 1.0


@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), yaw=st.floats(-10.0, 10.0))
@settings(max_examples=12, deadline=None)
def test_icp_undoes_motions_of_points(x: float, y: float, yaw: float) -> None:
    spec, grid = office()
    points = points_of(spec, grid >= 65)
    motion = SE2(x, y, math.radians(yaw))
    found = align(motion.transform(points), points)
    undone = found.target_from_source @ motion
    assert math.hypot(undone.x, undone.y) < 2e-3
    assert abs(undone.yaw) < 5e-4


def test_a_map_drawn_in_a_moved_frame_is_laid_back() -> None:
    spec, grid = office()
    motion = SE2(0.4, -0.3, math.radians(8.0))
    quality = compare_maps(moved(spec, grid, motion), (spec, grid))
    error = quality.truth_from_built @ motion
    assert math.hypot(error.x, error.y) < 0.02
    assert abs(error.yaw) < math.radians(0.2)
    assert quality.coverage_ratio > 0.99
    assert quality.nne_cells < 0.6
    assert quality.nne_reverse_cells < 0.6


def test_a_missing_room_lowers_coverage_and_raises_nne_one_way_only() -> None:
    spec, grid = office()
    partial = grid.copy()
    partial[: round(4.95 / 0.05), round(9.05 / 0.05) :] = -1
    quality = compare_maps((spec, partial), (spec, grid))
    lost = 1.0 - np.count_nonzero(partial == 0) / np.count_nonzero(grid == 0)
    assert quality.coverage_ratio == pytest.approx(1.0 - lost, abs=0.003)
    assert quality.nne_cells > 2.0
    assert quality.nne_reverse_cells < 0.1
    assert quality.false_free_ratio < 0.003


def test_false_free_counts_free_cells_that_are_not_free_in_truth() -> None:
    spec, grid = office()
    wrong = grid.copy()
    outside = np.argwhere(grid == -1)[:500]
    wrong[outside[:, 0], outside[:, 1]] = 0
    quality = compare_maps((spec, wrong), (spec, grid), truth_from_built=SE2())
    assert quality.false_free_ratio == pytest.approx(500 / np.count_nonzero(wrong == 0))


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_ssim_equals_scikit_image(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = ((rng.random((40, 57)) < 0.1) * 255).astype(np.uint8)
    b = np.roll(a, int(rng.integers(0, 3)), axis=1)
    expected = skimage_ssim(a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=255)
    assert structural_similarity(a, b) == pytest.approx(expected, abs=1e-9)


def test_nearest_neighbour_error_equals_brute_force() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(80, 2)), rng.normal(size=(60, 2))
    brute = np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1)).min(axis=1).mean()
    assert nearest_neighbour_error(a, b) == pytest.approx(brute)


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_best_rigid_motion_is_a_minimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(30, 2))
    b = SE2(0.3, -1.0, 2.0).transform(a) + rng.normal(scale=0.1, size=(30, 2))
    best = best_rigid_motion(a, b)

    def cost(motion: SE2) -> float:
        return float(((motion.transform(a) - b) ** 2).sum())

    for nudge in (SE2(1e-3), SE2(0, 1e-3), SE2(0, 0, 1e-3), SE2(-1e-3), SE2(0, -1e-3), SE2(0, 0, -1e-3)):
        assert cost(best @ nudge) > cost(best)


def test_overlay_shows_truth_red_and_built_blue() -> None:
    spec, grid = office()
    partial = grid.copy()
    partial[:, spec.width // 2 :] = -1
    overlay = compare_maps((spec, partial), (spec, grid), truth_from_built=SE2()).overlay
    half = overlay.shape[1] // 2
    assert (overlay[:, half + 5 :] == RED).all(axis=2).any()
    assert not (overlay[:, half + 5 :] == BLUE).all(axis=2).any()


def test_an_empty_map_is_refused() -> None:
    spec, grid = office()
    with pytest.raises(BadInputError, match="three points"):
        compare_maps((spec, np.zeros_like(grid)), (spec, grid))


def test_reachable_coverage_ignores_thick_walls_and_rooms_without_a_door() -> None:
    spec, grid = office()
    closed = grid.copy()
    middle = round(5.0 / 0.05)
    closed[middle, round(11.0 / 0.05) : round(12.0 / 0.05)] = 100
    built = closed.copy()
    built[: middle - 1, round(9.1 / 0.05) : round(12.9 / 0.05)] = -1
    near_walls = np.argwhere(closed == 100) + 1
    built[near_walls[:, 0], near_walls[:, 1]] = 100
    start = SE2(0.0, 4.0)
    assert compare_maps((spec, built), (spec, closed), truth_from_built=SE2()).coverage_ratio < 0.9
    assert reachable_coverage((spec, built), (spec, closed), SE2(), start, 0.25) == 1.0
    built[140:150, 100:110] = -1
    assert reachable_coverage((spec, built), (spec, closed), SE2(), start, 0.25) < 1.0
    with pytest.raises(BadInputError, match="start"):
        reachable_coverage((spec, built), (spec, closed), SE2(), SE2(-2.0, 4.0), 0.25)


def test_blocks_and_strips_change_nothing_and_bound_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    spec, grid = office()
    built = moved(spec, grid, SE2(0.31, -0.22, 0.1))
    whole = compare_maps(built, (spec, grid))
    reached = reachable_coverage(built, (spec, grid), whole.truth_from_built, SE2(1.0, 1.0, 0.0), 0.2)
    monkeypatch.setattr(map_quality, "BLOCK_CELLS", 500)
    for points in map_quality.blocks_of(spec, grid >= 0):
        assert len(points) <= 500
    parts = compare_maps(built, (spec, grid))
    assert (parts.coverage_ratio, parts.false_free_ratio) == (whole.coverage_ratio, whole.false_free_ratio)
    assert parts.ssim == pytest.approx(whole.ssim, abs=1e-12)
    assert (parts.overlay == whole.overlay).all()
    assert reachable_coverage(built, (spec, grid), whole.truth_from_built, SE2(1.0, 1.0, 0.0), 0.2) == reached


def test_a_map_beside_the_truth_covers_nothing_of_it() -> None:
    spec, grid = office()
    for x, y in ((100.0, 0.0), (-100.0, 0.0), (0.0, 100.0), (0.0, -100.0)):
        quality = compare_maps((spec, grid), (spec, grid), truth_from_built=SE2(x, y, 0.3))
        assert (quality.coverage_ratio, quality.false_free_ratio) == (0.0, 1.0)


def test_a_small_map_in_a_large_truth_is_judged_without_a_copy_of_the_truth() -> None:
    """A building of 8000 x 8000 cells took 34 s and 6 GB to judge; the curve of coverage took 3 s for each of its maps."""
    n = 6000
    truth = np.zeros((n, n), np.int8)
    truth[::400] = 100
    spec, small = GridSpec(0.05, n, n, -150.0, -150.0), GridSpec(0.05, 300, 300, 0.0, 0.0)
    built = truth[3000:3300, 3000:3300].copy()
    tracemalloc.start()
    quality = compare_maps((small, built), (spec, truth), truth_from_built=SE2())
    share = KnownShare((spec, truth)).of(small, built)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    free = np.count_nonzero(built == 0) / np.count_nonzero(truth == 0)
    assert share == pytest.approx(free, rel=1e-12)
    assert quality.coverage_ratio == pytest.approx(free, rel=1e-12)
    assert peak < 700e6


@pytest.mark.parametrize(("resolution", "shift"), [(0.05, 0.0), (0.05, 0.025), (0.1, 0.0), (0.03, 0.01)])
def test_the_share_that_is_known_is_that_of_the_cells_one_by_one(resolution: float, shift: float) -> None:
    """Cells of a map may lie half a cell beside those of the truth, or be larger: then they do not follow one another."""
    rng = np.random.default_rng(5)
    truth_spec, truth = GridSpec(0.05, 40, 30, -1.0, 0.5), rng.choice(np.array([-1, 0, 100], np.int8), (30, 40))
    spec = GridSpec(resolution, 35, 28, -0.8 + shift, 0.3 + shift)
    built = rng.choice(np.array([-1, 0, 0, 100], np.int8), spec.shape)
    known = 0
    for iy, ix in np.argwhere(truth == 0):
        row, column = spec.cell_of(*truth_spec.center_of(int(iy), int(ix)))
        known += bool(spec.contains_cell(row, column) and built[row, column] == 0)
    share = KnownShare((truth_spec, truth)).of(spec, built)
    assert share == pytest.approx(known / np.count_nonzero(truth == 0))
    assert share > 0.1


@given(yaw=st.floats(0.0, 90.0), width=st.floats(0.03, 0.3), x=st.floats(0.0, 0.05), length=st.floats(1.0, 4.0))
@settings(max_examples=60, deadline=None)
def test_thinning_leaves_a_line_of_every_wall_however_it_lies(
    yaw: float, width: float, x: float, length: float
) -> None:
    """Stairs two cells wide, as walls at 45 degrees make them, were eaten up: a room was laid a quarter of a metre beside itself."""
    spec = GridSpec(0.05, 120, 120, -3.0, -3.0)
    points = spec.centers_of(np.argwhere(np.ones(spec.shape, bool)))
    local = SE2(x, 0.5 * x, math.radians(yaw)).inverse().transform(points)
    inside = (np.abs(local[:, 0]) < 0.5 * length) & (np.abs(local[:, 1]) < 0.5 * width)
    wall = points[inside]
    lines = points_of(spec, map_quality.thin(inside.reshape(spec.shape)))
    assert len(wall) == 0 or nearest_neighbour_error(wall, lines) < 0.25
    assert (np.abs(SE2(x, 0.5 * x, math.radians(yaw)).inverse().transform(lines)[:, 1]) < 0.5 * width).all()


@pytest.mark.parametrize("start", [SE2(2.0, 2.0, math.radians(-45.0)), SE2(1.0, 1.0, math.radians(30.0))])
def test_a_perfect_map_is_judged_so_wherever_the_robot_started(start: SE2) -> None:
    world = load_world("lab_empty")
    spec, grid = truth_grid(world, 0.28, 0.05)
    told = TruthFrame(world.start @ start).grid(OccupancyGrid(0, "world", spec, grid))
    drawn = truth_grid(replace(world, start=world.start @ start).from_start(), 0.28, 0.05)
    quality = compare_maps(drawn, told)
    assert math.hypot(quality.truth_from_built.x, quality.truth_from_built.y) < 0.03
    assert abs(quality.truth_from_built.yaw) < 0.005
    assert max(quality.nne_cells, quality.nne_reverse_cells) < 1.2
    assert quality.ssim > 0.88
