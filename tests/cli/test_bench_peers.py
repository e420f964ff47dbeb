"""A bench compares with what it measured in the same run: no ratio to a peer without that peer's own time."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from ambler.cli.main import main

RESULTS = Path(__file__).parents[2] / "docs" / "results"
PEERS = re.compile(r"\b(navfn|nav2|ros ?1|amcl|explore_lite)\b", re.IGNORECASE)


def unmeasured(fields: dict[str, object]) -> list[str]:
    """Return the ratios to peers of which no time was measured."""
    ratios = {name: name.removeprefix("ratio_vs_").split("_")[0] for name in fields if name.startswith("ratio_vs_")}
    return [name for name, peer in ratios.items() if not any(f.startswith(f"peer_{peer}") for f in fields)]


@pytest.mark.parametrize(
    "words",
    [
        ["costmap", "--sizes", "60", "--runs", "1"],
        ["control", "--runs", "2"],
        ["planner", "--sizes", "1000", "--runs", "1", "--oracle-up-to", "0", "--paths", "0"],
    ],
    ids=lambda words: words[0],
)
def test_a_bench_names_no_peer_that_it_did_not_run(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", *words, "--json", str(tmp_path / "r.json")]) in (0, 1)
    fields = json.loads((tmp_path / "r.json").read_text())
    assert unmeasured(fields) == []
    assert not PEERS.search(capsys.readouterr().out)


@pytest.mark.parametrize("file", sorted(RESULTS.glob("bench_*.json")), ids=lambda file: file.stem)
def test_results_that_are_kept_hold_no_ratio_without_its_peer(file: Path) -> None:
    assert unmeasured(json.loads(file.read_text())) == []
