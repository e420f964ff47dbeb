"""The floor under a robot whose scanners look outward from its corners."""

import numpy as np
import pytest

from ambler.grids.probability_grid import Inserter, InsertionConfig, ProbabilityGrid
from ambler.nodes.slam2d import with_own_floor
from ambler.registration.planar_scan import PlanarScan

FOOTPRINT = np.array([[0.6, -0.4], [0.6, 0.4], [-0.6, 0.4], [-0.6, -0.4]])


@pytest.mark.parametrize("has_starts", [False, True])
def test_a_robot_stands_on_free_floor(has_starts: bool) -> None:
    points = np.array([[2.0, 0.0], [0.0, -2.0]], np.float32)
    starts = np.array([[0.6, 0.4], [0.6, -0.4]], np.float32) if has_starts else None
    free = np.array([[-3.0, 0.0]], np.float32)
    free_starts = np.array([[-0.6, 0.4]], np.float32) if has_starts else None
    scan = with_own_floor(PlanarScan(5, points, free, (0.6, 0.4), None, starts, free_starts), FOOTPRINT)
    assert scan.points is points
    begins, free_begins = scan.ray_starts()
    assert len(free_begins) == len(scan.free_points) == 181
    assert free_begins[0] == pytest.approx((-0.6, 0.4) if has_starts else (0.6, 0.4))
    grid = ProbabilityGrid(0.05, (0.0, 0.0), 8.0)
    Inserter(InsertionConfig()).insert(grid, begins, scan.points, scan.free_points, free_begins)
    x, y = np.meshgrid(*[np.arange(-1.0, 1.01, 0.05)] * 2)
    inside = (np.abs(x) < 0.56) & (np.abs(y) < 0.36)  # its corners, too
    cells = np.floor((np.stack((y[inside], x[inside])) - grid.frame[[2, 1]][:, None]) / 0.05).astype(int)
    values = grid.cells[cells[0], cells[1]]
    assert ((values > 0) & (values < 16384)).all()
    far = (np.abs(x) > 0.7) & (np.abs(y) > 0.5) & (x + y > 0.0)
    cells = np.floor((np.stack((y[far], x[far])) - grid.frame[[2, 1]][:, None]) / 0.05).astype(int)
    assert (grid.cells[cells[0], cells[1]] == 0).all(), "nothing is told of what lies around it"
