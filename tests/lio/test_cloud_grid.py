"""The plan that is cut out of a cloud: of a simulated hall against its true solids, on a slope, between storeys."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN
from ambler.lio.cloud_grid import CloudGrid, cut_plan
from ambler.lio.config import LioConfig
from ambler.lio.offline import run_offline
from ambler.sim.solids import Shape
from ambler.wire.map_files import load_map
from tests.lio.carried import scans_of, walk
from tests.lio.test_lio_verb import recorded

__all__ = ["recorded"]
STEP = 0.08


def plane(x: tuple[float, float], y: tuple[float, float], slope: float = 0.0, z: float = 0.0) -> np.ndarray:
    gx, gy = (v.ravel() for v in np.meshgrid(np.arange(*x, STEP), np.arange(*y, STEP)))
    return np.column_stack([gx, gy, z + slope * gx])


def wall(x: float, y: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
    gy, gz = (v.ravel() for v in np.meshgrid(np.arange(*y, STEP), np.arange(*z, STEP)))
    return np.column_stack([np.full(gy.size, x), gy, gz])


def at(grid: CloudGrid, x: float, y: float) -> int:
    return int(grid.occupancy[grid.spec.cell_of(x, y)])


def test_of_a_hall_what_is_free_is_free_and_what_stands_is_occupied() -> None:
    rig, scans = walk()
    result = run_offline(scans_of(scans), LioConfig(), rig.told_mount)
    way = np.array([pose.translation for pose in result.poses])
    grid = cut_plan(result.cloud, way)
    assert grid.left_out == 0.0
    first = next(s for s in scans if s.end_ns == int(result.stamps_ns[0]))
    world_from_map = first.world_from_imu @ result.poses[0].inverse()
    iy, ix = np.indices(grid.occupancy.shape)
    middles = grid.spec.resolution * (np.column_stack([ix.ravel(), iy.ravel()]) + 0.5)
    middles += [grid.spec.origin_x, grid.spec.origin_y]
    world = world_from_map.transform(np.column_stack([middles, np.zeros(len(middles))]))[:, :2]
    off = np.full(len(world), np.inf)
    for solid in rig_solids():
        local = np.abs(solid.world_from_solid.inverse().transform(world))
        assert solid.shape is Shape.BOX
        off = np.minimum(off, np.maximum(local[:, 0] - 0.5 * solid.size_x, local[:, 1] - 0.5 * solid.size_y))
    cells = grid.occupancy.ravel()
    free, occupied = cells == OCC_FREE, cells == OCC_OCCUPIED
    assert np.mean(off[free] < -0.1) < 0.002
    assert np.mean(off[occupied] < 0.2) > 0.9
    walked = np.array([world_from_map.transform(way)[:, :2]]).reshape(-1, 2)
    near = np.linalg.norm(world[:, None, :] - walked[None, ::20, :], axis=2).min(axis=1) < 1.5
    assert np.mean(free[near & (off > 0.2)]) > 0.98


def rig_solids() -> list:  # type: ignore[type-arg]
    from ambler.sim.site import draw_hall

    return list(draw_hall(3, 25.0).world.solids)


def test_a_slope_is_floor_and_a_kerb_wall_or_table_on_it_is_not() -> None:
    slope = 0.2
    ground = plane((-10.0, 10.0), (-6.0, 6.0), slope)
    fence = wall(4.0, (-6.0, 3.0), (0.8, 1.8))
    roof = plane((-5.0, -2.0), (-6.0, 6.0), slope, 2.4)
    table = plane((-0.6, 0.6), (3.0, 4.2), slope, 0.7)
    way = np.column_stack([np.linspace(-8.0, 3.0, 40), np.zeros(40), 1.2 + slope * np.linspace(-8.0, 3.0, 40)])
    grid = cut_plan(np.vstack([ground, fence, roof, table]), way)
    assert at(grid, 4.0, 0.0) == OCC_OCCUPIED
    assert at(grid, 0.0, 3.6) == OCC_OCCUPIED
    for x, y in ((-8.0, 0.0), (-3.5, 2.0), (2.0, -3.0), (3.5, 0.0)):
        assert at(grid, x, y) == OCC_FREE
    assert at(grid, 8.0, -3.0) == OCC_UNKNOWN  # behind the fence


def test_a_hole_in_the_floor_and_what_was_never_seen_are_not_free() -> None:
    ground = plane((-10.0, 10.0), (-6.0, 6.0))
    hole = (np.abs(ground[:, 0] - 3.0) < 1.5) & (np.abs(ground[:, 1]) < 6.1)
    way = np.column_stack([np.linspace(-8.0, 0.5, 30), np.zeros(30), np.full(30, 1.2)])
    grid = cut_plan(ground[~hole], way)
    assert at(grid, 0.5, 0.0) == OCC_FREE
    assert at(grid, 13.0, 0.0) == OCC_UNKNOWN if grid.spec.contains(13.0, 0.0) else True
    assert (grid.occupancy == OCC_OCCUPIED).sum() == 0


def test_of_two_storeys_the_first_is_shown_and_the_share_of_the_other_told() -> None:
    low, high = plane((-6.0, 6.0), (-6.0, 6.0)), plane((-6.0, 6.0), (-6.0, 6.0), 0.0, 4.0)
    block = wall(3.0, (-2.0, 2.0), (4.0, 5.0))
    flat = np.column_stack([np.linspace(-5.0, 5.0, 30), np.zeros(30)])
    way = np.vstack([np.column_stack([flat, np.full(30, 1.2)]), np.column_stack([flat[::-1], np.full(30, 5.2)])])
    grid = cut_plan(np.vstack([low, high, block]), way)
    assert grid.left_out == pytest.approx(0.5, abs=0.1)
    assert at(grid, 3.0, 0.0) == OCC_FREE  # what stands upstairs is no obstacle


def test_without_a_floor_it_is_refused() -> None:
    with pytest.raises(BadInputError, match="no floor"):
        cut_plan(wall(4.0, (-6.0, 3.0), (0.0, 2.0)), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]))
    with pytest.raises(BadInputError, match="nothing near"):
        cut_plan(np.full((5, 3), np.nan), np.zeros((2, 3)))


def test_the_verb_writes_a_map_that_others_read(recorded: Path, tmp_path: Path) -> None:
    out, told = tmp_path / "out", tmp_path / "r.json"
    assert main(["lio", str(recorded / "recording"), "--grid", "--out", str(out), "--json", str(told)]) == 0
    spec, occupancy = load_map(out / "map.yaml")
    fields = json.loads(told.read_text())
    assert fields["plan_left_out_ratio"] == 0.0
    assert spec.resolution**2 * (occupancy == 0).sum() == pytest.approx(fields["plan_free_m2"])
    assert fields["plan_free_m2"] > 40.0
