"""What a way is told from, when the mount is learned on it."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import spatial_error
from ambler.kernels import inertial as k
from ambler.lio.beginning import begun_covariance, since_start_jacobian, start_from_map
from ambler.lio.config import DriftConfig, LioConfig
from ambler.lio.drift import Drift
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.offline import offline_config, run_offline
from ambler.lio.start import level_rotation
from ambler.lio.state import FilterState, log, to_se3
from ambler.studies.lio_study import LioCase, make_rig
from tests.lio.carried import scans_of, walk

CONFIG = offline_config(LioConfig())


def state_of(*, seed: int) -> FilterState:
    rng = np.random.default_rng(seed)
    begun = FilterState(rotation=level_rotation(np.array([0.3, -0.2, 9.7])))
    begun.imu_from_lidar = SE3.from_rpy((0.1, -0.05, 0.2), 0.1, 0.3, -0.4).matrix()[:3].copy()
    return begun.plus(0.3 * rng.standard_normal(k.EXTRA + 7))


def lidar_of(state: FilterState) -> SE3:
    return state.map_from_imu @ to_se3(state.imu_from_lidar[:, 3], state.imu_from_lidar[:, :3])


def test_the_derivative_of_a_pose_since_the_start_is_that_of_differences() -> None:
    origin, state = state_of(seed=1), state_of(seed=2)
    n = k.EXTRA + 7
    begin = start_from_map(origin, state)
    here = begin @ state.map_from_imu
    jacobian = since_start_jacobian(origin, state, begin, n)
    step = 1e-6
    for column in range(n):
        moved = state.plus(step * np.eye(n)[column])
        there = start_from_map(origin, moved) @ moved.map_from_imu
        place = (np.array(there.translation) - np.array(here.translation)) / step
        turn = log((here.inverse() @ there).matrix()[:3, :3]) / step
        np.testing.assert_allclose(jacobian[:, column], np.r_[place, turn], atol=2e-5)


def test_at_the_start_nothing_of_the_mount_is_known_and_everything_of_the_place() -> None:
    begun = state_of(seed=3)
    covariance = begun_covariance(begun, CONFIG, True, 1.0)
    assert np.linalg.eigvalsh(covariance).min() > -1e-15
    place, turn = CONFIG.mount_sigma
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)[k.EXTRA : k.EXTRA + 6]), np.repeat([place, turn], 3))
    # The LiDAR lies in the map where its first scan was laid, whatever the mount turns out to be.
    for error in np.linalg.cholesky(covariance + 1e-18 * np.eye(len(covariance))).T:
        moved = begun.plus(error)
        off = (lidar_of(begun).inverse() @ lidar_of(moved)).matrix()
        assert np.linalg.norm(off[:3, 3]) < 5e-4
        assert np.linalg.norm(log(off[:3, :3])) < 5e-4
    jacobian = since_start_jacobian(begun, begun, SE3(), len(covariance))
    told = jacobian @ covariance @ jacobian.T
    assert np.sqrt(np.diag(told)).max() < 2e-4


@pytest.mark.parametrize("off", [(0.0, 0.3, 0.0), (0.3, 0.0, 0.0)])
def test_a_mount_that_leans_does_not_turn_the_way(off: tuple[float, float, float]) -> None:
    """The LiDAR leans by 0.3 degrees more than is told. In the map the IMU's poses turn by that; since the start they do not, and the covariance knows."""
    rig, recorded = walk()
    told = rig.mount @ SE3.from_rpy((0.0, 0.0, 0.0), *np.radians(off))
    odometry = LidarInertialOdometry(CONFIG, told)
    results = [r for scan in scans_of(recorded) if (r := odometry.update(scan)) is not None]
    stamps = np.array([r.stamp_ns for r in results], np.int64)
    truth = [s.world_from_imu for s in recorded[-len(results) :]]
    raw = spatial_error(stamps, [r.map_from_imu for r in results], stamps, truth)
    since = spatial_error(stamps, [r.start_from_imu for r in results], stamps, truth)
    assert raw.rotation_rms_deg > 0.2
    assert since.rotation_rms_deg < 0.6 * raw.rotation_rms_deg
    assert results[0].start_from_imu.matrix() == pytest.approx(results[0].map_from_imu.matrix(), abs=1e-6)
    turned = np.degrees(np.linalg.norm(log(results[-1].start_from_map.matrix()[:3, :3])))
    assert 0.15 < turned < 0.4  # what it has learned of 0.3
    whole = run_offline(scans_of(recorded), LioConfig(), told)
    ours = spatial_error(whole.stamps_ns, whole.poses, stamps, truth)
    assert ours.rotation_rms_deg < 0.6 * raw.rotation_rms_deg
    assert whole.poses[0].matrix() == pytest.approx(results[0].start_from_imu.matrix(), abs=1e-3)


def test_clocks_that_differ_by_a_millisecond_are_noticed() -> None:
    rig, recorded = walk()
    late = 1_500_000
    scans = [replace(s, cloud=replace(s.cloud, stamp_ns=s.cloud.stamp_ns - late)) for s in scans_of(recorded)]
    odometry = LidarInertialOdometry(CONFIG, rig.mount)
    for scan in scans:
        odometry.update(scan)
    assert odometry.state.clock == pytest.approx(rig.clock + 1e-9 * late, abs=4e-4)


@pytest.mark.parametrize("share", [0.0, -0.1, 1.1, float("nan")])
def test_a_share_that_is_none_and_a_beginning_without_extent_are_refused(share: float) -> None:
    with pytest.raises(BadInputError, match="learned_share"):
        LioConfig(learned_share=share)
    with pytest.raises(BadInputError, match="begin_m"):
        DriftConfig(begin_m=min(share, 0.0))


def test_leaving_the_start_counts_once() -> None:
    config = CONFIG.drift
    drift = Drift(config)
    for reach in (0.0, 0.2, 0.1, 3.0, 2.0, 5.0):
        drift.leave(reach)
    expected = np.repeat([config.begin_position**2, config.begin_rotation**2], 3)
    np.testing.assert_allclose(np.diag(drift.covariance(np.eye(3))), expected, rtol=1e-3)
    assert drift.begin_left < 1e-4


@pytest.mark.parametrize("seed", [11, 13])
def test_as_it_begins_to_move_the_gyroscope_knows_better_than_planes_through_rings(seed: int) -> None:
    """Outdoors the 16 rings of one place lie metres apart; the planes through them lean, and turned whatever was mapped afterwards."""
    rig = make_rig(LioCase("site", seed, "vlp_16", 100.0))
    recorded = list(islice(rig.scans(), 60))
    turned = []
    for noise in (0.0, LioConfig().drift.begin_noise):
        config = replace(LioConfig(), drift=replace(LioConfig().drift, begin_noise=noise))
        odometry = LidarInertialOdometry(config, rig.mount)
        results = [r for scan in scans_of(tuple(recorded)) if (r := odometry.update(scan)) is not None]
        truth = [s.world_from_imu for s in recorded[-len(results) :]]
        told = [results[0].map_from_imu.inverse() @ r.map_from_imu for r in results[-15:]]
        true = [truth[0].inverse() @ t for t in truth[-15:]]
        off = [log((a.inverse() @ b).matrix()[:3, :3]) for a, b in zip(told, true, strict=True)]
        turned.append(float(np.mean(np.linalg.norm(off, axis=1))))
    assert turned[1] < 0.9 * turned[0]


@pytest.mark.parametrize("lidar", ["vlp_16", "mid_360"])
def test_who_stands_since_the_start_is_turned_by_no_scan_nor_is_his_mount(lidar: str) -> None:
    """All its scans are of one place, and lean alike: matched with each other they turned a Mid-360 by 0.02 to 0.06 degrees before its first step."""
    rig = make_rig(LioCase("site", 11, lidar, 100.0))
    odometry = LidarInertialOdometry(CONFIG, rig.told_mount)
    scans = scans_of(tuple(islice(rig.scans(), 20)))
    results = [r for scan in scans if (r := odometry.update(scan)) is not None]
    assert len(results) > 8
    for result in results:
        assert result.health.is_at_rest
        np.testing.assert_array_equal(result.start_from_imu.matrix(), results[0].start_from_imu.matrix())
    np.testing.assert_allclose(odometry.state.imu_from_lidar, rig.told_mount.matrix()[:3], atol=2e-6)
    assert odometry.map.points().shape[0] > 1000


def test_who_glides_off_so_softly_that_no_gyroscope_notices_is_followed() -> None:
    rig = make_rig(LioCase("site", 11, "vlp_16", 100.0))
    odometry, step = LidarInertialOdometry(CONFIG, rig.told_mount), 0.01
    at_rest = scans_of(tuple(islice(rig.scans(), 20)))
    first, result = at_rest[12].cloud.points, None
    for number, scan in enumerate(at_rest):
        gone = step * max(0, number - 12)  # the scanner's own x, while its IMU says that it stands
        points = np.asarray(scan.cloud.points if gone == 0.0 else first - np.float32([gone, 0.0, 0.0]), np.float32)
        cloud = scan.cloud if gone == 0.0 else replace(at_rest[12].cloud, stamp_ns=scan.cloud.stamp_ns, points=points)
        result = odometry.update(replace(scan, cloud=cloud)) or result
    assert result is not None
    assert 0.02 < result.start_from_imu.translation[0] < step * 7 + 0.01


def test_returns_count_less_on_leaving_the_start_and_neither_at_rest_nor_later() -> None:
    rig, recorded = walk()
    odometry = LidarInertialOdometry(LioConfig(), rig.told_mount)
    factors = []
    for scan in scans_of(recorded):
        if odometry.update(scan) is not None:
            factors.append(odometry._noise_factor())
    assert factors[0] == 1.0
    assert max(factors) > 4.0
    assert factors[-1] == pytest.approx(1.0, abs=1e-3)


def test_mount_and_clock_take_their_share_of_an_update_and_the_pose_all_of_it() -> None:
    rig, recorded = walk()
    known = []
    for share in (1.0, 0.3):
        odometry = LidarInertialOdometry(replace(CONFIG, learned_share=share), rig.told_mount)
        for scan in scans_of(recorded)[:80]:
            odometry.update(scan)
        known.append(np.sqrt(np.diag(odometry.covariance)))
        assert np.linalg.eigvalsh(odometry.covariance).min() > -1e-12
    mount = slice(k.EXTRA + 3, k.EXTRA + 6)
    assert (known[1][mount] > 1.1 * known[0][mount]).all()
    assert (known[1][mount] < CONFIG.mount_sigma[1]).all()
