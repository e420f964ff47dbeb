"""What the studies of drawn sites share on the command line: which kinds, which robots, for how long, and how their results are told."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, names_of, seeds_of, write_summary

if TYPE_CHECKING:
    from ambler.studies.study_settings import StudySettings


def add_site_options(parser: argparse.ArgumentParser, robots: Sequence[str]) -> None:
    """Add kinds, robots (with their default), the time of an exploration and what every study has."""
    parser.add_argument("--kinds", nargs="+", default=["plot", "garage"], help="in turn (default: plot garage)")
    parser.add_argument("--robots", nargs="+", default=list(robots), help=f"default: {' '.join(robots)}")
    limit = "simulated seconds per exploration (default: that of `ambler demo`)"
    parser.add_argument("--time-limit", type=float, help=limit)
    add_study_options(parser, 2, "sites")


def sites_of(args: argparse.Namespace) -> tuple[tuple[str, ...], tuple[str, ...], tuple[int, ...], StudySettings]:
    """Return kinds, robots, seeds and settings; raises BadInputError for kinds and robots that there are not, before anything runs."""
    from ambler.core.errors import BadInputError
    from ambler.sim.generator.spatial import SPATIAL_KINDS

    kinds, robots = names_of(args.kinds), names_of(args.robots)
    for kind in kinds:
        if kind not in SPATIAL_KINDS:
            raise BadInputError(f"--kinds {kind!r}: there are {', '.join(SPATIAL_KINDS)}")
    settings, seeds = study_settings(args), seeds_of(args)
    settings.check([f"{kinds[0]}-{seeds[0]}"], robots)
    return kinds, robots, seeds, settings


def words_of(option: str, value: float | None) -> tuple[str, ...]:
    """Return an option with its value as words of a command line, none without a value."""
    return () if value is None else (option, str(value))


def tell(args: argparse.Namespace, fields: dict[str, Any], seeds: Sequence[int]) -> int:
    """Print and write a summary; returns 0 when all its bars are met."""
    print_fields(fields, 52, ".4g")
    write_summary(args, fields, seeds)
    return 0 if all(value for name, value in fields.items() if name.startswith("bars.")) else 1
