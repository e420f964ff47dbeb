"""The kernels of merging and scan matching against slow twins in plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.base_motion import BaseMotion
from ambler.core.se2 import SE2
from ambler.kernels import scan_draw, scan_motion, scan_pair

SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def test_move_beams_is_the_interpolated_pose_times_the_mounting() -> None:
    rng = np.random.default_rng(1)
    n = 600
    motion = BaseMotion()
    for k in range(12):
        pose = SE2.exp(np.array([0.9, 0.2, 1.5]) * 0.02 * k) @ SE2(*(0.002 * rng.normal(size=3)))
        motion.add_pose(20_000_000 * k, pose)
    angles = np.linspace(-2.0, 2.0, n)
    mount = SE2(0.3, 0.1, 0.4)
    ranges = rng.uniform(0.0, 12.0, n).astype(np.float32)
    ranges[::50], ranges[7::50] = np.nan, np.inf
    used = (np.arange(n) % 97 != 0).astype(np.uint8)
    begin_ns, step, reference_ns = 30_000_000, 0.1 / n, 140_000_000
    knots = motion.knots(begin_ns, begin_ns + 100_000_000, reference_ns)
    directions = np.zeros((3, n), np.float32)
    directions[:2] = np.array([np.cos(angles + mount.yaw), np.sin(angles + mount.yaw)])
    columns, kinds, counts = np.zeros((3, n), np.float32), np.zeros(n, np.uint8), np.zeros(5, np.int64)
    scan_motion.move_beams(
        *(ranges, directions, used, np.array([0.1, 10.0]), np.array([(begin_ns - reference_ns) * 1e-9, step])),
        *(np.array([mount.x, mount.y, 0.0]), knots.times, knots.poses, knots.twists),
        *(SQUARE, np.array([0, 4]), math.sqrt(0.5), columns, kinds, counts),
    )
    reference_from_odom = motion.planar_at(reference_ns).inverse()
    for i in range(n):
        r = float(ranges[i])
        in_base = mount.transform(np.array([[min(r, 10.0) * math.cos(angles[i]), min(r, 10.0) * math.sin(angles[i])]]))
        if used[i] == 0 or not r >= 0.1:
            kind = scan_motion.NOTHING
        elif r > 10.0:
            kind = scan_motion.EMPTY
        else:
            kind = scan_motion.NOTHING if np.abs(in_base).max() < 0.5 else scan_motion.RETURN
        assert kinds[i] == kind
        if kind != scan_motion.NOTHING:
            stamp_ns = round(begin_ns + i * step * 1e9)
            moved = (reference_from_odom @ motion.planar_at(stamp_ns)).transform(in_base)[0]
            np.testing.assert_allclose(columns[:2, i], moved, atol=4e-6)
    assert counts.sum() == n
    assert counts[scan_motion.MASKED] > 0


def test_fast_turns_between_knots_take_the_exact_path() -> None:
    n, twist = 100, np.array([1.0, 0.0, 9.0])
    columns, kinds, counts = np.zeros((3, n), np.float32), np.zeros(n, np.uint8), np.zeros(5, np.int64)
    directions = np.zeros((3, n), np.float32)
    directions[0] = 1.0
    scan_motion.move_beams(
        *(np.full(n, 2.0, np.float32), directions, np.ones(n, np.uint8), np.array([0.1, 10.0]), np.array([0.0, 0.01])),
        *(np.zeros(3), np.zeros(1), np.zeros((1, 3)), twist[None], np.zeros((0, 2)), np.zeros(1, np.int64), 0.0),
        *(columns, kinds, counts),
    )
    for i in range(n):
        expected = SE2.exp(twist * 0.01 * i).transform(np.array([[2.0, 0.0]]))[0]
        np.testing.assert_allclose(columns[:2, i], expected, atol=4e-6)


def draw(points: np.ndarray, kinds: np.ndarray, bins: int, far: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    columns = np.zeros((3, len(points)), np.float32)
    columns[:2] = points.T
    angles = -math.pi + 2.0 * math.pi / bins * np.arange(bins)
    directions = np.ascontiguousarray(np.column_stack([np.cos(angles), np.sin(angles)]))
    ranges, free = np.full(bins, np.inf), np.zeros(bins, np.uint8)
    scan_draw.draw_scan(
        *(columns, kinds, np.array([0.0, 0.0, 1.0, 0.0]), directions, np.array([0.05, far]), np.array([0.03, 0.4])),
        *(0, np.zeros((2, len(points)), np.uint8), ranges, free, np.zeros(bins, np.int16), np.zeros(bins, np.int32)),
    )
    return ranges, free


def draw_slowly(points: np.ndarray, kinds: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Intersect the centre ray of every bin with every joint, one after the other."""
    n = len(points)
    ranges, free = np.full(bins, np.inf), np.zeros(bins, np.uint8)

    def is_straight(a: int, b: int, c: int) -> bool:
        if not (0 <= a < n and 0 <= c < n and kinds[a] == kinds[b] == kinds[c] == scan_motion.RETURN):
            return False
        e, f = points[b] - points[a], points[c] - points[b]
        cross = abs(e[0] * f[1] - e[1] * f[0])
        longest = max(np.linalg.norm(e), np.linalg.norm(f))
        gap2 = f @ f
        return bool(cross <= 0.03 * longest and gap2 <= min(9.0 * (e @ e) + 4 * 0.03**2, 0.16))

    joined = [
        i + 1 < n
        and (
            kinds[i] == kinds[i + 1] == scan_motion.EMPTY
            or is_straight(i - 1, i, i + 1)
            or is_straight(i + 2, i + 1, i)
        )
        for i in range(n)
    ]
    start, crossed = 0, False
    for i in range(n):
        if joined[i]:
            p, q = points[i], points[i + 1]
            for b in range(bins):
                angle = -math.pi + 2.0 * math.pi * b / bins
                u = np.array([math.cos(angle), math.sin(angle)])
                matrix = np.column_stack([u, p - q])
                if abs(np.linalg.det(matrix)) < 1e-12:
                    continue
                r, s = np.linalg.solve(matrix, p)
                if r > 0 and 0 <= s <= 1:
                    crossed = True
                    if kinds[i] == scan_motion.EMPTY:
                        free[b] = 1
                    else:
                        ranges[b] = min(ranges[b], r)
            continue
        place = round((math.atan2(points[i, 1], points[i, 0]) / (2 * math.pi) + 0.5) * bins) % bins
        if kinds[i] == scan_motion.EMPTY:
            free[place] = 1
        elif kinds[i] == scan_motion.RETURN and not crossed:
            chain = points[start : i + 1]
            nearest = chain[np.argmin(np.linalg.norm(chain, axis=1))]
            place = round((math.atan2(nearest[1], nearest[0]) / (2 * math.pi) + 0.5) * bins) % bins
            ranges[place] = min(ranges[place], float(np.linalg.norm(nearest)))
        start, crossed = i + 1, False
    return ranges, free


@pytest.mark.parametrize("seed", range(2))
def test_draw_scan_equals_its_slow_twin(seed: int) -> None:
    """Random surfaces: pieces of walls with steps between them, lost beams, and arcs without returns."""
    rng = np.random.default_rng(seed)
    n, bins = 240, 200
    angles = np.linspace(-3.0, 3.0, n) + 0.3
    distance = np.repeat(rng.uniform(1.0, 6.0, 12), 20) / np.cos(np.tile(np.linspace(-0.3, 0.3, 20), 12))
    points = distance[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]) + rng.normal(size=(n, 2)) * 0.002
    points = points.astype(np.float32).astype(np.float64)  # what the columns hold
    kinds = np.full(n, scan_motion.RETURN, np.uint8)
    kinds[60:90] = scan_motion.EMPTY
    kinds[rng.integers(0, n, 12)] = scan_motion.NOTHING
    ranges, free = draw(points, kinds, bins)
    slow_ranges, slow_free = draw_slowly(points, kinds, bins)
    np.testing.assert_array_equal(free, slow_free)
    np.testing.assert_allclose(ranges, slow_ranges, rtol=1e-9)


def test_fit_lines_finds_the_main_axis_of_the_neighbours() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(-1.0, 1.0, 60)
    points = np.column_stack([x, 0.5 * x + 2.0]) + rng.normal(size=(60, 2)) * 0.005
    lines, cells = np.zeros((60, 4)), np.zeros(720, np.int32)
    scan_pair.fit_lines(points, 60, 0.3, 5, 0.03, lines, cells)
    for i in range(60):
        near = [j for j in range(max(i - 5, 0), min(i + 6, 60)) if np.linalg.norm(points[j] - points[i]) <= 0.3]
        if len(near) < 5:
            continue
        group = points[near]
        normal = np.linalg.eigh(np.cov(group.T))[1][:, 0]
        np.testing.assert_allclose(lines[i, :2], group.mean(axis=0), atol=1e-12)
        assert abs(abs(normal @ lines[i, 2:]) - 1.0) < 1e-9
    seen = cells[cells >= 0]
    assert set(seen.tolist()) <= set(range(60))


def test_place_scan_undoes_the_motion_of_a_turning_sensor() -> None:
    n, step, twist = 90, 0.001, np.array([0.4, -0.2, 1.2])
    middle = 0.5 * (n - 1) * step
    wall = np.column_stack([np.full(n, 2.0), np.linspace(-1.0, 1.0, n)])
    seen = [SE2.exp(twist * (i * step - middle)).inverse().transform(wall[i : i + 1])[0] for i in range(n)]
    ranges = np.linalg.norm(seen, axis=1)
    angles = np.arctan2(*np.array(seen).T[::-1])
    for sign in (1.0, -1.0):
        for i in range(n):
            points = np.zeros((1, 2))
            beam = np.array([sign * angles[i], 0.0, 0.0])
            count = scan_pair.place_scan(
                ranges[i : i + 1].astype(np.float32), beam, sign, np.array([0.1, 9.0]), middle - i * step, twist, points
            )
            assert count == 1
            np.testing.assert_allclose(points[0], wall[i], atol=1e-6)
