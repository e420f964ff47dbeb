"""The terrain analysis on made ground, seen by a simulated Mid-360: what is ground, what is not, and that errors of the mount change nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import terrain_columns as columns
from ambler.kernels import terrain_edges
from ambler.kernels import terrain_ground as ground
from ambler.kernels import terrain_steps as steps
from ambler.perception.terrain import Ground, Terrain, TerrainAnalysis
from ambler.perception.terrain_config import TerrainConfig, wide
from ambler.robots.spatial_robots import go2, mecanum
from ambler.sim.solids import Shape, Solid
from ambler.studies.made_ground import LEVEL, Rover, along_x, half_plane, made, obstacles, ramp, slab

ROBOTS = {"mecanum": mecanum().model, "go2": go2().model}
FLOOR = slab(-20.0, 20.0, -20.0, 20.0)
FALSE_MOST = 0.001  # of the points of a flat floor


def config(robot: str = "mecanum") -> TerrainConfig:
    return TerrainConfig().for_robot(ROBOTS[robot])


def seen(robot: str, *solids: object, until: float = 4.5, **more: object) -> Terrain:
    rover = Rover(made(*solids, **more), ROBOTS[robot], 1)  # type: ignore[arg-type]
    return rover.feed(TerrainAnalysis(config(robot)), along_x(0.0, until))


def within(terrain: Terrain, x0: float, x1: float, y: float = 2.0) -> np.ndarray:
    """Return the obstacle points between two lines across the way."""
    found = obstacles(terrain, config().step)
    return found[(found[:, 0] > x0) & (found[:, 0] < x1) & (np.abs(found[:, 1]) < y)]


def widest_gap(points: np.ndarray, y: float = 1.9) -> float:
    """Return the widest opening across the way from -y to y that the voxels of points leave, metres."""
    at = np.sort(np.concatenate([points[:, 1], [-y, y]]))
    return float(np.diff(at).max()) - config().voxel


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("roll", [-3.0, 3.0])
@pytest.mark.parametrize("pitch", [-3.0, 3.0])
@pytest.mark.parametrize("height", [-0.05, 0.05])
def test_a_flat_floor_has_no_obstacles_whatever_the_mount_is_off_by(
    robot: str, roll: float, pitch: float, height: float
) -> None:
    error = SE3.from_rpy((0.0, 0.0, height), math.radians(roll), math.radians(pitch), 0.0)
    for is_odom_tilted in (False, True):
        rover = Rover(made(FLOOR), ROBOTS[robot], 2, error, tilts_odom=is_odom_tilted)
        terrain = rover.feed(TerrainAnalysis(config(robot)), along_x(0.0, 2.4))
        assert len(terrain.points) > 1000
        assert len(obstacles(terrain, config().step)) <= FALSE_MOST * len(terrain.points)


@pytest.mark.parametrize(("robot", "depth"), [("mecanum", 0.08), ("mecanum", 0.3), ("mecanum", 0.99), ("go2", 0.1)])
def test_a_drop_is_seen_before_the_robot_is_near(robot: str, depth: float) -> None:
    solids = (slab(-20.0, 8.0), slab(8.0, 20.0, top=-depth)) if depth < LEVEL - 0.02 else (slab(-20.0, 8.0),)
    edge = within(seen(robot, *solids, until=6.4), 7.7, 8.9)
    assert widest_gap(edge) < 2.0 * ROBOTS[robot].inscribed_radius


def test_a_drop_is_seen_by_who_sees_little_floor_before_it() -> None:
    """A level LiDAR sees no floor within 5 m; with the edge 7 m away where it starts, less than a metre of sparse floor is all that it ever sees before it."""
    error = SE3.from_rpy((0.0, 0.0, -0.02), math.radians(-2.5), math.radians(-1.2), 0.0)
    gaps = []
    for seed in (1, 2, 3):
        beyond = half_plane(7.0, -0.36, -0.11, is_beyond=True)
        rover = Rover(made(half_plane(7.0, -0.36, 0.0, is_beyond=False), beyond), ROBOTS["mecanum"], seed, error)
        terrain = rover.feed(TerrainAnalysis(replace(config(), columns=144)), along_x(0.0, 5.0))
        gaps.append(widest_gap(within(terrain, 5.8, 8.4, 0.6), 0.5))
    assert max(gaps) < 0.4


def test_a_window_holds_the_floor_that_a_robot_sees() -> None:
    model = ROBOTS["mecanum"]
    assert 0.5 * config().size >= model.clouds[0].sees_floor_from + 4.0
    assert config("go2").columns == TerrainConfig().columns
    assert replace(TerrainConfig(), columns=240).for_robot(model).columns == 240


def marked(
    classes: NDArray[np.uint8], excess: NDArray[np.float32], rolled: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return classes and excess after the edges were marked in a window that begins at column and row `rolled`."""
    x, y = rolled
    kept, given = (np.roll(cells, (y, x), (0, 1)) for cells in (classes, excess))
    terrain_edges.mark_edges(np.zeros_like(kept), 6, given, 0.08, np.array([2 * x, 2 * y]), kept)
    return np.roll(kept, (-y, -x), (0, 1)), np.roll(given, (-y, -x), (0, 1))


def test_the_ends_of_a_window_are_not_beside_each_other() -> None:
    """Edges at its left and right end close no hole between them, however the arrays are rolled."""
    for rolled in ((0, 0), (10, 0), (17, 3)):
        classes, excess = np.full((20, 20), ground.GROUND, np.uint8), np.full((20, 20), 0.02, np.float32)
        classes[10, 2] = classes[10, 18] = ground.OBSTACLE
        told = classes.copy()
        classes, _ = marked(classes, excess, rolled)
        np.testing.assert_array_equal(classes, told)


@pytest.mark.parametrize("rolled", [(0, 0), (10, 3), (9, 10), (-29, -25)])
def test_a_hole_in_an_edge_is_closed_unless_level_ground_is_seen_in_it(rolled: tuple[int, int]) -> None:
    """An edge of a kerb along a row with a hole of five cells, seen too little (uneven) or as level ground, wherever in the rolled arrays it lies."""
    for is_level in (False, True):
        classes, excess = np.full((20, 20), ground.GROUND, np.uint8), np.zeros((20, 20), np.float32)
        classes[10, 3:8] = classes[10, 13:18] = ground.OBSTACLE
        excess[10, 3:18] = 0.02  # between a fifth and a third of a step: not level, not joined
        excess[10, 8:12] = 0.0 if is_level else 0.02
        classes, excess = marked(classes, excess, rolled)
        assert (classes[10, 8:13] == (ground.GROUND if is_level else ground.OBSTACLE)).all()
        assert (np.delete(classes, 10, axis=0) == ground.GROUND).all()
        assert (excess < 0.08).all()


def test_a_step_joins_what_is_uneven_beside_it_but_not_without_end() -> None:
    """Uneven ground is joined to a step three cells far. Judged again, what was joined is no step that joins more: a ramp of worn concrete would be shut from wall to wall."""
    m, made_of = 20, np.zeros(2, np.int64)
    uneven = np.zeros((m, m), np.float32)
    uneven[10, 2:18], uneven[10, 2] = 0.04, 0.12
    excess, classes = uneven.copy(), np.full((m, m), ground.GROUND, np.uint8)
    classes[10, 2] = ground.OBSTACLE
    classes, excess = marked(classes, excess, (0, 0))
    assert (classes[10, 2:6] == ground.OBSTACLE).all()
    assert (classes[10, 6:] == ground.GROUND).all()
    assert (excess == uneven).all()
    told, kinds = np.empty((m * m, 4), np.float32), np.empty(m * m, np.uint8)
    nothing, level = np.zeros((m, m), np.int32), np.zeros((m, m), np.float32)
    voxels, mask = np.zeros((2 * m, 2 * m, columns.BINS, 4), np.float32), np.zeros((2 * m, 2 * m), np.uint32)
    of_ground = (level, np.ones((m, m), np.uint8), nothing, np.zeros((2, m, m), np.float32), excess, level, classes)
    limits = np.array([0.08, 0.8, 0.0, 0.1, 0.075])
    count = ground.gather(*of_ground, made_of, 0.1, limits, voxels, mask, told, kinds)
    assert (
        (told[:count, 3] > 0.08) == (kinds[:count] == ground.OBSTACLE)
    ).all()  # yet it is told as what cannot be crossed


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_kerb_is_an_obstacle_and_what_lies_behind_it_is_ground(robot: str) -> None:
    terrain = seen(robot, FLOOR, slab(8.0, 20.0, top=0.12), until=6.4)
    assert widest_gap(within(terrain, 7.7, 8.5)) < 2.0 * ROBOTS[robot].inscribed_radius
    assert len(within(terrain, 9.0, 12.0)) <= 2  # of some 500 points, seen from afar


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_slope_of_15_degrees_is_ground_and_one_of_28_is_not(robot: str) -> None:
    for angle, is_free in ((15.0, True), (28.0, False)):
        mesh, top = ramp(6.0, 8.0, math.radians(angle))
        terrain = seen(robot, FLOOR, top, meshes=(mesh,), until=5.0)
        blocked = within(terrain, 5.8, 10.0, 3.0)
        assert len(blocked) == 0 if is_free else len(blocked) > 100


def test_ceilings_and_upper_floors_are_left_out() -> None:
    upper = slab(2.0, 8.0, -6.0, 6.0, top=2.7, bottom=2.5)
    terrain = seen("mecanum", FLOOR, upper, ceiling=LEVEL + 3.6, until=3.0)
    assert float(terrain.points[:, 2].max()) < 0.2
    assert len(obstacles(terrain, config().step)) <= 2


def test_what_hangs_lower_than_the_robot_is_an_obstacle_and_what_hangs_higher_is_not() -> None:
    for bottom, is_obstacle in ((0.5, True), (0.85, False)):
        board = slab(6.0, 6.4, -1.0, 1.0, top=bottom + 0.06, bottom=bottom)
        terrain = seen("mecanum", FLOOR, board)
        assert (len(within(terrain, 5.8, 6.6)) > 10) is is_obstacle


def test_the_floor_below_a_table_stays_ground() -> None:
    terrain = seen("mecanum", FLOOR, slab(8.0, 9.0, -0.5, 0.5, top=0.6, bottom=0.55), until=3.0)
    heights = terrain.heights[terrain.spec.cell_of(8.5, 0.0)]
    assert abs(float(heights)) < 0.05


def test_who_walks_away_is_forgotten() -> None:
    room = (FLOOR, slab(6.0, 6.3, -6.0, 6.0, top=2.0), slab(-6.3, -6.0, -6.0, 6.0, top=2.0))
    person = slab(3.0, 3.5, -0.25, 0.25, top=1.7)
    analysis, here = TerrainAnalysis(config()), [(0.0, 0.0, 0.0, 0.0)]
    there = Rover(made(*room, person), ROBOTS["mecanum"], 3).feed(analysis, here * 10)
    assert len(within(there, 2.8, 3.7, 0.5)) > 10
    later = Rover(made(*room), ROBOTS["mecanum"], 3)
    later._count = 10
    gone = later.feed(analysis, here * 25)
    assert len(within(gone, 2.8, 3.7, 0.5)) == 0
    assert len(within(gone, 5.8, 6.4)) > 100


def stairs() -> tuple[object, ...]:
    steps = [slab(6.0 + 0.3 * k, 6.3 + 0.3 * k, -2.0, 2.0, top=0.17 * (k + 1)) for k in range(8)]
    return (FLOOR, *steps, slab(8.4, 12.0, -2.0, 2.0, top=0.17 * 8))


def test_stairs_are_recognized_and_crossed_only_by_who_climbs() -> None:
    terrain = seen("go2", *stairs(), until=4.8)
    is_stairs = terrain.classes == Ground.STAIRS
    places = terrain.spec.centers_of(np.argwhere(is_stairs))
    assert len(places) >= 8
    assert ((places[:, 0] > 5.7) & (places[:, 0] < 8.8)).all()
    assert widest_gap(within(terrain, 5.7, 8.4)) < 0.45
    mesh, top = ramp(6.0, 4.0, math.radians(28.0))
    assert (seen("go2", FLOOR, top, meshes=(mesh,), until=4.8).classes == Ground.STAIRS).sum() < 10


def test_moving_the_world_by_whole_cells_moves_the_terrain_with_it() -> None:
    rover = Rover(made(FLOOR, slab(5.0, 6.0, 1.0, 2.0, top=0.5)), ROBOTS["mecanum"], 4)
    scans = [rover.scan(SE3((x, 0.07, LEVEL))) for x in np.arange(0.05, 1.0, 0.1).tolist()]
    terrains = []
    for shift in (0.0, 51.2, -76.8):
        analysis, by = TerrainAnalysis(config()), SE3((shift, -shift, 0.0))
        for points, stamp_ns, base, sensor in scans:
            moved = np.asarray(by.transform(points.astype(np.float64)), np.float32)
            analysis.update(moved, stamp_ns, by @ base, by @ sensor, rover.elevation)
        terrains.append(analysis.terrain())
    for other in terrains[1:]:
        assert np.mean(other.classes != terrains[0].classes) < 0.01  # points at the edge of a voxel fall to either side


def test_what_lies_behind_is_forgotten_with_the_window() -> None:
    rover = Rover(made(FLOOR, slab(3.0, 3.5, 1.0, 1.5, top=0.5)), ROBOTS["mecanum"], 5)
    analysis = TerrainAnalysis(config())
    first = rover.feed(analysis, along_x(0.0, 1.0))
    assert len(within(first, 2.8, 3.7)) > 0
    far = rover.feed(analysis, [(40.0, 0.0, 0.0, 0.0)] * 3)
    assert far.spec.origin_x == pytest.approx(40.0 - 0.5 * config().size, abs=0.2)
    assert len(obstacles(far, config().step)) == 0


@pytest.mark.parametrize("x", [0.0, 37.3])
def test_what_shall_be_forgotten_is_and_nothing_else(x: float) -> None:
    near, far = slab(x + 2.6, x + 3.0, 0.5, 1.0, top=0.5), slab(x + 4.4, x + 4.8, -1.0, -0.5, top=0.5)
    rover, analysis = Rover(made(slab(-5.0, 60.0), near, far), ROBOTS["mecanum"], 6), TerrainAnalysis(config())
    before = rover.feed(analysis, [(x + 0.05 * k, 0.0, 0.0, 0.0) for k in range(12)])
    analysis.forget(x + 2.8, 0.75, 0.9)
    after = analysis.terrain()
    for terrain, is_there in ((before, True), (after, False)):
        assert (len(within(terrain, x + 2.4, x + 3.2)) > 0) == is_there
        assert len(within(terrain, x + 4.2, x + 5.0)) > 0
    is_near = np.hypot(*(before.spec.centers_of(np.argwhere(np.isfinite(before.heights))) - (x + 2.8, 0.75)).T) < 0.7
    assert is_near.any()
    kept = after.spec.centers_of(np.argwhere(np.isfinite(after.heights)))
    assert not (np.hypot(*(kept - (x + 2.8, 0.75)).T) < 0.7).any()
    assert len(kept) > 0.8 * np.isfinite(before.heights).sum()


def test_same_clouds_give_the_same_terrain() -> None:
    first, second = (seen("mecanum", FLOOR, slab(5.0, 6.0, 1.0, 2.0, top=0.5), until=1.0) for _ in range(2))
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.classes, second.classes)


def test_a_wide_window_reaches_as_far_again() -> None:
    rover = Rover(made(FLOOR, slab(11.0, 12.0, -1.0, 1.0, top=0.6)), ROBOTS["mecanum"], 6)
    terrain = rover.feed(TerrainAnalysis(wide(config())), along_x(0.0, 1.6))
    assert terrain.spec.resolution * terrain.spec.width == pytest.approx(40.0)
    assert len(within(terrain, 10.8, 12.2)) > 0


def test_bad_input_is_named() -> None:
    analysis = TerrainAnalysis(config())
    with pytest.raises(BadInputError, match="shape"):
        analysis.update(np.zeros((4, 2), np.float32), 0, SE3(), SE3())
    with pytest.raises(BadInputError, match="even number"):
        TerrainConfig(columns=7)
    with pytest.raises(BadInputError, match="step"):
        TerrainConfig(step=0.0)


def test_the_image_holds_the_nearest_return_of_each_direction() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(-6.0, 6.0, (3000, 3)) * [1.0, 1.0, 0.2]
    image, origin = _image_of(points.astype(np.float32))
    slow = np.full_like(image, np.inf)
    for x, y, z in points.astype(np.float32).astype(np.float64) - origin:
        away = math.hypot(x, y)
        row = (z / away - columns.ROW_LOW) / columns.ROW
        share = abs(y) / (abs(x) + abs(y))
        quarter = (0 if x >= 0 else 1) if y >= 0 else (2 if x < 0 else 3)
        turned = quarter + (share if quarter in (0, 2) else 1.0 - share)
        column = min(columns.DIRECTIONS - 1, int(turned * columns.QUARTER))
        if row >= 0.0 and int(row) < columns.ROWS:
            slow[column, int(row)] = min(slow[column, int(row)], away)
    assert np.allclose(image[np.isfinite(image)], slow[np.isfinite(image)], rtol=1e-5)
    assert np.array_equal(np.isfinite(image), np.isfinite(slow))


def _image_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n = 16
    voxels, mask = np.zeros((columns.BINS, n, n, 4), np.float32), np.zeros((n, n), np.uint32)
    newest = np.full((n, n), -1e9, np.float32)
    ground, touched = np.full((n // 2, n // 2), np.nan, np.float32), np.zeros((n // 2, n // 2), np.uint8)
    image, origin = np.empty((columns.DIRECTIONS, columns.ROWS, 2), np.float32), np.array([0.1, -0.2, 0.3])
    limits = np.array([50.0, 0.1, 50.0, 0.1, 0.1])
    store = (np.zeros(2, np.int64), 0.1, ground, voxels, mask, newest, image, touched)
    columns.insert(points, origin, np.zeros(3), 0.0, limits, *store)
    return image[:, :, 0], origin


def test_a_cell_has_a_low_and_a_high_that_few_returns_do_not_decide() -> None:
    rng = np.random.default_rng(8)
    for _ in range(200):
        count = int(rng.integers(1, 10))
        heights, counts = rng.uniform(0.0, 0.5, count), rng.integers(1, 30, count).astype(np.float64)
        lift = 0.15
        sure = heights[counts >= 2.0]
        wanted = (math.nan, math.nan)
        if len(sure):
            kept = (heights >= sure.min()) & (heights <= sure.min() + lift)
            if counts[kept].sum() >= columns.RETURNS:
                returns = np.sort(np.repeat(heights[kept], counts[kept].astype(int)))
                total = len(returns)
                share = min(0.9, max(1.0 - columns.RETURNS / total, 0.25))
                wanted = tuple(float(returns[math.ceil(q * total - 1e-9) - 1]) for q in (0.25, share))
        low, high, _ = columns.low_and_high(heights.copy(), counts.copy(), count, lift)
        assert (low, high) == pytest.approx(wanted, nan_ok=True)


@pytest.mark.parametrize(("robot", "aside", "angle"), [("mecanum", 5.5, 0.3), ("mecanum", 6.2, 0.0), ("go2", 5.5, 0.0)])
def test_a_row_of_kerb_stones_is_seen_by_who_drives_past_it(robot: str, aside: float, angle: float) -> None:
    """Stones narrower than a cell, which hide the floor behind them and show little of themselves."""
    place = SE2(2.0, aside, angle)
    row = Solid("kerb", Shape.BOX, place, 12.0, 0.15, 0.0, LEVEL + 0.12)
    found = place.inverse().transform(obstacles(seen(robot, FLOOR, row, until=4.0), config().step)[:, :2].astype(float))
    along = np.arange(-5.5, 5.5, 0.2)
    robot_at = place.inverse().transform(np.array([[4.0, 0.0]]))[0]
    along = along[np.hypot(along - robot_at[0], robot_at[1]) < 6.5]
    on_row = found[np.abs(found[:, 1]) < 0.3, 0]
    closed = [bool((np.abs(on_row - at) < 0.2).any()) for at in along]
    assert len(closed) >= 20
    assert np.mean(closed) > 0.9


def test_a_ramp_is_no_flight_of_steps_to_who_drives_up_it() -> None:
    """A slope spreads the returns of a cell over its height, and far up a ramp they are few."""
    angle, robot = math.radians(12.0), "mecanum"
    length = 3.0 / math.tan(angle)
    mesh, top = ramp(6.0, length, angle, 4.0)
    walls = slab(0.0, 25.0, 2.0, 2.2, top=4.0), slab(0.0, 25.0, -2.2, -2.0, top=4.0)
    rover, analysis = Rover(made(FLOOR, top, *walls, meshes=(mesh,)), ROBOTS[robot], 1), TerrainAnalysis(config(robot))
    steps = cells = 0
    for k, x in enumerate(np.arange(0.0, 14.0, 0.1).tolist()):
        pitch = -angle if x > 6.0 else 0.0
        pose = SE3.from_rpy((x, 0.0, LEVEL + max(0.0, x - 6.0) * math.tan(angle)), 0.0, pitch, 0.0)
        points, stamp_ns, base, sensor = rover.scan(pose)
        analysis.update(points, stamp_ns, base, sensor)
        if k % 10 == 9:
            terrain = analysis.terrain()
            of_way = (np.abs(terrain.points[:, 1]) < 1.6) & (terrain.points[:, 0] > 5.0) & (terrain.kinds > 0)
            cells += int(of_way.sum())
            steps += int((of_way & (terrain.kinds == Ground.OBSTACLE)).sum())
    assert cells > 5000
    assert steps < 0.015 * cells


@pytest.mark.parametrize("robot", ROBOTS)
def test_ground_may_level_off_behind_a_crest(robot: str) -> None:
    """The deck at the end of a ramp is no drop, though it lies lower than the ramp would go on."""
    angle = math.radians(12.0)
    mesh, top = ramp(6.0, 8.0, angle)
    rover, analysis = Rover(made(FLOOR, top, meshes=(mesh,)), ROBOTS[robot], 1), TerrainAnalysis(config(robot))
    for x in np.arange(2.0, 12.5, 0.05).tolist():
        climbed = max(0.0, x - 6.0) * math.tan(angle)
        pose = SE3.from_rpy((x, 0.0, LEVEL + climbed), 0.0, -angle if x > 6.0 else 0.0, 0.0)
        points, stamp_ns, base, sensor = rover.scan(pose)
        analysis.update(points, stamp_ns, base, sensor)
    terrain = analysis.terrain()
    drops = terrain.points[terrain.kinds == Ground.DROP]
    assert len(terrain.points) > 1000
    assert len(drops[np.abs(drops[:, 1]) < 1.5]) == 0


def hidden_ramp(*, remembers: bool, height: float = 0.0) -> Terrain:
    """Look from a deck at a ramp that falls away behind its edge, as a level LiDAR cannot see it."""
    rover = Rover(made(slab(-20.0, 9.0)), ROBOTS["mecanum"], 1)
    analysis = TerrainAnalysis(config())
    for k in range(140):
        points, stamp_ns, base, sensor = rover.scan(SE3((0.05 * k, 0.0, LEVEL)))
        if remembers:
            x, y = (a.ravel() for a in np.meshgrid(np.arange(0.1, 13.0, 0.1), np.arange(-1.5, 1.5, 0.1)))
            z = np.where(x > 9.0, -0.16 * (x - 9.0), 0.0) + height
            analysis.remember(np.column_stack((x, y, z)).astype(np.float32))
        analysis.update(points, stamp_ns, base, sensor)
    return analysis.terrain()


def test_a_ramp_that_was_driven_is_ground_where_it_cannot_be_seen() -> None:
    blind, knowing = hidden_ramp(remembers=False), hidden_ramp(remembers=True)
    assert len(within(blind, 8.8, 11.0, 1.2)) > 5, "for who has not been there it is a drop"
    assert len(within(knowing, 8.8, 11.0, 1.2)) == 0
    spot = knowing.spec.cell_of(10.5, 0.0)
    assert knowing.classes[spot] == Ground.GROUND
    assert knowing.heights[spot] == pytest.approx(-0.16 * 1.5, abs=0.05)


@pytest.mark.parametrize(("robot", "beyond"), [("mecanum", -9.0), ("go2", -9.0), ("go2", -0.25)])
def test_ground_of_two_visits_between_which_odometry_drifted_has_no_steps(robot: str, beyond: float) -> None:
    """Squares of floor are remembered 9 cm higher than those beside them, as a robot finds its own floor again: no edge of a square is in its way, a deck's edge is,
    however high above what lies `beyond` it."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-8.15, 3.0, 0.1), np.arange(-8.15, 8.1, 0.1)))
    z = np.where((np.floor(x / 0.8) + np.floor(y / 1.2)) % 2.0 == 0.0, 0.045, -0.045)
    world = made(slab(-20.0, 3.0), *([slab(3.0, 20.0, top=beyond)] if beyond > -1.0 else []))
    rover, analysis = Rover(world, ROBOTS[robot], 4), TerrainAnalysis(config(robot))
    for _ in range(12):
        points, stamp_ns, base, sensor = rover.scan(SE3((0.0, 0.0, LEVEL)))
        analysis.remember(np.column_stack((x, y, z)).astype(np.float32))
        analysis.update(points, stamp_ns, base, sensor)
    terrain = analysis.terrain()
    remembered = np.abs(np.abs(terrain.heights[terrain.classes == Ground.GROUND]) - 0.045) < 1e-6
    assert remembered.sum() > 1000
    assert len(within(terrain, -8.0, 2.7, 8.0)) == 0
    assert widest_gap(within(terrain, 2.7, 3.9)) < 2.0 * ROBOTS[robot].inscribed_radius


def test_firm_ground_does_not_stand_as_high_as_what_was_seen_there_before() -> None:
    """A thing that was seen where the robot is told firm ground later leaves nothing of itself."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(2.1, 4.0, 0.1), np.arange(-1.5, 1.5, 0.1)))
    firm = np.column_stack((x, y, np.zeros(len(x)))).astype(np.float32)
    analysis = TerrainAnalysis(config())
    thing = Rover(made(FLOOR, slab(2.0, 4.0, -1.0, 1.0, top=0.3)), ROBOTS["mecanum"], 4)
    before = thing.feed(analysis, [(-3.0, 0.0, 0.0, 0.0)] * 10)
    assert len(within(before, 1.9, 4.1, 1.2)) > 20
    analysis.forget(3.0, 0.0, 2.0)
    gone = Rover(made(FLOOR), ROBOTS["mecanum"], 4)
    gone._count = 10
    for _ in range(10):
        points, stamp_ns, base, sensor = gone.scan(SE3((0.0, 0.0, LEVEL)))
        analysis.remember(firm)
        analysis.update(points, stamp_ns, base, sensor)
    terrain = analysis.terrain()
    assert len(within(terrain, 1.9, 4.1, 1.2)) == 0
    assert terrain.classes[terrain.spec.cell_of(3.0, 0.0)] == Ground.GROUND


def test_firm_ground_far_below_is_not_joined() -> None:
    below = hidden_ramp(remembers=True, height=-2.0)
    assert len(within(below, 8.8, 11.0, 1.2)) > 5


def test_remembered_ground_far_below_may_lie_under_a_deck() -> None:
    """Ground that falls and is known, but not seen: down to what may lie under a deck it is ground."""
    rover, analysis = Rover(made(slab(-20.0, 2.6, -20.0, 20.0)), ROBOTS["go2"], 4), TerrainAnalysis(config("go2"))
    x, y = (a.ravel() for a in np.meshgrid(np.arange(2.5, 7.2, 0.1), np.arange(-1.5, 1.5, 0.1)))
    for _ in range(6):
        points, stamp_ns, base, sensor = rover.scan(SE3((0.0, 0.0, LEVEL)))
        analysis.remember(np.column_stack((x, y, -0.35 * (x - 2.5))).astype(np.float32))
        analysis.update(points, stamp_ns, base, sensor)
    terrain = analysis.terrain()
    assert terrain.classes[terrain.spec.cell_of(5.0, 0.1)] == Ground.GROUND
    assert terrain.classes[terrain.spec.cell_of(6.8, 0.1)] == Ground.UNKNOWN


def test_ground_that_was_remembered_gives_way_to_what_is_seen() -> None:
    """Firm ground stands for cells of few returns as long as it is told; without it they have their own low again."""
    rover, analysis = Rover(made(FLOOR), ROBOTS["mecanum"], 4), TerrainAnalysis(config())
    told = SE3((0.0, 0.0, LEVEL))
    for _ in range(4):
        points, stamp_ns, base, sensor = rover.scan(told)
        analysis.update(points, stamp_ns, base, sensor)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-9.1, 9.1, 0.2), np.arange(-9.1, 9.1, 0.2)))
    analysis.remember(np.column_stack((x, y, np.full(len(x), 0.06))).astype(np.float32))
    heights = []
    nothing = np.zeros((0, 3), np.float32)
    for _ in range(2):
        analysis.update(nothing, stamp_ns, base, sensor)
        heights.append(analysis.terrain().heights)
        analysis.remember(nothing)
    is_raised = heights[0] > 0.05
    assert is_raised.sum() > 300
    seen_again = heights[1][is_raised & (np.isfinite(analysis._lows[_rolled(analysis)]))]
    assert len(seen_again) > 100
    assert np.quantile(np.abs(seen_again), 0.98) < 0.05  # what was told, 0.06, would be in all of them


def _rolled(analysis: TerrainAnalysis) -> tuple[np.ndarray, np.ndarray]:
    """Return the index that lays an array of the window's cells as its terrain lies."""
    m = analysis.config.columns // 2
    cx, cy = (analysis._first // 2).tolist()
    return np.ix_((cy + np.arange(m)) % m, (cx + np.arange(m)) % m)


def test_a_step_stays_one_until_something_comes_or_goes_there() -> None:
    m = 20
    heights = np.zeros((m, m), np.float32)
    many, seen_all = np.full((m, m), 50.0, np.float32), np.ones((m, m), np.uint8)
    sure, slopes = np.empty((m + 8, m + 8), np.float32), np.zeros((2, m, m), np.float32)
    for is_changed in (False, True):
        excess, classes = np.zeros((m, m), np.float32), np.zeros((m, m), np.uint8)
        excess[10, 6:14] = 0.12  # what was judged when it was seen; by now the floor alone is left
        changed = np.full((m, m), is_changed, np.uint8)
        known = (heights.copy(), seen_all, heights, heights, many, changed)
        steps.judge_ground(*known, np.zeros(2, np.int64), 0.1, 0.08, 0.4, sure, slopes, excess, classes)
        assert (classes[10, 6:14] == (ground.GROUND if is_changed else ground.OBSTACLE)).all()
        assert (np.delete(classes, 10, axis=0) == ground.GROUND).all()


@pytest.mark.parametrize("seen_of_it", [3, 4, 5, 8])
def test_the_rim_of_a_slope_is_no_step(seen_of_it: int) -> None:
    """Of a ramp of 15° that a robot begins to see, a few cells are known in a row: over three of them it rises by 16 cm."""
    m = 20
    heights = np.tile((0.2 * math.tan(math.radians(15.0)) * np.arange(m)).astype(np.float32), (m, 1))
    is_seen = np.zeros((m, m), np.uint8)
    is_seen[:, 6 : 6 + seen_of_it] = 1
    sure, slopes = np.empty((m + 8, m + 8), np.float32), np.zeros((2, m, m), np.float32)
    excess, classes = np.zeros((m, m), np.float32), np.zeros((m, m), np.uint8)
    many, nothing = np.full((m, m), 50.0, np.float32), np.zeros((m, m), np.uint8)
    for across in (heights, heights.T.copy()):
        known = (across, is_seen if across is heights else is_seen.T.copy(), across, across, many, nothing)
        steps.judge_ground(*known, np.zeros(2, np.int64), 0.1, 0.08, 0.4, sure, slopes, excess, classes)
        assert not (classes == ground.OBSTACLE).any()


@pytest.mark.parametrize("angle", [11.0, 15.0])
@pytest.mark.parametrize(("share_seen", "least"), [(0.35, 30), (0.5, 80)])
def test_a_slope_that_is_seen_with_holes_is_no_row_of_steps_and_a_kerb_on_it_is(
    angle: float, share_seen: float, least: int
) -> None:
    """Close to a LiDAR that looks over the ground half of the cells are known, and three cells of a slope are as high as a step."""
    m, rng = 40, np.random.default_rng(5)
    iy, ix = np.mgrid[0:m, 0:m]
    sure, slopes = np.empty((m + 8, m + 8), np.float32), np.zeros((2, m, m), np.float32)
    many, nothing = np.full((m, m), 50.0, np.float32), np.zeros((m, m), np.uint8)
    false, found = 0, 0
    for toward in np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False):
        slope = 0.2 * math.tan(math.radians(angle)) * (ix * math.cos(toward) + iy * math.sin(toward))
        is_seen = (rng.random((m, m)) < share_seen).astype(np.uint8)
        for kerb in (0.0, 0.16):
            heights = (slope + 0.005 * rng.standard_normal((m, m)) + kerb * (ix >= 20)).astype(np.float32)
            excess, classes = np.zeros((m, m), np.float32), np.zeros((m, m), np.uint8)
            known = (heights, is_seen, heights, heights, many, nothing)
            steps.judge_ground(*known, np.zeros(2, np.int64), 0.1, 0.08, 0.4, sure, slopes, excess, classes)
            if kerb:
                found += np.count_nonzero(classes[:, 19:22] == ground.OBSTACLE)
            else:
                false += np.count_nonzero(classes == ground.OBSTACLE)
    assert false <= 4, "of 16 times 560 or 800 cells"
    assert found > least


@pytest.mark.parametrize(("left", "is_step"), [(0.06, True), (0.02, False)])
def test_a_step_of_which_half_is_seen_stays_one_and_does_not_become_one(left: float, *, is_step: bool) -> None:
    """Few returns tell of a kerb's end, and fewer from near: it had been ground one second and a step the next, and ground when the robot reached it."""
    m = 20
    heights = np.zeros((m, m), np.float32)
    heights[10, 6:14] = left
    many, everywhere = np.full((m, m), 50.0, np.float32), np.ones((m, m), np.uint8)
    sure, slopes = np.empty((m + 8, m + 8), np.float32), np.zeros((2, m, m), np.float32)
    for before in (0.12, 0.0):
        excess, classes = np.zeros((m, m), np.float32), np.zeros((m, m), np.uint8)
        excess[10, 6:14] = before
        known = (heights.copy(), everywhere, heights, heights, many, everywhere)
        for _ in range(3):
            steps.judge_ground(*known, np.zeros(2, np.int64), 0.1, 0.08, 0.4, sure, slopes, excess, classes)
        assert (classes[10, 7:13] == (ground.OBSTACLE if is_step and before else ground.GROUND)).all()
        assert (np.delete(classes, 10, axis=0) == ground.GROUND).all()


@pytest.mark.parametrize("tenths", [1, 3, 7, 13, 36001])
def test_what_is_seen_now_is_not_older_than_now(tenths: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns hold times in single precision, which may lie before the stamp: such returns would count as looked through."""
    analysis, renew, older = TerrainAnalysis(config()), columns.renew, []

    def spied(*args: object) -> None:
        seen = analysis._voxels[analysis._voxels[..., columns.COUNT] > 0.0, columns.SEEN]
        older.append(int((seen.astype(np.float64) < args[3]).sum()))
        renew(*args)

    monkeypatch.setattr(columns, "renew", spied)
    points = np.array([[2.0, 0.1 * k, 0.05] for k in range(20)], np.float32)
    for stamp_ns in (0, tenths * 100_000_000):
        analysis.update(points, stamp_ns, SE3(), SE3((0.0, 0.0, 0.5)))
    assert older == [0, 0]


def test_a_low_thing_is_forgotten_slowly_unless_what_stood_on_it_has_left() -> None:
    """A voxel 12 cm over the ground whose column is seen again and again without it: alone, and below one at 1 m, of whom the foot was seen a
    little longer than the rest."""
    for stood in (False, True):
        left_after = _seconds_until_left(stood)
        assert 4.4 < left_after < 6.0 if not stood else left_after < 2.5


def _seconds_until_left(stood: bool) -> float:
    """Return after how many seconds of being overlooked a low voxel is forgotten."""
    n = 8
    voxels, mask = np.zeros((columns.BINS, n, n, 4), np.float32), np.zeros((n, n), np.uint32)
    newest, ground_z = np.full((n, n), -1e9, np.float32), np.zeros((n // 2, n // 2), np.float32)
    image, touched = (
        np.full((columns.DIRECTIONS, columns.ROWS, 2), np.inf, np.float32),
        np.zeros((n // 2, n // 2), np.uint8),
    )
    for z in (0.12, 1.0) if stood else (0.12,):
        b = int(z / 0.1) & (columns.BINS - 1)
        mask[4, 4] |= np.uint32(1) << np.uint32(b)
        voxels[b, 4, 4] = z, 0.5 if z < 0.3 else 0.0, 5.0, 0.0
    lows, highs, returns = np.zeros((3, n // 2, n // 2), np.float32)
    origin, up, elevations = np.array([-9.0, 0.0, 0.6]), np.array([0.0, 0.0, 1.0]), np.array([-1.0, 1.0])
    for k in range(1, 100):
        newest[4, 4] = 0.1 * k
        touched[2, 2] = 1
        store = (np.zeros(2, np.int64), 0.1, ground_z, voxels, mask, newest, image, touched)
        told = (lows, highs, returns, touched.copy())
        columns.renew(origin, up, elevations, 0.1 * k, 1.5, 0.25, 2.0, 5, *store, *told)
        if mask[4, 4] == 0:
            return 0.1 * k
    return math.inf
