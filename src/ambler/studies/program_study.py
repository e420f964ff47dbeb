"""Long programs in one run, and two robots in one world: explore, dock, undock, drive to random goals, dock again, without a restart."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.judgement import judge
from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.se2 import SE2
from ambler.evaluation.goals import draw_goals
from ambler.nodes.steps import DockStep, ExploreStep, NavigateStep, Step, UndockStep
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

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
    settings: StudySettings = DEFAULTS

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


def program_study(cases: Sequence[ProgramCase]) -> Study[ProgramCase]:
    """Return the study of these programs."""
    return Study("program", cases, run_case, _line)


def run_case(case: ProgramCase, out: Path) -> dict[str, Any]:
    """Run a program and judge it by its recording, which is deleted when all went well."""
    options = RunOptions(steps_of(case), case.world, case.robot, case.seed, port=None, time_limit=TIME_LIMIT)
    folder = RunFolder.new(out, case.label)
    run = SimulatedRun(case.settings.applied_to(options), folder)
    try:
        run.run()
        fields = judge(run).fields
    finally:
        run.close()
    if is_good({"ended": run.ended, **fields}):
        shutil.rmtree(folder.root)
    return fields


def is_good(result: dict[str, Any]) -> bool:
    """Say whether a program succeeded without a collision."""
    return result["ended"] == "succeeded" and result.get("collisions") == 0


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return counts of all, and flat fields `<robot>.<what>`: counts, and the worst values of all runs; what no run knows is None."""
    fields: dict[str, Any] = {"runs": len(results)}
    for robot in dict.fromkeys(r["robot"] for r in results):
        fields |= _summary(robot, [r for r in results if r["robot"] == robot])
    fields["succeeded"] = sum(r["ended"] == "succeeded" for r in results)
    return {**fields, "collisions": sum(r.get("collisions") or 0 for r in results)}


def _summary(robot: str, members: list[dict[str, Any]]) -> dict[str, Any]:
    fields: dict[str, Any] = {
        f"{robot}.runs": len(members),
        f"{robot}.succeeded": sum(m["ended"] == "succeeded" for m in members),
        f"{robot}.ended": ", ".join(m["ended"] for m in members),
    }
    for name in ("collisions", "goals", "goals_reached"):
        fields[f"{robot}.{name}"] = sum(m.get(name) or 0 for m in members)
    worst = {"reachable_coverage_ratio": min, "ate_unaligned_rms_m": max, "worst_goal_error_m": max}
    for name, of in {**worst, "dock_error_m": max, "dock_error_deg": max}.items():
        values = [m[name] for m in members if m.get(name) is not None]
        fields[f"{robot}.{name}_worst"] = of(values) if values else None
    return fields


def _line(result: dict[str, Any]) -> str:
    return f"{result['ended']}, {result['collisions']} collisions, {result['text'] or 'all done'}"


@dataclass(frozen=True, slots=True)
class TeamCase:
    """Two robots of one kind in one world and one process."""

    world: str
    robot: str
    seed: int
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.world}-{self.robot}-{self.seed}"


def team_study(cases: Sequence[TeamCase]) -> Study[TeamCase]:
    """Return the study of these teams; a result has `team`: the result of each member."""
    return Study("team", cases, run_team, _team_line)


def run_team(case: TeamCase, out: Path) -> dict[str, Any]:
    """Let two robots explore one world; each is judged, and its recording replayed."""
    first = RunOptions(world=case.world, robot=case.robot, seed=case.seed, port=None, time_limit=TIME_LIMIT)
    second = RunOptions(world=case.world, robot=case.robot, seed=case.seed + 1000, start=ASIDE, port=None)
    mates = {"second": case.settings.applied_to(second)}
    run = SimulatedRun(case.settings.applied_to(first), RunFolder.new(out, f"team-{case.label}"), mates=mates)
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
    return {"ended": results["first"]["ended"], "team": results}


def is_team_good(result: dict[str, Any]) -> bool:
    """Say whether both ended with proof and without a collision, and replay to the same bits."""
    team = result.get("team", {}).values()
    return bool(team) and all(r["ended"] == "finished" and r["collisions"] == 0 and r["is_replay_equal"] for r in team)


def summarize_teams(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<seed>.<member>.<what>`."""
    fields: dict[str, Any] = {"runs": len(results)}
    for result in results:
        for name, member in result.get("team", {}).items():
            for key in ("ended", "collisions", "reachable_coverage_ratio", "ate_rms_m", "is_replay_equal"):
                fields[f"{result['seed']}.{name}.{key}"] = member[key]
            for key in ("sim_seconds", "real_time_factor"):
                fields[f"{result['seed']}.{key}"] = member[key]
    return fields


def _team_line(result: dict[str, Any]) -> str:
    return "; ".join(f"{name}: {m['ended']}, {m['collisions']} collisions" for name, m in result["team"].items())
