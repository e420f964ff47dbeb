"""`ambler localize` on a drive whose truth is known, on a recorded one, and on bad input."""

import json
import math
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.recorded_localization import localize_recording
from ambler.apps.recorded_report import write_localization_report
from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.metrics import METRICS
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.recordings.log_scans import LogScan, planar_matrix
from ambler.wire.map_files import save_map
from tests.localization import rooms
from tests.public_data import public

BEAMS = 360


def recorded() -> tuple[list[LogScan], list[SE2]]:
    """The first 12 s of the drive through the office, as a log holds it."""
    room, scans, truth = rooms.office(), [], []
    rng = np.random.default_rng(4)
    angles = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False)
    beam, limits = np.array([angles[0], angles[1] - angles[0], 0.0]), np.array([0.05, 30.0, 5.0])
    for step in islice(rooms.drive(room, rooms.ROUTES["office"], rng, beams=4), 120):
        ranges = (room.cast(step.truth, angles) + 0.01 * rng.standard_normal(BEAMS)).astype(np.float32)
        odometry = ((step.stamp_ns, step.odom_from_base),)
        scans.append(LogScan(step.stamp_ns, ranges, beam, limits, planar_matrix(SE2()), odometry))
        truth.append(step.truth)
    return scans, truth


@pytest.mark.parametrize("is_told", [True, False])
def test_a_drive_is_found_in_its_map(is_told: bool) -> None:
    scans, truth = recorded()
    occupancy, spec = rooms.office().occupancy()
    start = truth[0] @ SE2(0.1, -0.05, 0.03) if is_told else None
    result = localize_recording(scans, spec, occupancy, lambda m: GridTracker(m, GridTrackerConfig()), start)
    assert result.is_found_at_the_end
    assert result.times_lost == 0
    assert result.found_after is not None
    assert result.found_after < (0.01 if is_told else 5.0)
    assert result.points_on_walls_ratio > 0.95
    by_stamp = {scan.stamp_ns: pose for scan, pose in zip(scans, truth, strict=True)}
    errors = [
        SE2.from_array(p).distance_to(by_stamp[s]) for s, p in zip(result.stamps_ns.tolist(), result.poses, strict=True)
    ]
    assert np.median(errors) < 0.02
    assert max(errors[10:]) < 0.06


def test_a_report_marks_the_largest_correction(tmp_path: Path) -> None:
    scans, _ = recorded()
    occupancy, spec = rooms.office().occupancy()
    result = localize_recording(scans, spec, occupancy, lambda m: GridTracker(m, GridTrackerConfig()))
    assert len(result.corrections) == len(result.poses)
    assert result.largest_correction == result.corrections.max() > 0.0
    fields = {"found_after_s": result.found_after, "largest_correction_m": result.largest_correction}
    notes = ["a.mcap is cut off: read up to the cut", "scans: /scan"]
    page = write_localization_report(tmp_path, Path("a.mcap"), (spec, occupancy), result, fields, notes)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["results"]["ended"] == "found"
    assert report["results"]["text"] == notes[0]
    assert set(report["results"]) <= set(METRICS)
    assert set(report["pictures"].values()) == {"map.png", "correction.png", "speed.png"}
    assert "scans: /scan" in page.read_text()


def test_a_wrong_pose_is_given_up_unless_nobody_watches() -> None:
    scans, truth = recorded()
    occupancy, spec = rooms.office().occupancy()
    wrong = truth[0] @ SE2(3.0, 1.0, 2.0)

    def localize(*, is_supervised: bool) -> float:
        result = localize_recording(
            scans[:40],
            spec,
            occupancy,
            lambda m: GridTracker(m, GridTrackerConfig()),
            wrong,
            is_supervised=is_supervised,
        )
        return len(result.poses) / result.scans

    assert localize(is_supervised=True) < 0.8  # it is given up after 0.3 s of 4 and found after 1 s
    assert localize(is_supervised=False) == 1.0


def test_what_a_wrong_pose_led_to_is_not_told_as_found() -> None:
    scans, truth = recorded()
    occupancy, spec = rooms.office().occupancy()
    wrong = truth[0] @ SE2(3.0, 1.0, 2.0)
    result = localize_recording(scans, spec, occupancy, lambda m: GridTracker(m, GridTrackerConfig()), wrong)
    assert result.is_found_at_the_end
    assert result.times_lost == 1
    assert result.found_after is not None
    assert result.found_after > 0.9
    assert len(result.corrections) == len(result.stamps_ns) == len(result.poses) > 40
    by_stamp = {scan.stamp_ns: pose for scan, pose in zip(scans, truth, strict=True)}
    told = zip(result.stamps_ns.tolist(), result.poses, strict=True)
    assert max(SE2.from_array(p).distance_to(by_stamp[s]) for s, p in told) < 0.1


def test_what_a_search_found_is_kept_when_the_robot_is_lost_afterwards() -> None:
    scans, _ = recorded()
    occupancy, spec = rooms.office().occupancy()
    hidden = [replace(s, ranges=np.full_like(s.ranges, 1.5)) for s in scans[80:]]
    result = localize_recording([*scans[:80], *hidden], spec, occupancy, lambda m: GridTracker(m, GridTrackerConfig()))
    assert result.times_lost == 1
    assert not result.is_found_at_the_end
    assert result.found_after is not None
    assert result.found_after < 5.0
    assert len(result.poses) > 30


def test_a_pose_outside_of_the_map_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    occupancy, spec = rooms.office().occupancy()
    save_map(tmp_path / "office", spec, occupancy)
    known = tmp_path / "office.yaml"
    assert main(["localize", "nothing.log", "--map", str(known), "--pose", "300,100,0"]) == 2
    assert capsys.readouterr().err.strip().endswith("office.yaml: the pose 300, 100 m lies outside of it")
    assert main(["localize", "nothing.log", "--map", str(known), "--pose", "0,0,0"]) == 2
    assert "nothing.log" in capsys.readouterr().err


def test_without_odometry_nothing_is_localized() -> None:
    scans, _ = recorded()
    occupancy, spec = rooms.office().occupancy()
    bare = [LogScan(s.stamp_ns, s.ranges, s.beam, s.limits, s.base_from_laser, ()) for s in scans[:5]]
    with pytest.raises(BadInputError, match="odometry"):
        localize_recording(bare, spec, occupancy, lambda m: GridTracker(m, GridTrackerConfig()))


def test_the_turtlebot_finds_itself_in_its_map(tmp_path: Path) -> None:
    folder = public("turtlebot4")
    arguments = ["--json", str(tmp_path / "r.json"), "--out", str(tmp_path / "out")]
    bag, known = folder / "macfirst_floor_take_2", folder / "mac_1st_floor_final.yaml"
    assert main(["localize", str(bag), "--map", str(known), *arguments]) == 0
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["points_on_walls_ratio"] > 0.7
    assert result["times_lost"] == 0
    assert (tmp_path / "out" / "map.png").stat().st_size > 5000
    assert len((tmp_path / "out" / "trajectory.tum").read_text().splitlines()) > 150


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nothing.log", "--map", "nothing.yaml"], "nothing.yaml: there is no such map"),
        (["nothing.log", "--map", "tests"], "tests: is a folder; give the map's YAML"),
        (["nothing.log", "--map", "nothing.yaml", "--pose", "1,2"], "--pose 1,2: is not X,Y,YAW"),
        (["nothing.log", "--map", "nothing.yaml", "--lag", "soon"], "--lag soon: is no number of seconds, nor `auto`"),
        (["nothing.log", "--map", "nothing.yaml", "--lag", "nan"], "--lag nan: is no number of seconds, nor `auto`"),
        (["nothing.log", "--map", "nothing.yaml", "--pose", "1,nan,2"], "not finite"),
        (["nothing.log", "--map", "nothing.yaml", "--unsupervised"], "--unsupervised needs --pose"),
    ],
)
def test_bad_input_is_one_clear_line(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["localize", *arguments]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line]
    assert says in line
