"""Planar scans: motion compensation against exact geometry, free rays, the height band of clouds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.planar import PlanarConfig, cloud_to_points, level, scan_duration, scan_to_points
from tests.registration.room import ranges_at, scan_at

MOUNT = SE3((0.2, -0.1, 0.3))
INCREMENT = 2 * math.pi / 360


def moving_scan(twist: np.ndarray, start: SE2) -> LaserScan:
    """Return the scan of a sensor whose base moves with a twist; each beam sees the room from where it was taken."""
    dt = 0.1 / 360
    ranges = np.empty(360, np.float32)
    for i in range(360):
        sensor = start @ SE2.exp(twist * (i * dt)) @ MOUNT.to_se2()
        ranges[i] = ranges_at(sensor, np.array([i * INCREMENT - math.pi]))[0]
    return LaserScan(0, "laser", -math.pi, INCREMENT, dt, 0.1, 0.05, 30.0, ranges, np.zeros(0, np.float32))


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


def test_levelling_turns_a_tilted_floor_flat() -> None:
    roll, pitch = 0.05, -0.08
    mount = SE3((0.1, 0.0, 0.6))
    tilt = SE3.from_rpy((0.0, 0.0, 0.0), roll, pitch, 0.0)
    floor = np.array([[x, y, 0.0] for x in (-3.0, 2.0, 4.0) for y in (-2.0, 3.0)])
    in_sensor = (tilt @ mount).inverse().transform(floor)
    cloud = cloud_of(in_sensor)
    config = PlanarConfig(range_min=0.3, range_max=10.0, free_length=10.0)
    assert len(cloud_to_points(cloud, level(mount, roll, pitch), np.zeros(3), config).points) == 0
    assert len(cloud_to_points(cloud, mount, np.zeros(3), config).points) > 0
