"""A resumed campaign takes the results that exist, and says worst values and whether all ended well."""

import json
from pathlib import Path

import pytest

from ambler.cli.main import main


def result(out: Path, robot: str, seed: int, **fields: object) -> None:
    told = {"world": "maze", "robot": robot, "seed": seed, "ended": "finished", "collisions": 0, **fields}
    (out / f"maze-{robot}-tour-{seed}.json").write_text(json.dumps(told))


@pytest.mark.parametrize(("collisions", "code"), [(0, 0), (1, 1)])
def test_results_that_exist_are_summarized_and_not_run_again(tmp_path: Path, collisions: int, code: int) -> None:
    for seed, coverage in ((0, 0.99), (1, 0.985), (2, 1.0)):
        result(tmp_path, "diff", seed, coverage_ratio=coverage, sim_seconds=100.0 + seed)
        result(tmp_path, "amr_omni", seed, coverage_ratio=None, collisions=collisions if seed == 1 else 0)
    summary = tmp_path / "summary.json"
    words = ["--worlds", "maze", "--robots", "diff", "amr_omni", "--runs", "3", "--resume"]
    assert main(["eval", "exploration", *words, "--out", str(tmp_path), "--json", str(summary)]) == code
    told = json.loads(summary.read_text())
    assert told["maze.diff.tour.runs"] == told["maze.diff.tour.finished"] == 3
    assert told["maze.diff.tour.coverage_ratio_worst"] == 0.985
    assert told["maze.diff.tour.coverage_ratio_median"] == 0.99
    assert told["maze.diff.tour.sim_seconds_worst"] == 102.0
    assert told["maze.amr_omni.tour.collisions"] == collisions
    assert "maze.amr_omni.tour.coverage_ratio_worst" not in told
