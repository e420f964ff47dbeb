"""Scans that are stamped late: how late is found by the turns that odometry and scans tell, in whichever order the beams were taken."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.recordings.lag import with_later_odometry
from ambler.recordings.log_scans import LogScan, planar_matrix
from ambler.slam2d.lag_search import LAG_MAX, find_lag
from ambler.slam2d.offline import run_offline
from tests.registration.room import BEAMS, beam_angles, ranges_at

PERIOD = 0.1  # s, and the time in which a scan's beams are taken
SECONDS = 14.0
ODOMETRY_PERIOD = 0.03
PARTS = 12  # of a scan, each taken at one instant


def pose_at(seconds: float, sway: float = 1.0) -> SE2:
    """Sways with up to 1.4 rad/s, never twice alike."""
    yaw = sway * (0.5 * math.sin(2.0 * seconds) + 0.3 * math.sin(1.3 * seconds))
    return SE2(0.6 * math.sin(0.5 * seconds), 0.3 * math.sin(0.8 * seconds), yaw)


def drive(
    lag: float,
    *,
    backward: bool = False,
    scale: float = 1.0,
    noise: float = 0.0,
    seconds: float = SECONDS,
    sway: float = 1.0,
) -> list[LogScan]:
    """Return scans whose stamps are `lag` seconds late and odometry with true stamps, its turns multiplied by `scale`."""
    rng, angles = np.random.default_rng(7), beam_angles()
    part = np.arange(BEAMS) * PARTS // BEAMS
    beam = np.array([angles[0], angles[1] - angles[0], PERIOD / BEAMS])
    odometry_times = np.arange(0.0, seconds, ODOMETRY_PERIOD)
    odometry = []
    for t in odometry_times:
        pose = pose_at(float(t), sway)
        odometry.append((round(t * 1e9), SE2(pose.x, pose.y, scale * pose.yaw + rng.normal(0.0, noise))))
    scans = []
    for t in np.arange(1.0, seconds - 1.0, PERIOD):
        parts = [ranges_at(pose_at(float(t) + PERIOD * (i + 0.5) / PARTS, sway), angles) for i in range(PARTS)]
        ranges = np.array(parts)[part[::-1] if backward else part, np.arange(BEAMS)] + rng.normal(0.0, 0.01, BEAMS)
        stamp_ns = round((t + lag) * 1e9)
        limits, mount = np.array([0.1, 30.0, 5.0]), planar_matrix(SE2())
        scans.append(LogScan(stamp_ns, ranges.astype(np.float32), beam, limits, mount, ()))
    scans[0] = replace(scans[0], odometry=tuple(odometry))
    return list(with_later_odometry(scans, 0.0))


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("lag", [-0.2, 0.07, 0.13, 0.45])
def test_the_lag_is_found(lag: float, backward: bool) -> None:
    found = find_lag(drive(lag, backward=backward))
    assert found is not None
    assert found.seconds == pytest.approx(lag, abs=0.015)
    assert found.miss < 0.5 * found.miss_before


@pytest.mark.parametrize("scale", [0.8, 1.3])
def test_wheels_that_skid_do_not_hide_it(scale: float) -> None:
    found = find_lag(drive(0.2, scale=scale))
    assert found is not None
    assert found.seconds == pytest.approx(0.2, abs=0.025)


@pytest.mark.parametrize("scale", [1.0, 1.3])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_stamps_of_one_clock_are_left_alone(scale: float, noise: float) -> None:
    assert find_lag(drive(0.0, scale=scale, noise=noise)) is None


def test_scans_are_placed_better_by_it() -> None:
    """What one instant told of the motion is not taken out of the scan of another."""

    def heading_error(scans: list[LogScan]) -> float:
        yaws = np.unwrap(run_offline(scans).poses[:, 2])
        true = np.array([pose_at(scan.stamp_ns * 1e-9 - lag).yaw for scan in scans])
        return float(np.std(yaws - true))

    lag = 0.3
    scans = drive(lag)
    found = find_lag(scans)
    assert found is not None
    after = heading_error(list(with_later_odometry(scans, found.seconds)))
    assert after < math.radians(0.1)
    assert heading_error(scans) > 3.0 * after


def test_what_tells_nothing_is_no_lag() -> None:
    late = drive(0.2)
    standing = [replace(scan, ranges=late[0].ranges) for scan in late]
    assert find_lag([]) is None
    assert find_lag(standing) is None
    assert find_lag([replace(scan, odometry=()) for scan in late]) is None
    assert (
        find_lag(late[: round(2 * LAG_MAX / PERIOD)]) is None
    )  # odometry that does not reach far enough to be shifted


def test_odometry_of_another_drive_has_no_lag() -> None:
    """Some shift always fits best; it explains nothing."""
    rng = np.random.default_rng(2)
    late = drive(0.2)
    yaws = iter(np.cumsum(rng.normal(0.0, 0.05, round(SECONDS / ODOMETRY_PERIOD) + 1)))
    other = [
        replace(scan, odometry=tuple((ns, SE2(p.x, p.y, float(next(yaws)))) for ns, p in scan.odometry))
        for scan in late
    ]
    assert find_lag(other) is None


def test_two_halves_that_tell_different_lags_are_not_believed() -> None:
    """A clock that was set in the middle of a recording."""
    early, late = drive(0.1), drive(0.5)
    both = [*early[:55], *(scan for scan in late if scan.stamp_ns > early[54].stamp_ns)]
    track = [entry for scan in early for entry in scan.odometry]
    both = [replace(scan, odometry=()) for scan in both]
    both[0] = replace(both[0], odometry=tuple(track))
    assert find_lag(with_later_odometry(both, 0.0)) is None


@pytest.mark.parametrize("comes_and_goes", [False, True])
def test_a_lag_that_elsewhere_explains_nothing_is_not_taken_out(comes_and_goes: bool) -> None:
    """Later in the recording the robot turns less, and its clocks agree; or they do not, as before."""
    first, later_ns = drive(0.2, seconds=19.0), 19_000_000_000
    second = [
        replace(scan, stamp_ns=scan.stamp_ns + later_ns, odometry=tuple((ns + later_ns, p) for ns, p in scan.odometry))
        for scan in drive(0.0 if comes_and_goes else 0.2, seconds=19.0, sway=0.8)
    ]
    assert (find_lag([*first, *second]) is None) == comes_and_goes


def test_later_odometry_is_handed_out_up_to_the_last_beam() -> None:
    scans = drive(0.0)
    moved = with_later_odometry(scans, 0.5)
    track, before = ([entry for scan in s for entry in scan.odometry] for s in (moved, scans))
    assert track == [(ns + 500_000_000, pose) for ns, pose in before][: len(track)]
    assert len(track) > 0.9 * len(before)
    for scan in moved[1:]:
        if scan.odometry:
            end_ns = scan.stamp_ns + round(scan.duration * 1e9)
            assert scan.odometry[-1][0] > end_ns >= scan.odometry[-1][0] - round(ODOMETRY_PERIOD * 1e9)
    assert [scan.stamp_ns for scan in moved] == [scan.stamp_ns for scan in scans]
