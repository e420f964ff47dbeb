"""Drives through campuses: the route is a way that a robot can drive, and what it measures and how it is judged fit the truth."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import LaserScan, Odometry
from ambler.core.se2 import SE2
from ambler.recordings.scan_recording import open_recording
from ambler.sim.body import TICK, TICK_NS
from ambler.sim.generator.draw import DrawnPlace, draw_place
from ambler.sim.sensors import SAFETY_270
from ambler.slam2d.back_end import LoopConstraint
from ambler.slam2d.offline import OfflineResult
from ambler.studies import campus_log
from ambler.studies.campus_log import BEGIN_NS, CampusLog, measured, record_campus
from ambler.studies.campus_route import Motion, draw_motion, route_of
from ambler.studies.campus_study import is_good, judged, summarize
from ambler.wire.tum import read_tum
from tests.sim.test_generator import _distance

X, Y = (0.0, 60.0, 130.0), (0.0, 50.0, 120.0)
WAYS = [[(a, y), (b, y)] for a, b in pairwise(X) for y in Y] + [[(x, a), (x, b)] for a, b in pairwise(Y) for x in X]
PASSAGE = [(30.0, 0.0), (30.0, 50.0)]
SPEED = 1.2


@pytest.fixture(scope="module")
def motion() -> Motion:
    return draw_motion([*WAYS, PASSAGE], (0.0, 0.0), 5, SPEED, np.random.default_rng(3))


@pytest.mark.parametrize("seed", range(8))
def test_routes_run_along_ways_and_never_turn_back(seed: int) -> None:
    route = route_of([*WAYS, PASSAGE], (1.0, -1.0), 5, np.random.default_rng(seed))
    assert route[0] == (0.0, 0.0)
    for a, b in pairwise(route):
        assert (a[0] == b[0]) != (a[1] == b[1])
        is_street = (a[0] == b[0] and a[0] in X) or (a[1] == b[1] and a[1] in Y)
        assert is_street or a[0] == b[0] == 30.0
    assert all(a != c for a, c in zip(route, route[2:], strict=False))
    assert route.count(route[0]) >= 2, "it comes back to its start"


def test_a_place_without_ways_has_no_route() -> None:
    with pytest.raises(BadInputError, match="without ways"):
        route_of([], (0.0, 0.0), 3, np.random.default_rng(0))


def test_a_motion_is_one_of_a_robot_that_looks_where_it_drives(motion: Motion) -> None:
    steps = np.diff(motion.poses, axis=0) / TICK
    speed = np.hypot(steps[:, 0], steps[:, 1])
    assert SPEED * 0.97 < speed.max() < SPEED * 1.1
    assert speed[:100].max() == 0.0
    assert np.abs(steps[:, 2]).max() < 0.9
    moving = speed > 0.3
    course = np.arctan2(steps[:, 1], steps[:, 0])[moving]
    aside = np.abs(np.angle(np.exp(1j * (course - motion.poses[:-1, 2][moving]))))
    assert np.quantile(aside, 0.99) < math.radians(5.0)
    assert max(motion.loops) > 300.0
    assert motion.length == pytest.approx(speed.sum() * TICK, rel=0.01)


def test_a_motion_stays_in_its_lanes(motion: Motion) -> None:
    points = motion.poses[::20, :2]
    off = np.full(len(points), np.inf)
    for a, b in [*WAYS, PASSAGE]:
        nearest = np.clip(points, np.minimum(a, b), np.maximum(a, b))
        off = np.minimum(off, np.hypot(*(points - nearest).T))
    assert off.max() < 1.0
    assert off.max() > 0.1, "it weaves"


@pytest.fixture(scope="module")
def hall() -> tuple[DrawnPlace, Motion]:
    """A flat, in whose hall the robot turns and goes 0.6 m there and on in a curve."""
    place = draw_place("flat", 3)
    n = 800
    turn = np.concatenate([np.zeros(200), np.linspace(0.0, 0.8, n - 200)])
    ahead = np.concatenate([np.zeros(200), np.full(n - 200, 0.6 / (n - 200))])
    yaw = place.world.start.yaw + turn
    x = place.world.start.x + np.cumsum(ahead * np.cos(yaw))
    y = place.world.start.y + np.cumsum(ahead * np.sin(yaw))
    return place, Motion(np.stack([x, y, yaw], axis=1), ())


def test_beams_end_on_what_is_there(hall: tuple[DrawnPlace, Motion]) -> None:
    place, motion = hall
    scans = [m for m, _ in measured(place, motion, SAFETY_270, 1) if isinstance(m, LaserScan)]
    assert len(scans) > 30
    height = [s for s in place.world.solids if s.z_min < 0.28 < s.z_max and not s.is_glass]
    for scan in (scans[0], scans[20], scans[-1]):
        angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
        times = (scan.stamp_ns - BEGIN_NS) / TICK_NS + np.arange(len(angles)) * scan.time_increment / TICK
        x, y, yaw = (np.interp(times, np.arange(len(motion.poses)), c) for c in motion.poses.T)
        returned = np.isfinite(scan.ranges) & (scan.ranges < 30.0)
        lx, ly = x + 0.08 * np.cos(yaw), y + 0.08 * np.sin(yaw)
        points = np.stack([lx + scan.ranges * np.cos(yaw + angles), ly + scan.ranges * np.sin(yaw + angles)], axis=1)
        points = points[returned]
        off = np.min([_distance(s, points) for s in height], axis=0)
        inside = np.quantile(off, 0.9)
        assert inside < 0.03
        assert returned.mean() > 0.95


def test_odometry_counts_what_wheels_turn(hall: tuple[DrawnPlace, Motion]) -> None:
    place, motion = hall
    told = [m for m, _ in measured(place, motion, SAFETY_270, 1) if isinstance(m, Odometry)]
    true = SE2.from_array(motion.poses[0]).inverse() @ SE2.from_array(motion.poses[-1])
    last = told[-1].pose.to_se2()
    assert last.distance_to(true) < 0.05
    assert last.yaw == pytest.approx(true.yaw, abs=0.08)
    assert told[5].pose.to_se2() == SE2()
    times = [t for _, t in measured(place, motion, SAFETY_270, 1)]
    assert times == sorted(times)


def test_a_log_is_recorded_with_its_mount_and_the_truth(
    hall: tuple[DrawnPlace, Motion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, motion = hall
    monkeypatch.setattr(campus_log, "draw_place", lambda kind, seed: place)
    monkeypatch.setattr(campus_log, "draw_motion", lambda *told: motion)
    log = record_campus(5, tmp_path, "safety_270")
    recording = open_recording(log.recording)
    assert any("(0.080, 0.000, 0.280)" in note for note in recording.notes)
    stamps, poses = read_tum(tmp_path / "truth.tum")
    assert np.allclose(stamps, recording.stamps, atol=1e-6)
    assert np.allclose(poses[0], 0.0, atol=1e-6)
    end = SE2.from_array(motion.poses[0]).inverse().transform(motion.poses[-1:, :2])[0]
    assert np.hypot(*(poses[-1, :2] - end)) < 0.05
    with pytest.raises(BadInputError, match="no scanner 'camera'"):
        record_campus(5, tmp_path / "other", "camera")


def test_a_map_is_judged_by_its_errors_and_its_closures(hall: tuple[DrawnPlace, Motion], tmp_path: Path) -> None:
    place, motion = hall
    log = CampusLog(place, motion, "safety_270", tmp_path)
    stamps = BEGIN_NS + np.arange(20, len(motion.poses), 20, dtype=np.int64) * TICK_NS
    truth = log.true_poses(stamps)
    poses = truth + np.array([0.02, 0.0, 0.0])
    poses[-1, 1] += 0.4
    at = [SE2.from_array(p) for p in truth]
    relation = at[3].inverse() @ at[30]
    loops = [relation, relation @ SE2(0.4, 0.0, 0.0), relation @ SE2(0.6, 0.0, 0.0), relation @ SE2(0.0, 0.0, 0.1)]
    found = tuple(LoopConstraint(int(stamps[3]), int(stamps[30]), loop) for loop in loops)
    result = OfflineResult(poses, GridSpec(0.05, 1, 1, 0, 0), np.zeros((1, 1), np.int8), 4, 9, 2, 1.0, found)
    fields = judged(log, stamps, result)
    assert (fields["closures"], fields["false_closures"]) == (4, 2)
    assert fields["worst_closure_m"] == pytest.approx(0.6, abs=1e-6)
    assert fields["start_max_m"] == pytest.approx(math.hypot(0.02, 0.4), abs=1e-6)
    assert 0.3 < fields["bend_m"] < 0.42
    assert not is_good(fields)
    assert is_good({"false_closures": 0, "bend_m": 0.29})
    assert not is_good({"ended": "crashed"})


def test_the_bars_of_campuses_ask_for_all_of_them() -> None:
    good = {"false_closures": 0, "bend_m": 0.1, "ate_rms_m": 0.05, "scans_per_second_hz": 300.0}
    met = summarize([{**good, "label": f"campus-{k}"} for k in range(3)])
    assert met["is_met"]
    for wrong in ({"bend_m": 0.31}, {"false_closures": 1}):
        fields = summarize([{**good, "label": "a"}, {**good, "label": "b"}, {**good, **wrong, "label": "c"}])
        assert not fields["is_met"]
        assert fields["maps_good"] == 2
    assert not summarize([{**good, "ate_rms_m": 0.2, "label": "a"}])["is_met"]
    assert not summarize([{"ended": "crashed", "label": "a"}])["is_met"]


def test_an_unknown_scanner_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", "campus", "--scanner", "camera"]) == 2
    assert "--scanner camera: one of scanner_360, safety_270" in capsys.readouterr().err
