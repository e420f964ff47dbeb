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


def _sure(scan: PlanarScan) -> np.ndarray:
    between = points_between_returns(scan, 0.05)
    return between.points[: between.sure]


def test_a_wall_that_is_seen_in_dots_is_closed_to_the_spacing() -> None:
    scan = _scan(_wall(8.0))
    between = _sure(scan)
    assert len(between) > 100
    assert np.abs(between[:, 0] - 8.0).max() < 1e-3
    along = np.sort(np.concatenate((scan.points[:, 1], between[:, 1])))
    assert np.diff(along).max() < 0.0501


def test_near_walls_whose_returns_touch_need_nothing() -> None:
    assert len(points_between_returns(_scan(_wall(2.0)), 0.05).points) == 0


def test_nothing_goes_on_from_one_thing_to_another_behind_it() -> None:
    ranges = _wall(8.0)
    ranges[30:] = _wall(5.0)[30:]
    between = points_between_returns(_scan(ranges), 0.05).points
    assert len(between) > 50
    assert np.minimum(np.abs(between[:, 0] - 8.0), np.abs(between[:, 0] - 5.0)).max() < 1e-3


def test_few_surfaces_are_seen_in_scattered_returns() -> None:
    """Leaves: some three follow each other in one direction by chance, most do not; without asking, the gaps would take over 200 points."""
    rng = np.random.default_rng(1)
    between = [len(_sure(_scan(_wall(8.0) + rng.uniform(-0.4, 0.4, 60)))) for _ in range(10)]
    assert np.mean(between) < 80


def test_a_gap_of_beams_stays_open() -> None:
    """A door: a few beams in the middle of the wall have no return."""
    scan = _scan(_wall(8.0))
    kept = np.ones(60, bool)
    kept[28:33] = False
    between = points_between_returns(PlanarScan(0, scan.points[kept], scan.free_points), 0.05).points
    low, high = scan.points[27, 1], scan.points[33, 1]
    assert not ((between[:, 1] > low + 1e-3) & (between[:, 1] < high - 1e-3)).any()


def test_a_wall_along_which_one_looks_goes_on_likely_where_its_returns_lie_far_apart() -> None:
    """A wall 0.9 m beside the sensor: from 13 m on its returns are farther apart than anything is certain over."""
    step = math.radians(0.5)
    angles = np.arange(1, 180) * step
    angles = angles[0.9 / np.sin(angles) < 20.0]
    points = np.column_stack((0.9 / np.tan(angles), np.full(len(angles), 0.9))).astype(np.float32)
    between = points_between_returns(PlanarScan(0, points, np.zeros((0, 2), np.float32)), 0.05)
    assert np.abs(between.points[:, 1] - 0.9).max() < 1e-5
    sure, likely = between.points[: between.sure, 0], between.points[between.sure :, 0]
    assert 9.0 < sure.max() < 13.0
    assert likely.min() > 9.0
    assert np.diff(np.sort(np.concatenate((points[points[:, 0] > 2.0, 0], between.points[:, 0])))).max() < 0.0501


def test_two_things_far_apart_in_one_direction_are_no_wall() -> None:
    points = np.array([[6.0, 0.9], [8.0, 0.9], [8.1, 1.6]], np.float32)
    assert len(points_between_returns(PlanarScan(0, points, np.zeros((0, 2), np.float32)), 0.05).points) == 0


def test_a_return_that_an_edge_tears_between_two_walls_is_no_wall() -> None:
    """A wall ends before another one, 18 m away: near wall, torn return and far wall lie nearly on a beam, whatever the place of the torn one."""
    step = math.radians(0.5)
    for share in np.linspace(0.05, 0.95, 19):
        ranges = 18.0 / np.cos((np.arange(40) - 20.0) * step)
        ranges[20:] += 1.5
        ranges[20] = 18.0 + 1.5 * share
        between = points_between_returns(_scan(ranges, step), 0.05).points
        off = np.minimum(np.abs(between[:, 0] - 18.0), np.abs(between[:, 0] - 19.5))
        assert off.max() < 0.1


def test_a_wall_along_the_beams_goes_on_to_its_ends() -> None:
    """Four returns of a wall seen at 10°, between nothing else: no end of it is left open."""
    step = math.radians(1.0)
    slope = math.tan(math.radians(10.0))
    angles = np.arange(4) * step
    away = 5.0 * slope / (np.sin(angles) + slope * np.cos(angles))
    points = np.column_stack((away * np.cos(angles), away * np.sin(angles)))[::-1].astype(np.float32)
    between = points_between_returns(PlanarScan(0, points, np.zeros((0, 2), np.float32)), 0.05).points
    ends = np.sort(np.concatenate((points, between))[:, 0])
    assert ends[0] == points[:, 0].min()
    assert np.diff(ends).max() < 0.0501
