"""Which returns of a scan a grid can speak for."""

from __future__ import annotations

import math

import numpy as np

from ambler.core.se2 import SE2
from ambler.grids.probability_grid import InsertionConfig
from ambler.registration.seen_by_both import contradiction, seen_by_both
from ambler.slam2d.submaps import ActiveSubmaps
from tests.registration.room import loop_of, scan_at

# Two rooms with a wall between them, as thick as a wall is, and a door in it.
LEFT, RIGHT = (-8.0, -0.1), (0.1, 8.0)
WALLS = np.array(
    [
        *loop_of((LEFT[0], -4.0), (LEFT[1], -4.0), (LEFT[1], 4.0), (LEFT[0], 4.0)),
        *loop_of((RIGHT[0], -4.0), (RIGHT[1], -4.0), (RIGHT[1], 4.0), (RIGHT[0], 4.0)),
    ]
)


def test_a_wall_that_was_seen_from_behind_is_another_surface() -> None:
    """Of the left room the scan knows all; the right one sees the other side of one wall, whose returns lie in known cells when it is believed nearer than it is."""
    active = ActiveSubmaps(InsertionConfig(), 1)
    view = SE2(-4.0, 0.5, 0.3)
    for _ in range(3):
        active.insert(scan_at(view, walls=WALLS, range_max=30.0), view)
    grid = active.submaps[0].grid
    local = active.submaps[0].local_from_submap.inverse()
    again, beside = SE2(-3.5, -0.4, 2.0), SE2(4.0, 0.2, math.pi)
    scan = scan_at(again, walls=WALLS, range_max=30.0)
    is_seen = seen_by_both(grid, scan.points, scan.origin, local @ again)
    assert is_seen.mean() > 0.65  # the others lie in cells between two beams
    other = scan_at(beside, walls=WALLS, range_max=30.0)
    nearer = local @ SE2(3.8, 0.2, math.pi)
    assert seen_by_both(grid, other.points, other.origin, nearer).mean() < 0.02
    # From the left the same points lie before known ground.
    on_wall = other.points[other.points[:, 0] > 3.0]
    assert seen_by_both(grid, on_wall, (8.0, 0.0), nearer).mean() > 0.3


def test_beyond_the_grid_nothing_is_known() -> None:
    active = ActiveSubmaps(InsertionConfig(), 1)
    active.insert(scan_at(SE2(-4.0, 0.0, 0.0), walls=WALLS, range_max=30.0), SE2(-4.0, 0.0, 0.0))
    points = np.array([[500.0, 0.0], [-500.0, 3.0], [0.0, 1e6]], np.float32)
    grid = active.submaps[0].grid
    grid.cells[[0, -1], :] = grid.cells[:, [0, -1]] = 1
    assert not seen_by_both(grid, points, (0.0, 0.0), SE2()).any()


def test_what_stands_where_nothing_stood_contradicts_and_a_new_view_does_not() -> None:
    active = ActiveSubmaps(InsertionConfig(), 1)
    view = SE2(-4.0, 0.0, 0.0)
    for _ in range(3):
        active.insert(scan_at(view, walls=WALLS, range_max=30.0), view)
    grid, local = active.submaps[0].grid, active.submaps[0].local_from_submap.inverse()
    scan = scan_at(view, walls=WALLS, range_max=30.0)
    assert contradiction(grid, scan.points, scan.origin, local @ view) < 0.1
    assert contradiction(grid, 0.6 * scan.points, scan.origin, local @ view) > 0.5
    beside = scan_at(SE2(4.0, 0.0, 0.0), walls=WALLS, range_max=30.0)
    assert contradiction(grid, beside.points, beside.origin, local @ SE2(4.0, 0.0, 0.0)) < 0.02
