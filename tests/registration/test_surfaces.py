"""Points between neighbouring returns: along one wall, and not from one thing to another."""

from __future__ import annotations

import math

import numpy as np

from ambler.registration.planar_scan import PlanarScan, points_between_returns


def _scan(ranges: np.ndarray, step: float = math.radians(1.0)) -> PlanarScan:
    """Return the scan of a device at the origin, beams `step` apart about the x axis."""
    angles = (np.arange(len(ranges)) - 0.5 * len(ranges)) * step
    points = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles))).astype(np.float32)
    return PlanarScan(0, points, np.zeros((0, 2), np.float32))


def _wall(distance: float, beams: int = 60) -> np.ndarray:
    """Return the ranges of a straight wall across the x axis."""
    angles = (np.arange(beams) - 0.5 * beams) * math.radians(1.0)
    return np.asarray(distance / np.cos(angles))


def test_a_wall_that_is_seen_in_dots_is_closed_to_the_spacing() -> None:
    scan = _scan(_wall(8.0))
    between = points_between_returns(scan, 0.05)
    assert len(between) > 100
    assert np.abs(between[:, 0] - 8.0).max() < 1e-3
    along = np.sort(np.concatenate((scan.points[:, 1], between[:, 1])))
    assert np.diff(along).max() < 0.0501


def test_near_walls_whose_returns_touch_need_nothing() -> None:
    assert len(points_between_returns(_scan(_wall(2.0)), 0.05)) == 0


def test_nothing_goes_on_from_one_thing_to_another_behind_it() -> None:
    ranges = _wall(8.0)
    ranges[30:] = _wall(5.0)[30:]
    between = points_between_returns(_scan(ranges), 0.05)
    assert len(between) > 50
    assert np.minimum(np.abs(between[:, 0] - 8.0), np.abs(between[:, 0] - 5.0)).max() < 1e-3


def test_few_surfaces_are_seen_in_scattered_returns() -> None:
    """Leaves: some three follow each other in one direction by chance, most do not; without asking, the gaps would take over 200 points."""
    rng = np.random.default_rng(1)
    between = [len(points_between_returns(_scan(_wall(8.0) + rng.uniform(-0.4, 0.4, 60)), 0.05)) for _ in range(10)]
    assert np.mean(between) < 80


def test_a_gap_of_beams_stays_open() -> None:
    """A door: a few beams in the middle of the wall have no return."""
    scan = _scan(_wall(8.0))
    kept = np.ones(60, bool)
    kept[28:33] = False
    between = points_between_returns(PlanarScan(0, scan.points[kept], scan.free_points), 0.05)
    low, high = scan.points[27, 1], scan.points[33, 1]
    assert not ((between[:, 1] > low + 1e-3) & (between[:, 1] < high - 1e-3)).any()
