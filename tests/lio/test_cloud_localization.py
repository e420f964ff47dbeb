"""A place in a saved cloud: found from a guess and from nothing, followed, refused where two look alike or where it is another place."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import cloud_search
from ambler.kernels.cloud_search import FLAT, WALL
from ambler.lio.cloud_localizer import CloudLocalizer, CloudPose, CloudTracker
from ambler.lio.cloud_map import CloudMap, Image
from ambler.lio.cloud_match import CloudMatch, apart, between, compared, judge, turned
from ambler.lio.cloud_relocalizer import CloudRelocalizer, CloudState
from ambler.lio.config import CloudLocalizerConfig, LioConfig
from ambler.lio.health import LioResult
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.offline import run_offline
from ambler.lio.sight import LocalCloud, Sight
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import HandRig
from ambler.sim.site import draw_hall
from ambler.sim.solids import Solid, WorldSpec
from ambler.wire.cloud_files import write_cloud
from tests.lio.carried import SMALL, scans_of, walk

CONFIG = CloudLocalizerConfig()


@functools.cache
def saved() -> CloudMap:
    """The cloud of the walk, and its frame: the walk's own start, level."""
    rig, scans = walk()
    return CloudMap(run_offline(scans_of(scans), LioConfig(), rig.told_mount).cloud)


@functools.cache
def map_from_world() -> SE3:
    _, scans = walk()
    rig, _ = walk()
    result = run_offline(scans_of(scans), LioConfig(), rig.told_mount)
    first = next(s for s in scans if s.end_ns == int(result.stamps_ns[0]))
    return result.poses[0] @ first.world_from_imu.inverse()


@functools.cache
def other_day(world: WorldSpec | None = None) -> tuple[tuple[LioResult, SE3], ...]:
    """Results of another walk the other way round with other noise, beginning elsewhere, and the true poses in the map."""
    site = draw_hall(3, 25.0)
    way = np.roll(site.way[::-1], 9, axis=0)[:10] + np.array([0.2, -0.15, 0.1])
    rig = HandRig(world or site.world, HandPath(way, rest=1.5, is_closed=False), SMALL, 41)
    odometry = LidarInertialOdometry(LioConfig(), rig.told_mount)
    out = []
    for scan, given in ((s, scans_of((s,))[0]) for s in rig.scans()):
        result = odometry.update(given)
        if result is not None:
            out.append((result, map_from_world() @ scan.world_from_imu))
    return tuple(out)


def followed(localizer: CloudLocalizer, results: tuple[tuple[LioResult, SE3], ...]) -> list[tuple[CloudPose, SE3]]:
    return [(localizer.update(result), truth) for result, truth in results]


@pytest.mark.parametrize(("way", "turn"), [((1.6, -1.1, 0.3), 28.0), ((-1.9, 0.4, -0.4), -29.0)])
def test_a_guess_within_two_metres_and_thirty_degrees_is_enough(way: tuple[float, float, float], turn: float) -> None:
    results = other_day()
    truth = results[0][1]
    x, y, z = np.add(truth.translation, way).tolist()
    guess = SE3((x, y, z), truth.rotation) @ SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, math.radians(turn))
    told = followed(CloudLocalizer(saved(), CONFIG, guess), results[:12])
    states = [pose.state for pose, _ in told]
    assert CloudState.FOUND in states[:10]
    pose, true = told[-1]
    assert pose.map_from_imu is not None
    off, angle = apart(true, pose.map_from_imu)
    assert off < 0.05
    assert math.degrees(angle) < 0.5


def test_without_a_guess_a_second_viewpoint_confirms_and_tracking_stays() -> None:
    results = other_day()
    told = followed(CloudLocalizer(saved(), CONFIG), results)
    found = next(k for k, (pose, _) in enumerate(told) if pose.state is CloudState.FOUND)
    assert all(pose.map_from_imu is None for pose, _ in told[:found])
    moved, _ = apart(results[0][0].map_from_imu, results[found][0].map_from_imu)
    assert moved > 1.0  # not from where it stood at first
    assert 1e-9 * (results[found][0].stamp_ns - results[0][0].stamp_ns) < 8.0
    errors = [apart(true, pose.map_from_imu)[0] for pose, true in told[found:] if pose.map_from_imu is not None]
    assert len(errors) == len(told) - found
    assert max(errors) < 0.06
    shown = [pose.map_from_imu.translation for pose, _ in told[found:] if pose.map_from_imu is not None]
    assert np.linalg.norm(np.diff(shown, axis=0), axis=1).max() < 0.25  # smooth: no step larger than a walk's


def test_another_hall_is_refused() -> None:
    site = draw_hall(8, 25.0)
    rig = HandRig(site.world, HandPath(site.way), SMALL, 5)
    odometry = LidarInertialOdometry(LioConfig(), rig.told_mount)
    localizer = CloudLocalizer(saved(), CONFIG)
    for given in scans_of(tuple(s for s, _ in zip(rig.scans(), range(110), strict=False))):
        result = odometry.update(given)
        if result is not None:
            assert localizer.update(result).map_from_imu is None


def test_a_hall_that_looks_alike_from_both_sides_is_ambiguous() -> None:
    world, way = twofold()
    rig = HandRig(world, HandPath(way, is_closed=False, rest=1.5), SMALL, 6)
    result = run_offline(scans_of(tuple(rig.scans())), LioConfig(), rig.told_mount)
    both = np.vstack([result.cloud, half_turned(result, rig)])
    localizer = CloudLocalizer(CloudMap(both), CONFIG)
    again = HandRig(world, HandPath(way, is_closed=False, rest=1.5), SMALL, 7)
    odometry = LidarInertialOdometry(LioConfig(), again.told_mount)
    states = set()
    for given in scans_of(tuple(again.scans())):
        made = odometry.update(given)
        if made is not None:
            states.add(localizer.update(made).state)
    assert CloudState.AMBIGUOUS in states
    assert CloudState.FOUND not in states


def twofold() -> tuple[WorldSpec, np.ndarray]:
    """A hall that looks the same turned by half a turn about its middle."""
    rng = np.random.default_rng(4)
    box = draw_hall(3, 25.0).world.solids[0]

    def make(x: float, y: float, yaw: float, sx: float, sy: float, high: float) -> list[Solid]:
        ahead = replace(box, world_from_solid=SE2(x, y, yaw), size_x=sx, size_y=sy, z_min=0.0, z_max=high)
        return [ahead, replace(ahead, world_from_solid=SE2(-x, -y, yaw))]

    solids = [*make(0.0, 8.0, 0.0, 30.0, 0.3, 4.0), *make(15.0, 0.0, 0.0, 0.3, 16.0, 4.0)]
    for _ in range(8):
        x, y = rng.uniform([-13.0, 2.5], [13.0, 7.0])
        solids += make(float(x), float(y), float(rng.uniform(0.0, 3.0)), 1.5, 0.8, float(rng.uniform(1.0, 3.0)))
    way = np.array([[x, 0.0, 1.2] for x in np.linspace(-9.0, 9.0, 10)])
    return WorldSpec("twofold", tuple(solids), SE2(), ceiling=4.0), way


def half_turned(result: object, rig: HandRig) -> np.ndarray:
    """The cloud of a walk (frame: its start, heading along x at x = -9) as seen after half a turn about the hall's middle."""
    cloud = result.cloud.astype(np.float64)  # type: ignore[attr-defined]
    start = rig.path.pose(0.0)
    world = start.transform(cloud) * [-1.0, -1.0, 1.0]
    return np.asarray(start.inverse().transform(world), np.float32)


def test_a_lost_place_is_given_up_and_looked_for_again() -> None:
    results = other_day()
    config = replace(CONFIG, tracker=replace(CONFIG.tracker, period=0.2, misses_most=4))
    localizer = CloudLocalizer(saved(), config)
    told = followed(localizer, results)
    assert told[-1][0].state is CloudState.TRACKING
    # Carried away while nothing was measured: what is seen fits the place no more.
    away = SE3.from_rpy((4.0, 2.5, 0.0), 0.0, 0.0, 0.8)
    stamp = results[-1][0].stamp_ns
    states = []
    for k, (result, _) in enumerate(results[:40]):
        moved = replace(result, stamp_ns=stamp + (k + 1) * 100_000_000, map_from_imu=away @ result.map_from_imu)
        states.append(localizer.update(moved).state)
    assert CloudState.LOST in states


def test_a_displaced_estimate_is_pulled_in_without_a_step() -> None:
    results = other_day()
    truth = results[0][1]
    displaced = SE3((0.25, -0.15, 0.1)) @ truth @ results[0][0].map_from_imu.inverse()
    tracker = CloudTracker(saved(), CONFIG, displaced, results[0][0])
    errors = []
    for result, true in results[1:]:
        tracker.update(result)
        errors.append(np.subtract((tracker.map_from_odom @ result.map_from_imu).translation, true.translation))
    sizes = np.linalg.norm(errors, axis=1)
    assert sizes[0] > 0.25
    assert sizes[-30:].max() < 0.03
    assert np.linalg.norm(np.diff(errors, axis=0), axis=1).max() < 0.06


def tube(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points of a smooth tunnel along x, 5 m wide and 4 m high, around the middle of its height."""
    x, u = rng.uniform(-30.0, 30.0, count), rng.uniform(-1.0, 1.0, count)
    side = rng.integers(4, size=count)
    y = np.choose(side, [np.full(count, 2.5), np.full(count, -2.5), 2.5 * u, 2.5 * u])
    z = np.choose(side, [2.0 * u, 2.0 * u, np.full(count, 2.0), np.full(count, -2.0)])
    return np.column_stack([x, y, z]) + rng.normal(0.0, 0.01, (count, 3))


def test_along_a_tunnel_the_place_is_left_to_the_odometry_and_across_it_is_corrected() -> None:
    rng = np.random.default_rng(5)
    tunnel = CloudMap(tube(rng, 200_000))
    like = other_day()[0][0]

    def sight(k: int) -> LioResult:
        near = tube(rng, 4000)
        return replace(like, stamp_ns=k * 100_000_000, map_from_imu=SE3(), points_imu=near[np.abs(near[:, 0]) < 20.0])

    tracker = CloudTracker(tunnel, CONFIG, SE3((0.4, 0.2, -0.1)), sight(0))
    for k in range(1, 80):
        tracker.update(sight(k))
    x, y, z = tracker.map_from_odom.translation
    assert abs(x - 0.4) < 0.05  # nothing here says how far along
    assert abs(y) < 0.03
    assert abs(z) < 0.03


def test_quality_counts_a_ray_through_a_wall_twice() -> None:
    match = CloudMatch(SE3(), walls=0.9, flats=1.0, blocked=0.2, residual_m=0.05, information=np.eye(6))
    assert match.quality == pytest.approx(0.5)


def test_the_place_where_walls_fit_tightly_comes_before_one_that_they_lie_beside() -> None:
    """Where things were moved rays go through what is gone at the right place, too; a place that explains few walls says nothing about tightness."""
    right = CloudMatch(SE3(), walls=0.86, flats=0.7, blocked=0.13, residual_m=0.027, information=np.eye(6))
    deck = replace(right, walls=0.83, blocked=0.05, residual_m=0.052)
    little = replace(right, walls=0.3, blocked=0.0, residual_m=0.004)
    assert deck.quality > right.quality
    assert [m.walls for m in compared([little, deck, right])] == [0.86, 0.83, 0.3]
    assert compared([right])[0].quality == right.quality
    assert compared([]) == ()


def two_decks(rng: np.random.Generator, *, has_upper: bool) -> np.ndarray:
    """Points of a floor with walls around one half of it, and of a deck 3 m above it with walls of another plan."""

    def wall(x0: float, y0: float, x1: float, y1: float, z: float) -> np.ndarray:
        along, up = rng.random(6000), rng.uniform(z, z + 2.0, 6000)
        return np.column_stack((x0 + along * (x1 - x0), y0 + along * (y1 - y0), up))

    def floor(z: float) -> np.ndarray:
        return np.column_stack((rng.uniform(0.0, 16.0, (20_000, 2)), np.full(20_000, z)))

    lower = [floor(0.0), wall(2.0, 2.0, 14.0, 2.0, 0.0), wall(2.0, 2.0, 2.0, 9.0, 0.0)]
    upper = [floor(3.0), wall(12.0, 14.0, 12.0, 5.0, 3.0), wall(5.0, 14.0, 12.0, 14.0, 3.0)]
    return np.concatenate([*lower, *(upper if has_upper else [])]) + rng.normal(0.0, 0.01, 3)


@pytest.mark.parametrize(("gone", "is_told"), [(0.12, False), (0.01, True)])
def test_a_place_that_only_leads_because_nothing_was_taken_away_there_is_not_told(
    gone: float, *, is_told: bool
) -> None:
    """Two decks of a garage: on the right one more of the walls is explained, and rays pass where cars stood; the other one leads, and must not be told. While little is gone, the right
    one leads by both measures."""
    right = CloudMatch(
        SE3((0.0, 0.0, 3.0)), walls=0.82, flats=0.74, blocked=gone, residual_m=0.031, information=np.eye(6)
    )
    other = CloudMatch(SE3(), walls=0.72, flats=0.80, blocked=0.01, residual_m=0.031, information=np.eye(6))
    far = CloudMatch(
        SE3((28.0, 0.0, 0.0)), walls=0.60, flats=0.7, blocked=0.06, residual_m=0.031, information=np.eye(6)
    )
    best, *others = compared([other, far, right])
    assert best.quality - others[0].quality > 0.03
    relocalizer = CloudRelocalizer(saved(), CONFIG.relocalizer, CONFIG.match)
    state, _ = relocalizer.state_of((best, *others))
    assert (best.map_from_local.translation[2] == 3.0) == is_told
    assert state is (CloudState.VERIFYING if is_told else CloudState.AMBIGUOUS)


def test_each_of_two_decks_is_seen_from_above_by_itself() -> None:
    rng = np.random.default_rng(3)
    assert CloudMap(two_decks(rng, has_upper=False)).decks == ()
    both = CloudMap(two_decks(rng, has_upper=True))
    assert len(both.decks) == 2
    for image, own, others in ((both.decks[0], (2.0, 5.0), (12.0, 9.0)), (both.decks[1], (12.0, 9.0), (2.0, 5.0))):
        assert _brightness(image, *own) > 200
        assert _brightness(image, *others) < 30
        assert _brightness(both.image, *own) > 200


def _brightness(image: Image, x: float, y: float) -> int:
    """Return what the finest level of an image holds around a place."""
    rim = image.stack.shape[1] - image.standing.shape[0]
    iy, ix = rim + int((y - image.corner[1]) / image.cell), rim + int((x - image.corner[0]) / image.cell)
    return int(image.stack[0, iy - 1 : iy + 2, ix - 1 : ix + 2].max())


def seen_from_where() -> tuple[LocalCloud, SE3]:
    """Return what the first scans of the other day saw together, and its true pose in the map."""
    results = other_day()[:8]
    sight = Sight(CONFIG.match, 10)
    for result, _ in results:
        sight.add(result)
    local = sight.gathered(10)
    result, truth = results[-1]
    true = truth @ result.map_from_imu.inverse() @ local.odom_from_local
    return local, true


def test_judging_tells_a_true_pose_from_one_through_a_wall() -> None:
    local, true = seen_from_where()
    good = judge(saved(), local, true, CONFIG.match)
    assert good.quality > 0.6
    assert good.blocked < 0.05
    assert good.residual_m < 0.1
    for shift in ((0.0, 0.0, 3.5), (3.0, 0.0, 0.0), (0.0, 4.0, 0.0)):
        bad = judge(saved(), local, SE3(shift) @ true, CONFIG.match)
        assert bad.quality < good.quality - 0.25


def test_how_tightly_a_place_fits_is_told_by_its_walls() -> None:
    """A floor that was mapped 12 cm too low, as on a thin deck a plane between both of its sides is: walls fit as before."""
    local, true = seen_from_where()
    points = saved().points.copy()
    is_floor = points[:, 2] < np.percentile(points[:, 2], 1.0) + 0.3
    assert 0.1 < is_floor.mean() < 0.9
    points[is_floor, 2] -= 0.12
    as_mapped = judge(saved(), local, true, CONFIG.match)
    too_low = judge(CloudMap(points), local, true, CONFIG.match)
    assert too_low.walls > 0.9 * as_mapped.walls
    assert too_low.residual_m < 1.1 * as_mapped.residual_m


def test_perturbations_are_inverse_to_differences() -> None:
    rng = np.random.default_rng(1)
    pose = SE3.from_rpy((1.0, 2.0, 3.0), 0.1, -0.2, 2.0)
    for _ in range(5):
        delta = np.append(rng.normal(0.0, 0.3, 3), rng.normal(0.0, 1.0, 3))
        assert between(pose, turned(pose, delta)) == pytest.approx(delta, abs=1e-9)


def test_rays_are_stopped_by_the_surface_between_and_not_by_that_beside() -> None:
    table = (np.full(1024, -1, np.int64), np.zeros(1024, np.int32))
    y, z = np.meshgrid(np.arange(-2.0, 2.0, 0.2), np.arange(0.0, 2.0, 0.2))
    wall = np.column_stack([np.full(y.size, 5.1), y.ravel(), z.ravel()])
    kinds, planes = np.zeros(len(wall), np.uint8), np.zeros((len(wall), 4))
    of_point = np.full(len(wall), WALL, np.uint8)
    cloud_search.fill_cells(*table, wall, of_point, np.tile([1.0, 0.0, 0.0, -5.1], (len(wall), 1)), 0.5, kinds, planes)
    eye = np.array([[0.0, 0.0, 1.0]] * 5)
    ends = np.array(
        [
            [9.0, 0.3, 1.1],  # through it
            [5.3, 0.1, 1.0],  # on it
            [4.0, 0.0, 1.0],  # before it
            [9.0, 8.0, 1.0],  # past its edge
            [0.0, 9.0, 1.0],  # beside
        ]
    )
    counts = [cloud_search.count_blocked(*table, planes, 0.5, eye[:1], ends[k : k + 1], 0.6, 0.2) for k in range(5)]
    assert counts == [1, 0, 0, 0, 0]


def test_a_ray_that_ends_just_before_a_surface_is_not_stopped_by_it() -> None:
    """In the very cell of the surface, nearer to it than a cell is wide."""
    table = (np.full(1024, -1, np.int64), np.zeros(1024, np.int32))
    y, z = np.meshgrid(np.arange(-2.0, 2.0, 0.2), np.arange(0.0, 2.0, 0.2))
    wall = np.column_stack([np.full(y.size, 5.45), y.ravel(), z.ravel()])
    kinds, planes = np.zeros(len(wall), np.uint8), np.zeros((len(wall), 4))
    of_point = np.full(len(wall), WALL, np.uint8)
    cloud_search.fill_cells(*table, wall, of_point, np.tile([1.0, 0.0, 0.0, -5.45], (len(wall), 1)), 0.5, kinds, planes)
    eye, ends = np.array([[0.0, 0.1, 1.1]]), np.array([[5.35, 0.1, 1.1], [5.55, 0.1, 1.1]])
    counts = [cloud_search.count_blocked(*table, planes, 0.5, eye, ends[k : k + 1], 0.05, 0.2) for k in range(2)]
    assert counts == [0, 1]


def test_heights_are_told_by_walls_and_flats_apart() -> None:
    table = (np.full(4096, -1, np.int64), np.zeros(4096, np.int32))
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0.1, 6.0, 0.5), np.arange(0.1, 6.0, 0.5)))
    floors = np.vstack([np.column_stack([x, y, np.full(x.size, z)]) for z in (0.1, 3.6)])
    wall = np.column_stack([np.full(12, 6.1), np.arange(0.1, 6.1, 0.5), np.full(12, 4.6)])
    points = np.vstack([floors, wall])
    of_point = np.concatenate([np.full(len(floors), FLAT), np.full(len(wall), WALL)]).astype(np.uint8)
    kinds, planes = np.zeros(len(points), np.uint8), np.zeros((len(points), 4))
    cloud_search.fill_cells(*table, points, of_point, np.zeros((len(points), 4)), 0.5, kinds, planes)
    seen = points[(points[:, 2] > 3.0)] - [3.0, 3.0, 4.6]
    shares = np.empty((12, 2))
    seen_kinds = np.where(seen[:, 2] < -0.5, FLAT, WALL).astype(np.uint8)
    cloud_search.score_heights(*table, kinds, 0.5, seen, seen_kinds, np.array([3.0, 3.0, 0.0]), 0.1, 0.5, shares)
    assert shares[9].tolist() == [1.0, 1.0]  # at 4.6 m: the upper floor
    assert shares[2].tolist() == [0.0, 1.0]  # at 1.1 m the lower floor fits, the wall does not


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (np.zeros((0, 3)), "0 finite points"),
        (np.full((5000, 3), np.nan), "0 finite points"),
        (np.random.default_rng(0).uniform(-1e6, 1e6, (5000, 3)), "is its unit metres"),
        (np.random.default_rng(0).uniform(-20.0, 20.0, (3000, 3)), "hardly any surface"),
    ],
)
def test_a_cloud_that_is_no_map_is_refused_by_name(tmp_path: Path, points: np.ndarray, text: str) -> None:
    file = tmp_path / "cloud.pcd"
    write_cloud(file, points.astype(np.float32))
    with pytest.raises(BadInputError, match=r"cloud\.pcd") as error:
        CloudMap.load(file)
    assert text in str(error.value)


def test_a_cut_off_cloud_is_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "cloud.pcd"
    write_cloud(file, np.zeros((2000, 3), np.float32))
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(BadInputError, match="cut off"):
        CloudMap.load(file)
