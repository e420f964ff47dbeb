"""What the LiDAR alone tells: how it turned where no IMU says so, and how fast it began where the IMU feels nothing."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ambler.core.messages import Imu, PointCloud
from ambler.lio.config import LioConfig, LoopConfig
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.offline import run_offline
from ambler.lio.state import log
from ambler.recordings.cloud_scan import CloudScan
from tests.lio.carried import walk
from tests.lio.corridor import corridor_scans

PERIOD_NS = 100_000_000


def seen_from(place: np.ndarray, yaw: float, k: int, speed: float | None = None) -> PointCloud:
    """What one cloud of the walk would be from another place (3,) and heading, as the `k`-th cloud: at one instant, or bent by a `speed` (m/s) along x."""
    cloud = walk()[1][5].cloud
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    time = np.zeros_like(cloud.time) if speed is None else cloud.time
    places = place + np.outer(time, [speed or 0.0, 0.0, 0.0])
    points = np.ascontiguousarray((cloud.points - places) @ turn, np.float32)
    return replace(cloud, stamp_ns=k * PERIOD_NS, points=points, time=time)


@pytest.mark.parametrize("jump", [25.0, -32.0])
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


@pytest.mark.parametrize("speed", [0.0, 1.0, 8.0])
def test_a_steady_motion_is_no_rest(speed: float) -> None:
    """The IMU feels the same, only the clouds move: who took that for rest stayed where he was, and who began without a speed bent his first scan by 0.8 m."""
    odometry, places, stamps = LidarInertialOdometry(), [], []
    for k in range(40):
        place = np.array([1e-9 * PERIOD_NS * speed * k, 0.0, 0.0])
        samples = [round((k + j / 20) * PERIOD_NS) for j in range(-19, 21)][:: 1 if k == 0 else 2]
        imu = tuple(
            Imu(at, "imu", (0.0, 0.0, 0.0), (0.0, 0.0, 9.80665)) for at in samples if at > (stamps or [-PERIOD_NS])[-1]
        )
        stamps += [sample.stamp_ns for sample in imu]
        result = odometry.update(CloudScan(seen_from(place, 0.0, k, speed), imu, ()))
        if result is not None:
            places.append((1e-9 * result.stamp_ns, result.map_from_imu.translation[0]))
    assert odometry.start is not None
    assert odometry.start.is_rest == (speed == 0.0)
    assert len(places) > 20
    (t0, x0), (t1, x1) = places[0], places[-1]
    assert x1 - x0 == pytest.approx(speed * (t1 - t0), abs=0.05)


def test_a_lidar_alone_that_begins_in_motion_straightens_its_first_scan() -> None:
    """Taken to stand, it had a first scan bent by 0.8 m in its map, and fitted all others to it."""
    odometry, places = LidarInertialOdometry(LioConfig(has_imu=False)), []
    for k in range(20):
        result = odometry.update(CloudScan(seen_from(np.array([0.8 * k, 0.0, 0.0]), 0.0, k, 8.0), (), ()))
        assert result is not None
        places.append(result.map_from_imu.translation[0])
    assert places[-1] - places[0] == pytest.approx(0.8 * 19, abs=0.05)
    assert np.mean([abs(b - a - 0.8) for a, b in pairwise(places)]) < 0.02


def test_a_lidar_alone_finds_the_speed_of_a_car_on_a_fast_road() -> None:
    odometry, places = LidarInertialOdometry(LioConfig(has_imu=False)), []
    for k in range(8):
        result = odometry.update(CloudScan(seen_from(np.array([3.6 * k, 0.0, 0.0]), 0.0, k, 36.0), (), ()))
        assert result is not None
        places.append(result.map_from_imu.translation[0])
    assert places[-1] - places[0] == pytest.approx(3.6 * 7, abs=0.05)


def test_a_speed_that_nothing_shows_is_told_as_unknown() -> None:
    """A car on a road between guard rails was told to go 0.3 m/s, give or take as much, and went 25: nobody was warned."""
    scans = corridor_scans(45, 8.0, 1.0)
    odometry = LidarInertialOdometry()
    results = [result for scan in scans if (result := odometry.update(scan)) is not None]
    assert odometry.unknown_speed == pytest.approx(np.array([[1.0, 0.0, 0.0]]), abs=0.02) or (
        odometry.unknown_speed == pytest.approx(np.array([[-1.0, 0.0, 0.0]]), abs=0.02)
    )
    assert len(results) > 10
    mapped = run_offline(scans, LioConfig(loops=LoopConfig(is_used=False)))
    assert not mapped.is_sure
    assert sum("the speed at the start is unknown along" in warning for warning in mapped.warnings()) == 1


def test_the_first_pose_of_a_speed_that_nothing_shows_says_so() -> None:
    odometry = LidarInertialOdometry()
    for scan in corridor_scans(45, 8.0, 1.0):
        if odometry.update(scan) is not None:
            break
    sigmas = np.sqrt(np.diag(odometry.covariance)[6:9])
    assert sigmas[0] > 7.0
    assert max(sigmas[1:]) < 1.0


def test_a_speed_that_a_wall_shows_later_is_known_from_then_on() -> None:
    odometry, unknown = LidarInertialOdometry(), []
    for scan in corridor_scans(60, 1.0, 1.0, walls=(8.0,)):
        if odometry.update(scan) is not None:
            unknown.append(len(odometry.unknown_speed))
    assert unknown[0] == 1
    assert unknown[-1] == 0
    assert odometry.state.velocity[0] == pytest.approx(1.0, abs=0.1)
