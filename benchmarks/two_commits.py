"""Runs the same jobs with two checkouts in turn and tells what changed: `python benchmarks/two_commits.py OLD NEW --json FILE`.

OLD and NEW are folders with a checkout each; both run with this Python. Every job writes its own result; of each number the median over
the runs of both checkouts is written, and of the times their ratio, new to old. Nothing else should run beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from ambler.evaluation.results import write_results

# Name, arguments of the old checkout, of the new one (the verbs changed their options).
JOBS: dict[str, tuple[str, str]] = {
    "office_diff": ("demo --world office --exit --no-view",) * 2,
    "lab_spot": ("demo --world lab_obstacle --robot spot --exit --no-view",) * 2,
    "warehouse_amr": ("demo --world warehouse --robot amr_omni --exit --no-view",) * 2,
    "navigate_office": (
        "navigate 10,0 --world office --exit --no-view",
        "navigate 10,0 --world office --exit --no-view",
    ),
    "rollout": ("bench control --runs 300",) * 2,
    "dock_room": ("dock charger_1 --world dock_room", "dock charger_1 --world dock_room --exit --no-view"),
}
TIMES = ("run_seconds", "process_seconds", "rollout_differential_60_ms", "rollout_omni_60_ms")
SAME = {"last_goal_error_m": "worst_goal_error_m", "goals_reached": "goals_reached"}


def run_once(checkout: Path, arguments: str, seed: int, out: Path) -> dict[str, Any]:
    """Run one job in a process of its own; returns its result with the whole time of the process."""
    result = out / "result.json"
    result.unlink(missing_ok=True)
    words = [sys.executable, "-m", "ambler.cli.main", *arguments.split()]
    words += ["--seed", str(seed), "--json", str(result)]
    if not arguments.startswith("bench"):
        words += ["--out", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src"), "OMP_NUM_THREADS": "1"}
    started = time.perf_counter()
    subprocess.run(words, env=environment, cwd=out, capture_output=True, check=False)
    seconds = time.perf_counter() - started
    found: dict[str, Any] = json.loads(result.read_text()) if result.exists() else {"ended": "crashed"}
    return {**found, "process_seconds": seconds}


def compare(name: str, runs: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Return flat fields `<job>.<old or new>.<field>` and `<job>.<time>_ratio`, medians over the runs."""
    fields: dict[str, Any] = {}
    for side, results in runs.items():
        fields[f"{name}.{side}.ended"] = ", ".join(sorted({r.get("ended", "measured") for r in results}))
        for key in sorted({k for r in results for k, v in r.items() if isinstance(v, float | int) and k != "seed"}):
            values = [r[key] for r in results if r.get(key) is not None]
            fields[f"{name}.{side}.{SAME.get(key, key)}"] = statistics.median(values) if values else None
    for key in TIMES:
        pairs = [(n[key], o[key]) for o, n in zip(runs["old"], runs["new"], strict=True) if key in o and key in n]
        if pairs:
            fields[f"{name}.{key}_ratio"] = statistics.median(new / old for new, old in pairs)
    return fields


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=3, help="seeds, each run with both (default: 3)")
    parser.add_argument("--only", nargs="*", default=list(JOBS), choices=list(JOBS))
    parser.add_argument("--json", type=Path, required=True)
    args = parser.parse_args()
    started = time.perf_counter()
    fields: dict[str, Any] = {"runs": args.runs}
    with tempfile.TemporaryDirectory() as folder:
        for checkout, side in ((args.old, 0), (args.new, 1)):  # compile and load everything once
            run_once(checkout.resolve(), JOBS["dock_room"][side], 0, Path(folder))
        for name in args.only:
            runs: dict[str, list[dict[str, Any]]] = {"old": [], "new": []}
            for k in range(args.runs):
                for side, checkout in enumerate((args.old, args.new)):
                    out = Path(folder) / f"{name}-{side}-{k}"
                    out.mkdir()
                    runs["new" if side else "old"].append(
                        run_once(checkout.resolve(), JOBS[name][side], args.seed + k, out)
                    )
            fields |= compare(name, runs)
            print(name, {k: v for k, v in fields.items() if k.startswith(name) and k.endswith("ratio")}, flush=True)
    command = (
        f"python benchmarks/two_commits.py OLD NEW --seed {args.seed} --runs {args.runs} --only {' '.join(args.only)}"
    )
    write_results(args.json, command, args.seed, time.perf_counter() - started, fields)
    return 0


if __name__ == "__main__":
    sys.exit(main())
