"""Signals at random instants of explorations: what was known must be saved, and nothing may be left half done."""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.core.errors import AmblerError
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.wire.map_files import load_map
from ambler.wire.mcap_reader import read_recording

INTERRUPTED = 130
ROBOT = "diff"
LATEST_SIGNAL = 12.0  # seconds after the start of the process


@dataclass(frozen=True, slots=True)
class InterruptCase:
    """An exploration with the seed `number` that gets a signal so many seconds after its process was started."""

    world: str
    seed: int
    number: int
    signal_name: str
    after: float
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.world).stem}-{self.seed}-{self.number}"


def interrupt_study(world: str, runs: int, seed: int, settings: StudySettings) -> Study[InterruptCase]:
    """Return the study of `runs` signals, drawn by the seed."""
    chance, cases = random.Random(seed), []
    for k in range(runs):
        name = chance.choice((signal.SIGINT, signal.SIGTERM)).name
        cases.append(InterruptCase(world, seed, k, name, chance.uniform(0.2, LATEST_SIGNAL), settings))
    return Study("interrupts", cases, interrupted_run, _line)


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return counts, and what was wrong in words."""
    fields: dict[str, Any] = {"runs": len(results), "in_order": sum(r.get("wrong") == "" for r in results)}
    for name in ("with_map", "with_report", "before_the_run"):
        fields[name] = sum(bool(r.get(name)) for r in results)
    fields["wrong"] = "; ".join(
        f"run {r['number']} ({r['signal_name']} after {r['after']:.1f} s): {r.get('wrong', r.get('why'))}"
        for r in results
        if r.get("wrong") != ""
    )
    return fields


def interrupted_run(case: InterruptCase, out: Path) -> dict[str, Any]:
    """Start an exploration in a process of its own, send it the signal, and look at what it leaves."""
    shutil.rmtree(out / "runs", ignore_errors=True)
    words = [sys.executable, "-m", "ambler.cli.main", "demo", "--exit", "--no-view"]
    words += ["--world", case.world, "--robot", ROBOT, "--seed", str(case.number)]
    words += ["--out", str(out / "runs"), "--json", str(out / "demo.json"), *case.settings.words(out / "profile.yaml")]
    with (out / "demo.log").open("w") as log:
        process = subprocess.Popen(words, stdout=log, stderr=subprocess.STDOUT)
        time.sleep(case.after)
        process.send_signal(signal.Signals[case.signal_name])
        code = process.wait()
    return judge_remains(code, out)


def judge_remains(code: int, out: Path) -> dict[str, Any]:
    """Say what a run left in `out`, and in one sentence what is wrong with it (empty: nothing)."""
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


def _line(result: dict[str, Any]) -> str:
    return f"{result['signal_name']} after {result['after']:.1f} s: {result['wrong'] or 'in order'}"
