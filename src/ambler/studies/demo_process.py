"""One demonstration, or another verb of a simulated robot, in a process of its own, for studies that need many."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from ambler.studies.study_settings import DEFAULTS, StudySettings


def run_demo(
    folder: Path,
    world: str,
    robot: str,
    seed: int,
    options: tuple[str, ...] = (),
    settings: StudySettings = DEFAULTS,
) -> dict[str, Any]:
    """Run a demonstration; see `run_verb`."""
    return run_verb("demo", folder, world, robot, seed, options, settings)


def run_verb(
    verb: str,
    folder: Path,
    world: str,
    robot: str,
    seed: int,
    options: tuple[str, ...] = (),
    settings: StudySettings = DEFAULTS,
) -> dict[str, Any]:
    """Run `ambler VERB` in `folder` and return its result; one that died has `ended` = crashed and `why`.

    `options` are further words of the verb. What it prints goes to `<verb>.log`, its result to `<verb>.json`, its settings stand in
    `profile.yaml`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    result_file, log_file = folder / f"{verb}.json", folder / f"{verb}.log"
    result_file.unlink(missing_ok=True)
    command = [
        *(sys.executable, "-m", "ambler.cli.main", verb, "--exit", "--no-view"),
        *("--world", world, "--robot", robot, "--seed", str(seed)),
        *("--out", str(folder), "--json", str(result_file)),
        *settings.words(folder / "profile.yaml"),
        *options,
    ]
    with log_file.open("w") as log:
        subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False)
    if result_file.exists():
        result: dict[str, Any] = json.loads(result_file.read_text())
        return result
    lines = log_file.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["it said nothing"]
    return {"ended": "crashed", "why": lines[-1]}


def demo_line(result: dict[str, Any]) -> str:
    """Say in a few words how a demonstration ended."""
    return f"{result['ended']}, {result.get('collisions')} collisions"
