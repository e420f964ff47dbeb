"""The layers and both costmaps: rays clear and mark, windows roll, maps grow, doors stay passable."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.inflation import InflationConfig
from ambler.costmap.layer import Moment
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.costmap.obstacle_layer import ObstacleConfig, ObstacleLayer, SensorRays
from ambler.costmap.static_layer import StaticConfig, StaticLayer, occupancy_table
from ambler.registration.planar_scan import RayFalls

FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
ROBOT = RobotModel("test", DriveKind.DIFFERENTIAL, FOOTPRINT, VelocityLimits())
SPEC = GridSpec(0.05, 80, 60, -1.0, -1.5)


def layer(**changes: float) -> ObstacleLayer:
    return ObstacleLayer(ObstacleConfig(**({"obstacle_range": 10.0, "raytrace_range": 10.0} | changes)))


def trace(grid: ObstacleLayer, rays: list[SensorRays], *, over: int | None = None) -> np.ndarray:
    """Let the layer trace rays, over cells of one cost if given; returns its cells."""
    if over is not None:
        trace(grid, [SensorRays((0.0, 0.0))])[:] = over
    grid.add(rays)
    grid.update(SPEC, Moment())
    assert grid.cells is not None
    return grid.cells


def see(costmap: LocalCostmap, pose: SE2, *rays: SensorRays) -> np.ndarray:
    costmap.layer(ObstacleLayer).add(rays)
    return costmap.update(pose)


def cost_at(costs: np.ndarray, spec: GridSpec, x: float, y: float) -> int:
    return int(costs[spec.cell_of(x, y)])


@given(seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_rays_free_the_cells_they_cross_and_hits_mark_their_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    origin = rng.uniform([-2.0, -2.5], [4.0, 2.5])
    hits = rng.uniform([-2.0, -2.5], [4.0, 2.5], (5, 2))
    free = rng.uniform([-2.0, -2.5], [4.0, 2.5], (5, 2))
    cells = trace(layer(), [SensorRays((float(origin[0]), float(origin[1])), hits, free)], over=254)
    marked = {tuple(c) for c in SPEC.cells_of(hits)}
    crossed = set()
    for end, last in [(e, 0.999) for e in hits] + [(e, 1.0) for e in free]:
        t = np.linspace(0.0, last, 2000)[:, None]
        crossed |= {tuple(c) for c in SPEC.cells_of(origin + t * (end - origin))}
    ends = {tuple(c) for c in SPEC.cells_of(hits)}
    for iy, ix in crossed - ends:
        if SPEC.contains_cell(iy, ix):
            assert cells[iy, ix] == 0
    for iy, ix in marked:
        if SPEC.contains_cell(iy, ix):
            assert cells[iy, ix] == 254
    freed = {tuple(c) for c in np.argwhere(cells == 0)}
    assert len(freed - crossed) <= 0.02 * len(crossed) + 2  # corners that the sampling missed


def test_rays_without_return_clear_up_to_their_range_and_mark_nothing() -> None:
    cells = trace(layer(raytrace_range=1.0), [SensorRays((0.0, 0.02), free_ends=np.array([[1e6, 0.02]]))], over=254)
    row = cells[SPEC.cell_of(0.0, 0.02)[0]]
    first, last = SPEC.cell_of(0.0, 0.02)[1], SPEC.cell_of(1.0, 0.02)[1]
    assert (row[first : last + 1] == 0).all()
    assert (row[:first] == 254).all()
    assert (row[last + 1 :] == 254).all()


def test_hits_beyond_the_obstacle_range_clear_but_do_not_mark() -> None:
    cells = trace(layer(obstacle_range=0.5, raytrace_range=3.0), [SensorRays((0.0, 0.02), np.array([[1.02, 0.02]]))])
    assert cost_at(cells, SPEC, 0.6, 0.02) == 0
    assert cost_at(cells, SPEC, 1.02, 0.02) == 255


def test_one_sensor_does_not_erase_what_another_sees_now() -> None:
    grid = layer()
    low = SensorRays((0.0, 0.02), np.array([[0.52, 0.02]]))
    high = SensorRays((0.0, 0.02), free_ends=np.array([[2.0, 0.02]]))
    for order in ([low, high], [high, low]):
        assert cost_at(trace(grid, order), SPEC, 0.52, 0.02) == 254


def falling(top: float) -> RayFalls:
    """Rays of a sensor at 0.8 m that fall by 0.25 per metre, and what one return met."""
    one = np.array([0.25], np.float32)
    return RayFalls(0.8, one, one, np.array([top], np.float32))


def test_rays_of_a_cloud_erase_what_they_pass_through_and_not_what_they_pass_over() -> None:
    grid, far = layer(raytrace_range=5.0, obstacle_range=5.0), np.array([[3.0, 0.02]])
    for x, top in ((1.02, 0.42), (1.22, 0.75), (2.02, 0.42)):
        trace(grid, [SensorRays((0.0, 0.02), np.array([[x, 0.02]]), falls=falling(top))])
    through = SensorRays((0.0, 0.02), free_ends=far, falls=falling(0.0))
    cells = trace(grid, [through])
    assert cost_at(cells, SPEC, 1.02, 0.02) == 254  # a table: the ray is 0.55 m high there
    assert cost_at(cells, SPEC, 1.22, 0.02) == 0  # a person who has left
    assert cost_at(cells, SPEC, 2.02, 0.02) == 0  # as high as the first, but the ray is 0.3 m high
    trace(grid, [SensorRays((0.0, 0.02), np.array([[0.82, 0.02]]), falls=falling(0.14))])
    assert cost_at(trace(grid, [through]), SPEC, 0.82, 0.02) == 0  # that was floor, most likely
    level = SensorRays((0.0, 0.02), free_ends=far)
    assert cost_at(trace(grid, [level]), SPEC, 1.02, 0.02) == 0


@pytest.mark.parametrize("tops", [(0.14, 0.42), (0.42, 0.14)])
def test_a_low_return_takes_no_protection_from_what_is_higher(tops: tuple[float, float]) -> None:
    grid = layer(raytrace_range=5.0, obstacle_range=5.0)
    for top in tops:
        trace(grid, [SensorRays((0.0, 0.02), np.array([[1.02, 0.02]]), falls=falling(top))])
    over = SensorRays((0.0, 0.02), free_ends=np.array([[3.0, 0.02]]), falls=falling(0.0))
    assert cost_at(trace(grid, [over]), SPEC, 1.02, 0.02) == 254


def test_the_highest_of_what_stands_in_a_cell_counts_and_moves_with_the_window() -> None:
    grid = layer(raytrace_range=5.0, obstacle_range=5.0)
    for top in (0.3, 0.7, 0.3):
        trace(grid, [SensorRays((0.0, 0.02), np.array([[1.02, 0.02]]), falls=falling(top))])
    trace(grid, [SensorRays((0.0, 0.02), np.array([[0.82, 0.02]]), falls=falling(0.4))])
    moved = GridSpec(SPEC.resolution, SPEC.width, SPEC.height, SPEC.origin_x + 4 * SPEC.resolution, SPEC.origin_y)
    grid.update(moved, Moment())
    grid.add([SensorRays((0.0, 0.02), free_ends=np.array([[3.0, 0.02]]), falls=falling(0.0))])
    grid.update(moved, Moment())
    assert grid.cells is not None
    assert cost_at(grid.cells, moved, 1.02, 0.02) == 0
    assert cost_at(grid.cells, moved, 0.82, 0.02) == 254


def test_not_a_number_is_passed_over() -> None:
    bad = SensorRays((0.0, 0.0), np.array([[np.nan, 0.0], [np.inf, 1.0]]), np.array([[np.nan, np.nan]]))
    cells = trace(layer(), [bad])
    assert set(np.unique(cells)) <= {0, 255}


def test_the_window_rolls_by_whole_cells_and_keeps_the_world_in_place() -> None:
    costmap = LocalCostmap(LocalCostmapConfig(size=4.0), ROBOT)
    box = np.array([[1.02, 0.52], [1.07, 0.52]])
    see(costmap, SE2(), SensorRays((0.0, 0.0), box))
    rng = np.random.default_rng(0)
    x = y = 0.0
    for _ in range(60):
        x, y = x + rng.uniform(-0.03, 0.03), y + rng.uniform(-0.03, 0.03)
        costs = costmap.update(SE2(x, y, 0.4))
        spec = costmap.spec
        assert spec.origin_x / 0.05 == pytest.approx(round(spec.origin_x / 0.05))
        assert abs(spec.origin_x + 2.0 - x) <= 0.0251
        assert {tuple(p) for p in spec.centers_of(np.argwhere(costs == 254)).round(3)} == {
            (1.025, 0.525),
            (1.075, 0.525),
        }
    costmap.update(SE2(30.0, 0.0))
    assert (costmap.update(SE2()) == 0).all()


def test_the_footprint_is_freed_and_clear_forgets() -> None:
    costmap = LocalCostmap(LocalCostmapConfig(), ROBOT)
    points = np.array([[0.2, 0.1], [1.0, 1.0]])
    costs = see(costmap, SE2(), SensorRays((2.0, 2.0), points))
    assert cost_at(costs, costmap.spec, 0.2, 0.1) == 0
    assert cost_at(costs, costmap.spec, 1.01, 1.01) == 254
    costmap.clear()
    assert (costmap.costs == 0).all()
    tracking = LocalCostmap(LocalCostmapConfig(tracks_unknown=True), ROBOT)
    assert cost_at(tracking.update(SE2()), tracking.spec, 2.0, 2.0) == 255
    assert cost_at(tracking.costs, tracking.spec, 0.0, 0.0) == 0


def test_a_local_doorway_stays_passable() -> None:
    costmap = LocalCostmap(LocalCostmapConfig(), ROBOT)
    wall = np.arange(0.45, 2.0, 0.02)
    posts = np.column_stack((np.full(2 * len(wall), 1.02), np.concatenate((wall, -wall))))
    costs = see(costmap, SE2(), SensorRays((0.0, 0.0), posts))
    for y in np.arange(-0.4, 0.41, 0.05):
        assert cost_at(costs, costmap.spec, 1.02, y) == 0


def occupancy(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return rng.choice(np.array([-1, 0, 40, 100], np.int8), shape, p=[0.2, 0.7, 0.05, 0.05])


@given(seed=st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_changes_box_by_box_equal_a_fresh_global_costmap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    config = GlobalCostmapConfig(inflation=InflationConfig(radius=0.4))
    costmap = GlobalCostmap(config, ROBOT)
    cells = occupancy(rng, SPEC.shape)
    for _ in range(4):
        cells = cells.copy()
        y, x = int(rng.integers(0, 50)), int(rng.integers(0, 70))
        cells[y : y + 5, x : x + 8] = occupancy(rng, (5, 8))
        cells.flags.writeable = False
        costs = costmap.set_map(SPEC, cells)
        costs.flags.writeable = False
        np.testing.assert_array_equal(costs, GlobalCostmap(config, ROBOT).set_map(SPEC, cells))


def test_the_global_costmap_grows_with_its_map_and_keeps_its_obstacles() -> None:
    config = GlobalCostmapConfig(inflation=InflationConfig(radius=0.0))
    costmap = GlobalCostmap(config, ROBOT)
    costmap.set_map(SPEC, np.zeros(SPEC.shape, np.int8))
    costmap.layer(ObstacleLayer).add([SensorRays((0.0, 0.0), np.array([[1.02, 0.52]]))])
    costmap.update()
    larger = GridSpec(0.05, 120, 100, -2.0, -2.5)
    costs = costmap.set_map(larger, np.full(larger.shape, -1, np.int8))
    assert costs.shape == larger.shape
    assert cost_at(costs, larger, 1.02, 0.52) == 254
    assert cost_at(costs, larger, 0.5, 0.26) == 0  # seen free by the ray, though unknown in the map
    assert cost_at(costs, larger, -1.5, -2.0) == 255
    costs = costmap.clear()
    assert (costs == 255).all()


def test_static_costs_follow_the_configuration() -> None:
    table = occupancy_table(StaticConfig())
    assert [int(table[v + 128]) for v in (-1, 0, 30, 64, 65, 100)] == [255, 0, 0, 0, 254, 254]
    graded = occupancy_table(StaticConfig(lethal_threshold=100, tracks_unknown=False, is_trinary=False))
    assert [int(graded[v + 128]) for v in (-1, 0, 50, 100)] == [0, 0, 127, 254]


def test_a_costmap_without_a_map_says_so() -> None:
    costmap = GlobalCostmap(GlobalCostmapConfig(), ROBOT)
    assert not costmap.has_map
    with pytest.raises(BadInputError, match="no map"):
        _ = costmap.spec
    with pytest.raises(BadInputError, match="no map"):
        costmap.update()
    with pytest.raises(BadInputError, match="no StaticLayer"):
        costmap.layer(StaticLayer)
    with pytest.raises(BadInputError, match="does not fit"):
        costmap.set_map(SPEC, np.zeros((3, 3), np.int8))


def doorway(width: int) -> np.ndarray:
    """Return a map of two rooms and a door in the wall between them that is so many cells wide, int8 [iy, ix]."""
    cells = np.zeros(SPEC.shape, np.int8)
    cells[:, 40:42] = 100
    cells[30 - width // 2 : 30 - width // 2 + width, 40:42] = 0
    return cells


def is_through(costs: np.ndarray) -> bool:
    """Say whether the middle row is open from room to room."""
    return bool((costs[29:31] < 253).any(axis=0).all())


def drive_through(costmap: GlobalCostmap, *, to: int = 60) -> np.ndarray:
    """Let the robot's middle pass along the middle row, up to a column."""
    costs = costmap.costs
    for ix in range(20, to, 5):
        costs = costmap.update(Moment(SE2(-1.0 + 0.05 * ix, -1.5 + 0.05 * 29.5, 0.0)))
    return costs


def test_a_door_that_the_robot_has_passed_stays_open_when_its_wall_grows_by_a_cell_but_not_when_somebody_stands_there() -> (
    None
):
    wide, narrow, shut = doorway(9), doorway(7), doorway(4)
    config = GlobalCostmapConfig(inflation=InflationConfig(inscribed_radius=0.24))
    fresh = GlobalCostmap(config, ROBOT)
    assert is_through(fresh.set_map(SPEC, wide))
    assert not is_through(fresh.set_map(SPEC, narrow))
    costmap = GlobalCostmap(config, ROBOT)
    costmap.set_map(SPEC, wide)
    drive_through(costmap)
    assert is_through(costmap.set_map(SPEC, narrow))
    assert is_through(costmap.update()), "the same without news"
    assert (costmap.costs[narrow == 100] == 254).all()
    assert not is_through(costmap.set_map(SPEC, shut))
    someone = narrow.copy()
    someone[28, 41] = 100
    assert not is_through(costmap.set_map(SPEC, someone))
    larger = GridSpec(0.05, 120, 100, -2.0, -2.5)  # the map grows and its origin moves
    grown = np.zeros(larger.shape, np.int8)
    grown[20:80, 20:100] = narrow
    costs = costmap.set_map(larger, grown)
    assert is_through(costs[20:80, 20:100])
    costmap.forget_driven()
    assert not is_through(costmap.set_map(SPEC, narrow))


def test_what_the_robot_did_not_drive_is_not_kept_open() -> None:
    config = GlobalCostmapConfig(inflation=InflationConfig(inscribed_radius=0.24))
    costmap = GlobalCostmap(config, ROBOT)
    before = costmap.set_map(SPEC, doorway(7)).copy()
    drive_through(costmap, to=35)  # as far as before the door
    costmap.update(Moment(SE2(2.0, 0.0, 0.0)))  # found again behind it
    assert not is_through(costmap.costs)
    np.testing.assert_array_equal(before == 254, costmap.costs == 254)
    assert (costmap.costs[:, 36:44] == before[:, 36:44]).all()
