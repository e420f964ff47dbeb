"""Campaigns of explorations: places are drawn once and told, fresh ones stand beside those of development, and only fresh ones count."""

import json
from pathlib import Path
from typing import Any

import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.studies import exploration_campaign as campaign
from ambler.studies import exploration_study

GOOD = {
    "ended": "finished",
    "collisions": 0,
    "reachable_coverage_ratio": 0.995,
    "ate_unaligned_rms_m": 0.02,
    "ate_unaligned_max_m": 0.05,
    "recovery_time_ratio": 0.01,
    "path_length_m": 100.0,
    "sim_seconds": 200.0,
}


def result(places: str, world: str, robot: str = "diff", **other: Any) -> dict[str, Any]:
    return {**GOOD, "places": places, "world": world, "robot": robot, **other}


def test_places_are_read_and_mistakes_refused() -> None:
    assert campaign.parse_places(["fresh:20", "development"]) == (20, True)
    assert campaign.parse_places(["development"]) == (0, True)
    for wrong in ("fresh", "fresh:0", "fresh:x", "office"):
        with pytest.raises(BadInputError, match="fresh:N"):
            campaign.parse_places([wrong])
    with pytest.raises(BadInputError, match="castle"):
        campaign.check_kinds(["office", "castle"])


def test_kinds_take_turns_and_each_place_has_its_own_seed() -> None:
    fresh = campaign.fresh_places(("office", "flat"), (5, 8, 2))
    assert fresh == ("office-5", "flat-8", "office-2")
    cases = campaign.cases_of(fresh, ("maze",), ("diff", "spot"), (5, 8, 2))
    assert [(c.world, c.robot, c.seed, c.places) for c in cases[:3]] == [
        ("office-5", "diff", 5, "fresh"),
        ("office-5", "spot", 5, "fresh"),
        ("flat-8", "diff", 8, "fresh"),
    ]
    assert [(c.world, c.seed, c.places) for c in cases[6:]] == [("maze", 5, "development")] * 2
    assert len({c.label for c in cases}) == len(cases)


def test_kinds_are_told_apart_with_what_they_cost() -> None:
    halls = [
        result("fresh", f"hall-{k}", sim_seconds=1000.0, run_cpu_seconds=150.0 + k, peak_memory_mb=800.0)
        for k in range(3)
    ]
    offices = [result("fresh", f"office-{k}", run_cpu_seconds=40.0, peak_memory_mb=500.0 + k) for k in range(2)]
    fields = campaign.summarize([*halls, *offices])
    assert (fields["fresh.hall.runs"], fields["fresh.office.runs"]) == (3, 2)
    assert fields["fresh.hall.cpu_per_sim_second_median"] == pytest.approx(0.151)
    assert fields["fresh.office.cpu_per_sim_second_worst"] == pytest.approx(0.2)
    assert (fields["fresh.hall.peak_memory_mb_worst"], fields["fresh.office.peak_memory_mb_worst"]) == (800.0, 501.0)
    assert fields["fresh.hall-1.diff.cpu_per_sim_second"] == pytest.approx(0.151)
    assert not any(name.startswith("fresh.hall.") for name in campaign.summarize(halls))


def test_bars_count_on_fresh_places_only() -> None:
    bad = result("development", "maze", collisions=3, ended="stuck")
    fields = campaign.summarize([*(result("fresh", f"office-{k}") for k in range(3)), bad])
    assert all(fields[f"bars.{name}"] for name in ("done", "collisions", "start_rms_m_median", "start_rms_m_95"))
    assert fields["bars.recovery_time_ratio"]
    assert (fields["fresh.diff.done"], fields["development.diff.done"]) == (3, 0)
    assert fields["development.diff.not_done"] == "stuck 1"
    assert fields["development.maze.diff.collisions"] == 3
    assert fields["fresh.diff.done_ratio_low_95"] == pytest.approx(0.4385, abs=1e-3)


@pytest.mark.parametrize(
    ("wrong", "bar"),
    [
        ({"ended": "stuck"}, "done"),
        ({"reachable_coverage_ratio": 0.97}, "done"),
        ({"reachable_coverage_ratio": None}, "done"),
        ({"collisions": 1}, "collisions"),
        ({"ate_unaligned_rms_m": 0.11}, "start_rms_m_95"),
        ({"recovery_time_ratio": 0.3}, "recovery_time_ratio"),
    ],
)
def test_each_bar_notices(wrong: dict[str, Any], bar: str) -> None:
    runs = [result("fresh", f"office-{k}") for k in range(4)]
    assert all(value for name, value in campaign.summarize(runs).items() if name.startswith("bars."))
    runs[2] |= wrong
    assert not campaign.summarize(runs)[f"bars.{bar}"]


def test_time_in_recoveries_is_a_share_of_all_time_and_the_median_is_the_middle() -> None:
    runs = [
        result("fresh", "a", recovery_time_ratio=0.5, sim_seconds=100.0, ate_unaligned_rms_m=0.01),
        result("fresh", "b", recovery_time_ratio=0.0, sim_seconds=900.0, ate_unaligned_rms_m=0.02),
        result("fresh", "c", recovery_time_ratio=0.0, sim_seconds=0.0, ate_unaligned_rms_m=0.07),
    ]
    fields = campaign.group_fields(runs)
    assert fields["recovery_time_ratio"] == pytest.approx(0.05)
    assert (fields["start_rms_m_median"], fields["start_rms_m_95"], fields["start_rms_m_worst"]) == (0.02, 0.07, 0.07)


def test_a_crashed_run_is_not_done() -> None:
    crashed = {"places": "fresh", "world": "office-1", "robot": "diff", "ended": "crashed", "why": "it broke"}
    fields = campaign.summarize([crashed])
    assert (fields["fresh.diff.done"], fields["fresh.diff.crashed"], fields["fresh.diff.not_done"]) == (
        0,
        1,
        "crashed 1",
    )
    assert not fields["bars.start_rms_m_median"], "unknown is no success"
    assert campaign.table(fields)


def test_a_campaign_draws_once_and_tells_its_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []

    def pretend(folder: Path, world: str, robot: str, seed: int, *rest: object) -> dict[str, Any]:
        ran.append(world)
        return {**GOOD, "world": world, "robot": robot, "seed": seed}

    monkeypatch.setattr(exploration_study, "run_demo", pretend)
    monkeypatch.setattr(campaign, "development_places", lambda: ("lab_empty",))
    summary = tmp_path / "summary.json"
    words = ["--places", "fresh:2", "development", "--kinds", "flat", "--robots", "diff", "--seed", "draw"]
    for _ in range(2):
        arguments = ["eval", "exploration", *words, "--processes", "0", "--out", str(tmp_path), "--json", str(summary)]
        assert main(arguments) == 0
    told = json.loads(summary.read_text())
    assert told["fresh_places"] == ",".join(ran[:2])
    assert told["seeds"] == ",".join(name.removeprefix("flat-") for name in ran[:2])
    assert ran[2:] == ["lab_empty"], "nothing is run again"
    assert told["bars.done"]
    assert told["development.lab_empty.diff.done"]
