"""`ambler eval live`: every verb in real time, and a live robot whose simulator runs in another process, with its cable pulled, too."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, first_seed, print_fields, write_summary

VERBS = ("explore", "navigate", "navigate_lost", "dock", "undock")


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "every verb in real time; a live robot behind a serial line and a socket, with its cable pulled, too"
    parser: argparse.ArgumentParser = subparsers.add_parser("live", help=text, description=text)
    parser.add_argument("--apart", type=int, default=5, help="explorations with the simulator apart (default: 5)")
    parser.add_argument("--cables", type=int, default=3, help="pulled cables (default: 3)")
    parser.add_argument("--verbs", nargs="*", default=list(VERBS), choices=VERBS)
    add_study_options(parser, 10, "of each verb in real time")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: every run ended well, without a collision."""
    from ambler.apps.scene import checked_scene
    from ambler.studies.live_study import LiveCase, is_good, live_study, summarize

    settings, seed = study_settings(args), first_seed(args)
    counts = {**dict.fromkeys(args.verbs, args.runs), "apart": args.apart, "cable": args.cables}
    cases = [LiveCase(kind, seed + k, settings) for kind, count in counts.items() for k in range(count)]
    for options in {case.kind: case.options for case in cases}.values():
        checked_scene(options)
    results = conduct_study(args, live_study(cases))
    fields = summarize(results)
    print_fields(fields)
    write_summary(args, fields, [seed])
    return 0 if all(map(is_good, results)) else 1
