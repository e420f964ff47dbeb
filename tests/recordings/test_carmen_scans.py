"""CARMEN logs become scans: no wall where nothing came back, the angles of the scanner, odometry of raw lines, a mount that is told."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ambler.core.base_motion import STILL, steady_sweep
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.recordings.log_scans import DEAD_ODOMETRY
from ambler.recordings.scan_recording import Choices, ScanRecording, open_recording
from ambler.recordings.sweep import Sweep
from ambler.slam2d.offline import run_offline
from tests.registration.room import distance_to_walls, loop_of, ranges_at

HALL = np.array(
    [*loop_of((-3.0, -4.0), (27.0, -4.0), (27.0, 5.0), (-3.0, 5.0)), *loop_of((6, 1), (7, 1), (7, 2), (6, 2))]
)
PATH = [SE2(0.1 * k, 0.3 * math.sin(0.1 * k), 0.2 * math.sin(0.07 * k)) for k in range(80)]
ANGLES = np.radians(np.arange(-90, 91))


def scans(
    angles: np.ndarray = ANGLES, reach: float = 80.0, nothing: float = 81.83, mount: SE2 | None = None
) -> list[str]:
    """Return the readings of every pose of the path, as text."""
    rng = np.random.default_rng(5)
    out = []
    for pose in PATH:
        ranges = ranges_at(pose @ (mount or SE2()), angles, HALL) + rng.normal(0.0, 0.005, len(angles))
        out.append(" ".join(f"{r:.3f}" for r in np.where(ranges < reach, ranges, nothing)))
    return out


def pose_text(pose: SE2) -> str:
    return f"{pose.x:.6f} {pose.y:.6f} {pose.yaw:.6f}"


def flaser(readings: list[str], odometry: list[SE2] = PATH) -> list[str]:
    return [
        f"FLASER {len(r.split())} {r} {pose_text(pose)} {pose_text(pose)} {1000 + 0.1 * k:.3f} host {0.1 * k:.3f}"
        for k, (r, pose) in enumerate(zip(readings, odometry, strict=True))
    ]


def robot_laser(readings: list[str], reach: float) -> list[str]:
    return [
        f"ROBOTLASER3 0 -1.570796 3.141593 0.0174533 {reach} 0.01 0 {len(r.split())} {r} 0 {pose_text(pose)} {pose_text(pose)}"
        f" 0 0 0 0 0 {1000 + 0.1 * k:.3f} host {0.1 * k:.3f}"
        for k, (r, pose) in enumerate(zip(readings, PATH, strict=True))
    ]


def raw_laser(readings: list[str]) -> list[str]:
    """Return raw lines and, between them, the odometry, which is told half a period later and earlier."""
    out = []
    for k, (r, pose) in enumerate(zip(readings, PATH, strict=True)):
        out.append(
            f"RAWLASER1 0 -1.570796 3.141593 0.0174533 80 0.01 0 {len(r.split())} {r} 0 {1000 + 0.1 * k:.3f} host {0.1 * k:.3f}"
        )
        out.append(f"ODOM {pose_text(pose)} 0 0 0 {1000 + 0.1 * k:.3f} host {0.1 * k:.3f}")
    return out


def opened(folder: Path, lines: list[str], choices: Choices | None = None) -> ScanRecording:
    log = folder / "a.log"
    log.write_text("\n".join(lines) + "\n")
    return open_recording(log, choices)


def points_off_walls(recording: ScanRecording) -> tuple[int, int]:
    """Return how many returns lie more than 0.1 m beside all walls, with true poses, and how many there are."""
    off, total = 0, 0
    for scan, pose in zip(recording.scans, PATH, strict=True):
        points = scan.to_planar(steady_sweep(STILL, scan.duration)).points
        off += int((distance_to_walls(pose.transform(points), HALL) > 0.1).sum())
        total += len(points)
    return off, total


@pytest.mark.parametrize(("reach", "nothing"), [(8.0, 8.19), (8.0, 8.191), (4.0, 4.095), (5.6, 5.6), (80.0, 81.91)])
def test_what_no_echo_came_from_is_no_wall(tmp_path: Path, reach: float, nothing: float) -> None:
    recording = opened(tmp_path, flaser(scans(reach=reach, nothing=nothing)))
    off, total = points_off_walls(recording)
    assert (off, total > 1000) == (0, True)
    assert any("no return" in note for note in recording.notes) == (reach < 30.0)


@pytest.mark.parametrize("parameter", ["robot_front_laser_max", "robot_frontlaser_max", "laser_front_laser_maxrange"])
def test_the_range_that_a_parameter_tells_counts(tmp_path: Path, parameter: str) -> None:
    # Two values for nothing, half and half: no pile that could be found.
    lines = [line.replace(" 8.190 ", " 8.410 ", 30) for line in flaser(scans(reach=8.0, nothing=8.19))]
    assert points_off_walls(opened(tmp_path, lines))[0] > 0
    assert points_off_walls(opened(tmp_path, [f"PARAM {parameter} 8.1 host 0", *lines]))[0] == 0


def test_a_parameter_that_tells_too_much_hides_no_pile(tmp_path: Path) -> None:
    lines = ["PARAM robot_front_laser_max 81.9 host 0", *flaser(scans(reach=8.0, nothing=8.19))]
    assert points_off_walls(opened(tmp_path, lines))[0] == 0


def test_a_range_that_many_walls_exceed_is_not_the_scanner_s(tmp_path: Path) -> None:
    """Programs write their own limits into logs, such as up to where they mind obstacles."""
    recording = opened(tmp_path, ["PARAM robot_front_laser_max 8.1 host 0", *flaser(scans(reach=25.0))])
    off, total = points_off_walls(recording)
    within = sum(int((ranges_at(pose, ANGLES, HALL) < 24.9).sum()) for pose in PATH)
    assert (off, total >= within) == (0, True)
    assert any("beyond the 8.1 m" in note for note in recording.notes)


def test_walls_at_the_end_of_sight_stay(tmp_path: Path) -> None:
    recording = opened(tmp_path, flaser(scans()))
    farthest = max(float(scan.ranges.max()) for scan in recording.scans)
    assert farthest > 25.0
    for scan in recording.scans:
        assert len(scan.to_planar(steady_sweep(STILL, scan.duration)).points) == len(ANGLES)


def test_robot_lasers_carry_their_range(tmp_path: Path) -> None:
    lines = [line.replace(" 8.190 ", " 8.410 ", 30) for line in robot_laser(scans(reach=8.0, nothing=8.19), 8.1)]
    off, total = points_off_walls(opened(tmp_path, lines))
    assert (off, total > 2000) == (0, True)


@pytest.mark.parametrize(
    "angles",
    [
        np.radians(-135.0 + 0.5 * np.arange(541)),
        np.radians(-50.0 + 0.25 * np.arange(401)),
        np.radians(0.3515625 * (np.arange(682) - 340.5)),
    ],
    ids=["541", "401", "682"],
)
def test_scanners_of_other_fields_of_view_are_known(tmp_path: Path, angles: np.ndarray) -> None:
    off, total = points_off_walls(opened(tmp_path, flaser(scans(angles))))
    assert (off, total) == (0, len(angles) * len(PATH))


def test_an_unknown_scanner_is_told_and_can_be_described(tmp_path: Path) -> None:
    lines = flaser(scans(np.radians(np.linspace(-120.0, 120.0, 301))))
    recording = opened(tmp_path, lines)
    assert any("301 beams" in note for note in recording.notes)
    assert points_off_walls(recording)[0] > 1000
    described = opened(tmp_path, ["PARAM laser_front_laser_fov 240 host 0", *lines])
    assert points_off_walls(described)[0] == 0
    assert described.notes == ()


def test_raw_lines_move_with_the_odometry_between_them(tmp_path: Path) -> None:
    recording = opened(tmp_path, raw_laser(scans()))
    told = [entry for scan in recording.scans for entry in scan.odometry]
    assert [stamp for stamp, _ in told] == [round((1000 + 0.1 * k) * 1e9) for k in range(len(PATH))]
    assert all(b > a for (a, _), (b, _) in pairwise(told))
    assert any("80 ODOM lines" in note for note in recording.notes)
    poses = [SE2.from_array(p) for p in run_offline(recording.scans).poses]
    moved = poses[0].inverse() @ poses[-1]
    assert moved.distance_to(PATH[0].inverse() @ PATH[-1]) < 0.05


def test_raw_lines_without_odometry_are_matched_alone(tmp_path: Path) -> None:
    recording = opened(tmp_path, [line for line in raw_laser(scans()) if not line.startswith("ODOM")])
    assert all(scan.odometry == () for scan in recording.scans)


@pytest.mark.parametrize(
    ("lines", "mount"),
    [
        (["PARAM robot_frontlaser_offset 0.3 host 0"], SE2(0.3, 0.0, 0.0)),
        (["PARAM robot_rearlaser_offset -0.2 host 0"], SE2(-0.2, 0.0, math.pi)),
    ],
)
def test_raw_lines_are_mounted_where_the_parameter_says(tmp_path: Path, lines: list[str], mount: SE2) -> None:
    raw = raw_laser(scans(mount=mount))
    if abs(mount.yaw) > 1.0:
        raw = [line.replace("RAWLASER1", "RAWLASER2") for line in raw]
    assert points_off_walls(opened(tmp_path, [*lines, *raw]))[0] == 0


@pytest.mark.parametrize("lines_of", [flaser, raw_laser])
def test_a_mount_that_is_told_counts(tmp_path: Path, lines_of: object) -> None:
    assert callable(lines_of)
    mount = SE2(0.4, 0.1, 0.5)
    lines = lines_of(scans(mount=mount))
    assert points_off_walls(opened(tmp_path, lines))[0] > 1000
    assert points_off_walls(opened(tmp_path, lines, Choices(base_from_laser=mount)))[0] == 0


def test_one_mount_for_two_scanners_is_refused_and_so_are_choices_of_bags(tmp_path: Path) -> None:
    front = flaser(scans())
    with pytest.raises(BadInputError, match=r"a\.log: one mount for several scanners \(FLASER, RLASER\)"):
        opened(tmp_path, [*front, front[-1].replace("FLASER", "RLASER")], Choices(base_from_laser=SE2()))
    for choices in (Choices("/scan"), Choices(sweep=Sweep.FORWARD), Choices(odom_topic="none")):
        with pytest.raises(BadInputError, match="is no ROS bag"):
            opened(tmp_path, front, choices)


def with_dead_poses(lines: list[str], pose: SE2) -> list[str]:
    """Return the lines with one and the same pose in each."""
    return [line.replace(pose_text(told), pose_text(pose)) for line, told in zip(lines, PATH, strict=True)]


@pytest.mark.parametrize("kind", ["flaser", "robot_laser"])
def test_odometry_that_never_changes_while_the_robot_moves_counts_as_none(tmp_path: Path, kind: str) -> None:
    """It was believed: the robot stands, the scans say, where the first walls can be laid on those of a later place."""
    readings = scans()
    lines = flaser(readings) if kind == "flaser" else robot_laser(readings, 80.0)
    recording = opened(tmp_path, with_dead_poses(lines, SE2(2.0, 1.0, 0.5)))
    assert DEAD_ODOMETRY in recording.notes
    assert all(scan.odometry == () for scan in recording.scans)
    alone = opened(tmp_path, [line for line in raw_laser(readings) if line.startswith("RAW")])
    assert np.abs(run_offline(recording.scans).poses - run_offline(alone.scans).poses).max() < 0.01
    told = opened(tmp_path, lines)
    assert DEAD_ODOMETRY not in told.notes
    assert all(scan.odometry for scan in told.scans)


@pytest.mark.parametrize("passing", [0, 40])
def test_the_odometry_of_a_robot_that_stands_is_kept(tmp_path: Path, passing: int) -> None:
    """Also where somebody passes: a part of the readings differs then."""
    rng = np.random.default_rng(2)
    ranges = ranges_at(PATH[0], ANGLES, HALL)
    readings = []
    for k in range(len(PATH)):
        seen = np.where((np.arange(181) >= 2 * k) & (np.arange(181) < 2 * k + passing), 1.0, ranges)
        readings.append(" ".join(f"{r:.3f}" for r in seen + rng.normal(0.0, 0.02, 181)))
    recording = opened(tmp_path, with_dead_poses(flaser(readings), PATH[0]))
    assert DEAD_ODOMETRY not in recording.notes
    assert all(scan.odometry for scan in recording.scans)


def test_a_lag_that_is_told_moves_the_odometry_of_a_log(tmp_path: Path) -> None:
    """The scans of this logger are two lines older than what the wheels tell beside them."""
    late = 2
    recording = opened(tmp_path, flaser(scans()[:-late], PATH[late:]), Choices(lag=0.1 * late))
    track = [entry for scan in recording.scans for entry in scan.odometry]
    assert len(track) == len(PATH) - 2 * late + 1  # up to the last scan, and the next one
    for stamp_ns, pose in track:
        true = PATH[round(stamp_ns * 1e-8) - 10_000]
        assert pose.distance_to(true) < 1e-5
        assert abs(pose.yaw - true.yaw) < 1e-5
