"""Draws results at random, runs the command of each again at its commit, and compares: `python benchmarks/run_again.py --json FILE`.

Only results that name their commit, were made from an unchanged source, and took at most `--most` seconds are drawn, and only commands that
say all: not those that work on what another run left (`runs/`), nor old ones that draw their seeds. Times, memory and places of files may differ,
nothing else.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from ambler.evaluation.results import write_results

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
OF_THE_MACHINE = (
    "seconds",
    "factor",
    "memory",
    "recording",
    "command",
    "date",
    "folder",
    "machine",
    "time_",
    "cpu",
    "duration",
    "_ms",
)


def is_of_the_machine(name: str) -> bool:
    """Say whether a value may differ between two runs of the same code."""
    return any(part in name for part in OF_THE_MACHINE) and "sim_seconds" not in name


def candidates(most: float) -> list[Path]:
    """Return the results that can be made again."""
    out = []
    for path in sorted(RESULTS.glob("*.json")):
        told = json.loads(path.read_text())
        is_ours = (
            str(told.get("command", "")).startswith("ambler ") and " bench " not in told["command"]
        )  # those are times
        if (
            is_ours
            and says_all(told)
            and told.get("commit")
            and told.get("is_dirty") is False
            and told["wall_seconds"] <= most
        ):
            out.append(path)
    return out


def says_all(told: dict[str, Any]) -> bool:
    """Say whether a command can give the same numbers by itself."""
    words = shlex.split(told["command"])
    inputs = [word for k, word in enumerate(words) if k and not words[k - 1].startswith("--")]
    return "draw" not in words and not any(word.startswith("runs/") for word in inputs)


def run_again(path: Path, folder: Path) -> list[str]:
    """Run the command of a result at its commit; returns the names of values that differ although they must not."""
    before = json.loads(path.read_text())
    checkout = folder / before["commit"][:12]
    if not checkout.exists():
        subprocess.run(
            ["git", "-C", ROOT, "worktree", "add", "--detach", checkout, before["commit"]],
            check=True,
            capture_output=True,
        )
    words = shlex.split(os.path.expandvars(before["command"]))[1:]
    result = folder / path.name
    # results do not depend on how many processes there are; one leaves the machine to others
    for option, value in (("--json", str(result)), ("--out", str(folder / path.stem)), ("--processes", "1")):
        if option in words:
            words[words.index(option) + 1] = value
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    subprocess.run(
        [sys.executable, "-m", "ambler.cli.main", *words], env=environment, cwd=folder, capture_output=True, check=False
    )
    after: dict[str, Any] = json.loads(result.read_text()) if result.exists() else {}
    return [
        name
        for name in sorted({*before, *after})
        if not is_of_the_machine(name) and before.get(name) != after.get(name)
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--most", type=float, default=120.0, help="wall seconds of a result at most (default: 120)")
    parser.add_argument("--json", type=Path, required=True)
    args = parser.parse_args()
    started, fields = time.perf_counter(), dict[str, Any]()
    known = candidates(args.most)
    drawn = random.Random(args.seed).sample(known, min(args.count, len(known)))
    equal = 0
    with tempfile.TemporaryDirectory() as name:
        for path in drawn:
            differing = run_again(path, Path(name))
            fields[f"{path.stem}.differing"] = ", ".join(differing)
            print(f"{path.stem}: {'differs in ' + ', '.join(differing) if differing else 'equal'}", flush=True)
            equal = sum(not value for value in fields.values())
            told = {"candidates": len(known), "drawn": len(drawn), "compared": len(fields), "equal": equal, **fields}
            # after each of them, for the whole takes long and may be interrupted
            write_results(args.json, " ".join(["python", *sys.argv]), args.seed, time.perf_counter() - started, told)
    subprocess.run(["git", "-C", ROOT, "worktree", "prune"], check=True)
    return 0 if 0 < len(drawn) == equal else 1


if __name__ == "__main__":
    raise SystemExit(main())
