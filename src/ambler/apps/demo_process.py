"""One demonstration in a process of its own, for studies that need many."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.apps.study_settings import DEFAULTS, StudySettings


@dataclass(frozen=True, slots=True)
class DemoJob:
    """What to run; `options` are further words of `ambler demo`, `tag` tells runs apart that differ only in them."""

    world: str
    robot: str
    seed: int
    tag: str = ""
    options: tuple[str, ...] = ()
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name of the run for files and people."""
        parts = (Path(self.world).stem, Path(self.robot).stem, self.tag, str(self.seed))
        return "-".join(part for part in parts if part) + self.settings.suffix


def run_demo(job: DemoJob, out: Path, *, is_resumed: bool = False) -> dict[str, Any]:
    """Run a demonstration and return its result; one that died has `ended` = crashed. Its output goes to `<label>.log` in `out`, its
    result to `<label>.json`, and where that exists already, a resumed study takes it instead of running again. What is set stands in
    `<label>.yaml`."""
    out.mkdir(parents=True, exist_ok=True)
    result_file = out / f"{job.label}.json"
    if is_resumed and result_file.exists():
        return _told(job, json.loads(result_file.read_text()))
    result_file.unlink(missing_ok=True)
    command = [
        *(sys.executable, "-m", "ambler.cli.main", "demo", "--exit", "--no-view"),
        *("--world", job.world, "--robot", job.robot, "--seed", str(job.seed)),
        *("--out", str(out), "--json", str(result_file), *job.options),
        *job.settings.words(out / f"{job.label}.yaml"),
    ]
    with (out / f"{job.label}.log").open("w") as log:
        subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False)
    result: dict[str, Any] = {"world": Path(job.world).stem, "robot": job.robot, "ended": "crashed", "seed": job.seed}
    if result_file.exists():
        result = json.loads(result_file.read_text())
    return _told(job, result)


def _told(job: DemoJob, result: dict[str, Any]) -> dict[str, Any]:
    print(f"{job.label}: {result['ended']}, {result.get('collisions')} collisions", flush=True)
    return result
