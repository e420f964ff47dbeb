"""A return is judged by the truth in the map that was made, however that map is bent, and by the log of the run."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from ambler.bridges.recorder import Recorder
from ambler.core.errors import BadInputError
from ambler.core.messages import Contact, Odometry, PoseStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.return_quality import ExploredTruth, WayPoint, drive_ends, judge_return
from ambler.runtime.topics import CONTACT, LOCALIZED_POSE, SLAM_POSE, TRUE_POSE

MAP_FROM_WORLD = SE3.from_rpy((4.0, -3.0, -1.0), 0.0, 0.0, 0.8)
STEP_NS = 100_000_000


def bent(pose: SE3) -> SE3:
    """Where a map holds a place that lies at `pose` in the world: a centimetre off for each metre along x."""
    x, y, z = pose.translation
    return MAP_FROM_WORLD @ SE3((1.01 * x, y, z), pose.rotation)


def way(count: int, aside: float = 0.0) -> list[SE3]:
    """Along 20 m of the world, uphill."""
    return [SE3.from_rpy((x, aside, 0.1 * x), 0.0, -0.1, 0.3) for x in np.linspace(0.0, 20.0, count)]


def odometry(stamp_ns: int, frame: str, pose: SE3) -> Odometry:
    return Odometry(stamp_ns, frame, "base", pose, (0.5, 0.0, 0.0), (0.0,) * 3, np.eye(6), np.eye(6))


def explored(folder: Path) -> ExploredTruth:
    recorder = Recorder(folder)
    for k, pose in enumerate(way(201)):
        recorder.on_message(TRUE_POSE, odometry(k * STEP_NS, "world", pose), k * STEP_NS)
        recorder.on_message(SLAM_POSE, PoseStamped(k * STEP_NS, "map", bent(pose)), k * STEP_NS)
    recorder.close()
    return ExploredTruth.of_recording(recorder.folder)


def returned(folder: Path, off: float, wrong: int = 0) -> Path:
    """Drive the way again 0.5 m beside it; the pose is told from 3 s on, `off` m too far to the left, the first `wrong` ones 5 m."""
    recorder = Recorder(folder)
    for k, pose in enumerate(way(201, aside=0.5)):
        recorder.on_message(TRUE_POSE, odometry(k * STEP_NS, "world", pose), k * STEP_NS)
        if k >= 30:
            told = bent(pose) @ SE3((0.0, 5.0 if k < 30 + wrong else off, 0.0))
            recorder.on_message(LOCALIZED_POSE, odometry(k * STEP_NS, "map", told), k * STEP_NS)
        if k == 60:
            recorder.on_message(CONTACT, Contact(k * STEP_NS, "body", "car", (0.0,) * 3, 0.5, 10.0), k * STEP_NS)
    recorder.close()
    return recorder.folder


def log_of(folder: Path, *words: tuple[int, str, str]) -> Path:
    file = folder / "log.jsonl"
    file.write_text(
        "".join(json.dumps({"stamp_ns": at, "node": node, "code": code}) + "\n" for at, node, code in words)
    )
    return file


def test_what_is_told_is_compared_with_the_bent_map(tmp_path: Path) -> None:
    truth = explored(tmp_path / "first")
    recording, log = returned(tmp_path / "second", 0.04), log_of(tmp_path)
    quality = judge_return(recording, log, truth, [])
    assert quality.found_s == pytest.approx(3.0)
    assert quality.found_m == pytest.approx(0.04, abs=0.01)
    assert quality.track_rms_m == pytest.approx(0.04, abs=0.005)
    assert (quality.wrong, quality.poses, quality.collisions) == (0, 171, 1)
    assert quality.path_length_m == pytest.approx(20.1, abs=0.1)
    naive = max(math.dist(bent(p).translation, (MAP_FROM_WORLD @ p).translation) for p in way(201))
    assert naive > 0.15, "without the bend the truth would be off"


def test_a_wrong_place_counts_however_short_it_was_told(tmp_path: Path) -> None:
    truth = explored(tmp_path / "first")
    quality = judge_return(returned(tmp_path / "second", 0.0, wrong=2), log_of(tmp_path), truth, [])
    assert quality.wrong == 2
    assert quality.found_m == pytest.approx(5.0, abs=0.01)


def test_arrivals_are_where_the_robot_truly_stood(tmp_path: Path) -> None:
    truth = explored(tmp_path / "first")
    log = log_of(
        tmp_path,
        (0, "gate", "GATE_ARMED"),
        (100, "operator", "STEP_NAVIGATE"),
        (5_000_000_000, "navigator", "NAVIGATION_SUCCEEDED"),
        (5_000_000_000, "operator", "SUCCEEDED"),
        (5_000_000_001, "operator", "STEP_NAVIGATE"),
        (10_000_000_000, "operator", "SUCCEEDED"),
        (10_000_000_001, "operator", "STEP_NAVIGATE"),
        (12_000_000_000, "operator", "NO_VALID_PATH"),
        (12_000_000_000, "operator", "NO_VALID_PATH"),
    )
    assert [code for _, code in drive_ends(log)] == ["SUCCEEDED", "SUCCEEDED", "NO_VALID_PATH"]
    stood = [bent(SE3((x, 0.5, 0.1 * x))).translation for x in (5.0, 10.0, 12.0)]
    there = [WayPoint(SE2(x + 0.1, y, 0.0), z) for x, y, z in stood]
    there[1] = WayPoint(there[1].map_from_goal, there[1].height + 3.0)  # on the deck above
    quality = judge_return(returned(tmp_path / "second", 0.0), log, truth, there)
    assert [arrival.error for arrival in quality.arrivals] == pytest.approx([0.1] * 3, abs=0.02)
    assert [arrival.is_there(0.25) for arrival in quality.arrivals] == [True, False, False]
    assert not quality.arrivals[0].is_there(0.05)


def test_what_is_no_log_and_no_exploration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="log of a run"):
        drive_ends(tmp_path / "none.jsonl")
    with pytest.raises(BadInputError, match="0 poses"):
        ExploredTruth([], [])
