"""The study of drawn ground, and the bench of the terrain analysis: one case of each kind, a few clouds."""

from __future__ import annotations

from pathlib import Path

import pytest

from ambler.studies.bench_terrain import measure
from ambler.studies.ground_study import KINDS, GroundCase, run_case, summarize


@pytest.mark.parametrize("kind", KINDS)
def test_a_case_is_judged_and_leaves_a_picture(kind: str, tmp_path: Path) -> None:
    case = GroundCase(7, "mecanum", kind)
    result = run_case(case, tmp_path)
    assert (tmp_path / "terrain.png").stat().st_size > 10_000
    assert abs(result["height_off_m"]) <= 0.05
    assert abs(result["pitch_off_deg"]) <= 3.0
    assert result == run_case(case, tmp_path)
    fields = summarize([{**result, "seed": 7, "robot": "mecanum", "kind": kind}])
    if kind == "flat":
        assert fields["mecanum.flat_points"] == result["points"] > 1000
        assert fields["mecanum.false_ratio"] <= 0.001
    else:
        assert result["is_good"]
        assert fields[f"mecanum.{kind}_good"] == 1


def test_a_wrong_case_misses_the_bar() -> None:
    good = {"robot": "go2", "kind": "flat", "points": 1000, "false_points": 0}
    assert summarize([good])["is_met"]
    assert not summarize([{**good, "false_points": 2}])["is_met"]
    assert not summarize([good, {"robot": "go2", "kind": "drop", "is_good": False}])["is_met"]
    assert not summarize([good, {"robot": "go2", "kind": "drop", "ended": "crashed"}])["is_met"]


def test_the_bench_tells_medians_of_both_windows() -> None:
    fields = measure(3, 0)
    assert fields["points"] > 15_000
    for window in ("near", "wide"):
        assert 0.0 < fields[f"{window}_update_ms"] <= fields[f"{window}_update_p95_ms"]
