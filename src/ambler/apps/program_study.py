"""Long programs in one run, and two robots in one world: explore, dock, undock, drive to random goals, dock again, without a restart."""

from __future__ import annotations

import shutil
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.judgement import judge
from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.apps.study_settings import DEFAULTS, StudySettings
from ambler.core.se2 import SE2
from ambler.evaluation.goals import draw_goals
from ambler.kernels.warmup import imported_kernel_modules, warm_up
from ambler.nodes.steps import DockStep, ExploreStep, NavigateStep, Step, UndockStep
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world

TIME_LIMIT = 3600.0
ASIDE = SE2(0.0, 0.55, 0.0)  # where the second robot starts, in the frame of the first one's start


@dataclass(frozen=True, slots=True)
class ProgramCase:
    """One run: `goals` random ones; with a `dock`, it is docked at before and after them."""

    world: str
    robot: str
    seed: int
    goals: int = 5
    dock: str | None = None

    @property
    def label(self) -> str:
        """A name of the run for files and people."""
        return f"{self.world}-{self.robot}-{self.seed}"


def steps_of(case: ProgramCase) -> tuple[Step, ...]:
    """Return the steps of a case; its goals are drawn by its seed among the places that the robot can stand in."""
    rng = np.random.default_rng([case.seed, 8])
    goals = draw_goals(load_world(case.world), robot_named(case.robot), case.goals, rng)
    drives = tuple(NavigateStep(goal) for goal in goals)
    if case.dock is None:
        return (ExploreStep(), *drives)
    return (ExploreStep(), DockStep(case.dock), UndockStep(case.dock), *drives, DockStep(case.dock))


def run_case(case: ProgramCase, out: Path, settings: StudySettings = DEFAULTS) -> dict[str, Any]:
    """Run a program and judge it by its recording, which is deleted when all went well."""
    warm_up(imported_kernel_modules())
    options = RunOptions(steps_of(case), case.world, case.robot, case.seed, port=None, time_limit=TIME_LIMIT)
    folder = RunFolder.new(out, case.label)
    run = SimulatedRun(settings.applied_to(options), folder)
    try:
        run.run()
        fields = judge(run).fields
    finally:
        run.close()
    if run.ended == "succeeded" and fields["collisions"] == 0:
        shutil.rmtree(folder.root)
    return fields


def run_cases(
    cases: list[ProgramCase], out: Path, processes: int, settings: StudySettings = DEFAULTS
) -> list[dict[str, Any]]:
    """Run every case in a process of a pool; returns the results in order."""
    with ProcessPoolExecutor(processes) as pool:
        return list(pool.map(run_case, cases, [out] * len(cases), [settings] * len(cases)))


def run_team(
    world: str, robot: str, seed: int, out: Path, settings: StudySettings = DEFAULTS
) -> dict[str, dict[str, Any]]:
    """Let two robots explore one world in one process; returns the result of each with `is_replay_equal`."""
    warm_up(imported_kernel_modules())
    first = RunOptions(world=world, robot=robot, seed=seed, port=None, time_limit=TIME_LIMIT)
    second = RunOptions(world=world, robot=robot, seed=seed + 1000, start=ASIDE, port=None)
    folder, mates = RunFolder.new(out, f"team-{world}-{robot}-{seed}"), {"second": settings.applied_to(second)}
    run = SimulatedRun(settings.applied_to(first), folder, mates=mates)
    try:
        run.run()
        results = {member.prefix or "first": judge(run, member).fields for member in run.team}
    finally:
        run.close()
    for member in run.team:
        replay = replay_run(member.folder.root).comparison
        results[member.prefix or "first"] |= {
            "is_replay_equal": replay.is_equal,
            "replayed_messages": replay.equal_count,
        }
    return results
