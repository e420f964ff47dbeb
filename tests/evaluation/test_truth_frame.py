"""Ground truth of the world told in a robot's map frame: poses, and grids turned by right angles or by any angle."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ambler.bridges.recorder import Recorder
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid, PoseStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation import truth_frame
from ambler.evaluation.truth_frame import TruthFrame, start_frame
from ambler.runtime.topics import TRUE_START
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.truth import truth_grid

START = SE2(3.0, -1.5, 2.0)


def test_poses_are_told_from_the_map() -> None:
    frame = TruthFrame(START)
    inside = [SE2(), SE2(1.0, 2.0, 3.0), SE2(-4.0, 0.5, -2.5)]
    for pose in inside:
        assert frame.pose(START @ pose).distance_to(pose) < 1e-12
    rows = frame.poses(np.array([(START @ pose).as_array() for pose in inside]))
    np.testing.assert_allclose(rows, [pose.as_array() for pose in inside], atol=1e-12)


@pytest.mark.parametrize("degrees", [0, 90, 180, -90])
def test_right_angles_keep_every_cell(degrees: int) -> None:
    rng = np.random.default_rng(0)
    spec = GridSpec(0.05, 7, 4, -0.3, 1.2)
    grid = OccupancyGrid(0, "world", spec, rng.integers(-1, 101, spec.shape).astype(np.int8))
    frame = TruthFrame(SE2(0.4, -2.0, math.radians(degrees)))
    turned, cells = frame.grid(grid)
    assert cells.size == 28
    for iy in range(4):
        for ix in range(7):
            x, y = spec.center_of(iy, ix)
            place = frame.pose(SE2(x, y, 0.0))
            assert cells[turned.cell_of(place.x, place.y)] == grid.data[iy, ix]


def test_any_other_angle_agrees_with_a_map_that_was_drawn_there() -> None:
    """A room with a box, started in at 20 degrees: its true map, sampled, beside the one cut in the frame of the start."""
    sides = [
        (4.0, 0.0, 8.1, 0.1),
        (4.0, 6.0, 8.1, 0.1),
        (0.0, 3.0, 0.1, 6.1),
        (8.0, 3.0, 0.1, 6.1),
        (6.0, 4.0, 1.0, 0.6),
    ]
    solids = tuple(Solid("s", Shape.BOX, SE2(x, y, 0.0), *size, 0.0, 2.0) for x, y, *size in sides)
    world = WorldSpec("room", solids, SE2(4.2, 2.2, math.radians(20.0)))
    spec, data = truth_grid(world, 0.18, 0.05)
    turned, cells = TruthFrame(world.start).grid(OccupancyGrid(0, "world", spec, data))
    drawn, wanted = truth_grid(world.from_start(), 0.18, 0.05)
    free = np.argwhere(wanted == 0)
    index = turned.cells_of(drawn.centers_of(free))
    assert (cells[index[:, 0], index[:, 1]] == 0).mean() > 0.97
    walls = np.argwhere(cells == 100)
    back = drawn.cells_of(turned.centers_of(walls))
    near = np.array([(wanted[y - 1 : y + 2, x - 1 : x + 2] == 100).any() for y, x in back])
    assert near.mean() > 0.98
    assert 0.8 < len(walls) / np.count_nonzero(wanted == 100) < 1.25


def test_what_is_sampled_does_not_depend_on_how_much_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    grid = OccupancyGrid(
        0, "world", GridSpec(0.05, 70, 50, -1.0, 2.0), rng.choice(np.array([-1, 0, 100], np.int8), (50, 70))
    )
    frame = TruthFrame(SE2(0.3, 3.0, 0.4))
    spec, whole = frame.grid(grid)
    for at_once in (1, 150, 1000):
        monkeypatch.setattr(truth_frame, "CELLS_AT_ONCE", at_once)
        again, strips = frame.grid(grid)
        assert again == spec
        np.testing.assert_array_equal(strips, whole)
    assert {-1, 0, 100} == set(np.unique(whole).tolist())


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0])
def test_the_true_map_has_the_cells_of_a_map_that_begins_at_the_start(yaw_deg: float) -> None:
    """Half a cell beside each other, two equal maps would look 0.8 alike."""
    walls = [(4.0, 0.0, 8.13, 0.1), (4.0, 6.0, 8.13, 0.1), (0.0, 3.0, 0.1, 6.17), (8.0, 3.0, 0.1, 6.17)]
    solids = tuple(Solid("s", Shape.BOX, SE2(x, y, 0.0), *size, 0.0, 2.0) for x, y, *size in walls)
    world = WorldSpec("room", solids, SE2(4.228, 2.231, math.radians(yaw_deg)))
    spec, data = truth_grid(world, 0.18, 0.05)
    turned, cells = TruthFrame(world.start).grid(OccupancyGrid(0, "world", spec, data))
    drawn, wanted = truth_grid(world.from_start(), 0.18, 0.05)
    shift = np.array([turned.origin_x - drawn.origin_x, turned.origin_y - drawn.origin_y]) / 0.05
    assert np.abs(shift - np.round(shift)).max() < 1e-6
    index = drawn.cells_of(turned.centers_of(np.argwhere(cells != -1)))
    assert np.array_equal(wanted[index[:, 0], index[:, 1]], cells[cells != -1])


def test_a_recording_tells_where_the_robot_started(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "told")
    recorder.on_message(TRUE_START, PoseStamped(0, "world", SE3.from_se2(START)), 0)
    recorder.close()
    assert start_frame(recorder.folder).world_from_map.distance_to(START) < 1e-12
    silent = Recorder(tmp_path / "silent")
    silent.close()
    with pytest.raises(BadInputError, match="where in the world"):
        start_frame(silent.folder)
