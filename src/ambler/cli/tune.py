"""`ambler tune SPACE.yaml`: vary settings of the exploring robot over worlds and seeds, rank them, save the best as a profile."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "tune", help="search a space of settings over worlds and seeds; resumable; saves the best as a profile"
    )
    parser.add_argument("space", type=Path, metavar="SPACE.yaml", help="what to vary and what counts (docs/tuning.md)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the study's folder; run again to go on")
    parser.add_argument("--processes", type=int, default=1, help="runs at the same time (default: 1)")
    parser.add_argument("--seed", type=int, help="seed of the sampling (default: that of the file)")
    parser.add_argument("--trials", type=int, help="how many trials (default: that of the file; may grow later)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Search, rank, report. 0: the best trial keeps every constraint in every case."""
    from dataclasses import replace

    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.evaluation.tuning import write_best, write_ranking
    from ambler.evaluation.tuning_report import study_fields, write_study_report
    from ambler.evaluation.tuning_space import load_space
    from ambler.studies.pool import LocalPool
    from ambler.studies.study import Spent
    from ambler.studies.tuning_study import check_space, tune

    space = load_space(args.space)
    if args.seed is not None:
        space = replace(space, seed=args.seed)
    if args.trials is not None:
        if args.trials < 2:
            raise BadInputError("--trials: needs at least 2, the defaults are one of them")
        space = replace(space, trials=args.trials)
    pool = LocalPool(args.processes)
    check_space(space)
    spent = Spent()
    ranking = tune(space, args.out, pool, tell=lambda line: print(line, flush=True), spent=spent)
    fields = study_fields(space, ranking)
    write_ranking(args.out / "ranking.jsonl", ranking)
    report = write_study_report(args.out, space, ranking)
    best = ranking[0]
    is_proved = best.is_valid and best.cases == len(space.cases())
    command = f"ambler tune {args.space} --out {args.out} --processes {args.processes} --seed {space.seed}"
    if is_proved:
        heading = f"trial {best.trial} of `{command}`, objective {best.objective:.4f} (defaults {fields['default_objective']:.4f})"
        write_best(args.out / "best.yaml", space.profile(best.values), heading)
        print(
            f"best: trial {best.trial}, {best.objective:.4f} against {fields['default_objective']:.4f} of the defaults"
        )
        print(f"profile: {args.out / 'best.yaml'}  (ambler demo --profile)")
    else:
        print(f"no trial keeps the constraints in every case; the nearest: {'; '.join(best.broken[:1]) or best.trial}")
    print(f"report: {report}")
    if args.json:
        write_results(args.json, command, space.seed, spent.wall, fields, cpu_seconds=spent.cpu)
    return 0 if is_proved else 1
