"""Stations: what is collected while the base holds still, what is not, and within what memory."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Odometry, PointCloud
from ambler.core.se3 import SE3
from ambler.lio.station_cloud import (
    RestWatch,
    ScanState,
    Station,
    StationCloudConfig,
    StationClouds,
    StationScan,
)

S = 1_000_000_000
CONFIG = StationCloudConfig()
STANDS = SE3.from_rpy((3.0, -2.0, 0.4), 0.02, -0.03, 1.2)


def odometry(stamp_ns: int, pose: SE3, speed: float = 0.0, turn: float = 0.0) -> Odometry:
    return Odometry(stamp_ns, "odom", "base", pose, (speed, 0.0, 0.0), (0.0, 0.0, turn), np.eye(6), np.eye(6))


def cloud(stamp_ns: int, points: NDArray[np.floating]) -> PointCloud:
    n = len(points)
    intensity = np.arange(n, dtype=np.float32)
    return PointCloud(
        stamp_ns, "odom", points.astype(np.float32), intensity, np.zeros(n, np.float32), np.zeros(n, np.uint16)
    )


class Robot:
    """A base with odometry at 100 Hz and a cloud every 0.1 s, told when its scan ends: 200 points of a wall 4 m ahead, no two scans alike."""

    def __init__(self, hold: float = 3.0, config: StationCloudConfig = CONFIG, noise: float = 0.0) -> None:
        self.rng = np.random.default_rng(1)
        self.pose, self.now_ns, self.noise = STANDS, 10 * S, noise
        self.rest = RestWatch(config)
        self.scan = StationScan(config, hold, 1, config.cell, self.now_ns)
        self.seen: list[NDArray[np.float64]] = []

    def live(self, seconds: float, speed: float = 0.0) -> None:
        """Go on, along its own x axis."""
        for _ in range(round(seconds * 100)):
            self.now_ns += S // 100
            self.pose = self.pose @ SE3((0.01 * speed, 0.0, 0.0))
            now = odometry(self.now_ns, self.pose, speed + self.rng.normal(0.0, self.noise))
            self.rest.add(now)
            self.scan.move(now, self.rest)
            if self.now_ns % (S // 10) == 0:
                wall = np.column_stack([np.full(200, 4.1), *self.rng.uniform(-3.0, 3.0, (2, 200))])
                self.seen.append(wall)
                self.scan.see(cloud(self.now_ns, STANDS.transform(wall)))
            self.scan.tick(self.now_ns)


def test_it_begins_at_rest_and_collects_for_as_long_as_was_asked() -> None:
    robot = Robot(hold=3.0)
    robot.live(0.45)
    assert robot.scan.state is ScanState.WAITING
    robot.live(0.2)
    assert robot.scan.state is ScanState.HOLDING
    robot.live(4.0)
    assert (robot.scan.state, robot.scan.code) == (ScanState.OVER, "SUCCEEDED")
    station = robot.scan.station()
    assert station is not None
    assert station.seconds == pytest.approx(3.0)
    assert station.scans == 30
    assert station.level == 1
    assert station.odom_from_base == STANDS
    assert station.density == pytest.approx(len(station.points) / 200, rel=0.02)
    assert station.density > 25.0
    assert station.points[:, 0] == pytest.approx(4.1, abs=1e-5)  # in the base, wherever odom is
    assert len(station.points) == len(station.intensity)


def test_there_is_one_point_per_cube_however_long_it_holds() -> None:
    coarse = replace(CONFIG, cell=0.5)
    robot = Robot(hold=8.0, config=coarse)
    robot.live(9.0)
    station = robot.scan.station()
    assert station is not None
    assert station.scans == 80
    cells = np.floor(station.points.astype(np.float64) / 0.5)
    assert len(np.unique(cells, axis=0)) == len(station.points)
    assert len(station.points) == pytest.approx(144, abs=20)
    assert max(len(part.points) for part in robot.scan._parts) < 200


def test_nothing_is_collected_while_it_moves() -> None:
    robot = Robot()
    robot.live(3.0, speed=0.3)
    assert robot.scan.state is ScanState.WAITING
    assert robot.scan.scans == 0
    robot.scan.tick(robot.now_ns + 10 * S)
    assert robot.scan.station() is None


def test_who_creeps_is_not_at_rest_and_noise_is_no_motion() -> None:
    robot = Robot()
    robot.live(2.0, speed=0.06)
    assert robot.scan.state is ScanState.WAITING
    noisy = Robot(noise=0.05)
    noisy.live(2.0)
    assert noisy.scan.state is ScanState.HOLDING


def test_a_turn_is_no_rest_either() -> None:
    rest = RestWatch(CONFIG)
    for k in range(100):
        rest.add(odometry(k * S // 100, STANDS, turn=0.1))
    assert rest.since_ns is None
    for k in range(100, 200):
        rest.add(odometry(k * S // 100, STANDS))
    assert rest.since_ns is not None
    assert 1.0 < rest.since_ns / S < 1.3


def test_after_a_gap_in_the_odometry_rest_begins_anew() -> None:
    rest = RestWatch(CONFIG)
    for stamp_ns in (0, S // 100, 2 * S):
        rest.add(odometry(stamp_ns, STANDS))
    assert rest.since_ns == 2 * S


def test_who_is_moved_keeps_what_was_seen_before() -> None:
    robot = Robot(hold=5.0)
    robot.live(3.0)
    before = robot.scan.scans
    robot.live(0.3, speed=0.5)
    assert robot.scan.code == "MOVED"
    assert "moved after" in robot.scan.text
    station = robot.scan.station()
    assert station is not None
    assert before - 6 <= station.scans < before  # the last half second is left out: it may have moved already
    assert 1.8 < station.seconds < 2.5
    assert len(station.points) < 200 * station.scans + 1
    robot.live(2.0)
    assert robot.scan.scans == station.scans  # it is over


def test_slowly_carried_away_is_moved_too() -> None:
    robot = Robot(hold=60.0)
    robot.live(1.0)
    robot.live(2.0, speed=0.03)  # slower than what counts as motion
    assert robot.scan.code == "MOVED"
    turned = Robot(hold=60.0)
    turned.live(1.0)
    turned.pose = turned.pose @ SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, 0.05)
    turned.live(0.1)
    assert turned.scan.code == "MOVED"


def test_who_is_moved_at_once_leaves_nothing() -> None:
    robot = Robot(hold=5.0)
    robot.live(1.5)
    robot.live(0.3, speed=0.5)
    assert robot.scan.code == "MOVED"
    assert robot.scan.station() is None


def test_it_does_not_wait_for_ever() -> None:
    robot = Robot()
    robot.live(CONFIG.patience + 0.2, speed=0.3)
    assert robot.scan.code == "NOT_AT_REST"
    assert robot.scan.station() is None
    silent = Robot()
    silent.live(0.2)
    silent.scan.tick(silent.now_ns + S)
    assert silent.scan.code == "STALE_INPUT"
    lost = Robot()
    lost.live(2.0)
    lost.scan.tick(lost.now_ns, is_lost=True)
    assert lost.scan.code == "LOST"
    assert lost.scan.station() is None


def station(points: NDArray[np.floating]) -> Station:
    return Station(
        S, 0, SE3(), 5.0, 50, 30.0, CONFIG.cell, points.astype(np.float32), np.arange(len(points), dtype=np.float32)
    )


def test_memory_is_bounded_by_larger_cubes_for_all() -> None:
    clouds = StationClouds(replace(CONFIG, points_most=5000))
    rng = np.random.default_rng(2)
    for _ in range(10):
        clouds.add(station(rng.uniform(0.0, 1.0, (2000, 3)) * [1.0, 1.0, 0.01]))
        assert sum(len(s.points) for s in clouds.stations) <= 5000
    assert clouds.cell > CONFIG.cell
    assert len(clouds.stations) == 10
    for s in clouds.stations:
        assert len(s.points) == len(s.intensity) > 100
        assert s.density == 30.0
        cells = np.floor(s.points.astype(np.float64) / clouds.cell)
        assert len(np.unique(cells, axis=0)) == len(s.points)


def test_a_single_station_is_bounded_as_well() -> None:
    config = replace(CONFIG, points_most=1000)
    robot = Robot(hold=10.0, config=config)
    robot.live(11.0)
    assert robot.scan.cell > CONFIG.cell
    found = robot.scan.station()
    assert found is not None
    assert 300 < len(found.points) <= 1000
    clouds = StationClouds(config)
    clouds.add(found)
    assert clouds.cell == found.cell


def test_what_cannot_be_is_refused() -> None:
    for settings in ({"cell": 0.0}, {"rest_time": -1.0}, {"speed_most": math.nan}, {"points_most": 3}):
        with pytest.raises(BadInputError, match=next(iter(settings))):
            StationCloudConfig(**settings)  # type: ignore[arg-type]
