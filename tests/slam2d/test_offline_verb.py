"""`ambler slam2d` on a small synthetic CARMEN log: map, trajectory and picture, or one line and nothing on disk."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.evaluation.metrics import METRICS
from ambler.evaluation.relations import load_relations, relation_errors
from ambler.recordings.scan_recording import open_recording
from ambler.slam2d.offline import OfflineResult, run_offline
from ambler.wire.map_files import load_map
from ambler.wire.tum import write_tum
from tests.registration.room import distance_to_walls, ranges_at
from tests.slam2d.drives import drive, errors, oval

FILES = {"trajectory.tum", "map.pgm", "map.png", "map.yaml", "report.html", "report.json", "speed.png"}


def log_lines(truth: list[SE2], odometry: list[SE2]) -> list[str]:
    """Return FLASER lines of a scanner over 180 degrees at the base."""
    angles = np.radians(np.arange(-90.0, 90.0))
    lines = []
    for k, (pose, odom) in enumerate(zip(truth, odometry, strict=True)):
        ranges = " ".join(f"{r:.3f}" for r in ranges_at(pose, angles))
        place = f"{odom.x:.6f} {odom.y:.6f} {odom.yaw:.6f}"
        lines.append(f"FLASER {len(angles)} {ranges} {place} {place} {1000.0 + 0.1 * k:.6f} robot {0.1 * k:.6f}")
    return lines


def test_a_log_becomes_a_map_a_trajectory_and_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    course = drive(oval(1.1))
    log, out = tmp_path / "room.clf", tmp_path / "out"
    log.write_text("\n".join(["# a comment", *log_lines(course.truth, course.odometry)]) + "\n")
    assert main(["slam2d", str(log), "--out", str(out), "--json", str(tmp_path / "result.json")]) == 0
    assert {p.name for p in out.iterdir()} == FILES
    assert {p.name for p in tmp_path.iterdir()} == {"room.clf", "out", "result.json"}
    rows = np.loadtxt(out / "trajectory.tum")
    assert rows[:, 0] == pytest.approx(1000.0 + 0.1 * np.arange(len(course.truth)), abs=1e-5)
    poses = [SE2(r[1], r[2], 2.0 * float(np.arctan2(r[6], r[7]))) for r in rows]
    # The first scans are matched to a map of few, scattered returns, and lie less well than all others.
    assert errors(course.truth[20:], poses[20:])[:, 0].max() < 0.03
    assert errors(course.truth, poses)[:, 0].max() < 0.08
    assert (out / "map.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    spec, occupancy = load_map(out / "map.yaml")
    walls = spec.centers_of(np.argwhere(occupancy == 100))
    room_from_map = course.truth[20] @ poses[20].inverse()
    assert np.quantile(distance_to_walls(room_from_map.transform(walls)), 0.98) < 0.06
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["scans"] == len(course.truth)
    assert result["points_on_walls_ratio"] > 0.99
    assert "written:" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert set(report["results"]) <= set(METRICS)
    assert report["results"]["ended"] == "mapped"
    assert set(report["pictures"].values()) == {"map.png", "speed.png"}


def test_the_worst_relation_is_marked_in_the_report(tmp_path: Path) -> None:
    course = drive(oval(0.05))
    log, relations, out = tmp_path / "a.clf", tmp_path / "a.relations", tmp_path / "out"
    log.write_text("\n".join(log_lines(course.truth, course.odometry)) + "\n")
    lines = []
    for k, wrong in ((1, 0.0), (2, 0.7), (3, 0.0)):
        pose = course.truth[0].inverse() @ course.truth[k]
        lines.append(f"1000.000000 {1000.0 + 0.1 * k:.6f} {pose.x + wrong:.6f} {pose.y:.6f} 0 0 0 {pose.yaw:.6f}")
    relations.write_text("\n".join(lines) + "\n")
    assert main(["slam2d", str(log), "--out", str(out), "--relations", str(relations)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["results"]["relations_used"] == 3
    assert "relations.png" in report["pictures"].values()
    recording = open_recording(log)
    scans = run_offline(recording.scans)
    errors = relation_errors(load_relations(relations), recording.stamps, scans.poses)
    assert errors.to_us[np.argmax(errors.translation)] == 1_000_200_000


def test_a_log_whose_last_line_is_cut_off_is_mapped_up_to_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    course = drive(oval(0.05))
    log = tmp_path / "cut.clf"
    log.write_text(("\n".join(log_lines(course.truth, course.odometry)) + "\n")[:-300])
    assert main(["slam2d", str(log), "--out", str(tmp_path / "out")]) == 0
    assert len((tmp_path / "out" / "trajectory.tum").read_text().splitlines()) == len(course.truth) - 1
    told = f"cut.clf is cut off in line {len(course.truth)}: read up to there"
    assert told in capsys.readouterr().out
    assert told in (tmp_path / "out" / "report.html").read_text()


def test_a_log_with_a_line_that_is_cut_in_its_middle_is_mapped_without_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    course = drive(oval(0.05))
    log, lines = tmp_path / "torn.clf", log_lines(course.truth, course.odometry)
    lines[3] = lines[3][:400]
    log.write_text("\n".join(lines) + "\n")
    assert main(["slam2d", str(log), "--out", str(tmp_path / "out")]) == 0
    assert len((tmp_path / "out" / "trajectory.tum").read_text().splitlines()) == len(course.truth) - 1
    told = "left out: a damaged line, line 4 (FLASER): announces 180 readings"
    assert told in capsys.readouterr().out.replace("\n", " ")
    assert told in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize("damage", ["only", "garbage", "empty"])
def test_damaged_logs_leave_nothing_behind(damage: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    course = drive(oval(0.05))
    text = "\n".join(log_lines(course.truth, course.odometry)) + "\n"
    text = {"only": text[:300], "garbage": text.replace(" robot", " x y z robot", 9), "empty": ""}[damage]
    log = tmp_path / "broken.clf"
    log.write_text(text)
    assert main(["slam2d", str(log), "--out", str(tmp_path / "out")]) == 2
    assert {p.name for p in tmp_path.iterdir()} == {"broken.clf"}
    error = capsys.readouterr().err.strip()
    assert "broken.clf" in error
    assert "Traceback" not in error


def _some_result() -> OfflineResult:
    grid = GridSpec(0.05, 1, 1, 0.0, 0.0)
    return OfflineResult(np.zeros((2, 3)), grid, np.zeros((1, 1), np.int8), 0, 2, 1, 1.0, ())


def test_a_map_that_may_be_bent_or_unsolved_says_so_in_words() -> None:
    result = replace(_some_result(), loop_closures=0, way=20.0)
    assert result.warnings() == []
    bent = replace(result, way=250.0)
    assert bent.warnings() == ["no loop closure in 250 m: the map may be bent"]
    assert replace(bent, loop_closures=3).warnings() == []
    (unsolved,) = replace(result, is_converged=False).warnings()
    assert "did not converge" in unsolved


def test_reference_poses_are_compared_with(tmp_path: Path) -> None:
    """A reference that is right gives centimetres, one whose second half lies beside the first gives what it lies beside."""
    course = drive(oval(1.1))
    log = tmp_path / "room.clf"
    log.write_text("\n".join(log_lines(course.truth, course.odometry)) + "\n")
    poses = np.array([p.as_array() for p in course.truth])
    stamps = 1000.0 + 0.1 * np.arange(len(poses))
    errors = {}
    for name, off in (("right", 0.0), ("wrong", 0.8)):
        moved = poses.copy()
        moved[len(poses) // 2 :, 0] += off
        write_tum(tmp_path / f"{name}.tum", stamps, moved)
        result = tmp_path / f"{name}.json"
        words = ["slam2d", str(log), "--truth", str(tmp_path / f"{name}.tum"), "--out", str(tmp_path / name)]
        assert main([*words, "--json", str(result)]) == 0
        errors[name] = json.loads(result.read_text())["ate_rms_m"]
    assert errors["right"] < 0.04
    assert 0.2 < errors["wrong"] < 0.8
