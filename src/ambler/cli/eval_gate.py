"""`ambler eval gate`: a long random search for cases in which the velocity gate breaks a promise."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "gate", help="a long random search for counterexamples to what the velocity gate promises"
    )
    parser.add_argument("--runs", type=int, default=1_000_000, help="random cases per seed (default: 1000000)")
    parser.add_argument("--seed", type=int, default=0, help="the first seed (default: 0)")
    parser.add_argument("--seeds", type=int, default=1, help="how many seeds, one after the other (default: 1)")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Search; 0 when no counterexample was found."""
    import sys
    import time

    from ambler.apps.config import recorded_config
    from ambler.evaluation.gate_search import GateSearchResult, search_gate
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    if args.runs < 1 or args.seeds < 1 or args.seed < 0:
        print("--runs and --seeds must be positive, --seed not negative", file=sys.stderr)
        return 2
    settings = study_settings(args, "gate.sources", "gate.stale_delay", takes_faults=False)
    config = recorded_config(settings.profile).gate
    warm_up(imported_kernel_modules())
    wall, cpu = time.perf_counter(), time.process_time()
    results: list[GateSearchResult] = []
    for seed in range(args.seed, args.seed + args.seeds):

        def tell(done: int, seed: int = seed) -> None:
            if sys.stderr.isatty():
                print(f"\rseed {seed}: {done} of {args.runs} cases", end="", file=sys.stderr, flush=True)

        results.append(search_gate(args.runs, seed, tell, config))
        print(f"seed {seed}: {results[-1].cases} cases, {results[-1].counterexamples} counterexamples", flush=True)
    names = results[0].violations
    example = next((r.example for r in results if r.example), "")
    fields: dict[str, Any] = {
        "seeds": ",".join(str(s) for s in range(args.seed, args.seed + args.seeds)),
        "cases": sum(r.cases for r in results),
        "gate_runs": sum(r.gate_runs for r in results),
        "gate_outputs_moving": sum(r.gate_moving for r in results),
        "counterexamples": sum(r.counterexamples for r in results),
        **{f"counterexamples_{name}": sum(r.violations[name] for r in results) for name in names},
        "grazes": sum(r.grazes for r in results),
        "cpu_seconds": round(time.process_time() - cpu, 1),
    }
    if example:
        print(example)
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - wall, fields)
    return 0 if fields["counterexamples"] == 0 else 1
