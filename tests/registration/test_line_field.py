"""Lines through the returns of a submap: against their definition in NumPy, and what a scan's fit to them gains and leaves alone."""

import numpy as np
import pytest

from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import line_field as kernels
from ambler.registration.line_field import LineConfig, LineField
from tests.registration.room import CORRIDOR, WALLS, beam_angles, random_pose, ranges_at

CONFIG = LineConfig()
NOISE = 0.01


def noisy_points(pose: SE2, rng: np.random.Generator, walls: np.ndarray = WALLS, beams: int = 720) -> np.ndarray:
    angles = beam_angles(beams)
    ranges = ranges_at(pose, angles, walls) + rng.normal(0.0, NOISE, beams)
    ranges, angles = ranges[ranges < 20.0], angles[ranges < 20.0]
    return np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles))).astype(np.float32)


def mapped(rng: np.random.Generator, walls: np.ndarray = WALLS, scans: int = 40) -> LineField:
    field = LineField(CONFIG)
    for k in range(scans):
        pose = SE2(-1.5 + 0.05 * k, -0.4 + 0.01 * k, 0.3 + 0.05 * k)
        points = pose.transform(noisy_points(pose, rng, walls)).astype(np.float32)
        field.add(points, np.array([[pose.x, pose.y]]))
    return field


def side(dx: float, dy: float) -> int:
    if abs(dx) >= abs(dy):
        return 0 if dx > 0 else 1
    return 2 if dy > 0 else 3


def test_a_line_is_the_principal_axis_of_the_points_around() -> None:
    rng = np.random.default_rng(4)
    size = CONFIG.size
    along = rng.uniform(-1.0, 1.0, 800)
    points = np.column_stack((along, 0.4 * along + 2.02 + rng.normal(0.0, 0.008, 800))).astype(np.float32)
    starts = np.column_stack((rng.uniform(-1.0, 1.0, 800), np.zeros(800)))
    keys, moments = np.full(1024, kernels.EMPTY), np.zeros((1024, 6))
    new = kernels.add_points(keys, moments, size, starts, points)
    sides = np.array([side(*ray) for ray in points - starts])
    cells = np.floor(points.astype(np.float64) / size).astype(int)
    assert new == len({(*cell, s) for cell, s in zip(cells.tolist(), sides, strict=True)}) == (keys >= 0).sum()
    checked = 0
    for x, y in ((0.03, 2.03), (0.51, 2.2), (-0.6, 1.8)):
        line = np.empty(5)
        is_line = kernels.line_at(keys, moments, size, x, y, 2, 8.0, line)
        at = np.floor(np.array([x, y]) / size).astype(int)
        chosen = points[(np.abs(cells - at).max(axis=1) <= 1) & (sides == 2)].astype(np.float64)
        values, vectors = np.linalg.eigh(np.cov(chosen.T, bias=True))
        assert is_line
        assert line[:2] == pytest.approx(chosen.mean(axis=0), abs=1e-6)
        assert abs(line[2:4] @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-9)
        assert line[4] == pytest.approx(values[0], rel=1e-4)
        checked += 1
    assert checked == 3
    assert not kernels.line_at(keys, moments, size, 0.03, 2.03, 3, 8.0, np.empty(5))  # nobody saw it from above
    assert not kernels.line_at(keys, moments, size, 0.03, 2.03, 2, 1e4, np.empty(5))


def test_a_fit_is_as_good_as_the_scanner() -> None:
    """720 returns of 10 mm tell a pose to a millimetre, which a grid of 50 mm alone does not."""
    rng = np.random.default_rng(1)
    field = mapped(rng)
    errors = []
    for _ in range(40):
        truth = random_pose(rng)
        start = truth @ SE2(*rng.uniform(-0.03, 0.03, 2), rng.uniform(-0.01, 0.01))
        found = field.fit(noisy_points(truth, rng), (0.0, 0.0), start).grid_from_base
        off = truth.inverse() @ found
        errors.append((np.hypot(off.x, off.y), abs(off.yaw)))
    median = np.median(errors, axis=0)
    assert median[0] < 0.0025
    assert median[1] < 0.0006


def test_along_a_corridor_the_start_is_kept() -> None:
    rng = np.random.default_rng(2)
    field = mapped(rng, CORRIDOR)
    start = SE2(0.3, 0.02, 0.005)
    found = field.fit(noisy_points(SE2(0.5, 0.0, 0.0), rng, CORRIDOR), (0.0, 0.0), start).grid_from_base
    assert found.x == pytest.approx(0.3, abs=0.002)
    assert found.y == pytest.approx(0.0, abs=0.002)
    assert abs(wrap_angle(found.yaw)) < 0.001


def test_the_two_sides_of_a_thin_wall_stay_apart() -> None:
    field = LineField(CONFIG)
    x = np.linspace(-1.0, 1.0, 400)
    lower, upper = (np.column_stack((x, np.full(400, y))).astype(np.float32) for y in (1.0, 1.08))
    field.add(lower, np.array([[0.0, -3.0]]))
    field.add(upper, np.array([[0.0, 5.0]]))
    scan = np.column_stack((x, np.full(400, 1.0))).astype(np.float32)
    found = field.fit(scan, (0.0, -3.0), SE2(0.0, 0.02, 0.0)).grid_from_base
    assert found.y == pytest.approx(0.0, abs=0.002)


@pytest.mark.parametrize("points", [np.zeros((0, 2), np.float32), np.full((50, 2), 40.0, np.float32)])
def test_a_scan_on_no_line_stays_where_it_is(points: np.ndarray) -> None:
    field = mapped(np.random.default_rng(3), scans=5)
    start = SE2(0.1, 0.2, 0.3)
    assert field.fit(points, (0.0, 0.0), start).grid_from_base == start


def test_packing_changes_no_fit_and_what_comes_later_fits_in() -> None:
    truth, start = SE2(0.2, -0.3, 0.7), SE2(0.22, -0.31, 0.705)
    field, same = (mapped(np.random.default_rng(5)) for _ in range(2))
    scan = noisy_points(truth, np.random.default_rng(6))
    before = field.fit(scan, (0.0, 0.0), start).grid_from_base
    packed = field.packed()
    assert 0 < len(packed.keys) == len(np.unique(packed.keys))
    again = LineField.of(packed)
    assert again.fit(scan, (0.0, 0.0), start).grid_from_base == before
    assert before != start
    more = noisy_points(SE2(0.1, 0.1, 0.0), np.random.default_rng(7))
    for each in (again, same):
        each.add(more, np.zeros((1, 2)))
    assert np.array_equal(np.sort(again.packed().keys), np.sort(same.packed().keys))
    assert again.fit(scan, (0.0, 0.0), start).grid_from_base == same.fit(scan, (0.0, 0.0), start).grid_from_base
