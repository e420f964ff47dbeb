"""`ambler eval interrupts`: signals at random instants of runs; what was known must be saved, and nothing may be left half done."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli.run_options import add_settings, check_outputs, study_settings

if TYPE_CHECKING:
    from ambler.apps.study_settings import StudySettings

INTERRUPTED = 130
ROBOT = "diff"
LATEST_SIGNAL = 12.0  # seconds after the start of the process


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "end runs by signals at random instants: is what was known saved, and nothing left half done?"
    parser: argparse.ArgumentParser = subparsers.add_parser("interrupts", help=text, description=text)
    parser.add_argument("--runs", type=int, default=30, help="(default: 30)")
    parser.add_argument("--seed", type=int, default=0, help="of the instants and signals (default: 0)")
    parser.add_argument("--world", default="office", help="what is explored (default: office)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: every run ended with code 130 and left a whole report and map, or nothing at all."""
    import random
    import signal
    import time

    from ambler.evaluation.results import write_results

    settings = study_settings(args)
    settings.check([args.world], [ROBOT])
    check_outputs(args.json, args.out)
    started, chance = time.perf_counter(), random.Random(args.seed)
    fields: dict[str, Any] = {"runs": args.runs, "in_order": 0, "with_map": 0, "with_report": 0, "before_the_run": 0}
    wrong: list[str] = []
    for k in range(args.runs):
        number = chance.choice((signal.SIGINT, signal.SIGTERM))
        seconds = chance.uniform(0.2, LATEST_SIGNAL)
        folder = args.out / f"interrupt-{args.seed}-{k}{settings.suffix}"
        found = interrupted_run(args.world, k, seconds, number, folder, settings)
        fields["in_order"] += not found["wrong"]
        for name in ("with_map", "with_report", "before_the_run"):
            fields[name] += bool(found[name])
        wrong += [f"run {k} ({number.name} after {seconds:.1f} s): {found['wrong']}"] if found["wrong"] else []
        print(f"run {k}: {number.name} after {seconds:.1f} s: {found['wrong'] or 'in order'}", flush=True)
    fields["wrong"] = "; ".join(wrong)
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 1 if wrong else 0


def interrupted_run(
    world: str, seed: int, seconds: float, number: Any, out: Path, settings: StudySettings
) -> dict[str, Any]:
    """Start an exploration in a process of its own, send it a signal after some time, and look at what it leaves."""
    import subprocess
    import sys
    import time

    out.mkdir(parents=True, exist_ok=True)
    words = [sys.executable, "-m", "ambler.cli.main", "demo", "--exit", "--no-view", "--world", world, "--robot", ROBOT]
    words += ["--seed", str(seed), "--out", str(out / "runs"), "--json", str(out / "result.json")]
    words += settings.words(out / "profile.yaml")
    with (out / "output.txt").open("w") as log:
        process = subprocess.Popen(words, stdout=log, stderr=subprocess.STDOUT)
        time.sleep(seconds)
        process.send_signal(number)
        code = process.wait()
    return judge_remains(code, out)


def judge_remains(code: int, out: Path) -> dict[str, Any]:
    """Say what a run left in `out`, and in one sentence what is wrong with it (empty: nothing)."""
    import json

    from ambler.core.errors import AmblerError
    from ambler.wire.map_files import load_map
    from ambler.wire.mcap_reader import read_recording

    folders = [p for p in (out / "runs").glob("*") if not p.is_symlink()]
    found: dict[str, Any] = {"with_map": False, "with_report": False, "before_the_run": not folders, "wrong": ""}
    partial = [p.name for p in out.rglob("*") if "partial" in p.name or p.suffix in (".tmp", ".part")]
    if code not in (0, INTERRUPTED):
        found["wrong"] = f"exit code {code}"
    elif partial:
        found["wrong"] = f"left half done: {', '.join(partial)}"
    elif folders:
        (folder,) = folders
        found["with_map"] = (folder / "map.yaml").exists()
        found["with_report"] = (folder / "report.html").exists()
        text = (folder / "report.html").read_text() if found["with_report"] else ""
        try:
            if found["with_map"]:
                load_map(folder / "map.yaml")
            count = sum(1 for _ in read_recording(folder / "recording"))
            ended = json.loads((folder / "report.json").read_text())["results"]["ended"] if found["with_report"] else ""
        except (AmblerError, OSError, ValueError, KeyError) as error:
            found["wrong"] = f"cannot be read: {error}"
            return found
        if not found["with_report"]:
            found["wrong"] = "no report"
        elif count == 0:
            found["wrong"] = "the recording is empty"
        elif code == INTERRUPTED and ended == "interrupted" and "no frontier is left" in text:
            found["wrong"] = "the report says that no frontier is left"
        elif ended == "interrupted" and not found["with_map"] and count > 200:
            found["wrong"] = "no map"
    return found
