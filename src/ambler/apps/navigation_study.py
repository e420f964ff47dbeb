"""Navigation to many random goals of known maps: journeys of some goals each, one file per journey, so that a study may go on."""

from __future__ import annotations

import json
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
from ambler.apps.study_settings import DEFAULTS, StudySettings
from ambler.core.se2 import SE2
from ambler.evaluation.goals import DriveSpan, draw_goals, judge_drives
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.steps import NavigateStep
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world

SECONDS_PER_GOAL = 300.0
TOLERANCE = 0.15  # metres from a goal at which it is reached
SLACK = 0.1  # metres by which the truth may exceed the tolerance: the localization's own error


@dataclass(frozen=True, slots=True)
class NavigationStudy:
    """`goals` random goals in each of `worlds` (names, maps' YAML or pictures), driven in journeys of `per_journey`, each of which begins at
    the world's start."""

    worlds: tuple[str, ...]
    robot: str = "diff"
    goals: int = 200
    per_journey: int = 25
    seed: int = 0
    physics: Literal["contact", "kinematic"] = "contact"
    settings: StudySettings = DEFAULTS


def run_study(study: NavigationStudy, out: Path) -> dict[str, Any]:
    """Drive all journeys that `out` holds no result of, and return flat fields `<world>.<robot>.<what>`; unknown values are None."""
    fields: dict[str, Any] = {"robot": study.robot, "physics": study.physics, "goals_per_journey": study.per_journey}
    for world in study.worlds:
        goals = draw_goals(load_world(world), robot_named(study.robot), study.goals, np.random.default_rng(study.seed))
        parts = [goals[k : k + study.per_journey] for k in range(0, len(goals), study.per_journey)]
        journeys = [_journey(study, world, number, part, out) for number, part in enumerate(parts)]
        fields |= {f"{_label(world)}.{study.robot}.{name}": v for name, v in summarize(journeys).items()}
    return fields


def summarize(journeys: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summarize the journeys of one world. A goal counts as reached when the robot said so and the truth agrees."""
    drives = [drive for journey in journeys for drive in journey["drives"]]
    reached = [d for d in drives if is_reached(d)]
    speeds = [d["speed"] for d in drives if d["speed"] is not None]
    simulated, wall, cpu = (sum(j[name] for j in journeys) for name in ("sim_seconds", "run_seconds", "cpu_seconds"))
    failed = sorted(
        {d["code"] for d in drives if d["code"] != "SUCCEEDED"} | {j["ended"] for j in journeys} - {"succeeded"}
    )
    return {
        "goals": sum(j["goals"] for j in journeys),
        "reached": len(reached),
        "collisions": sum(j["collisions"] for j in journeys),
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


def _journey(study: NavigationStudy, world: str, number: int, goals: tuple[SE2, ...], out: Path) -> dict[str, Any]:
    """Drive one journey, or read what an earlier study left. A recording is kept only where something went wrong."""
    label = f"{_label(world)}-{study.robot}-{study.physics}-{study.seed}-{study.per_journey}-{number}{study.settings.suffix}"
    file = out / f"{label}.json"
    if file.exists():
        known: dict[str, Any] = json.loads(file.read_text())
        return known
    folder = RunFolder.new(out, label)
    options = RunOptions(
        steps=tuple(NavigateStep(goal, xy_tolerance=TOLERANCE) for goal in goals),
        world=world,
        robot=study.robot,
        seed=study.seed * 1000 + number,
        physics=study.physics,
        port=None,
        time_limit=SECONDS_PER_GOAL * len(goals),
    )
    run = SimulatedRun(study.settings.applied_to(options), folder)
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
    result: dict[str, Any] = {
        "world": world,
        "ended": run.ended,
        "goals": len(goals),
        "collisions": collisions,
        "sim_seconds": run.run_seconds,
        "run_seconds": run.wall_seconds,
        "cpu_seconds": cpu_seconds,
        "drives": driven,
    }
    reached = sum(is_reached(drive) for drive in driven)
    print(f"{label}: {reached}/{len(goals)} reached, {collisions} collisions, {run.run_seconds:.0f} s", flush=True)
    if reached == len(goals) and collisions == 0:
        shutil.rmtree(folder.root)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(result))
    part.rename(file)
    return result


def _label(world: str) -> str:
    path = Path(world)
    return f"{path.parent.name}_{path.stem}" if path.parent.name else path.stem
