"""Navigation to many random goals of known maps: journeys of some goals each."""

from __future__ import annotations

import math
import shutil
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.se2 import SE2
from ambler.evaluation.goals import DriveSpan, draw_goals, judge_drives
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.steps import NavigateStep
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

SECONDS_PER_GOAL = 300.0
TOLERANCE = 0.15  # metres from a goal at which it is reached
SLACK = 0.1  # metres by which the truth may exceed the tolerance: the localization's own error


@dataclass(frozen=True, slots=True)
class Journey:
    """Drives to `goals` (in the frame of the world's start), one after the other, from the world's start on. `world`: a name, a map's YAML or
    a picture."""

    world: str
    robot: str
    number: int
    seed: int
    goals: tuple[SE2, ...]
    physics: Literal["contact", "kinematic"] = "contact"
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{_label(self.world)}-{self.robot}-{self.physics}-{self.seed}-{len(self.goals)}-{self.number}"


def journeys_to(
    world: str,
    robot: str,
    goals: int,
    per_journey: int,
    seed: int,
    physics: Literal["contact", "kinematic"],
    settings: StudySettings,
) -> list[Journey]:
    """Return the journeys to so many random goals of a world."""
    drawn = draw_goals(load_world(world), robot_named(robot), goals, np.random.default_rng(seed))
    parts = [drawn[k : k + per_journey] for k in range(0, len(drawn), per_journey)]
    return [Journey(world, robot, k, seed, part, physics, settings) for k, part in enumerate(parts)]


def navigation_study(journeys: Sequence[Journey]) -> Study[Journey]:
    """Return the study of these journeys."""
    return Study("navigation", journeys, drive_journey, _line)


def summarize_all(journeys: Sequence[Journey], results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<world>.<robot>.<what>` of all journeys; unknown values are None. Goals of a journey that crashed count, too."""
    results = [{**r, "goals": len(journey.goals)} for journey, r in zip(journeys, results, strict=True)]
    fields: dict[str, Any] = {}
    for world, robot in dict.fromkeys((r["world"], r["robot"]) for r in results):
        members = [r for r in results if (r["world"], r["robot"]) == (world, robot)]
        fields |= {f"{_label(world)}.{robot}.{name}": value for name, value in summarize(members).items()}
    return fields


def summarize(journeys: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summarize the journeys of one world. A goal counts as reached when the robot said so and the truth agrees."""
    drives = [drive for journey in journeys for drive in journey.get("drives", [])]
    reached = [d for d in drives if is_reached(d)]
    speeds = [d["speed"] for d in drives if d["speed"] is not None]
    simulated, wall, cpu = (
        sum(j.get(name, 0.0) for j in journeys) for name in ("sim_seconds", "run_seconds", "cpu_seconds")
    )
    failed = sorted(
        {d["code"] for d in drives if d["code"] != "SUCCEEDED"} | {j["ended"] for j in journeys} - {"succeeded"}
    )
    return {
        "goals": sum(j.get("goals", 0) for j in journeys),
        "reached": len(reached),
        "collisions": sum(j.get("collisions", 0) for j in journeys),
        "failures": ",".join(failed),
        "drive_mean_s": statistics.fmean(d["seconds"] for d in reached) if reached else None,
        "path_mean_m": statistics.fmean(d["path_length"] for d in reached) if reached else None,
        "speed_median_mps": statistics.median(speeds) if speeds else None,
        "true_error_median_m": statistics.median(d["error"] for d in reached) if reached else None,
        "true_error_max_m": max((d["error"] for d in reached), default=None),
        "sim_seconds": simulated,
        "real_time_factor": simulated / wall if wall > 0.0 else None,
        "sim_seconds_per_cpu_second": simulated / cpu if cpu > 0.0 else None,
    }


def is_reached(drive: dict[str, Any]) -> bool:
    """Say whether a drive ended with success within the tolerance of its goal, by the truth."""
    error = float(drive["error"])
    return drive["code"] == "SUCCEEDED" and math.isfinite(error) and error <= TOLERANCE + SLACK


def drive_journey(journey: Journey, out: Path) -> dict[str, Any]:
    """Drive one journey. Its recording is kept only where something went wrong."""
    folder, goals = RunFolder.new(out, journey.label), journey.goals
    options = RunOptions(
        steps=tuple(NavigateStep(goal, xy_tolerance=TOLERANCE) for goal in goals),
        world=journey.world,
        robot=journey.robot,
        seed=journey.seed * 1000 + journey.number,
        physics=journey.physics,
        port=None,
        time_limit=SECONDS_PER_GOAL * len(goals),
    )
    run = SimulatedRun(journey.settings.applied_to(options), folder)
    began = time.process_time()
    try:
        run.run(options.time_limit)
    finally:
        run.close()
    cpu_seconds = time.process_time() - began
    ends = () if run.end is None else run.end.ends
    spans = [DriveSpan(goal, e.code, e.begun_ns, e.ended_ns) for goal, e in zip(goals, ends, strict=False)]
    drives, collisions = judge_drives(folder.recording, spans, TruthFrame(run.robot.world_from_map))
    driven = [asdict(drive) for drive in drives]
    reached = sum(is_reached(drive) for drive in driven)
    if reached == len(goals) and collisions == 0:
        shutil.rmtree(folder.root)
    return {
        "ended": run.ended,
        "goals": len(goals),
        "reached": reached,
        "collisions": collisions,
        "sim_seconds": run.run_seconds,
        "run_seconds": run.wall_seconds,
        "cpu_seconds": cpu_seconds,
        "drives": driven,
    }


def _line(result: dict[str, Any]) -> str:
    return f"{result['reached']}/{result['goals']} reached, {result['collisions']} collisions, {result['sim_seconds']:.0f} s"


def _label(world: str) -> str:
    path = Path(world)
    return f"{path.parent.name}_{path.stem}" if path.parent.name else path.stem
