"""The whole filter on a short simulated walk, and on what goes wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import Imu, Odometry, PointCloud
from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import spatial_error
from ambler.kernels import inertial as kernels
from ambler.lio.config import DegeneracyConfig, LioConfig, RestConfig, WheelConfig
from ambler.lio.health import LioResult
from ambler.lio.measurements import wheel_velocity
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.offline import run_offline
from ambler.lio.start import LioInputError
from ambler.recordings.cloud_scan import CloudScan
from ambler.sim.hand_rig import HandRig, RigScan
from ambler.studies.lio_study import nees
from tests.lio.carried import scans_of, walk


def carried(
    scans: list[CloudScan], config: LioConfig | None = None, mount: SE3 | None = None
) -> tuple[LidarInertialOdometry, list[LioResult]]:
    rig, _ = walk()
    odometry = LidarInertialOdometry(config, mount if mount is not None else rig.told_mount)
    return odometry, [r for scan in scans if (r := odometry.update(scan)) is not None]


def error_of(results: list[LioResult], recorded: tuple[RigScan, ...]) -> float:
    stamps = np.array([s.end_ns for s in recorded], np.int64)
    ours = np.array([r.stamp_ns for r in results], np.int64)
    truth = [s.world_from_imu for s in recorded]
    return spatial_error(ours, [r.map_from_imu for r in results], stamps, truth).start_rms_m


def test_a_walk_is_followed_to_centimetres_and_the_covariance_says_so() -> None:
    _, recorded = walk()
    odometry, results = carried(scans_of(recorded))
    assert error_of(results, recorded) < 0.02
    truth = [s.world_from_imu for s in recorded[-len(results) :]]
    assert 0.1 < nees(results, truth) < 4.0
    assert not any(r.health.is_lost for r in results)
    assert np.mean([r.health.inlier_ratio for r in results]) > 0.6
    covariance = odometry.covariance
    assert (covariance == covariance.T).all()
    assert np.linalg.eigvalsh(covariance).min() > -1e-12


def wheels_of(rig: HandRig, stamp_ns: int, spinning: float) -> Odometry:
    """What wheels would measure that know no error, but spin `spinning` m/s too fast."""
    before, after = rig.pose_at(stamp_ns - 5_000_000), rig.pose_at(stamp_ns + 5_000_000)
    vx, vy, vz = np.array((before.inverse() @ after).translation) / 0.01
    nothing = np.zeros((6, 6))
    return Odometry(stamp_ns, "odom", "base", SE3(), (vx + spinning, vy, vz), (0.0, 0.0, 0.0), nothing, nothing)


@pytest.mark.parametrize("every", [1, 20])
def test_wheels_that_spin_carry_nobody_away(every: int) -> None:
    """For four seconds of the walk they turn 1 m/s too fast, as those of a robot that pushes against a kerb; of each scan `every` point is used."""
    rig, recorded = walk()
    scans = []
    for number, scan in enumerate(recorded):
        c, kept = scan.cloud, slice(None, None, every)
        thin = replace(c, points=c.points[kept], intensity=c.intensity[kept], time=c.time[kept], ring=c.ring[kept])
        wheels = wheels_of(rig, scan.end_ns, 1.0 if 60 <= number < 100 else 0.0)
        scans.append(CloudScan(thin, scan.imu, (wheels,)))
    odometry = LidarInertialOdometry(LioConfig(wheels=WheelConfig(sideways_sigma=0.3)), rig.told_mount, SE3())
    results = [r for scan in scans if (r := odometry.update(scan)) is not None]
    assert error_of(results, recorded) < 0.02


def test_wheels_that_tell_no_number_or_are_not_used_change_nothing() -> None:
    """One velocity that is no number gives way to the one before it; with `wheels.is_used` off, none counts."""
    rig, recorded = walk()
    good = [wheels_of(rig, scan.end_ns, 0.0) for scan in recorded[:60]]
    bad = [replace(wheels, linear=(np.nan, 0.0, 0.0)) for wheels in good]
    scans = scans_of(recorded[:60])

    def way(config: LioConfig, wheels: list[tuple[Odometry, ...]]) -> list[SE3]:
        odometry = LidarInertialOdometry(config, rig.told_mount, SE3())
        fed = [replace(scan, odometry=told) for scan, told in zip(scans, wheels, strict=True)]
        return [r.map_from_imu for scan in fed if (r := odometry.update(scan)) is not None]

    both = way(LioConfig(), list(zip(good, bad, strict=True)))
    assert both == way(LioConfig(), [(wheels,) for wheels in good])
    none = way(LioConfig(), [()] * 60)
    assert way(LioConfig(), [(wheels,) for wheels in bad]) == none
    assert way(LioConfig(wheels=WheelConfig(is_used=False)), [(wheels,) for wheels in good]) == none
    assert both != none


def test_wheels_within_their_noise_count_fully_and_those_that_spin_hardly_at_all() -> None:
    rig, recorded = walk()
    pulled = []
    for spinning in (0.02, 1.0):
        odometry = LidarInertialOdometry(LioConfig(), rig.told_mount, SE3())
        for scan in scans_of(recorded)[:60]:
            odometry.update(scan)
        odometry.covariance[6:9, 6:9] += 0.05**2 * np.eye(3)  # nothing but the wheels tells the speed
        before = odometry.state.velocity.copy()
        rate = odometry._knots[-1, kernels.W : kernels.W + 3]
        speed = tuple(odometry.state.rotation.T @ before + np.array([spinning, 0.0, 0.0]))
        told = replace(wheels_of(rig, recorded[59].end_ns, 0.0), linear=speed)
        measured = wheel_velocity(odometry.state, rate, told, SE3(), odometry.config.wheels)
        odometry._measure(measured, odometry.config.wheels.slip)
        pulled.append(float(np.linalg.norm(odometry.state.velocity - before)) / spinning)
    assert pulled[0] > 0.5
    assert pulled[1] < 0.15
    with pytest.raises(BadInputError, match="slip"):
        WheelConfig(slip=0.0)


@pytest.mark.parametrize("iterations", [1, 2, 5])
def test_the_prediction_counts_once_however_often_the_update_goes_round(iterations: int) -> None:
    rig, recorded = walk()
    scans = scans_of(recorded)
    odometry = LidarInertialOdometry(replace(LioConfig(), iterations_most=iterations), rig.told_mount)
    for scan in scans[:60]:
        odometry.update(scan)
    where = odometry.state.position.copy()
    odometry.state.position = where + np.array([0.0, 0.0, 0.02])
    odometry.covariance = np.diag(np.r_[[8e-3**2] * 3, [1e-12] * (len(odometry.covariance) - 3)])
    before = odometry.state.position[2]
    result = odometry.update(scans[60])
    truth = recorded[60].world_from_imu.translation[2] - recorded[59].world_from_imu.translation[2]
    assert result is not None
    gained = 1.0 - odometry.covariance[2, 2] / 8e-3**2  # Kalman: the share of the innovation by which it moved
    moved = before + truth - result.map_from_imu.translation[2]
    assert 0.3 < gained < 0.95
    assert moved == pytest.approx(0.02 * gained, abs=0.003)


@pytest.mark.parametrize("first", [35, 60])
def test_who_begins_in_motion_learns_how_fast_before_he_maps(first: int) -> None:
    """Taken to stand, he bent his first scan by 14 cm, and was 8 and 11 cm off in the mean."""
    rig, scans = walk()
    scans = scans[first:]
    result = run_offline(scans_of(scans), LioConfig(), rig.told_mount)
    assert "in motion" in result.note
    truth = [s.world_from_imu for s in scans]
    error = spatial_error(result.stamps_ns, result.poses, np.array([s.end_ns for s in scans]), truth)
    assert error.start_rms_m < 0.03


def test_the_map_is_level() -> None:
    _, recorded = walk()
    odometry, _ = carried(scans_of(recorded)[:60])
    points = odometry.map.points().astype(np.float64)
    floor = points[np.abs(points[:, 2] + 1.25) < 0.06]
    assert len(floor) > 200
    (slope_x, slope_y, height), *_ = np.linalg.lstsq(np.column_stack([floor[:, :2], np.ones(len(floor))]), floor[:, 2])
    assert max(abs(slope_x), abs(slope_y)) < 0.006  # bias of the accelerometer 2 mrad, the mount 1 mrad
    assert height == pytest.approx(-1.25, abs=0.02)


def test_equal_input_gives_equal_bits() -> None:
    _, recorded = walk()
    first, second = (carried(scans_of(recorded)[:60])[1] for _ in range(2))
    assert [r.map_from_imu for r in first] == [r.map_from_imu for r in second]


def test_forces_in_g_give_the_same_way() -> None:
    _, recorded = walk()
    scans = scans_of(recorded)[:100]
    in_g = [replace(s, imu=tuple(_scaled(i, 1.0, 1.0 / 9.80665) for i in s.imu)) for s in scans]
    ours, theirs = carried(scans)[1][-1], carried(in_g)[1][-1]
    np.testing.assert_allclose(ours.map_from_imu.translation, theirs.map_from_imu.translation, atol=1e-4)


def test_a_lidar_alone_follows_the_walk_too() -> None:
    _, recorded = walk()
    _, results = carried(scans_of(recorded), LioConfig(has_imu=False))
    assert len(results) == len(recorded)
    assert error_of(results, recorded) < 0.1


def test_a_wrong_mount_is_found_when_it_is_estimated() -> None:
    rig, recorded = walk()
    wrong = rig.mount @ SE3.from_rpy((0.0, 0.0, 0.0), 0.03, -0.03, 0.0)
    odometry, _ = carried(scans_of(recorded), LioConfig(estimates_mount=True), wrong)
    found = odometry.state.imu_from_lidar[:, :3].T @ rig.mount.matrix()[:3, :3]
    before = wrong.matrix()[:3, :3].T @ rig.mount.matrix()[:3, :3]
    assert np.arccos((np.trace(found) - 1) / 2) < 0.4 * np.arccos((np.trace(before) - 1) / 2)


def test_a_late_clock_is_found_when_it_is_estimated() -> None:
    _, recorded = walk()
    late = [replace(s, cloud=replace(s.cloud, stamp_ns=s.cloud.stamp_ns - 15_000_000)) for s in scans_of(recorded)]
    odometry, _ = carried(late, LioConfig(estimates_clock=True))
    assert odometry.state.clock == pytest.approx(0.015, abs=0.004)


def test_at_rest_nothing_moves_and_the_map_does_not_grow() -> None:
    _, recorded = walk()
    first = scans_of(recorded)[:18]
    still: list[CloudScan] = []
    for turn in range(12):  # the same two seconds again and again, 20 s on end
        shift = turn * 1_800_000_000
        still += [_later(s, shift) for s in first]
    odometry, results = carried(still)
    start = np.array(results[15].map_from_imu.translation)
    assert max(float(np.linalg.norm(np.array(r.map_from_imu.translation) - start)) for r in results[15:]) < 0.003
    assert np.mean([r.health.is_at_rest for r in results[15:]]) > 0.8
    points = len(odometry.map.points())
    for scan in first:
        odometry.update(_later(scan, 12 * 1_800_000_000))
    assert len(odometry.map.points()) == points


def _seen_in_a_stairwell(shift: SE3) -> np.ndarray:
    """What 16 rings see in a stairwell of 4.8 by 4 m, float32 (N, 3)."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0.0, 360.0, 0.5)), np.radians(np.arange(-15.0, 16.0, 2.0)))
    level = np.cos(elevation)
    beams = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    beams = beams @ shift.matrix()[:3, :3].T
    half, place = np.array([2.4, 2.0, 1.5]), np.array(shift.translation)
    with np.errstate(divide="ignore"):
        ranges = ((np.sign(beams) * half - place) / beams).min(axis=1)
    return np.asarray(ranges[:, None] * beams @ shift.matrix()[:3, :3], np.float32)


def test_the_first_map_of_a_narrow_place_is_as_dense_as_later_ones() -> None:
    """Cells of half a metre leave few points of a stairwell, whose planes would lean."""
    _, recorded = walk()
    points = _seen_in_a_stairwell(SE3.from_rpy((0.2, 0.1, 0.0), 0.02, 0.03, 0.4))
    zero = np.zeros(len(points), np.float32)
    scan = scans_of(recorded)[0]
    odometry = LidarInertialOdometry(LioConfig(has_imu=False))
    result = odometry.update(
        CloudScan(PointCloud(scan.cloud.stamp_ns, "lidar", points, zero, zero, zero.astype(np.uint16)), (), ())
    )
    assert result is not None
    assert result.health.points > 0.5 * odometry.config.scan.points_wanted


def _outage(first: list[CloudScan], turns: int) -> tuple[tuple[Imu, ...], int]:
    """The inertial measurements of scans at rest, `turns` times on end, and how much later they end."""
    shifts = [turn * 1_800_000_000 for turn in range(1, turns + 1)]
    return tuple(i for shift in shifts for scan in first for i in _later(scan, shift).imu), shifts[-1]


@pytest.mark.parametrize("rest", [RestConfig(), RestConfig(way_most=0.0)], ids=["where it began", "elsewhere"])
def test_who_stands_through_a_minute_without_clouds_is_where_he_was(rest: RestConfig) -> None:
    """The inertial measurements of the outage tell that it stands, although the speed that a minute of them adds up to does not."""
    _, recorded = walk()
    first = scans_of(recorded)[:18]
    odometry, results = carried(first, LioConfig(rest=rest))
    imu, shift = _outage(first, 33)
    again = [_later(scan, shift + 1_800_000_000) for scan in first]
    again[0] = replace(again[0], imu=imu + again[0].imu)
    later = [r for scan in again if (r := odometry.update(scan)) is not None]
    assert len(later) == len(again)
    assert not any(r.health.is_lost for r in later)
    start = np.array(results[-1].map_from_imu.translation)
    assert max(float(np.linalg.norm(np.array(r.map_from_imu.translation) - start)) for r in later) < 0.01


def test_after_an_outage_what_fits_nowhere_begins_no_other_map() -> None:
    """Scans of another place are lost until one fits again, and then it is where it was."""
    _, recorded = walk()
    first = scans_of(recorded)[:18]
    odometry, results = carried([*first, *(_later(scan, 1_800_000_000) for scan in first)], LioConfig(insert_m=0.0))
    imu, shift = _outage(first, 4)
    again = [_later(scan, shift + 1_800_000_000) for scan in first]
    again[0] = replace(again[0], imu=imu + again[0].imu)
    for k in range(4):
        away = again[k].cloud.points + np.float32([0.0, 0.0, 60.0])
        again[k] = replace(again[k], cloud=replace(again[k].cloud, points=away))
    points = len(odometry.map.points())
    later = [r for scan in again[:4] if (r := odometry.update(scan)) is not None]
    assert len(odometry.map.points()) == points
    later += [r for scan in again[4:] if (r := odometry.update(scan)) is not None]
    assert [r.health.is_lost for r in later] == [True] * 4 + [False] * 14
    off = np.subtract(later[-1].map_from_imu.translation, results[-1].map_from_imu.translation)
    assert float(np.linalg.norm(off)) < 0.01


def test_points_that_are_none_and_gaps_in_the_imu_do_no_harm() -> None:
    _, recorded = walk()
    scans = scans_of(recorded)
    for k in range(40, 200, 7):
        cloud = scans[k].cloud
        points = cloud.points.copy()
        points[::5] = np.nan
        scans[k] = replace(scans[k], cloud=replace(cloud, points=points))
    scans[100] = replace(scans[100], imu=scans[100].imu[:2] + scans[100].imu[-1:])
    scans[120] = replace(scans[120], cloud=_empty(scans[120].cloud))
    _, results = carried(scans)
    assert error_of(results, recorded) < 0.03
    assert max(r.health.imu_gap for r in results) > 0.05


def test_a_hole_in_the_inertial_measurements_is_as_long_as_it_is() -> None:
    _, recorded = walk()
    scans = [replace(s, imu=()) if 80 <= k < 90 else s for k, s in enumerate(scans_of(recorded)[:110])]
    _, results = carried(scans)
    assert max(r.health.imu_gap for r in results) > 0.9


@pytest.mark.parametrize(("first", "count"), [(40, 5), (90, 5), (130, 15), (160, 30)])
def test_clouds_lead_through_a_time_without_inertial_measurements(first: int, count: int) -> None:
    """The next measurement comes with the first of those clouds, as a recording gives it, and tells little of what was between."""
    _, recorded = walk()
    scans = scans_of(recorded)
    last = first + count
    for k in range(first, last):
        scans[k] = replace(scans[k], imu=scans[last].imu[:1] if k == first else ())
    scans[last] = replace(scans[last], imu=scans[last].imu[1:])
    _, results = carried(scans)
    assert max(r.health.imu_gap for r in results) > 0.09 * count
    assert not any(r.health.is_contradicted or r.health.is_lost for r in results)
    assert error_of(results, recorded) < 0.017  # 0.011 with all of them


def test_clouds_far_from_all_inertial_measurements_are_refused() -> None:
    _, recorded = walk()
    late = [
        replace(s, cloud=replace(s.cloud, stamp_ns=s.cloud.stamp_ns + 1000 * 10**9)) for s in scans_of(recorded)[:40]
    ]
    with pytest.raises(LioInputError, match="the clocks differ"):
        carried(late)


def test_inertial_measurements_too_far_behind_the_clouds_are_named() -> None:
    _, recorded = walk()
    first = replace(next(iter(scans_of(recorded))), imu=(), is_overdue=True)
    with pytest.raises(LioInputError, match="first 300 MB of clouds: they begin later, or lie too far behind"):
        carried([first])


def test_without_inertial_measurements_it_says_so() -> None:
    _, recorded = walk()
    with pytest.raises(LioInputError, match="no inertial measurements"):
        carried([replace(scans_of(recorded)[0], imu=())])


def test_a_recording_whose_measurements_are_no_numbers_is_refused_with_their_count() -> None:
    rig, recorded = walk()
    scans = [
        replace(scan, imu=tuple(_scaled(sample, 1.0, np.nan) for sample in scan.imu))
        for scan in scans_of(recorded)[:20]
    ]
    with pytest.raises(BadInputError, match=r"never began.*inertial measurements were refused"):
        run_offline(scans, LioConfig(), rig.told_mount)


def test_registered_points_lie_where_the_room_is() -> None:
    rig, recorded = walk()
    odometry, results = carried(scans_of(recorded)[:100])
    last = recorded[99]
    world_from_map = last.world_from_imu @ results[-1].map_from_imu.inverse()
    world = world_from_map.transform(odometry.registered(last.cloud))
    assert np.abs(world[world[:, 2] < 0.3, 2]).max() < 0.3
    assert np.median(np.abs(world[world[:, 2] < 0.1, 2])) < 0.02
    assert rig.scene.solids.floor == 0.0


def _scaled(sample: Imu, rate: float, force: float) -> Imu:
    w, a = sample.angular_velocity, sample.linear_acceleration
    return replace(
        sample,
        angular_velocity=(rate * w[0], rate * w[1], rate * w[2]),
        linear_acceleration=(force * a[0], force * a[1], force * a[2]),
    )


def _later(scan: CloudScan, shift_ns: int) -> CloudScan:
    imu = tuple(replace(i, stamp_ns=i.stamp_ns + shift_ns) for i in scan.imu)
    return replace(scan, cloud=replace(scan.cloud, stamp_ns=scan.cloud.stamp_ns + shift_ns), imu=imu)


def _empty(cloud: PointCloud) -> PointCloud:
    return replace(
        cloud, points=cloud.points[:0], intensity=cloud.intensity[:0], time=cloud.time[:0], ring=cloud.ring[:0]
    )


def test_forces_of_the_wrong_sign_contradict_what_the_lidar_sees() -> None:
    """At rest they only turn what is up; the way was 18 m off, and nothing was said."""
    rig, recorded = walk()

    def turned(scan: CloudScan) -> CloudScan:
        imu = [replace(s, linear_acceleration=tuple(-force for force in s.linear_acceleration)) for s in scan.imu]
        return replace(scan, imu=tuple(imu))

    scans = scans_of(recorded)[:120]
    assert run_offline(scans, LioConfig(), rig.told_mount).contradicted == 0
    wrong = run_offline([turned(scan) for scan in scans], LioConfig(), rig.told_mount)
    assert not wrong.is_sure
    assert any("fit badly" in line for line in wrong.warnings())


def test_what_hardly_any_plane_faces_is_told_unless_wheels_tell_it() -> None:
    """In the open and in a stairwell leaning planes tell a way that was not gone; in a yard, as faint, the right one."""
    rig, recorded = walk()
    scans = scans_of(recorded)[:120]
    right = run_offline(scans, LioConfig(), rig.told_mount)
    assert right.faint == 0
    assert right.is_sure
    doubtful = LioConfig(degeneracy=DegeneracyConfig(share_faint=0.4))
    result = run_offline(scans, doubtful, rig.told_mount)
    assert result.faint > 0.5 * len(result.poses)
    assert result.faint <= len(result.poses) - result.at_rest
    assert any("face some direction" in warning for warning in result.warnings())
    assert not any("face some direction" in warning for warning in right.warnings())
    driven = [replace(scan, odometry=(wheels_of(rig, scan.end_ns, 0.0),)) for scan in scans]
    assert run_offline(driven, doubtful, rig.told_mount, SE3()).faint == 0


def test_a_place_uncertain_by_a_tenth_of_the_way_is_no_map() -> None:
    rig, recorded = walk()
    result = run_offline(scans_of(recorded)[:120], LioConfig(), rig.told_mount)
    vague = replace(result, covariances=result.covariances + 4.0 * np.eye(6))
    assert replace(vague, degenerate=0).is_sure
    assert not replace(vague, degenerate=1).is_sure
    assert any("not to be trusted" in warning for warning in replace(vague, degenerate=1).warnings())
