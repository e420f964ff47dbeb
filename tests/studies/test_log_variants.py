"""Variants of logs: each tells of the same way through the same place, and its poses go back to those of the log."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ambler.core.base_motion import STILL, BaseMotion
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.recordings.log_scans import LogScan, planar_matrix
from ambler.studies.log_variants import KINDS, Variant, odometry_of, poses_of_log, varied
from ambler.studies.log_variants_study import cases_of, is_good, judged, reference_of, summarize
from ambler.wire.tum import write_tum
from tests.registration.room import distance_to_walls, ranges_at

BASE_FROM_LASER = SE2(0.2, 0.1, 0.05)
WAY = [SE2(1.5 * math.cos(0.1 * k), 1.2 * math.sin(0.1 * k), 0.1 * k + 1.5) for k in range(60)]
ODOM = SE2(5.0, -2.0, 0.7)
ANGLES = np.linspace(-1.5, 1.4, 90)


def _log() -> list[LogScan]:
    scans = []
    for k, pose in enumerate(WAY):
        ranges = ranges_at(pose @ BASE_FROM_LASER, ANGLES).astype(np.float32)
        beam, limits = np.array([ANGLES[0], ANGLES[1] - ANGLES[0], 0.0]), np.array([0.1, 20.0, 5.0])
        stamp = 1000 + 100_000_000 * k
        scans.append(LogScan(stamp, ranges, beam, limits, planar_matrix(BASE_FROM_LASER), ((stamp, ODOM @ pose),)))
    return scans


def _points(scan: LogScan) -> np.ndarray:
    motion = BaseMotion()
    return scan.to_planar(motion.sweep(scan.stamp_ns, 0.0, STILL)).points.astype(float)


def _mirrored(pose: SE2) -> SE2:
    return SE2(pose.x, -pose.y, -pose.yaw)


def _truth(variant: Variant) -> list[SE2]:
    return [_mirrored(WAY[k]) if variant.is_mirrored else WAY[k] for k in variant.rows]


@pytest.mark.parametrize("is_keyframed", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_variant_sees_the_walls_from_where_the_log_was(kind: str, is_keyframed: bool) -> None:
    variant = varied(_log(), kind, 3, is_keyframed=is_keyframed)
    assert len(variant.scans) == len(variant.rows) > 5
    assert all(np.diff([s.stamp_ns for s in variant.scans]) > 0), "stamps increase, in whichever direction it drives"
    for scan, pose in zip(variant.scans, _truth(variant), strict=True):
        points = pose.transform(_points(scan))
        points[:, 1] *= -1.0 if variant.is_mirrored else 1.0
        assert distance_to_walls(points).max() < 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_poses_of_a_variant_go_back_to_those_of_the_log(kind: str) -> None:
    log = _log()
    variant = varied(log, kind, 3, is_keyframed=True)
    rows, poses = poses_of_log(log, variant, np.array([p.as_array() for p in _truth(variant)]))
    assert (rows[0], rows[-1]) == (variant.rows.min(), variant.rows.max())
    assert len(rows) == rows[-1] - rows[0] + 1, "scans that were left out have poses, too"
    for row, pose in zip(rows, poses, strict=True):
        assert SE2.from_array(pose).distance_to(WAY[row]) < 1e-9
        assert abs(math.remainder(pose[2] - WAY[row].yaw, 2.0 * math.pi)) < 1e-9


def test_other_wheels_alone_tell_another_way() -> None:
    log = _log()
    for kind in KINDS:
        variant = varied(log, kind, 3)
        motion = odometry_of(variant.scans[0]).inverse() @ odometry_of(variant.scans[-1])
        truth = _truth(variant)
        off = (truth[0].inverse() @ truth[-1]).distance_to(motion)
        assert (off > 0.02) == (kind in ("other_wheels", "late")), kind


def test_late_scans_bear_the_odometry_of_when_they_are_old() -> None:
    log, variant = _log(), varied(_log(), "late", 3)
    assert 0.05 <= variant.lag <= 0.6
    for k, scan in enumerate(variant.scans[: -round(variant.lag / 0.1) - 1]):
        true = SE2(
            1.5 * math.cos(0.1 * k + variant.lag), 1.2 * math.sin(0.1 * k + variant.lag), 0.1 * k + variant.lag + 1.5
        )
        told = ODOM.inverse() @ odometry_of(scan)
        assert told.distance_to(true) < 2e-3
        assert abs(math.remainder(told.yaw - true.yaw, 2.0 * math.pi)) < 1e-6
        assert scan.stamp_ns == log[k].stamp_ns


def test_what_is_left_out_is_as_much_as_its_kind_says() -> None:
    log = _log()
    assert 0.5 * len(log) <= len(varied(log, "later", 3).scans) <= 0.9 * len(log)
    assert 2 / 3 * len(log) <= len(varied(log, "dropped", 3).scans) <= 5 / 6 * len(log)
    assert [len(s.ranges) for s in varied(log, "thinned", 3).scans] == [len(ANGLES) // 2] * len(log)
    steps = [a.distance_to(b) for a, b in pairwise(WAY)]
    assert max(steps) < 0.2
    kept = varied(log, "as_recorded", 3, is_keyframed=True).rows
    ways = [sum(steps[a:b]) for a, b in pairwise(kept)]
    assert min(ways) > 0.15, "turns count, too"
    assert max(ways) < 1.2


def test_poses_are_judged_by_the_file_beside_the_log(tmp_path: Path) -> None:
    log = tmp_path / "place.clf.gz"
    with pytest.raises(BadInputError, match="neither relations nor poses"):
        reference_of(log)
    stamps, poses = np.arange(len(WAY)) * 0.5, np.array([p.as_array() for p in WAY])
    write_tum(tmp_path / "place.tum", stamps, poses)
    assert judged(reference_of(log), stamps, poses)["error_m"] < 1e-6
    bent = poses + np.array([[0.01 * k, 0.0, 0.0] for k in range(len(WAY))])
    assert judged(reference_of(log), stamps[::-1], bent[::-1])["error_m"] > 0.1
    (tmp_path / "place.relations").write_text("0.0 10.0 1.0 0 0 0 0 0\n0.0 20.0 3.0 0 0 0 0 0\n")
    fields = judged(
        reference_of(log), np.array([0.0, 10.0, 20.0]), np.array([[0.0, 0, 0], [1.0, 0.5, 0], [3.0, 1.5, 0]])
    )
    assert fields["error_m"] == pytest.approx(1.0)
    assert fields["open_ratio"] == 0.5


def test_a_variant_is_good_by_the_bar_or_by_what_the_log_reaches() -> None:
    assert is_good({"error_m": 0.5, "bar_m": 0.5}, 0.1)
    assert is_good({"error_m": 0.8, "bar_m": 0.5}, 0.4)
    assert not is_good({"error_m": 0.9, "bar_m": 0.5}, 0.4)
    assert not is_good({"error_m": 30.0, "bar_m": 0.5}, 20.0), "a log that stays open excuses nothing"
    assert not is_good({}, 20.0), "nor is good what crashed"


def test_summaries_count_by_place_and_by_kind() -> None:
    cases = cases_of([("a.log", "a.tum"), ("b.log", "b.tum")], ("as_recorded", "later"), (1, 2))
    assert [c.label for c in cases][:3] == ["a-as_recorded-1", "a-later-1", "a-later-2"]
    results = [
        {
            "label": c.label,
            "kind": c.kind,
            "error_m": 9.0 if c.label == "b-later-2" else 0.2,
            "bar_m": 0.5,
            "open_ratio": 0.0,
        }
        for c in cases
    ]
    fields = summarize(results, [c.place for c in cases])
    assert (fields["runs"], fields["variants_good"]) == (6, 5)
    assert (fields["b.good"], fields["a.good"], fields["later.good"], fields["as_recorded.good"]) == (2, 3, 3, 2)
    assert fields["b.error_worst_m"] == 9.0
