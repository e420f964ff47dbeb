"""The true map of worlds with meshes and terrain: level cuts of surfaces."""

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.sim.mesh_cut import slice_mesh
from ambler.sim.meshes import HeightField, TriangleMesh
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.truth import cut, truth_grid
from ambler.sim.world_file import load_world
from tests.sim.test_meshes import CUBE, CUBE_TRIANGLES


def cube(x: float, y: float, size: float, z: float = 0.0) -> TriangleMesh:
    return TriangleMesh("cube", (CUBE - [0.5, 0.5, 0.0]) * size + [x, y, z], CUBE_TRIANGLES)


def area(segments: np.ndarray) -> float:
    a, b = segments[:, 0], segments[:, 1]
    return float(0.5 * np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def test_slices_of_a_cube_and_a_tetrahedron_enclose_their_areas() -> None:
    """Counter-clockwise seen from above: the outside lies on the right."""
    assert area(slice_mesh(cube(3.0, 1.0, 1.0).corners, 0.4)) == pytest.approx(1.0, abs=1e-12)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    pyramid = TriangleMesh("pyramid", corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))
    for z in (0.0, 0.25, 0.5, 0.9):
        assert area(slice_mesh(pyramid.corners, max(z, 1e-12))) == pytest.approx(0.5 * (1 - z) ** 2, abs=1e-9)
    assert len(slice_mesh(pyramid.corners, 1.001)) == 0
    assert len(slice_mesh(pyramid.corners, -0.001)) == 0


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0])
def test_a_closed_mesh_is_cut_like_the_solid_that_it_is(yaw_deg: float) -> None:
    """The mesh may mark cells more, whose corner the surface just crosses between sample points, never one less."""
    pose = SE2(1.013, 0.987, math.radians(yaw_deg))
    solid = Solid("box", Shape.BOX, pose, 1.0, 1.0, 0.0, 1.0)
    far = Solid("far", Shape.BOX, SE2(-2.0, -2.0, 0.0), 0.1, 0.1, 0.0, 1.0)
    mesh = TriangleMesh("cube", CUBE - [0.5, 0.5, 0.0], CUBE_TRIANGLES).moved(pose)
    spec, as_solid = cut(WorldSpec("w", (far, solid), SE2()), 0.5, 0.05)
    spec_, as_mesh = cut(WorldSpec("w", (far,), SE2(), meshes=(mesh,)), 0.5, 0.05)
    assert spec == spec_
    assert not (as_solid & ~as_mesh).any()
    assert np.count_nonzero(as_mesh & ~as_solid) <= 12
    assert as_mesh[spec.cell_of(pose.x, pose.y)]


def test_of_an_open_mesh_only_the_surface_is_solid_and_low_or_hanging_ones_are_not_cut() -> None:
    tube = TriangleMesh("tube", cube(1.0, 1.0, 1.0).vertices, CUBE_TRIANGLES[4:])
    hollow = TriangleMesh("hollow", tube.vertices, tube.triangles[:-1])
    spec, solid = cut(WorldSpec("w", (), SE2(), meshes=(hollow,)), 0.5, 0.05)
    assert not solid[spec.cell_of(1.0, 1.0)]
    assert solid[spec.cell_of(0.5 + 1e-6, 1.0)]
    for z in (-1.1, 0.6):
        _, solid = cut(WorldSpec("w", (), SE2(), meshes=(cube(1.0, 1.0, 1.0, z),)), 0.5, 0.05)
        assert not solid.any()


def test_terrain_is_solid_where_it_is_not_lower_than_the_cut() -> None:
    x = np.linspace(-3.0, 3.0, 61)
    field = HeightField("hill", np.tile(0.1 * x, (61, 1)), 0.1, SE2(-3.0, -3.0, 0.0))
    spec, solid = cut(WorldSpec("w", (), SE2(), terrain=field), 0.151, 0.05)
    columns = spec.centers_of(np.array([[0, k] for k in range(spec.width)]))[:, 0]
    row = solid[spec.cell_of(0.0, 0.0)[0]]
    np.testing.assert_array_equal(row, (columns > 1.5) & (columns < 3.0))


@pytest.mark.parametrize("robot", robot_names())
def test_the_true_map_of_the_ramp_begins_where_a_level_scanner_sees_the_slope(robot: str) -> None:
    """The yard's ramp begins 3 m ahead of the start: tan 10 degrees later it is as high as the scanner."""
    height = robot_named(robot).sensor_height
    spec, grid = truth_grid(load_world("ramp").from_start(), height, 0.05)
    ahead = min(3.0 + height / math.tan(math.radians(10.0)), 30.0)
    if height < 0.59:
        row = grid[spec.cell_of(0.0, 0.0)[0]]
        begin = spec.cell_of(0.0, 0.0)[1]
        first = begin + int(np.argmax(row[begin:] != 0))
        assert row[first] == 100
        assert spec.center_of(0, first)[0] == pytest.approx(ahead, abs=0.05)
        assert grid[spec.cell_of(8.0, 0.0)] == -1
    else:
        assert grid[spec.cell_of(8.0, 0.0)] == 0
    assert grid[spec.cell_of(1.7, 4.5)] == (100 if height < 0.12 else 0)


def test_heights_of_the_true_map_count_from_the_ground_at_the_start() -> None:
    """On the platform the same scanner sees over the ramps and meets the kerb only if it looks low."""
    world = load_world("ramp", start=SE2(10.0, 2.0, 0.0))
    _, in_world = truth_grid(world, 0.2, 0.05)
    world = world.from_start()
    spec, low = truth_grid(world, 0.1, 0.05)
    assert low[spec.cell_of(0.4, 4.5 + 0.17)] != 0
    spec, high = truth_grid(world, 0.2, 0.05)
    assert high[spec.cell_of(0.4, 4.5)] == 0
    assert high[spec.cell_of(-6.0, 0.0)] == 0
    assert np.count_nonzero(in_world == 0) == pytest.approx(np.count_nonzero(high == 0), rel=0.01)
