"""Refinement: the bicubic surface, its derivatives, the accuracy in the room, and what a corridor leaves open."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import correlation
from ambler.registration.gauss_newton import MatchResult, RefineConfig, refine
from ambler.registration.planar_scan import filter_voxels_adaptively
from tests.registration.mapped import GRID_FROM_ROOM, corridor_grid, room_grid
from tests.registration.room import CORRIDOR, random_pose, scan_at

FREE = RefineConfig(1.0, 0.01, 0.01, 0.01)
SIGMA = 0.35


UNKNOWN = 0.3


def surface(cells: np.ndarray, fx: float, fy: float) -> np.ndarray:
    out = np.empty(3)
    correlation.surface(cells, fx, fy, UNKNOWN, np.empty(4), np.empty(4), out)
    return out


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_the_surface_is_smooth_and_its_gradient_true(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 32768, (9, 11)).astype(np.uint16)
    x, y = rng.uniform(-1.0, 12.0), rng.uniform(-1.0, 10.0)
    d = 1e-5
    value, gx, gy = surface(cells, x, y)
    right, left = surface(cells, x + d, y), surface(cells, x - d, y)
    up, down = surface(cells, x, y + d), surface(cells, x, y - d)
    assert gx == pytest.approx((right[0] - left[0]) / (2 * d), abs=1e-4)
    assert gy == pytest.approx((up[0] - down[0]) / (2 * d), abs=1e-4)
    assert abs(right[0] + left[0] - 2 * value) < 1e-8
    assert surface(cells, -7.0, 4.0)[0] == pytest.approx(UNKNOWN)


def catmull_rom(u: float) -> np.ndarray:
    """Return the weights (4,) of four samples for the value between the middle ones, of which it goes through both."""
    return 0.5 * np.array([-u + 2 * u**2 - u**3, 2 - 5 * u**2 + 3 * u**3, u + 4 * u**2 - 3 * u**3, u**3 - u**2])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_the_surface_goes_through_the_cells_and_what_is_unknown_has_a_value_of_its_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 32768, (9, 11)).astype(np.uint16)
    cells[rng.random(cells.shape) < 0.3] = 0
    known = np.where(cells > 0, 0.1 + 0.8 * (cells - 1.0) / 32766, UNKNOWN)
    padded = np.pad(known, 5, constant_values=UNKNOWN)
    x, y = rng.uniform(-1.0, 12.0), rng.uniform(-1.0, 10.0)
    jx, jy = math.floor(x - 0.5), math.floor(y - 0.5)
    around = padded[jy + 4 : jy + 8, jx + 4 : jx + 8]
    expected = catmull_rom(y - 0.5 - jy) @ around @ catmull_rom(x - 0.5 - jx)
    assert surface(cells, x, y)[0] == pytest.approx(expected)


def test_normal_equations_are_those_of_numerical_jacobians() -> None:
    rng = np.random.default_rng(2)
    grid, room_from_base = room_grid(), SE2(0.3, -0.5, 0.4)
    points = scan_at(room_from_base).points[::9].astype(np.float64)
    pose = (GRID_FROM_ROOM @ room_from_base).as_array() + rng.normal(0.0, 0.01, 3)

    def residuals(p: np.ndarray) -> np.ndarray:
        at = (SE2.from_array(p).transform(points) - grid.frame[1:]) / grid.frame[0]
        return np.array([1.0 - surface(grid.cells, x, y)[0] for x, y in at])

    d = 1e-6
    jacobian = np.column_stack([(residuals(pose + e) - residuals(pose - e)) / (2 * d) for e in d * np.eye(3)])
    r = residuals(pose)
    h, g = np.empty((3, 3)), np.empty(3)
    total, inliers, probable = correlation.normal_equations(
        grid.cells, grid.frame, points.astype(np.float32), pose, UNKNOWN, h, g, np.empty(11)
    )
    assert h == pytest.approx(jacobian.T @ jacobian, rel=1e-3, abs=1e-3 * np.abs(h).max())
    assert g == pytest.approx(jacobian.T @ r, rel=1e-3, abs=1e-3 * np.abs(g).max())
    assert total == pytest.approx(float(r @ r))
    assert inliers == int((r < 0.5).sum())
    assert probable == pytest.approx(float((1.0 - r).sum()))


def match_in_room(rng: np.random.Generator, config: RefineConfig, *, noise: bool) -> tuple[SE2, MatchResult]:
    """Return the error true^-1 * found, and the match, of a start that is off by up to 4 cm and 1.5 degrees."""
    room_from_base = random_pose(rng)
    true = GRID_FROM_ROOM @ room_from_base
    scan = scan_at(room_from_base, rng=rng if noise else None)
    points = filter_voxels_adaptively(scan.points, 0.5, 200)
    away, turn = rng.uniform(-0.03, 0.03, 2), math.radians(rng.uniform(-1.5, 1.5))
    start = SE2(true.x + away[0], true.y + away[1], true.yaw + turn)
    match = refine(room_grid(), points, start, start, config)
    return true.inverse() @ match.grid_from_base, match


@pytest.mark.parametrize("seed", range(3))
def test_refinement_reaches_millimetres(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(15):
        error, match = match_in_room(rng, FREE, noise=False)
        assert math.hypot(error.x, error.y) < 0.006
        assert abs(math.degrees(error.yaw)) < 0.1
        assert match.score > 0.8
        assert match.inlier_ratio > 0.97
        assert match.degeneracy > 0.3


def test_the_minimum_is_found() -> None:
    """Steps that go too far and are taken back are work for nothing, and twenty of them end before the minimum."""
    rng = np.random.default_rng(3)
    iterations, left = [], []
    for _ in range(30):
        room_from_base = random_pose(rng)
        true = GRID_FROM_ROOM @ room_from_base
        points = filter_voxels_adaptively(scan_at(room_from_base, rng=rng).points, 0.5, 200)
        start = true @ SE2(*rng.uniform(-0.02, 0.02, 3))
        match = refine(room_grid(), points, start, start, FREE)
        best = match.grid_from_base
        for _ in range(5):  # on from there, with the same prior
            best = refine(room_grid(), points, best, start, FREE).grid_from_base
        iterations.append(match.iterations)
        left.append(match.grid_from_base.distance_to(best))
    assert np.mean(iterations) < 15.0
    assert np.quantile(left, 0.9) < 1e-4


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-3, 1.0]))
def test_information_is_weighed_along_its_axes(seed: int, along: float) -> None:
    """The covariance and the degeneracy against NumPy's eigenvectors; `along` is what the points tell of the first axis."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(rng.integers(1, 9), 3)) * (along, 1.0, 3.0)
    h = 10.0 ** rng.uniform(-1.0, 4.0) * jacobian.T @ jacobian
    sigma, match = 0.5, MatchResult(SE2(), h, 1.0, 1.0, 0.0, 1, 0.25)
    telling = h[:2, :2] - np.outer(h[:2, 2], h[2, :2]) / h[2, 2]
    values, vectors = np.linalg.eigh(telling)
    assert match.degeneracy == pytest.approx(max(0.0, values[0]) / values[1] if values[1] > 0.0 else 0.0, abs=1e-6)
    share = np.clip(values / max(0.25 * values[1], 1e-9), 0.05, 1.0)
    weighed = h.copy()
    weighed[:2, :2] += (vectors * (values * share**2)) @ vectors.T - telling
    expected = sigma**2 * np.linalg.inv(weighed + sigma**2 * np.diag([1.0, 1.0, 10.0]))
    expected += np.diag([1e-4, 1e-4, 4e-4])
    assert match.covariance(sigma, (0.01, 0.02)) == pytest.approx(expected, rel=1e-4, abs=1e-6 * expected.max())


def test_errors_of_noisy_scans_agree_with_the_covariance() -> None:
    rng = np.random.default_rng(11)
    squared = []
    for _ in range(40):
        error, match = match_in_room(rng, FREE, noise=True)
        covariance = match.covariance(SIGMA, (0.0, 0.0))
        assert np.array_equal(covariance, covariance.T)
        e = np.array([error.x, error.y, error.yaw])
        c, s = math.cos(match.grid_from_base.yaw), math.sin(match.grid_from_base.yaw)
        e[:2] = np.array([[c, -s], [s, c]]) @ e[:2]
        squared.append(float(e @ np.linalg.solve(covariance, e)))
    # The mean of chi^2 with 3 degrees of freedom is 3; sigma is set for real, worse scans.
    assert 0.1 < np.mean(squared) < 3.0


def test_a_corridor_leaves_its_direction_to_the_prior() -> None:
    for yaw in (0.0, 0.1, -0.4):
        base = SE2(0.3, 0.05, yaw)
        points = filter_voxels_adaptively(scan_at(base, 0, CORRIDOR, range_max=6.0).points, 0.5, 200)
        prior = SE2(0.4, 0.07, yaw + 0.01)
        match = refine(corridor_grid(), points, prior, prior, RefineConfig())
        assert match.degeneracy < 0.05
        assert abs(match.grid_from_base.x - prior.x) < 0.01
        assert abs(match.grid_from_base.y - base.y) < 0.02  # its walls lie up to 1.5 cm beside their cells' centres
        assert abs(wrap_angle(match.grid_from_base.yaw - yaw)) < math.radians(0.2)
        covariance = match.covariance(SIGMA, (0.0, 0.0))
        assert covariance[0, 0] > 100.0 * covariance[1, 1]
        _, vectors = np.linalg.eigh(covariance[:2, :2])
        assert abs(vectors[0, -1]) > math.cos(math.radians(3.0))


def test_the_floor_adds_to_the_covariance() -> None:
    _, match = match_in_room(np.random.default_rng(5), FREE, noise=False)
    added = match.covariance(SIGMA, (0.02, 0.01)) - match.covariance(SIGMA, (0.0, 0.0))
    assert added == pytest.approx(np.diag([4e-4, 4e-4, 1e-4]), abs=1e-12)


def test_a_prior_beyond_half_a_turn_is_the_same_prior() -> None:
    room_from_base = SE2(-0.4, 0.3, math.pi - 0.37 - 0.001)  # the grid's yaw is just below pi
    true = GRID_FROM_ROOM @ room_from_base
    points = scan_at(room_from_base).points
    prior = SE2(true.x + 0.01, true.y, wrap_angle(true.yaw + 0.01))
    assert prior.yaw < 0.0 < true.yaw
    match = refine(room_grid(), points, true, prior, RefineConfig())
    assert abs(wrap_angle(match.grid_from_base.yaw - true.yaw)) < math.radians(0.1)


def test_a_strong_prior_holds_the_pose() -> None:
    true = GRID_FROM_ROOM @ SE2(0.1, -0.2, 0.3)
    start = true @ SE2(0.03, 0.02, 0.01)
    match = refine(room_grid(), scan_at(SE2(0.1, -0.2, 0.3)).points, start, start, RefineConfig(1.0, 1e3, 1e3, 1e3))
    assert match.grid_from_base.distance_to(start) < 1e-4
