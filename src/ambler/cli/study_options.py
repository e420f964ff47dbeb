"""What every study can be told on the command line, and what is done with its results."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ambler.cli.run_options import add_settings, check_outputs

if TYPE_CHECKING:
    from ambler.studies.study import Case, Study

    C = TypeVar("C", bound=Case)


def add_study_options(parser: argparse.ArgumentParser, runs: int, what: str, *, processes: int = 1) -> None:
    """Add seeds, pool, folder, settings and JSON; `what` says what `--runs` counts."""
    parser.add_argument(
        "--seed",
        default="0",
        help="the first seed, all of them with commas, or `draw` for some that nobody chose (default: 0)",
    )
    parser.add_argument("--runs", type=int, default=runs, help=f"{what} (default: {runs})")
    pool = parser.add_argument_group("where it runs")
    pool.add_argument(
        "--processes",
        type=int,
        default=processes,
        help=f"runs at the same time; 0: in this process (default: {processes})",
    )
    pool.add_argument("--cluster", metavar="ADDRESS", help="on the workers of this Dask scheduler, as tcp://host:8786")
    pool.add_argument("--out", type=Path, default=Path("runs"), help="where results are kept (default: runs)")
    pool.add_argument("--fresh", action="store_true", help="run again what --out has results of")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the summary as JSON")


def seeds_of(args: argparse.Namespace) -> tuple[int, ...]:
    """Return the seeds that were asked for; raises BadInputError."""
    from ambler.studies import study

    return study.seeds_of(args.seed, args.runs, args.out / f"{vars(args)['eval_verb']}.seeds.json")


def first_seed(args: argparse.Namespace) -> int:
    """Return the one seed of a study that draws all its cases from it; raises BadInputError."""
    return seeds_of(args)[0]


def conduct_study(args: argparse.Namespace, study: Study[C]) -> list[dict[str, Any]]:
    """Run a study where it was asked to; raises BadInputError when its results could not be written."""
    from ambler.studies.pool import ClusterPool, LocalPool, Pool, ThisProcess
    from ambler.studies.study import Spent, conduct

    check_outputs(args.json, args.out)
    spent = vars(args).setdefault("spent", Spent())  # a campaign may be several studies
    pool: Pool
    if args.cluster:
        pool = ClusterPool(args.cluster)
    else:
        pool = LocalPool(args.processes) if args.processes else ThisProcess()
    return conduct(study, args.out, pool, is_fresh=args.fresh, tell=lambda line: print(line, flush=True), spent=spent)


def write_summary(args: argparse.Namespace, fields: dict[str, Any], seeds: Sequence[int]) -> None:
    """Write the summary of a study with its seeds and the seconds of all its cases, where it was asked for."""
    from ambler.evaluation.results import write_results

    if args.json:
        listed = ",".join(str(seed) for seed in seeds)
        command = with_seeds(args.command_line, listed)
        told = {"seeds": listed, **fields}
        write_results(args.json, command, seeds[0], args.spent.wall, told, cpu_seconds=args.spent.cpu)


def with_seeds(command: str, listed: str) -> str:
    """Return a command that names the seeds which were drawn, so that run again it gives the same."""
    words = shlex.split(command)
    for k, word in enumerate(words):
        if word == "--seed=draw":
            words[k] = f"--seed={listed}"
        elif word == "draw" and words[k - 1] == "--seed":
            words[k] = listed
    return shlex.join(words)


def names_of(words: Sequence[str]) -> tuple[str, ...]:
    """Return names given as words, with or without commas."""
    return tuple(name for word in words for name in word.split(",") if name)
