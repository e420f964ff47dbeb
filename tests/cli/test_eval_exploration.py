"""A study of explorations takes the results that exist, and says worst values and whether all ended well."""

import json
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ambler.cli.main import main
from ambler.studies import exploration_study, pool


@pytest.mark.parametrize(("collisions", "code"), [(0, 0), (1, 1)])
def test_explorations_are_summarized_and_not_run_again(
    tmp_path: Path, collisions: int, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[tuple[str, int]] = []

    def pretend(folder: Path, world: str, robot: str, seed: int, *rest: object) -> dict[str, Any]:
        ran.append((robot, seed))
        result = {"world": world, "robot": robot, "seed": seed, "ended": "finished", "collisions": 0}
        if robot == "diff":
            return {**result, "coverage_ratio": (0.99, 0.985, 1.0)[seed], "sim_seconds": 100.0 + seed}
        return {**result, "coverage_ratio": None, "collisions": collisions if seed == 1 else 0}

    monkeypatch.setattr(exploration_study, "run_demo", pretend)
    ticks = count(0.0)  # of a clock on which every case takes a second
    monkeypatch.setattr(pool, "time", SimpleNamespace(perf_counter=lambda: next(ticks)))
    summary = tmp_path / "summary.json"
    words = ["--worlds", "maze", "--robots", "diff", "amr_omni", "--runs", "3", "--processes", "0"]
    for _ in range(2):
        assert main(["eval", "exploration", *words, "--out", str(tmp_path), "--json", str(summary)]) == code
    assert ran == [(robot, seed) for robot in ("diff", "amr_omni") for seed in range(3)]
    told = json.loads(summary.read_text())
    assert told["wall_seconds"] == len(ran), "although the second run did not run any"
    assert told["seeds"] == "0,1,2"
    assert told["maze.diff.tour.runs"] == told["maze.diff.tour.finished"] == 3
    assert told["maze.diff.tour.coverage_ratio_worst"] == 0.985
    assert told["maze.diff.tour.coverage_ratio_median"] == 0.99
    assert told["maze.diff.tour.sim_seconds_worst"] == 102.0
    assert told["maze.amr_omni.tour.collisions"] == collisions
    assert "maze.amr_omni.tour.coverage_ratio_worst" not in told
