"""One run of a tuning study: a demonstration in a process of its own, its result kept, its recording thrown away."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ambler.apps.scene import RunOptions, checked_scene
from ambler.core.errors import AmblerError, BadInputError
from ambler.evaluation.tuning_space import Case, TuningSpace

INTERRUPTED = (130, -signal.SIGINT, -signal.SIGTERM)  # Ctrl-C reaches the runs as well


class RunKilledError(AmblerError):
    """A run was ended from outside, by want of memory for example, which says nothing of its trial."""

    code = "RUN_KILLED"


@dataclass(frozen=True, slots=True)
class DemoEvaluator:
    """Runs `ambler demo` with a profile and returns its result; a run that died has `ended` = crashed and its log's last line.
    Raises KeyboardInterrupt for one that was interrupted, RunKilledError for one that was killed, BadInputError for a bad profile.

    `work` holds the folders of the runs under way and the logs; `options` are passed to every run.
    """

    work: Path
    options: tuple[str, ...] = ()

    def __call__(self, profile: dict[str, Any], case: Case, label: str) -> dict[str, Any]:
        folder = self.work / label
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (folder / "profile.yaml").write_text(yaml.safe_dump(profile), encoding="utf-8")
        result, log_file = folder / "result.json", self.work / f"{label}.log"
        command = [
            *(sys.executable, "-m", "ambler.cli.main", "demo", "--exit", "--no-view"),
            *("--world", case.world, "--robot", case.robot, "--seed", str(case.seed)),
            *("--profile", str(folder / "profile.yaml"), "--out", str(folder), "--json", str(result)),
            *self.options,
        ]
        with log_file.open("w", encoding="utf-8") as log:
            code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False).returncode
        lines = log_file.read_text(encoding="utf-8", errors="replace").strip().splitlines() or [""]
        try:
            if code == 2:
                raise BadInputError(f"{label}: {lines[-1]}")
            if code in INTERRUPTED:
                raise KeyboardInterrupt(label)
            if code < 0:
                raise RunKilledError(f"{label}: its process was ended by signal {-code}; run the same command to go on")
            if not result.exists():
                return {"ended": "crashed", "why": lines[-1]}
            metrics: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
            return metrics
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def check_space(space: TuningSpace) -> None:
    """Raise BadInputError unless every world, robot and end of a range makes a configuration."""
    for case in space.cases():
        checked_scene(RunOptions(world=case.world, robot=case.robot, profile=space.profile({})))
    world, robot = space.worlds[0], space.robots[0]
    for name, parameter in space.parameters.items():
        for value in parameter.extremes():
            checked_scene(RunOptions(world=world, robot=robot, profile=space.profile({name: value})))
