"""Wrong units, clocks and mounts are named; a sound recording is not accused."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from ambler.core.messages import Imu
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig
from ambler.lio.doctor import Diagnosis, compare_turns, examine, first_seconds
from ambler.recordings.cloud_scan import CloudScan
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import HandRig
from ambler.sim.sensors import MID_360
from ambler.sim.solids import Shape, Solid, WorldSpec
from tests.lio.carried import scans_of, walk


def examined(scans: list[CloudScan], mount: SE3 | None = None) -> Diagnosis:
    rig, _ = walk()
    return examine(scans, LioConfig(), mount if mount is not None else rig.told_mount)


def with_rates(scale: float, shift_ns: int = 0) -> list[CloudScan]:
    _, recorded = walk()
    out = []
    for scan in scans_of(recorded)[:120]:
        imu = tuple(
            replace(
                i,
                stamp_ns=i.stamp_ns + shift_ns,
                angular_velocity=tuple(scale * w for w in i.angular_velocity),
            )
            for i in scan.imu
        )
        out.append(replace(scan, imu=imu))
    return out


def packets(scans: list[CloudScan], parts: int = 10) -> list[CloudScan]:
    """Parts of turns, as some drivers send them."""
    out, width = [], 0.1 / parts
    for scan in scans:
        c, part = scan.cloud, np.floor(scan.cloud.time / width).astype(int)
        for j in range(parts):
            kept, time = part == j, (c.time - np.float32(width * j)).astype(np.float32)
            stamp_ns = c.stamp_ns + round(width * j * 1e9)
            cloud = replace(c, stamp_ns=stamp_ns, points=c.points[kept], time=time[kept])
            cloud = replace(cloud, ring=c.ring[kept], intensity=c.intensity[kept])
            out.append(replace(scan, cloud=cloud, imu=scan.imu if j == 0 else ()))
    return out


def test_the_first_seconds_are_examined_however_many_parts_a_turn_has() -> None:
    """A hundred and twenty tenths of turns were a second of rest, in which no unit can be wrong."""
    whole = with_rates(np.degrees(1.0))
    parts = list(first_seconds(packets(whole), 10.0))
    assert len(list(first_seconds(whole, 10.0))) == pytest.approx(100, abs=2)
    assert len(parts) == pytest.approx(1000, abs=20)
    assert "degrees per second" in examined(parts).troubles[0]


@pytest.mark.parametrize("parts", [2, 10])
def test_a_sound_recording_in_parts_of_turns_is_not_accused(parts: int) -> None:
    """Halves of turns were accused of a wrong mount (agreement -0.05), tenths agreed at 0.66."""
    diagnosis = examined(packets(with_rates(1.0)[:70], parts))
    assert diagnosis.troubles == ()
    assert diagnosis.agreement is not None
    assert diagnosis.agreement > (0.9 if parts == 10 else 0.6)


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_what_the_lidar_does_not_follow_accuses_nobody(seed: int) -> None:
    """For two seconds the plate is spun to and fro, between the middles of scans, by more than can be followed; what was made of them had hardly to do with the gyroscope's turns."""
    scans, rng = with_rates(1.0), np.random.default_rng(seed)
    jumps = np.zeros(len(scans))
    jumps[70:90] = rng.choice([-1.0, 1.0], 20) * rng.uniform(0.7, 1.2, 20)
    jumps[89] -= jumps.sum()
    middles = np.array([scan.cloud.stamp_ns + 50_000_000 for scan in scans])
    yaws = np.cumsum(jumps)

    def spun(vector: np.ndarray, yaw: float) -> np.ndarray:
        """The same in axes that are turned about the vertical."""
        c, s = np.cos(yaw), np.sin(yaw)
        return vector @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def felt(sample: Imu) -> Imu:
        k = min(int(np.searchsorted(middles, sample.stamp_ns)), len(scans) - 1)
        x, y, z = spun(np.array(sample.angular_velocity), float(yaws[k])).tolist()
        return replace(sample, angular_velocity=(x, y, z + 10.0 * float(jumps[k])))

    for k, scan in enumerate(scans):
        points = np.ascontiguousarray(spun(scan.cloud.points, float(yaws[k])), np.float32)
        imu = tuple(felt(sample) for sample in scan.imu)
        scans[k] = replace(scan, cloud=replace(scan.cloud, points=points), imu=imu)
    diagnosis = examined(scans)
    assert diagnosis.troubles == ()
    assert diagnosis.agreement is not None
    assert diagnosis.agreement > 0.9


def test_a_sound_recording_is_not_accused() -> None:
    diagnosis = examined(with_rates(1.0))
    assert diagnosis.troubles == ()
    assert diagnosis.rate_ratio == pytest.approx(1.0, abs=0.05)
    assert diagnosis.shift == pytest.approx(0.0, abs=0.016)


def test_degrees_per_second_are_named() -> None:
    assert "degrees per second" in examined(with_rates(180.0 / np.pi)).troubles[0]
    assert "twice" in examined(with_rates(np.pi / 180.0)).troubles[0]


def test_a_clock_that_is_off_is_named_with_the_cure() -> None:
    diagnosis = examined(with_rates(1.0, 100_000_000))
    troubles = diagnosis.troubles
    assert diagnosis.shift == pytest.approx(0.1, abs=0.016)
    assert any("lidar_clock=0.1" in t for t in troubles)


def test_a_clock_that_was_named_is_no_trouble_once_it_is_told() -> None:
    """Who did what the refusal asked for had been refused again."""
    rig, _ = walk()
    told = LioConfig(lidar_clock=0.1)
    assert examine(with_rates(1.0, 100_000_000), told, rig.told_mount).troubles == ()
    more = examine(with_rates(1.0, 220_000_000), told, rig.told_mount)
    assert more.shift == pytest.approx(0.12, abs=0.016)
    assert any("lidar_clock=0.2" in t for t in more.troubles)


def test_a_mount_that_is_turned_is_named() -> None:
    turned = SE3.from_rpy((0.0, 0.0, 0.0), np.pi, 0.0, 0.0)
    assert any("other axes" in t for t in examined(with_rates(1.0), turned).troubles)


def test_a_recording_at_rest_says_nothing() -> None:
    assert examined(with_rates(1.0)[:18]) == Diagnosis(())


def turning(rng: np.random.Generator, scale: float, noise: float) -> Diagnosis:
    """Turns about the vertical as a gyroscope says, 1 / `scale` of which a LiDAR does that follows them with `noise` (rad/s)."""
    times = np.arange(0.0, 6.0, 0.1)
    at = np.arange(-0.5, 6.5, 0.005)
    rate = np.abs(np.sin(1.7 * at))
    rows = np.column_stack([at, np.zeros_like(at), np.zeros_like(at), rate])
    seen = scale * np.interp(times[1:] - 0.05, at, rate) + rng.normal(0.0, noise, len(times) - 1)
    return compare_turns(np.column_stack([0.0 * seen, 0.0 * seen, seen]), times, rows, SE3())


def test_a_moderate_difference_is_named_where_the_lidar_follows_well_only() -> None:
    rng = np.random.default_rng(0)
    assert turning(rng, 1.0, 0.02).troubles == ()
    assert "1.60 times as fast" in turning(rng, 1.6, 0.02).troubles[0]
    # A robot in the open that turns on the spot as soon as it is switched on: its LiDAR alone overshoots by half of the turn, and correlates with 0.7.
    assert turning(rng, 1.6, 0.45).troubles == ()


def pulses(delay: float, late: float, noise: float) -> Diagnosis:
    """A long turn and a quick one, by a LiDAR whose stamps are `delay` s off, and which follows the quick one `late` s late."""
    rng = np.random.default_rng(3)
    at, times = np.arange(-1.0, 7.0, 0.005), np.arange(0.0, 6.0, 0.1)
    rate = np.exp(-(((at - 2.6) / 0.7) ** 2)) + np.exp(-(((at - 4.8) / 0.35) ** 2))
    rows = np.column_stack([at, 0.0 * at, 0.0 * at, rate])
    middles = times[1:] - 0.05
    seen = np.interp(middles + delay - late * (middles > 4.0), at, rate) + rng.normal(0.0, noise, len(middles))
    return compare_turns(np.column_stack([0.0 * seen, 0.0 * seen, seen]), times, rows, SE3())


def test_a_lidar_that_follows_one_turn_late_has_no_wrong_clock() -> None:
    told = pulses(0.15, 0.0, 0.05)
    assert "the clocks differ by +0.1" in told.troubles[0]
    assert told.shift == pytest.approx(0.15, abs=0.02)
    assert pulses(0.0, 0.0, 0.05).troubles == ()
    assert pulses(0.0, 0.3, 0.05).troubles == ()


def rocking(turn_seen: float, rock_seen: float, mount: SE3) -> Diagnosis:
    """A body that turns slowly while it rocks about its other axes, of which turning and rocking a LiDAR alone sees such shares (with noise)."""
    rng = np.random.default_rng(4)
    at, times = np.arange(-0.5, 6.5, 0.005), np.arange(0.0, 6.0, 0.1)
    growing = np.clip(0.15 * at, 0.0, None)
    turns = np.column_stack(
        [0.3 * growing * np.sin(9.0 * at), 0.3 * growing * np.cos(9.0 * at), growing * np.sin(1.7 * at)]
    )
    middles = times[1:] - 0.05
    seen = np.column_stack([np.interp(middles, at, turns[:, j]) for j in range(3)])
    seen *= (rock_seen, rock_seen, turn_seen)
    told = turns @ mount.matrix()[:3, :3].T
    return compare_turns(seen + rng.normal(0.0, 0.01, seen.shape), times, np.column_stack([at, told]), SE3())


def test_rocking_that_a_lidar_hardly_sees_accuses_nobody() -> None:
    upright, lying = SE3(), SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.5 * np.pi, 0.0)
    assert rocking(1.0, 1.0, upright).troubles == ()
    in_the_open = rocking(1.0, 0.05, upright)
    assert in_the_open.troubles == ()
    assert in_the_open.rate_ratio == pytest.approx(1.0, abs=0.1)
    assert "0.60 times as fast" in rocking(0.6, 0.03, upright).troubles[0]
    assert "other axes" in rocking(1.0, 0.05, lying).troubles[0]


def test_turns_over_a_plain_accuse_nobody() -> None:
    """A plain with nine posts: the LiDAR alone cannot tell a turn about the vertical, and was taken for one that is mounted in other axes."""
    rng = np.random.default_rng(4)
    posts = []
    for _ in range(9):
        angle, far = float(rng.uniform(0.0, 6.28)), float(rng.uniform(12.0, 40.0))
        place = SE2(far * math.cos(angle), far * math.sin(angle), 0.0)
        posts.append(Solid("post", Shape.CYLINDER, place, 0.2, 0.2, 0.0, 3.0))
    around = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    way = np.column_stack([8.0 * np.cos(around), 8.0 * np.sin(around), np.full(40, 1.25)])
    world = WorldSpec("plain", tuple(posts), SE2(8.0, 0.0, 0.0))
    rig = HandRig(world, HandPath(way), replace(MID_360, columns=2000), 8)
    scans = [CloudScan(scan.cloud, scan.imu, ()) for scan in islice(rig.scans(), 120)]
    assert examined(scans, rig.told_mount).troubles == ()


def test_a_turn_that_has_just_begun_accuses_nobody() -> None:
    """Rates that only rise fit themselves shifted, where they are of another size: a sound recording of a drone was refused."""
    at, times = np.arange(0.0, 12.3, 0.005), np.arange(0.05, 12.0, 0.1)
    rng = np.random.default_rng(0)

    def rising(t: np.ndarray) -> np.ndarray:
        return np.asarray(1.5 * np.clip((t - 10.0) / 2.0, 0.0, 1.2) ** 1.6)

    rows = np.column_stack([at, 0.0 * at, 0.0 * at, rising(at)])
    seen = rising(times[1:] - 0.05) + rng.normal(0.0, 0.02, len(times) - 1)
    seen[-3:] *= 1.3
    turns = np.column_stack([0.0 * seen, 0.0 * seen, seen])
    assert compare_turns(turns, times, rows, SE3()).troubles == ()
    assert "times as fast" in compare_turns(1.6 * turns, times, rows, SE3()).troubles[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mount_that_is_tilted_by_half_a_right_angle_is_named(axis: int) -> None:
    """It had passed, and 30 m became 37 m of error."""
    rig, _ = walk()
    tilted = rig.told_mount @ SE3.from_rpy((0.0, 0.0, 0.0), *(math.radians(45.0) * (k == axis) for k in range(3)))
    assert any("other axes" in t for t in examined(with_rates(1.0), tilted).troubles)
