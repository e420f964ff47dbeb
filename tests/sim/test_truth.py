"""The ground-truth map: the surfaces that can be seen from free space, cut at the sensor's height."""

import numpy as np
import pytest
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim import truth
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.scene import build_scene
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.truth import reachable_floor, truth_grid
from ambler.sim.world_file import load_world, world_names


def box(x: float, y: float, size_x: float, size_y: float, z_max: float = 2.0) -> Solid:
    return Solid("box", Shape.BOX, SE2(x, y, 0.0), size_x, size_y, 0.0, z_max)


def closed_room(*inside: Solid) -> WorldSpec:
    """A room with inner faces at +-2 m and walls 0.5 m thick."""
    walls = (box(2.25, 0, 0.5, 5), box(-2.25, 0, 0.5, 5), box(0, 2.25, 5, 0.5), box(0, -2.25, 5, 0.5))
    return WorldSpec("room", (*walls, *inside), SE2())


def test_free_area_and_surface_of_a_room() -> None:
    spec, grid = truth_grid(closed_room(), 0.3, 0.05)
    assert np.count_nonzero(grid == 0) == 80 * 80
    assert np.count_nonzero(grid == 100) == 4 * 80
    assert grid[spec.cell_of(0.0, 0.0)] == 0
    assert grid[spec.cell_of(2.02, 0.0)] == 100
    assert grid[spec.cell_of(2.3, 0.0)] == -1


def test_a_cell_that_holds_a_surface_is_occupied() -> None:
    spec, grid = truth_grid(closed_room(box(1.0, 0.0, 0.08, 0.08)), 0.3, 0.05)
    assert all(grid[spec.cell_of(x, y)] == 100 for x in (0.97, 1.03) for y in (-0.03, 0.03))


@pytest.mark.parametrize("thickness", [0.002, 0.005, 0.01])
def test_a_wall_that_is_thinner_than_the_samples_are_apart_is_drawn(thickness: float) -> None:
    for k in range(26):
        _, grid = truth_grid(closed_room(box(1.0 + 0.002 * k, 0.0, thickness, 4.5)), 0.3, 0.05)
        assert np.count_nonzero(grid == 0) <= 62 * 80


@pytest.mark.parametrize("at_once", [1, 700, 5000])
def test_what_is_drawn_does_not_depend_on_how_much_at_once(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    aslant = Solid("wall", Shape.BOX, SE2(0.9, -0.9, 0.6), 1.5, 0.1, 0.0, 2.0)
    pillar = Solid("pillar", Shape.CYLINDER, SE2(-0.9, 1.1, 0.0), 0.7, 0.7, 0.0, 2.0)
    world = closed_room(aslant, pillar)
    spec, whole = truth_grid(world, 0.3, 0.05)
    monkeypatch.setattr(truth, "SAMPLES_AT_ONCE", at_once)
    again, strips = truth_grid(world, 0.3, 0.05)
    assert again == spec
    np.testing.assert_array_equal(strips, whole)
    assert whole[spec.cell_of(0.9, -0.9)] != 0


def test_low_things_are_not_cut_and_hollow_ones_stay_unknown() -> None:
    low = box(1.0, 1.0, 0.4, 0.4, z_max=0.2)
    spec, grid = truth_grid(closed_room(low), 0.3, 0.05)
    assert grid[spec.cell_of(1.0, 1.0)] == 0
    hollow = [box(-1, 0.5, 1.1, 0.1), box(-1, -0.5, 1.1, 0.1), box(-0.5, 0, 0.1, 1.1), box(-1.5, 0, 0.1, 1.1)]
    spec, grid = truth_grid(closed_room(*hollow), 0.3, 0.05)
    assert grid[spec.cell_of(-1.0, 0.0)] == -1


def test_a_start_inside_a_solid_is_refused() -> None:
    with pytest.raises(BadInputError, match="start"):
        truth_grid(closed_room(box(0, 0, 1, 1)), 0.3, 0.05)


OPEN = ("campus", "tunnel")
WIDE = ("campus",)  # its truth takes a quarter of a minute at 5 cm
LAB_WALLS = 1.2


def resolution_of(name: str, robot: str) -> float:
    return 0.1 if name in WIDE and robot != "mecanum" else 0.05


# Rays pass glass, which is a true surface all the same.
@pytest.mark.parametrize("robot", robot_names())
@pytest.mark.parametrize("name", [name for name in world_names() if name != "glass"])
def test_rays_end_on_true_surfaces(name: str, robot: str) -> None:
    """A level ray at the sensor's height runs through free cells and ends within a cell of an occupied one; some of those worlds are open,
    or their walls are lower than a tall robot's sensor, and rays that meet nothing are let go."""
    world, height = load_world(name).from_start(), robot_named(robot).sensor_height
    spec, grid = truth_grid(world, height, resolution_of(name, robot))
    angles = np.linspace(-np.pi, np.pi, 500)
    directions = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    above = height + (0.0 if world.is_flat else float(world.ground_at(np.zeros((1, 2)))[0]))
    distance, _, _ = build_scene(world).cast(np.tile([0.0, 0.0, above], (500, 1)), directions)
    is_met = np.isfinite(distance)
    assert is_met.all() or name in OPEN or (name.startswith("lab") and height > LAB_WALLS)
    distance, directions = distance[is_met], directions[is_met]
    ends = spec.cells_of((distance[:, None] + 1e-4) * directions[:, :2])
    near_surface = ndimage.binary_dilation(grid == 100, np.ones((3, 3)))
    assert near_surface[ends[:, 0], ends[:, 1]].all()
    for share in np.linspace(0.02, 0.98, 25):
        on_way = share * np.maximum(distance - 0.2, 0.0)
        cells = spec.cells_of(on_way[:, None] * directions[:, :2])
        assert (grid[cells[:, 0], cells[:, 1]] != -1).all()


@pytest.mark.parametrize("name", world_names())
def test_free_space_is_enclosed_by_surfaces(name: str) -> None:
    _, grid = truth_grid(load_world(name), 0.28, resolution_of(name, ""))
    assert not (ndimage.binary_dilation(grid == 0) & (grid == -1)).any()


def test_the_reachable_floor_is_that_of_a_body_from_its_underside_to_its_top() -> None:
    """Two rooms of 2 m, joined by a gap of 0.6 m: over it a beam at 0.5 m, across it a kerb of 4 cm."""
    walls = (box(0, 1.15, 0.1, 1.7), box(0, -1.15, 0.1, 1.7))
    beam = Solid("beam", Shape.BOX, SE2(0, 0, 0), 0.1, 0.6, 0.5, 2.0)
    world = closed_room(*walls, beam, box(0, 0, 0.1, 0.6, z_max=0.04))
    world = WorldSpec("rooms", world.solids, SE2(-1.0, 0.0, 0.0))

    def area(radius: float, heights: tuple[float, float]) -> float:
        spec, clear, reached = reachable_floor(world, radius, 0.05, heights)
        assert not (reached & ~clear).any()
        assert reached[spec.cell_of(-1.0, 0.0)]
        return float(reached.sum()) * 0.05**2

    half = 1.45 * 3.5
    assert area(0.25, (0.05, 0.33)) == pytest.approx(2 * half, rel=0.1)
    assert area(0.25, (0.05, 0.65)) == pytest.approx(half, rel=0.1), "the beam is in the way of a taller one"
    assert area(0.25, (0.03, 0.33)) == pytest.approx(half, rel=0.1), "the kerb is in the way of a lower one"
    assert area(0.32, (0.05, 0.33)) < 1.1 * half, "the gap is too narrow"
