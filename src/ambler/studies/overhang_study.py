"""Rooms full of what hangs above a planar scanner: a tall robot drives through them with its depth cameras in the costmaps and without.

Goals lie behind tables, signs, bars and open drawers, so the straight way leads through them. The cameras are mounted otherwise than drawn.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from ambler.apps.robot import Parts
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.evaluation.goals import DriveSpan, judge_drives
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.steps import NavigateStep
from ambler.settings.profiles import merge
from ambler.sim.rig_errors import with_depth_mounts_off
from ambler.sim.robots import robot_named
from ambler.studies.made_overhangs import draw_goals, save_room
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

GOALS = 4
TOLERANCE, SLACK = 0.15, 0.1  # metres from a goal at which it is reached, and by which the truth may exceed that
PLACE_OFF, ANGLE_OFF = 0.02, math.radians(1.0)  # what a camera's mount is off by at most after a usual installation
SECONDS_PER_GOAL = 90.0
VOXELS = ("auto", "never")


@dataclass(frozen=True, slots=True)
class OverhangCase:
    """Drives through the room of a seed, with voxels or without."""

    seed: int
    robot: str
    voxels: str
    physics: Literal["contact", "kinematic"] = "contact"
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.robot}-{self.voxels}-{self.physics}-{self.seed}"


def overhang_study(
    seeds: Sequence[int],
    robot: str = "porter+depth",
    physics: Literal["contact", "kinematic"] = "contact",
    settings: StudySettings = DEFAULTS,
    voxels: Sequence[str] = VOXELS,
) -> Study[OverhangCase]:
    """Return the study of the rooms of these seeds, each with voxels and without; raises BadInputError for robots that nobody knows,
    and for settings that the robot does not take."""
    settings.check(("lab_empty",), (robot,))
    cases = [OverhangCase(seed, robot, choice, physics, settings) for seed in seeds for choice in voxels]
    return Study("overhangs", cases, run_case, _line)


def run_case(case: OverhangCase, out: Path) -> dict[str, Any]:
    """Drive from goal to goal until one is not reached; the recording is kept only where something went wrong with voxels."""
    folder = RunFolder.new(out, case.label)
    room = folder.root / "room.yaml"
    save_room(case.seed, room)
    goals = draw_goals(case.seed, robot_named(case.robot), GOALS)
    options = RunOptions(
        tuple(NavigateStep(goal, TOLERANCE, math.pi) for goal in goals),
        str(room),
        case.robot,
        case.seed,
        physics=case.physics,
        port=None,
        time_limit=SECONDS_PER_GOAL * GOALS,
    )
    settings = StudySettings(merge(case.settings.profile, {"voxels": case.voxels}), case.settings.faults)
    built = partial(with_depth_mounts_off, seed=case.seed, place=PLACE_OFF, angle=ANGLE_OFF)
    run = SimulatedRun(settings.applied_to(options), folder, parts=Parts(built=built))
    try:
        run.run(options.time_limit)
    finally:
        run.close()
    ends = () if run.end is None else run.end.ends
    spans = [DriveSpan(goal, e.code, e.begun_ns, e.ended_ns) for goal, e in zip(goals, ends, strict=False)]
    drives, collisions = judge_drives(folder.recording, spans, TruthFrame(run.robot.world_from_map))
    reached = sum(d.code == "SUCCEEDED" and d.error <= TOLERANCE + SLACK for d in drives)
    if case.voxels == "never" or (reached == GOALS and collisions == 0):
        shutil.rmtree(folder.root)
    return {
        "ended": run.ended,
        "goals": GOALS,
        "reached": reached,
        "collisions": collisions,
        "sim_seconds": run.run_seconds,
        "run_seconds": run.wall_seconds,
        "path_length_m": sum(d.path_length for d in drives),
    }


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<voxels>.<what>`; the bar: with voxels every goal is reached and nothing is touched."""
    fields: dict[str, Any] = {}
    for voxels in dict.fromkeys(r["voxels"] for r in results):
        mine = [r for r in results if r["voxels"] == voxels]
        told = [r for r in mine if r.get("ended") != "crashed"]
        name = "with_voxels" if voxels == "auto" else "without"
        fields |= {
            f"{name}.runs": len(mine),
            f"{name}.crashed": len(mine) - len(told),
            f"{name}.goals": sum(r.get("goals", GOALS) for r in mine),
            f"{name}.reached": sum(r["reached"] for r in told),
            f"{name}.collisions": sum(r["collisions"] for r in told),
            f"{name}.runs_with_collision": sum(r["collisions"] > 0 for r in told),
        }
    good = [r for r in results if r["voxels"] == "auto"]
    fields["is_met"] = all(r.get("collisions") == 0 and r.get("reached") == GOALS for r in good)
    return fields


def _line(result: dict[str, Any]) -> str:
    return f"{result['reached']} of {result['goals']} goals, {result['collisions']} collisions, {result['ended']}"
