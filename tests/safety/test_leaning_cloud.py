"""The gate's points of a cloud whose sensor leans while it turns: floor is no obstacle, and what stands on it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.messages import PointCloud
from ambler.core.se3 import SE3
from ambler.safety.points import points_of_cloud

MOUNT = SE3((0.0, 0.0, 0.7))
BAND = (0.15, 0.9)
PARTS = 11


def lean(share: float) -> SE3:
    return SE3.from_rpy((0.0, 0.0, 0.0), 0.0, math.radians(6.0) * share, 0.0)


def swept(height: float) -> PointCloud:
    """Points 3 m ahead at one height, each seen while the body goes down on its nose."""
    n = 200
    share = np.linspace(0.0, 1.0, n)
    points = [(lean(float(s)) @ MOUNT).inverse().transform(np.array([[3.0, 0.0, height]]))[0] for s in share]
    zeros = np.zeros(n, np.float32)
    times = (0.1 * share).astype(np.float32)
    return PointCloud(0, "lidar", np.array(points, np.float32), zeros, times, np.zeros(n, np.uint16))


SWEEP = [lean(k / (PARTS - 1)) @ MOUNT for k in range(PARTS)]


def test_floor_is_no_obstacle_while_the_body_leans_within_one_turn() -> None:
    assert len(points_of_cloud(swept(0.0), SWEEP, np.zeros(3), 4.0, BAND)) == 0
    assert len(points_of_cloud(swept(0.0), SWEEP[-1:], np.zeros(3), 4.0, BAND)) == 0  # beams that were held for lower
    assert (
        len(points_of_cloud(swept(0.0), [lean(-1.0) @ MOUNT], np.zeros(3), 4.0, BAND)) > 100
    )  # a wrong lean makes walls


def test_an_obstacle_stays_one_where_it_is() -> None:
    points = points_of_cloud(swept(0.3), SWEEP, np.zeros(3), 4.0, BAND)
    assert len(points) == 200
    assert points[:, 2] == pytest.approx(0.3, abs=0.02)
    assert points[:, 0] == pytest.approx(3.0, abs=0.02)
    with_one_lean = points_of_cloud(swept(0.3), SWEEP[-1:], np.zeros(3), 4.0, BAND)
    assert len(with_one_lean) < 150  # one lean for the whole turn loses it


def seen(mount: SE3, points: np.ndarray) -> PointCloud:
    """Those of some points in a level base that a Mid-360 at `mount` sees: 7 degrees down to 52 up."""
    local = mount.inverse().transform(points)
    elevation = np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1]))
    local = local[(elevation >= LOWEST) & (elevation <= math.radians(52.0))]
    zeros = np.zeros(len(local), np.float32)
    return PointCloud(0, "lidar", local.astype(np.float32), zeros, zeros, np.zeros(len(local), np.uint16))


LOWEST = math.radians(-7.0)
TILTED, LEVEL = SE3.from_rpy((0.18, 0.0, 0.47), 0.0, math.radians(28.0), 0.0), SE3((0.0, 0.0, 0.62))


def test_who_stands_behind_a_scanner_that_is_tilted_forwards_is_in_the_way_though_only_the_trunk_is_seen() -> None:
    y, z = (a.ravel() for a in np.meshgrid(np.arange(-0.2, 0.21, 0.02), np.arange(0.0, 1.7, 0.02)))
    cloud = seen(TILTED, np.column_stack((np.full(len(y), -0.6), y, z)))
    band = (0.15, 0.57)
    found = points_of_cloud(cloud, [TILTED], np.zeros(3), 4.0, band, None, LOWEST)
    assert len(found) > 50
    assert found[:, 0] == pytest.approx(-0.6, abs=0.01)
    assert len(points_of_cloud(cloud, [TILTED], np.zeros(3), 4.0, band)) == 0


def test_what_hangs_over_a_robot_that_sees_the_floor_below_it_is_not_in_the_way() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-2.0, 2.0, 0.1), np.arange(-2.0, 2.0, 0.1)))
    cloud = seen(LEVEL, np.column_stack((x, y, np.full(len(x), 1.2))))
    assert len(cloud.points) > 300
    assert len(points_of_cloud(cloud, [LEVEL], np.zeros(3), 4.0, (0.15, 0.72), None, LOWEST)) == 0


def test_a_ceiling_behind_a_tilted_scanner_is_not_in_the_way() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-6.0, 2.0, 0.05), np.arange(-2.0, 2.0, 0.05)))
    cloud = seen(TILTED, np.column_stack((x, y, np.full(len(x), 2.0))))
    assert len(points_of_cloud(cloud, [TILTED], np.zeros(3), 4.0, (0.15, 0.57), None, LOWEST)) == 0
