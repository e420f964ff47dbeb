"""Runs one campaign on the local pool and on a Dask cluster of this machine, one of whose two workers is killed in the middle, and compares
the results case by case: `python benchmarks/cluster_and_local.py --json FILE`. Needs the extra `cluster`.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from ambler.evaluation.results import write_results
from ambler.studies.exploration_study import ExplorationCase, exploration_study, summarize
from ambler.studies.pool import ClusterPool, LocalPool
from ambler.studies.study import conduct

ADDRESS = "tcp://127.0.0.1:8791"
OF_THE_MACHINE = ("seconds", "factor", "memory", "recording", "command", "date", "folder")
WORKERS = 2


def is_of_the_machine(name: str) -> bool:
    """Say whether a value may differ between two runs of the same code: times of this machine, places of files."""
    return any(part in name for part in OF_THE_MACHINE) and name != "sim_seconds"


def same(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """Return the names of values that differ although they must not."""
    return [name for name in sorted({*a, *b}) if not is_of_the_machine(name) and a.get(name) != b.get(name)]


def start_cluster(folder: Path) -> list[subprocess.Popen[bytes]]:
    """Start a scheduler and workers, each in a process of its own that no nanny starts again."""
    dask = [
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        ADDRESS[-4:],
        "--no-dashboard",
    ]
    worker = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        ADDRESS,
        "--nthreads",
        "1",
        "--no-nanny",
        "--no-dashboard",
    ]
    with (folder / "cluster.log").open("w") as log:
        scheduler = subprocess.Popen(dask, stdout=log, stderr=log, cwd=folder)
        time.sleep(3.0)
        workers = [subprocess.Popen(worker, stdout=log, stderr=log, cwd=folder) for _ in range(WORKERS)]
    time.sleep(5.0)
    return [scheduler, *workers]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--world", default="lab_empty")
    parser.add_argument("--json", type=Path, required=True)
    args = parser.parse_args()
    started = time.perf_counter()
    study = exploration_study([ExplorationCase(args.world, "diff", "tour", seed) for seed in range(args.runs)])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        local = conduct(study, folder / "local", LocalPool(WORKERS))
        cluster = start_cluster(folder)
        told: list[str] = []

        def tell(line: str) -> None:
            print(line, flush=True)
            told.append(line)
            if len(told) == args.runs // 2:
                os.kill(cluster[1].pid, signal.SIGKILL)
                print("one worker is killed", flush=True)

        try:
            apart = conduct(study, folder / "cluster", ClusterPool(ADDRESS), tell=tell)
        finally:
            for process in reversed(cluster):
                process.kill()
                process.wait()
    differing = {a["label"]: found for a, b in zip(local, apart, strict=True) if (found := same(a, b))}
    for label, names in differing.items():
        print(f"{label} differs in {', '.join(names)}")
    tables = [{k: v for k, v in summarize(results).items() if not is_of_the_machine(k)} for results in (local, apart)]
    fields = {
        "runs": args.runs,
        "local.results": len(local),
        "cluster.results": len(apart),
        "cluster.told": len(told),
        "cluster.labels": len({r["label"] for r in apart}),
        "cluster.crashed": sum(r["ended"] == "crashed" for r in apart),
        "cases_that_differ": len(differing),
        "is_table_equal": tables[0] == tables[1],
        **{f"table.{name}": value for name, value in tables[1].items()},
    }
    write_results(args.json, " ".join(["python", *sys.argv]), 0, time.perf_counter() - started, fields)
    is_good = fields["is_table_equal"] and not differing and fields["cluster.told"] == args.runs
    print("equal" if is_good else "not equal")
    return 0 if is_good else 1


if __name__ == "__main__":
    raise SystemExit(main())
