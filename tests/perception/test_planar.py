"""Planar scans: motion compensation against exact geometry, free rays, the height band of clouds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.base_motion import BaseMotion
from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.level_mount import level_mount
from ambler.perception.planar import PlanarConfig, cloud_to_points, scan_duration, scan_to_points
from tests.registration.room import ranges_at, scan_at

MOUNT = SE3((0.2, -0.1, 0.3))
INCREMENT = 2 * math.pi / 360


def moving_scan(twist: np.ndarray, start: SE2, growth: float = 0.0) -> LaserScan:
    """Return the scan of a sensor whose base moves with a twist that changes at the rate of `growth` of it per second; each beam sees the room from where
    it was taken."""
    dt = 0.1 / 360
    ranges = np.empty(360, np.float32)
    for i in range(360):
        sensor = start @ moved(twist, i * dt, growth) @ MOUNT.to_se2()
        ranges[i] = ranges_at(sensor, np.array([i * INCREMENT - math.pi]))[0]
    return LaserScan(0, "laser", -math.pi, INCREMENT, dt, 0.1, 0.05, 30.0, ranges, np.zeros(0, np.float32))


def moved(twist: np.ndarray, t: float, growth: float) -> SE2:
    """Where a base is after t seconds whose twist keeps its direction and changes its size."""
    return SE2.exp(twist * (t + 0.5 * growth * t * t))


def test_a_base_that_brakes_and_turns_is_followed_through_the_sweep() -> None:
    twist, start, growth = np.array([0.8, 0.0, 1.2]), SE2(0.4, -0.2, 0.3), -10.0  # to rest within the sweep
    motion, scan = BaseMotion(), moving_scan(twist, start, growth)
    for t in np.arange(0.0, 0.105, 0.01):
        motion.add_pose(round(t * 1e9), SE2(3.0, 1.0, 2.0) @ moved(twist, float(t), growth))
    sweep = motion.sweep(0, scan_duration(scan), np.zeros(3))
    followed = start.transform(scan_to_points(scan, MOUNT, sweep, PlanarConfig()).points)
    steady = start.transform(scan_to_points(scan, MOUNT, motion.twist_over(0, 100_000_000), PlanarConfig()).points)
    assert distance_to_walls(followed).max() < 0.005
    assert distance_to_walls(steady).max() > 0.02


@settings(max_examples=10, deadline=None)
@given(st.floats(-1, 1), st.floats(-0.5, 0.5), st.floats(-1.5, 1.5))
def test_a_moving_scan_lies_on_the_walls_after_compensation(vx: float, vy: float, wz: float) -> None:
    twist, start = np.array([vx, vy, wz]), SE2(0.4, -0.2, 0.3)
    scan = scan_to_points(moving_scan(twist, start), MOUNT, twist, PlanarConfig())
    seen = start.transform(scan.points)
    origin = start.transform(np.array([scan.origin]))[0]
    bearing = np.arctan2(seen[:, 1] - origin[1], seen[:, 0] - origin[0])
    # Every point must lie on a wall: its distance to the wall segments is zero.
    assert distance_to_walls(seen).max() < 1e-4
    assert len(bearing) == 360


def distance_to_walls(points: np.ndarray) -> np.ndarray:
    """Return each point's distance to the nearest wall of the room."""
    from tests.registration.room import WALLS

    a, e = WALLS[:, :2], WALLS[:, 2:] - WALLS[:, :2]
    t = np.clip(((points[:, None] - a) * e).sum(-1) / (e * e).sum(-1), 0, 1)
    return np.asarray(np.linalg.norm(points[:, None] - (a + t[..., None] * e), axis=-1).min(axis=1))


def test_without_compensation_a_moving_scan_misses_the_walls() -> None:
    twist = np.array([0.8, 0.0, 1.0])
    scan = scan_to_points(moving_scan(twist, SE2()), MOUNT, np.zeros(3), PlanarConfig())
    assert distance_to_walls(scan.points.astype(float)).max() > 0.05


def test_a_resting_scan_equals_the_ideal_one() -> None:
    scan = moving_scan(np.zeros(3), SE2())
    ideal = scan_at(MOUNT.to_se2())
    points = scan_to_points(scan, MOUNT, np.zeros(3), PlanarConfig()).points
    assert points == pytest.approx(MOUNT.to_se2().transform(ideal.points), abs=1e-4)
    assert scan_duration(scan) == pytest.approx(0.1 * 359 / 360)


def test_returns_free_rays_and_missing_measurements_are_told_apart() -> None:
    ranges = np.array([1.0, np.inf, np.nan, 0.01, 25.0], np.float32)
    scan = LaserScan(7, "laser", 0.0, 0.1, 0.0, 0.0, 0.05, 20.0, ranges, np.zeros(0, np.float32))
    out = scan_to_points(scan, SE3(), np.zeros(3), PlanarConfig(free_length=4.0))
    assert out.points == pytest.approx(np.array([[1.0, 0.0]]))
    assert np.hypot(out.free_points[:, 0], out.free_points[:, 1]) == pytest.approx([4.0, 4.0])
    assert out.stamp_ns == 7


def test_a_scanner_mounted_upside_down_turns_the_other_way() -> None:
    scan = LaserScan(0, "laser", 0.5, 0.1, 0.0, 0.0, 0.05, 20.0, np.array([2.0], np.float32), np.zeros(0, np.float32))
    out = scan_to_points(scan, SE3.from_rpy((0.0, 0.0, 0.0), math.pi, 0.0, 0.0), np.zeros(3), PlanarConfig())
    assert math.atan2(out.points[0, 1], out.points[0, 0]) == pytest.approx(-0.5, abs=1e-6)


def cloud_of(points: list[tuple[float, float, float]] | np.ndarray) -> PointCloud:
    """Return a cloud at rest of points (N, 3)."""
    n = len(points)
    return PointCloud(
        0,
        "lidar",
        np.array(points, np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.uint16),
    )


def test_height_band_of_a_cloud() -> None:
    config = PlanarConfig(range_min=0.3, range_max=10.0, free_length=10.0)
    mount = SE3((0.0, 0.0, 0.8))
    cloud = cloud_of(
        [
            (3.0, 0.0, -0.4),  # at 0.4 m: an obstacle
            (5.0, 0.0, -0.4),  # behind it: hidden
            (0.0, 4.0, -0.8),  # the floor: no obstacle, free up to where the ray leaves the band
            (-4.0, 0.0, 0.5),  # above the band: neither, the ray starts above it
            (0.0, -20.0, -0.5),  # in the band, but too far: free up to the limit
        ]
    )
    scan = cloud_to_points(cloud, mount, np.zeros(3), config)
    assert scan.points == pytest.approx(np.array([[3.0, 0.0]]), abs=1e-6)
    lengths = sorted(np.hypot(scan.free_points[:, 0], scan.free_points[:, 1]).tolist())
    assert lengths == pytest.approx([4.0 * 0.7 / 0.8, 10.0], abs=1e-5)


def test_the_mean_of_a_surface_removes_the_bias_of_its_nearest_return() -> None:
    rng = np.random.default_rng(3)
    sigma, rings, bins = 0.01, 16, 360
    bearing = (np.arange(bins) + 0.5) * 2 * math.pi / bins - math.pi
    wall = 3.0 + sigma * rng.standard_normal((rings, bins))
    behind = np.full((4, bins), 3.5)  # seen past the wall: another surface
    distance, angle = np.concatenate((wall, behind)), np.tile(bearing, (rings + 4, 1))
    flat = np.stack((distance * np.cos(angle), distance * np.sin(angle), np.zeros_like(distance)), axis=-1)
    config = PlanarConfig(height_min=-0.1, height_max=0.1, azimuth_bins=bins, surface_depth=0.08)
    points = cloud_to_points(cloud_of(flat.reshape(-1, 3)), SE3(), np.zeros(3), config).points
    assert len(points) == bins
    error = np.hypot(points[:, 0], points[:, 1]) - 3.0
    assert wall.min(axis=0).mean() - 3.0 < -1.5 * sigma  # the nearest of 16 lies 1.77 sigma too near
    assert abs(error.mean()) < 4.0 * sigma / math.sqrt(rings * bins)
    assert error.std() == pytest.approx(sigma / math.sqrt(rings), rel=0.15)


def test_one_surface_ends_at_its_depth() -> None:
    config = PlanarConfig(height_min=-0.1, height_max=0.1, surface_depth=0.06)
    for second, seen in ((2.05, 2.025), (2.07, 2.0)):
        cloud = cloud_of([(second, 0.0, 0.0), (2.0, 0.0, 0.0)])
        points = cloud_to_points(cloud, SE3(), np.zeros(3), config).points
        assert points == pytest.approx(np.array([[seen, 0.0]]), abs=1e-6)


BODY = SE3((0.1, 0.0, 0.6))
WALKING = PlanarConfig(range_min=0.3, range_max=30.0, free_length=10.0)
SWEEP = 0.1  # seconds of a turn


def walking(amplitude: float) -> BaseMotion:
    """Return the motion of a body that pitches with 2.5 Hz and rolls with half of that on the spot, told at 50 Hz."""
    motion = BaseMotion()
    for k in range(20):
        motion.add_pose(k * 20_000_000, lean_at(k * 0.02, amplitude))
    return motion


def lean_at(t: float, amplitude: float) -> SE3:
    roll, pitch = amplitude * math.sin(7.9 * t), amplitude * math.cos(15.7 * t)
    return SE3.from_rpy((0.0, 0.0, 0.0), roll, pitch, 0.0)


def swept(distance: float, height: float, amplitude: float) -> PointCloud:
    """Return what a turn sees of a ring of points at a height above the floor, each from where the leaning sensor was then."""
    n = 360
    times = np.linspace(0.0, SWEEP, n, dtype=np.float32)
    bearing = np.arange(n) * INCREMENT - math.pi
    ring = np.stack((distance * np.cos(bearing), distance * np.sin(bearing), np.full(n, height)), axis=1)
    points = [
        (lean_at(float(t), amplitude) @ BODY).inverse().transform(p[None])[0] for t, p in zip(times, ring, strict=True)
    ]
    zeros = np.zeros(n, np.float32)
    return PointCloud(0, "lidar", np.array(points, np.float32), zeros, times, np.zeros(n, np.uint16))


@pytest.mark.parametrize("distance", [5.0, 12.0, 20.0, 28.0])
def test_the_floor_under_a_walking_body_is_no_wall_at_any_distance(distance: float) -> None:
    lean = math.radians(1.5)
    cloud = swept(distance, 0.0, lean)
    mount = level_mount(BODY, walking(lean), 0, SWEEP)
    assert len(cloud_to_points(cloud, mount, np.zeros(3), WALKING).points) == 0
    # One lean for the whole turn, as it was at its stamp, would be wrong.
    at_stamp = level_mount(BODY, walking(lean), 0, 0.0)
    assert distance < 8.0 or len(cloud_to_points(cloud, at_stamp, np.zeros(3), WALKING).points) > 20


@pytest.mark.parametrize("distance", [5.0, 12.0, 28.0])
def test_a_wall_is_seen_by_a_walking_body_where_it_is(distance: float) -> None:
    lean = math.radians(1.5)
    mount = level_mount(BODY, walking(lean), 0, SWEEP)
    points = cloud_to_points(swept(distance, 0.4, lean), mount, np.zeros(3), WALKING).points
    assert len(points) == 360
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx(distance, abs=0.01)


def test_what_may_be_floor_is_free_only_while_its_ray_is_surely_above_it() -> None:
    still = math.radians(0.5)
    motion = BaseMotion()
    motion.add_pose(0, SE3.from_rpy((0.0, 0.0, 0.0), 0.0, still, 0.0))
    motion.add_pose(200_000_000, SE3.from_rpy((0.0, 0.0, 0.0), 0.0, still, 0.0))
    mount = level_mount(BODY, motion, 0, SWEEP)
    level_from_sensor = SE3.from_rpy((0.0, 0.0, 0.0), 0.0, still, 0.0) @ BODY
    low = level_from_sensor.inverse().transform(
        np.array([[0.0, 20.0, 0.15]])
    )  # above the band's edge, within the doubt
    free = cloud_to_points(cloud_of(low), mount, np.zeros(3), PlanarConfig(range_max=30.0, free_length=30.0))
    assert len(free.points) == 0
    along = float(np.hypot(*(free.free_points[0] - free.origin)))
    sensor_height = level_from_sensor.translation[2]
    height = sensor_height + (0.15 - sensor_height) * along / 20.0
    assert height == pytest.approx(0.1 + math.radians(0.3) * along, abs=1e-3)


def test_a_planar_scanner_that_nods_sees_floor_and_no_wall() -> None:
    nod, height = math.radians(2.0), 0.3
    motion = BaseMotion()
    for stamp_ns in (0, 200_000_000):
        motion.add_pose(stamp_ns, SE3.from_rpy((0.0, 0.0, 0.0), 0.0, nod, 0.0))
    mount = level_mount(SE3((0.0, 0.0, height)), motion, 0, 0.1)
    floor = height / math.sin(nod)
    ranges = np.array(
        [floor, 4.0, np.inf, floor], np.float32
    )  # floor ahead, a wall ahead, nothing ahead, a wall behind
    seen = LaserScan(0, "laser", 0.0, 0.0, 0.0, 0.1, 0.05, 30.0, ranges[:3], np.zeros(0, np.float32))
    ahead = scan_to_points(seen, mount, np.zeros(3), PlanarConfig(free_length=20.0))
    at = height * math.sin(nod)  # where the nod carried the scanner
    assert ahead.points[:, 0] == pytest.approx([at + 4.0 * math.cos(nod)], abs=1e-3)
    # The two others are free to where they come near the floor.
    reach = (height - 0.1) / (math.sin(nod) + math.radians(0.3))
    assert ahead.free_points[:, 0] - at == pytest.approx([reach, reach], abs=0.02)
    behind = LaserScan(0, "laser", math.pi, 0.0, 0.0, 0.1, 0.05, 30.0, ranges[3:], np.zeros(0, np.float32))
    assert len(scan_to_points(behind, mount, np.zeros(3), PlanarConfig()).points) == 1


def test_a_level_body_needs_no_sweep() -> None:
    motion = BaseMotion()
    motion.add_pose(0, SE3((1.0, 2.0, 0.0)))
    motion.add_pose(200_000_000, SE3.from_se2(SE2(1.0, 2.0, 1.0)))
    assert level_mount(BODY, motion, 0, SWEEP) is BODY
    assert level_mount(BODY, BaseMotion(), 0, SWEEP) is BODY  # nothing is known


def test_how_low_a_direction_was_looked_through() -> None:
    config = PlanarConfig(range_min=0.3, range_max=10.0, free_length=10.0)
    low, high = [(2.0, 0.0, -0.4), (2.05, 0.0, -0.38)], [(0.0, 2.0, -0.4), (0.0, 2.1, 0.6)]
    floor, farther = [(-2.9, 0.0, -0.8)], [(-4.0, 0.0, -0.3)]
    scan = cloud_to_points(cloud_of([*low, *high, *floor, *farther]), SE3((0.0, 0.0, 0.8)), np.zeros(3), config)
    assert scan.falls is not None
    assert scan.falls.height == pytest.approx(0.8)
    ahead, left, behind = (int(np.argmin(np.hypot(*(scan.points - p).T))) for p in ((2, 0), (0, 2), (-4, 0)))
    assert scan.falls.tops[ahead] == pytest.approx(0.42, abs=1e-6)  # the highest return of what ends there
    assert scan.falls.tops[left] == np.inf  # it goes on above the band
    assert scan.falls.sinks[ahead] == pytest.approx(0.2, abs=1e-6)
    assert scan.falls.sinks[behind] == pytest.approx(0.8 / 2.9, abs=1e-6)  # of the ray that met the floor before
    below, _ = scan.falls.below(0.25)
    assert below[behind] == pytest.approx(0.55 * 2.9 / 0.8, abs=1e-5)
    thin = scan.thinned(0.1)
    assert thin.falls is not None
    assert len(thin.falls.tops) == len(thin.falls.sinks) == len(thin.points)
