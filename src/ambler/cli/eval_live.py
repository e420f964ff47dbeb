"""`ambler eval live`: every verb in real time, and a live robot whose simulator runs in another process, with its cable pulled, too."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli.run_options import add_settings, check_outputs, study_settings

if TYPE_CHECKING:
    from ambler.apps.scene import RunOptions

VERBS = ("explore", "navigate", "navigate_lost", "dock", "undock")


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "every verb in real time; a live robot behind a serial line and a socket, with its cable pulled, too"
    parser: argparse.ArgumentParser = subparsers.add_parser("live", help=text, description=text)
    parser.add_argument("--runs", type=int, default=10, help="of each verb in real time (default: 10)")
    parser.add_argument("--apart", type=int, default=5, help="explorations with the simulator apart (default: 5)")
    parser.add_argument("--cables", type=int, default=3, help="pulled cables (default: 3)")
    parser.add_argument("--verbs", nargs="*", default=list(VERBS), choices=VERBS)
    parser.add_argument("--seed", type=int, default=0, help="the first seed (default: 0)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: every run ended well, without a collision."""
    import time

    from ambler.apps import live_study
    from ambler.apps.scene import checked_scene
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    planned = _planned(args)
    for runs in planned.values():
        checked_scene(runs[0])
    check_outputs(args.json, args.out)
    started = time.perf_counter()
    warm_up(imported_kernel_modules())
    fields: dict[str, Any] = {}
    apart, cables = planned.pop("apart", []), planned.pop("cable", [])
    for verb, runs in planned.items():
        fields |= _summary(verb, [live_study.run_live(options, args.out) for options in runs])
    if apart:
        results = [live_study.run_live(options, args.out, replays=True) for options in apart]
        fields |= _summary("apart", results)
        fields["apart.replays_within"] = sum(r["is_replay_within"] for r in results)
        fields["apart.pose_difference_p95_m"] = live_study.worst([r["pose_difference_p95_m"] for r in results])
    pulled = [live_study.pull_cable(options, args.out) for options in cables]
    for name in pulled[0] if pulled else ():
        fields[f"cable.{name}_max"] = live_study.worst([p[name] for p in pulled])
    fields["cable.runs"] = len(pulled)
    for name, value in fields.items():
        print(f"{name}: {value}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    wanted = len(args.verbs) * args.runs + args.apart
    done = sum(v for name, v in fields.items() if name.endswith(".succeeded"))
    return 0 if done == wanted and not any(v for name, v in fields.items() if name.endswith(".collisions")) else 1


def _planned(args: argparse.Namespace) -> dict[str, list[RunOptions]]:
    """Return the runs of each verb, and those `apart` and with a pulled `cable`, where there are any."""
    from dataclasses import replace

    from ambler.apps.live_study import VERBS, cable_options

    settings = study_settings(args)

    def runs(count: int, make: Callable[[int], RunOptions], **how: Any) -> list[RunOptions]:
        return [settings.applied_to(replace(make(args.seed + k), **how)) for k in range(count)]

    planned = {verb: runs(args.runs, VERBS[verb], is_realtime=True) for verb in args.verbs}
    planned |= {"apart": runs(args.apart, VERBS["explore"], is_apart=True), "cable": runs(args.cables, cable_options)}
    return {name: of for name, of in planned.items() if of}


def _summary(name: str, results: list[dict[str, Any]]) -> dict[str, Any]:
    ended = [r["ended"] for r in results]
    return {
        f"{name}.runs": len(results),
        f"{name}.succeeded": sum(e in ("finished", "succeeded") for e in ended),
        f"{name}.ended": ", ".join(sorted(set(ended))),
        f"{name}.collisions": sum(r["collisions"] for r in results),
        f"{name}.lost_messages": sum(r["lost_messages"] for r in results),
        f"{name}.seconds_median": sorted(r["sim_seconds"] for r in results)[len(results) // 2] if results else None,
    }
