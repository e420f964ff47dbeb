"""Odometry of a base at the IMU's rate: as exact between scans as at them, honest about it, and silent when nothing fits."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import Odometry
from ambler.core.se3 import SE3
from ambler.lio.base_odometry import BaseOdometry
from ambler.lio.carry import CarriedState
from ambler.lio.config import LioConfig, WheelConfig
from ambler.lio.odometry import LidarInertialOdometry
from tests.lio.carried import scans_of, walk

IMU_FROM_BASE = SE3.from_rpy((0.3, -0.1, -0.8), 0.1, -0.2, 1.0)
NO_WHEELS = LioConfig(wheels=WheelConfig(is_used=False))


@functools.cache
def told(late: int = 0, blind_from: int | None = None) -> tuple[Odometry, ...]:
    """Odometry of the walk. Each scan is registered `late` inertial measurements after it is complete; from scan `blind_from` on none comes."""
    rig, recorded = walk()
    odometry = BaseOdometry(NO_WHEELS, rig.told_mount, IMU_FROM_BASE)
    out, waiting = [], []
    for number, scan in enumerate(recorded):
        if blind_from is None or number < blind_from:
            odometry.add(scan.cloud)
        for sample in scan.imu:
            message = odometry.add(sample)
            if message is not None:
                out.append(message)
            waiting = [(scan, left - 1) for scan, left in waiting] + [(scan, late) for scan in odometry.scans()]
            while waiting and waiting[0][1] <= 0:
                registered = odometry.register(waiting.pop(0)[0])
                if registered is not None:
                    odometry.take(registered)
    return tuple(out)


def errors(messages: tuple[Odometry, ...]) -> np.ndarray:
    """Position errors (N, 3) in the frame of the first message."""
    rig, _ = walk()
    world_from_odom = rig.pose_at(messages[0].stamp_ns) @ IMU_FROM_BASE @ messages[0].pose.inverse()
    return np.array(
        [
            np.subtract((world_from_odom @ m.pose).translation, (rig.pose_at(m.stamp_ns) @ IMU_FROM_BASE).translation)
            for m in messages
        ]
    )


def test_it_is_told_at_the_rate_of_the_imu_and_as_exact_as_the_scans() -> None:
    messages = told(late=5)
    stamps = np.array([m.stamp_ns for m in messages])
    assert np.diff(stamps).max() < 6e6  # 200 Hz
    assert (np.diff(stamps) > 0).all()
    assert 1e-4 < float(np.sqrt((errors(messages) ** 2).sum(axis=1).mean())) < 0.03


def test_a_late_scan_costs_little_because_the_measurements_since_are_walked_again() -> None:
    at_once, late = errors(told(late=0)), errors(told(late=12))
    assert np.linalg.norm(late, axis=1).max() < np.linalg.norm(at_once, axis=1).max() + 0.01


def test_it_begins_level_under_the_base_with_its_heading() -> None:
    first = told()[0]
    rig, _ = walk()
    lean = (rig.pose_at(first.stamp_ns) @ IMU_FROM_BASE).matrix()[2, :3]
    assert first.pose.translation == pytest.approx((0.0, 0.0, 0.0), abs=2e-3)
    assert first.pose.to_se2().yaw == pytest.approx(0.0, abs=1e-3)
    assert first.pose.matrix()[2, :3] == pytest.approx(lean, abs=5e-3)  # gravity's direction in the base
    assert (first.frame, first.child) == ("odom", "base")


def test_velocities_are_those_of_the_base_not_of_the_imu() -> None:
    rig, _ = walk()
    off, speeds = [], []
    for m in told()[200:-200:37]:
        before, after = (rig.pose_at(m.stamp_ns + dt) @ IMU_FROM_BASE for dt in (-5_000_000, 5_000_000))
        way = (before.inverse() @ after).translation
        off.append(np.subtract(m.linear, np.divide(way, 0.01)))
        speeds.append(np.linalg.norm(way) / 0.01)
    assert max(speeds) > 1.0
    assert float(np.sqrt(np.square(off).mean())) < 0.03


def test_the_covariance_holds_the_errors() -> None:
    messages = told(late=5)[::50]
    off = errors(messages)
    nees = [e @ np.linalg.solve(m.pose_covariance[:3, :3], e) / 3.0 for e, m in zip(off[1:], messages[1:], strict=True)]
    assert 0.05 < float(np.mean(nees)) < 4.0
    for m in messages:
        assert np.linalg.eigvalsh(m.pose_covariance).min() > 0.0
        assert np.linalg.eigvalsh(m.twist_covariance).min() > 0.0


def test_without_scans_it_coasts_for_a_second_and_then_says_nothing() -> None:
    _, recorded = walk()
    messages = told(blind_from=60)
    last = recorded[59].end_ns
    beyond = (messages[-1].stamp_ns - last) * 1e-9
    assert 0.9 < beyond <= NO_WHEELS.coast_most + 0.01
    assert np.linalg.norm(errors(messages)[-1]) < 0.2
    spread = [math.sqrt(m.pose_covariance[0, 0]) for m in (messages[-220], messages[-1])]
    assert spread[1] > 2.0 * spread[0]  # and its covariance grows meanwhile


def test_a_correction_of_the_map_moves_what_is_told_in_odom_as_it_moves_the_map() -> None:
    rig, recorded = walk()
    odometry = BaseOdometry(NO_WHEELS, rig.told_mount, IMU_FROM_BASE)
    found = None
    for scan in recorded[:15]:
        odometry.add(scan.cloud)
        for sample in scan.imu:
            odometry.add(sample)
        for ready in odometry.scans():
            found = odometry.register(ready) or found
            if found is not None:
                odometry.take(found)
    assert found is not None
    correction = SE3.from_rpy((1.0, -2.0, 0.5), 0.1, 0.2, 1.0)
    corrected = odometry.in_odom(correction.transform(found.points).astype(np.float32))
    told = odometry.between_odoms(correction).transform(odometry.in_odom(found.points))
    assert told == pytest.approx(corrected, abs=1e-4)
    assert np.abs(told - odometry.in_odom(found.points)).max() > 1.0


def test_before_the_start_it_says_nothing() -> None:
    _, recorded = walk()
    assert (told()[0].stamp_ns - recorded[0].cloud.stamp_ns) * 1e-9 > 0.9  # a second of rest


def test_a_minute_without_clouds_is_digested_as_it_comes() -> None:
    """No scan then holds more than ten seconds of measurements, and where the robot stood is told on."""
    rig, recorded = walk()
    odometry = BaseOdometry(NO_WHEELS, rig.told_mount, IMU_FROM_BASE)
    rest, spans, out = recorded[:18], [], []
    for turn in range(36):
        for scan in rest:
            shift = turn * 1_800_000_000
            if turn in (0, 1, 34, 35):
                odometry.add(replace(scan.cloud, stamp_ns=scan.cloud.stamp_ns + shift))
            for sample in scan.imu:
                out.append(odometry.add(replace(sample, stamp_ns=sample.stamp_ns + shift)))
                for ready in odometry.scans():
                    spans.append(1e-9 * (ready.imu[-1].stamp_ns - ready.imu[0].stamp_ns))
                    registered = odometry.register(ready)
                    if registered is not None:
                        odometry.take(registered)
    assert len(spans) > 4 * 18 - 2 + 8
    assert max(spans) < 10.1
    assert out[-1] is not None
    assert np.linalg.norm(out[-1].pose.translation) < 0.01


def test_measurements_wait_for_a_scan_for_ten_seconds_at_most() -> None:
    _, recorded = walk()
    carried = CarriedState(NO_WHEELS.imu)
    for k in range(4000):
        carried.add(replace(recorded[0].imu[0], stamp_ns=k * 5_000_000))
    assert len(carried) == pytest.approx(2000, abs=2)


def test_nothing_is_told_of_poses_whose_inertial_measurements_are_no_numbers() -> None:
    rig, recorded = walk()
    odometry = BaseOdometry(NO_WHEELS, rig.told_mount, IMU_FROM_BASE)
    clean = LidarInertialOdometry(NO_WHEELS, rig.told_mount)
    wholes = iter(scans_of(recorded))
    for scan in recorded[:40]:
        odometry.add(scan.cloud)
        for sample in scan.imu:
            bad = replace(sample, stamp_ns=sample.stamp_ns - 1_000_000, angular_velocity=(math.nan, 0.0, 0.0))
            assert odometry.add(bad) is None
            odometry.add(sample)
        for ready in odometry.scans():
            registered = odometry.register(ready)
            expected = clean.update(next(wholes))
            assert (registered is None) == (expected is None)
            if registered is not None and expected is not None:
                ours, theirs = registered.result.map_from_imu, expected.map_from_imu
                assert ours.translation == pytest.approx(theirs.translation, abs=1e-4)
                odometry.take(registered)
