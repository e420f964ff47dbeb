"""What the LiDAR alone tells: how it turned where no IMU says so, and how fast it began where the IMU feels nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import Imu, PointCloud
from ambler.lio.config import LioConfig
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.state import log
from ambler.recordings.cloud_scan import CloudScan
from tests.lio.carried import walk

PERIOD_NS = 200_000_000


def seen_from(place: np.ndarray, yaw: float, k: int) -> PointCloud:
    """What one cloud of the walk would be from another place (3,) and heading, at one instant, as the `k`-th cloud."""
    cloud = walk()[1][5].cloud
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    points = np.ascontiguousarray((cloud.points - place) @ turn, np.float32)
    return replace(cloud, stamp_ns=k * PERIOD_NS, points=points, time=np.zeros_like(cloud.time))


@pytest.mark.parametrize("jump", [25.0, -40.0])
def test_a_lidar_alone_finds_how_far_it_turned_between_two_clouds(jump: float) -> None:
    """Twice one way and back: the prediction is off by the turn, then by twice as much. A real recording was lost from 13 degrees on."""
    odometry = LidarInertialOdometry(LioConfig(has_imu=False))
    yaws = [0.0] * 12 + [math.radians(jump * n) for n in (1, 2, 1, 0)]
    for k, yaw in enumerate(yaws):
        odometry.update(CloudScan(seen_from(np.zeros(3), yaw, k), (), ()))
        c, s = math.cos(yaw), math.sin(yaw)
        turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        assert np.linalg.norm(log(turned.T @ odometry.state.rotation)) < math.radians(1.0)
        assert np.linalg.norm(odometry.state.position) < 0.05


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_a_steady_motion_is_no_rest(speed: float) -> None:
    """The IMU feels the same, only the clouds move: who took that for rest stayed where he was."""
    odometry, places = LidarInertialOdometry(), []
    for k in range(40):
        place = np.array([0.2 * speed * k, 0.0, 0.0])
        stamps = [round((k + j / 20) * PERIOD_NS) for j in range(-19, 1)]
        imu = tuple(Imu(stamp, "imu", (0.0, 0.0, 0.0), (0.0, 0.0, 9.80665)) for stamp in stamps)
        result = odometry.update(CloudScan(seen_from(place, 0.0, k), imu, ()))
        if result is not None:
            places.append(result.map_from_imu.translation[0])
    assert odometry.start is not None
    assert odometry.start.is_rest == (speed == 0.0)
    assert len(places) > 20
    assert places[-1] - places[0] == pytest.approx(0.2 * speed * (len(places) - 1), abs=0.05)
