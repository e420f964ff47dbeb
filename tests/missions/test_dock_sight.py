"""What a docking robot looks at: clouds of several scanners or the scan of one, and only where it expects the dock."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.messages import LaserScan, Odometry, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.detection import DockDetection
from ambler.docking.dock import Dock
from ambler.nodes.dock_sight import DockSight, detector_of
from ambler.sim.robots import robot_named
from tests.docking.docks import NOTCH, REFLECTORS, scan_of, segments_of_v

ROBOT = robot_named("amr_omni").model
TRUTH = SE2(0.7, 0.05, 0.08)
STAMP = 1_000_000_000


def sight_of(dock: Dock) -> DockSight:
    sight, zeros = DockSight(ROBOT), np.zeros((6, 6))
    for k in range(3):
        stamp = STAMP + (k - 1) * 100_000_000
        sight.add_odometry(
            Odometry(stamp, "odom", "base", SE3(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), zeros, zeros.copy())
        )
    sight.begin(dock, detector_of(dock, ROBOT, None))
    return sight


def seen_points(dock: Dock) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 2) in the base frame and intensities (N,)."""
    rng = np.random.default_rng(1)
    if dock.v_shape is not None:
        points = scan_of(segments_of_v(dock, TRUTH), rng)
        return points, np.full(len(points), 0.5)
    a, b = TRUTH.transform(np.array([[0.7, -0.5], [0.7, 0.5]]))
    points = scan_of(np.array([[*a, *b]]), rng, step=math.radians(0.17))
    away = np.hypot(*(points[:, None] - TRUTH.transform(dock.reflectors)[None]).transpose(2, 0, 1)).min(axis=1)
    return points, np.where(away < 0.025, 400.0, 0.5)


def cloud_of(points: np.ndarray, bright: np.ndarray) -> PointCloud:
    n = len(points)
    flat = np.column_stack((points, np.full(n, 0.18))).astype(np.float32)
    return PointCloud(STAMP, "base", flat, bright.astype(np.float32), np.zeros(n, np.float32), np.zeros(n, np.uint16))


def scan_message(points: np.ndarray, bright: np.ndarray) -> LaserScan:
    """The same as the scan of a scanner at the base's origin."""
    angles = np.arctan2(points[:, 1], points[:, 0])
    index = np.round((angles + math.pi) / math.radians(0.17)).astype(int)
    ranges, intensities = np.full(2118, np.inf, np.float32), np.zeros(2118, np.float32)
    ranges[index], intensities[index] = np.hypot(*points.T), bright
    step = math.radians(0.17)
    return LaserScan(STAMP, "base", -math.pi, step, 0.0, 0.1, 0.05, 30.0, ranges, intensities)


@pytest.mark.parametrize("dock", [NOTCH, REFLECTORS], ids=lambda d: d.name)
def test_clouds_and_scans_show_docks_where_they_are_expected(dock: Dock) -> None:
    sight, (points, bright) = sight_of(dock), seen_points(dock)
    assert sight.wants_scans
    assert not sight.wants_pictures
    assert sight.look_at_cloud(cloud_of(points, bright), None) is None, "a shape has no name: where is it expected?"
    for look in (
        sight.look_at_cloud(cloud_of(points, bright), TRUTH @ SE2(0.05, 0.05, 0.05)),
        sight.look_at_scan(scan_message(points, bright), TRUTH @ SE2(0.05, 0.05, 0.05)),
    ):
        assert look is not None
        detection = look()
        assert detection is not None
        assert detection.stamp_ns == STAMP
        assert detection.base_from_dock.distance_to(TRUTH) < 0.02
    elsewhere = sight.look_at_cloud(cloud_of(points, bright), TRUTH @ SE2(0.0, 1.0, 0.0))
    assert elsewhere is not None
    assert elsewhere() is None
    sight.end()
    assert sight.look_at_cloud(cloud_of(points, bright), TRUTH) is None


def test_once_seen_the_dock_is_expected_where_it_was() -> None:
    sight, (points, bright) = sight_of(NOTCH), seen_points(NOTCH)
    first = sight.look_at_cloud(cloud_of(points, bright), TRUTH)
    assert first is not None
    found = first()
    assert found is not None
    assert sight.take(found, STAMP + 50_000_000)
    assert sight.look_at_cloud(cloud_of(points, bright), None) is not None, "the filter is the prior, not the map"


def test_one_false_sighting_does_not_take_the_place_of_the_map() -> None:
    """Until a second sighting agrees, the dock is looked for where the map has it."""
    sight, (points, bright) = sight_of(NOTCH), seen_points(NOTCH)
    false = DockDetection(STAMP - 50_000_000, "test", TRUTH @ SE2(0.0, 0.9, 0.0), np.eye(3) * 1e-6, 1)
    assert sight.take(false, STAMP)
    look = sight.look_at_cloud(cloud_of(points, bright), TRUTH @ SE2(0.02, 0.02, 0.02))
    assert look is not None
    found = look()
    assert found is not None
    assert found.base_from_dock.distance_to(TRUTH) < 0.02
