"""Panes beside a robot, from scan after scan: they reach as far as it could touch them, not across openings that it passed, and not across what only an edge shows."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import LaserScan
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.near_panes import NearPanes

STANDS = np.zeros(3)
N = 720


def scan_at(y: float, is_pane: Callable[[np.ndarray], np.ndarray], x: float = 0.0, pane: float = 0.6) -> LaserScan:
    """What a scanner at (x, y), heading 0, sees of a pane at x = `pane` where `is_pane` says so of places along it; a wall stands at x = 4, and all around at 9 m."""
    angles = -math.pi + np.arange(N) * 2.0 * math.pi / N
    with np.errstate(divide="ignore"):
        along = y + (pane - x) * np.tan(angles)
        shines = (np.abs(angles) < math.radians(12.0)) & is_pane(along)
        wall = np.minimum(np.where(np.cos(angles) > 0.1, (4.0 - x) / np.cos(angles), np.inf), 9.0)
    ranges = np.where(shines, (pane - x) / np.cos(angles), wall)
    intensities = np.where(shines, 0.06 + 4.0 * np.exp(-0.5 * (angles / math.radians(2.5)) ** 2), 0.5)
    return LaserScan(
        *(0, "laser", -math.pi, 2.0 * math.pi / N, 0.0, 0.1, 0.05, 20.0),
        *(ranges.astype(np.float32), intensities.astype(np.float32)),
    )


def doorway(along: np.ndarray) -> np.ndarray:
    return (along < -0.5) | (along > 0.5)


def pass_by(panes: NearPanes, first: float, last: float, is_pane: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Drive along the pane; return what is told at the end, in the frame that all was driven in, along the pane."""
    told: list[np.ndarray] = []
    for y in np.arange(first, last + 0.01, 0.04):
        pose = SE2(0.0, float(y), 0.0)
        told = [pose.transform(flat) for _, flat in panes.look(scan_at(y, is_pane), pose, SE3(), STANDS)]
    assert len(told) == 1
    np.testing.assert_allclose(told[0][:, 0], 0.6, atol=0.02)
    return told[0][:, 1]


def test_a_pane_goes_on_to_both_sides_as_far_as_the_robot_reaches() -> None:
    along = pass_by(NearPanes(1.5, 0.9), 0.7, 0.7, doorway)
    assert along.min() == pytest.approx(-0.2, abs=0.05)
    assert along.max() == pytest.approx(1.6, abs=0.05)


def test_it_ends_at_an_opening_that_was_passed() -> None:
    along = pass_by(NearPanes(1.5, 0.9), -0.7, 0.7, doorway)
    assert along.min() == pytest.approx(0.5, abs=0.07)
    assert along.max() == pytest.approx(1.6, abs=0.05)


def test_a_scanner_that_hangs_head_down_sees_the_same() -> None:
    """Turned over about its x axis, so that its beams run clockwise: the opening lies where it is, not mirrored."""
    panes, over = NearPanes(1.5, 0.9), SE3((0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    assert over.to_se2().yaw == pytest.approx(0.0)
    told: list[tuple[float, np.ndarray]] = []
    for y in np.arange(-0.7, 0.71, 0.04):
        seen = scan_at(float(y), doorway)
        hanging = replace(seen, ranges=np.roll(seen.ranges[::-1], 1), intensities=np.roll(seen.intensities[::-1], 1))
        told = panes.look(hanging, SE2(0.0, float(y), 0.0), over, STANDS)
    ((_, flat),) = told
    along = 0.7 - flat[:, 1]  # in the frame of a scanner that hangs, left is right
    assert along.min() == pytest.approx(0.5, abs=0.07)
    assert along.max() == pytest.approx(1.6, abs=0.05)


def test_what_was_passed_is_forgotten_with_travel() -> None:
    panes = NearPanes(1.5, 0.9)
    pass_by(panes, -0.7, 0.7, doorway)
    for k in range(200):
        pose = SE2(0.0, 40.0 + (k % 2), 0.0)
        panes.look(scan_at(0.0, lambda along: along > 100.0), pose, SE3(), STANDS)
    assert pass_by(panes, 0.7, 0.7, doorway).min() == pytest.approx(-0.2, abs=0.05)


def test_what_shines_now_is_no_opening() -> None:
    """A pane that shines where beams passed before, a door of glass that was shut, is there."""
    panes = NearPanes(1.5, 0.9)
    pass_by(panes, -0.7, 0.7, doorway)
    pose = SE2()
    ((_, flat),) = panes.look(scan_at(0.0, lambda along: np.full(along.shape, True)), pose, SE3(), STANDS)
    assert flat[:, 1].min() <= -0.07
    assert flat[:, 1].max() >= 0.07


def test_an_edge_of_glass_is_no_pane() -> None:
    """Two centimetres that shine, all that a pane shows from its end, do not reach across a corridor."""
    edge = scan_at(0.0, lambda along: np.abs(along) < 0.012, x=0.25)
    assert NearPanes(1.5, 0.9).look(edge, SE2(), SE3(), STANDS) == []


def test_a_pane_far_away_is_left_alone() -> None:
    assert NearPanes(0.5, 0.9).look(scan_at(2.0, doorway), SE2(), SE3(), STANDS) == []
