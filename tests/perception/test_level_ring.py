"""What a scanner of many rings sees at its own height, as a planar scan."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError
from ambler.core.messages import PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.level_ring import BEAMS, SLOPE, level_ring

MOUNT = SE3.from_rpy((0.2, -0.1, 0.7), 0.0, math.radians(4.0), 0.3)
RADIUS = 3.0  # of the round room that the sensor stands in, about the origin of odom
TWIST = np.array([0.6, 0.2, 0.8])


def pose_at(seconds: float) -> SE3:
    """A body that drives a bend and sways, odom_from_base."""
    planar = SE2.exp(TWIST * seconds)
    lean = SE3.from_rpy((0.0, 0.0, 0.3), 0.05 * math.sin(20.0 * seconds), 0.06 * math.cos(17.0 * seconds), 0.0)
    return SE3.from_se2(planar) @ lean


def motion() -> BaseMotion:
    out = BaseMotion()
    for k in range(21):
        out.add_pose(round(k * 1e7), pose_at(k * 0.01))
    return out


def cloud(rings: int = 16) -> PointCloud:
    """What a spinning scanner of `rings` from -15 to 15 degrees sees of the round wall in 0.1 s, with the height of each return over the sensor as its intensity."""
    columns = 900
    azimuth, elevation = np.linspace(-math.pi, math.pi, columns), np.radians(np.linspace(-15.0, 15.0, rings))
    points, heights, times = [], [], []
    for k, a in enumerate(azimuth):
        seconds = 0.1 * k / columns
        sensor = pose_at(seconds) @ MOUNT
        for e in elevation:
            ray = (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e))
            dx, dy, dz = sensor.rotate(ray)
            x, y, _ = sensor.translation
            b, c, square = x * dx + y * dy, x * x + y * y - RADIUS**2, dx * dx + dy * dy
            far = (-b + math.sqrt(b * b - square * c)) / square
            points.append(far * np.array(ray))
            heights.append(far * dz)
            times.append(seconds)
    n = len(points)
    return PointCloud(
        0,
        "lidar",
        np.array(points, np.float32),
        np.array(heights, np.float32),
        np.array(times, np.float32),
        np.zeros(n, np.uint16),
    )


def test_a_scanner_that_leans_and_turns_sees_the_wall_where_it_is() -> None:
    scan, base_from_scanner = level_ring(cloud(), MOUNT, motion())
    assert len(scan.ranges) == BEAMS
    is_return = np.isfinite(scan.ranges)
    assert is_return.mean() > 0.99
    angles = scan.angle_min + np.arange(BEAMS) * scan.angle_increment
    flat = (scan.ranges * (np.cos(angles), np.sin(angles))).T[is_return]
    in_odom = SE3.from_se2(pose_at(0.0).to_se2()) @ base_from_scanner
    points = in_odom.transform(np.column_stack((flat, np.zeros(len(flat)))))
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx(RADIUS, abs=0.01)
    assert (np.abs(scan.intensities[is_return]) <= SLOPE * (RADIUS + 0.5)).all(), "none of them rises or falls by more"


def test_its_place_is_that_of_the_sensor_in_a_level_base() -> None:
    _, base_from_scanner = level_ring(cloud(), MOUNT, motion())
    sensor = pose_at(0.0) @ MOUNT
    assert base_from_scanner.translation[:2] == pytest.approx(sensor.translation[:2], abs=1e-9)
    assert base_from_scanner.translation[2] == pytest.approx(sensor.translation[2] - 0.3)
    assert base_from_scanner.rotate((1.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))


def test_of_two_returns_of_one_beam_the_more_level_one_counts() -> None:
    points = np.array([[3.0, 0.0, 0.01], [2.0, 0.0, 0.04], [0.0, 2.0, 0.5]], np.float32)
    values = np.array([1.0, 2.0, 3.0], np.float32)
    still = BaseMotion()
    still.add_pose(0, SE3())
    two = PointCloud(0, "lidar", points, values, np.zeros(3, np.float32), np.zeros(3, np.uint16))
    scan, _ = level_ring(two, SE3(), still)
    assert np.flatnonzero(np.isfinite(scan.ranges)).tolist() == [BEAMS // 2]
    assert scan.ranges[BEAMS // 2] == pytest.approx(3.0)
    assert scan.intensities[BEAMS // 2] == 1.0


def test_without_a_pose_of_its_moment_nothing_is_told() -> None:
    with pytest.raises(StaleInputError):
        level_ring(cloud(2), MOUNT, BaseMotion())


def test_an_empty_cloud_is_an_empty_scan() -> None:
    nothing = np.zeros(0, np.float32)
    empty = PointCloud(0, "lidar", np.zeros((0, 3), np.float32), nothing, nothing, np.zeros(0, np.uint16))
    scan, _ = level_ring(empty, MOUNT, motion())
    assert np.isnan(scan.ranges).all()


@pytest.mark.parametrize("seed", range(5))
def test_numbers_that_are_none_are_left_out(seed: int) -> None:
    """Of points, and times that lie before the stamp; what is sound counts as before."""
    rng, good = np.random.default_rng(seed), cloud(4)
    n, wrong = len(good.points), np.array([np.nan, np.inf, -np.inf], np.float32)
    points, times = np.array(good.points), np.array(good.time)
    hit = rng.choice(n, n // 3, replace=False)
    points[hit] = rng.choice(wrong, (len(hit), 3))
    times[hit] = rng.choice(np.array([-1e30, -5.0, -np.inf], np.float32), len(hit))
    broken = PointCloud(0, "lidar", points, np.array(good.intensity), times, np.array(good.ring))
    scan, _ = level_ring(broken, MOUNT, motion())
    keep = np.delete(np.arange(n), hit)
    of_kept = PointCloud(0, "lidar", points[keep], good.intensity[keep], times[keep], good.ring[keep])
    expected, _ = level_ring(of_kept, MOUNT, motion())
    both = np.isfinite(scan.ranges) & np.isfinite(expected.ranges)
    assert both.sum() > 0.9 * np.isfinite(expected.ranges).sum()
    assert scan.ranges[both] == pytest.approx(expected.ranges[both], abs=0.02)
