"""Tuning on the engine of all studies: successive halving, each rung a study of the trials that are still going.

Every run is a demonstration with the profile of its trial; its recording is thrown away.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.apps.scene import RunOptions, checked_scene
from ambler.evaluation.tuning import Ranked, TrialResults
from ambler.evaluation.tuning_space import Case, TuningSpace
from ambler.studies.demo_process import demo_line, run_demo
from ambler.studies.pool import Pool
from ambler.studies.study import Spent, Study, conduct
from ambler.studies.study_settings import StudySettings

KEPT = {"result.json", "case.log", "demo.log", "demo.json", "profile.yaml"}


@dataclass(frozen=True, slots=True)
class TrialCase:
    """One trial in one case; `options` are further words of `ambler demo`."""

    trial: int
    case: Case
    settings: StudySettings
    options: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.trial:04d}-{self.case.name}"


RunTrial = Callable[[TrialCase, Path], dict[str, Any]]


def run_trial(trial: TrialCase, folder: Path) -> dict[str, Any]:
    """Explore with the profile of a trial."""
    case = trial.case
    result = run_demo(folder, case.world, case.robot, case.seed, trial.options, trial.settings)
    for path in folder.iterdir():
        if path.name in KEPT:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
    return result


def tune(
    space: TuningSpace,
    out: Path,
    pool: Pool,
    *,
    run: RunTrial = run_trial,
    tell: Callable[[str], None] = print,
    spent: Spent | None = None,
) -> list[Ranked]:
    """Run what `out` has no results of, rung by rung, and return the ranking; `spent` counts what all runs took. Raises BadInputError when runs lack what `space` weighs."""
    results = TrialResults(space)
    cases = space.cases()
    going = list(range(len(results.trials)))
    options = ("--time-limit", str(space.time_limit), *(["--kinematic"] if space.physics == "kinematic" else []))
    settings = [StudySettings(space.profile(values)) for values in results.trials]
    before = 0
    for count in space.rungs():
        trials = [TrialCase(t, case, settings[t], options) for case in cases[before:count] for t in going]
        alone = 1 if before == 0 else 0  # the first of all: what no run tells is noticed before the others have run
        for some in (trials[:alone], trials[alone:]):
            told = conduct(Study("tune", some, run, demo_line), out, pool, tell=tell, spent=spent)
            for trial, metrics in zip(some, told, strict=True):
                results.add(trial.trial, trial.case, metrics)
        going, before = results.going_on(going, count), count
    return results.ranking()


def check_space(space: TuningSpace) -> None:
    """Raise BadInputError unless every world, robot and end of a range makes a configuration."""
    for case in space.cases():
        checked_scene(RunOptions(world=case.world, robot=case.robot, profile=space.profile({})))
    world, robot = space.worlds[0], space.robots[0]
    for name, parameter in space.parameters.items():
        for value in parameter.extremes():
            checked_scene(RunOptions(world=world, robot=robot, profile=space.profile({name: value})))
