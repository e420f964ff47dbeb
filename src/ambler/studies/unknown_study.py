"""Drives to goals in places of which there is no map: the planner on a visibility graph beside the grid planner, the same robot, place and seed.

Half of the goals lie behind a dead end: the way to them is at least `DETOUR` times as long as the straight line, so that a robot that trusts the
unknown goes the wrong way first.
"""

from __future__ import annotations

import math
import shutil
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import BadInputError
from ambler.core.grid import COST_LETHAL
from ambler.core.messages import Contact, Odometry
from ambler.core.se2 import SE2
from ambler.evaluation.collisions import find_collisions
from ambler.evaluation.goals import MARGIN, RESOLUTION
from ambler.evaluation.reversals import count_reversals
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.steps import NavigateStep
from ambler.planning.distance import distance_field
from ambler.runtime.topics import CONTACT, TRUE_POSE
from ambler.settings.profiles import merge
from ambler.sim.robots import robot_named
from ambler.sim.truth import reachable_cells
from ambler.sim.world_file import load_world
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.wire.mcap_reader import read_recording

PLANNERS = ("visibility_graph", "grid")
TOLERANCE = 0.15  # metres from a goal at which it is reached
SLACK = 0.1  # metres by which the truth may exceed that: the drift of a map that is being made
DETOUR = 1.8  # the way to a goal behind a dead end is at least so many times the straight line
LEAST_WAY = 12.0  # metres of the way to a goal
TIME_LIMIT = 900.0
DRAWS = 2000  # goals looked at before a place is said to have no dead end


@dataclass(frozen=True, slots=True)
class UnknownCase:
    """One drive to `goal` (x, y in the frame of the start) through an unknown world with a planner. `way` is the shortest true way in metres."""

    world: str
    robot: str
    planner: str
    seed: int
    goal: tuple[float, float]
    way: float
    is_dead_end: bool
    physics: Literal["contact", "kinematic"] = "contact"
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.world).stem}-{self.robot}-{self.planner}-{'dead_end' if self.is_dead_end else 'any'}"


def unknown_cases(
    kinds: Sequence[str],
    robot: str,
    seeds: Sequence[int],
    physics: Literal["contact", "kinematic"],
    settings: StudySettings = DEFAULTS,
) -> list[UnknownCase]:
    """Return two cases per seed, one for each planner; kinds of places take turns, every other pair of them has a dead end."""
    cases = []
    for k, seed in enumerate(seeds):
        is_dead_end = k % (2 * len(kinds)) >= len(kinds)
        world, goal, way = draw_goal(kinds[k % len(kinds)], robot, seed, is_dead_end=is_dead_end)
        cases += [UnknownCase(world, robot, p, seed, goal, way, is_dead_end, physics, settings) for p in PLANNERS]
    return cases


def draw_goal(kind: str, robot_name: str, seed: int, *, is_dead_end: bool) -> tuple[str, tuple[float, float], float]:
    """Return the first place of a kind from a seed on that has such a goal, the goal (x, y in the frame of its start), and the true way to it."""
    robot = robot_named(robot_name)
    for name in (f"{kind}-{seed + 1_000_000 * again}" for again in range(40)):
        radius = robot.model.circumscribed_radius + MARGIN
        spec, reachable = reachable_cells(load_world(name).from_start(), radius, RESOLUTION, robot.sensor_height)
        ways = distance_field(np.where(reachable, 0, COST_LETHAL).astype(np.uint8), spec, SE2())
        cells = np.argwhere(reachable & np.isfinite(ways) & (ways >= LEAST_WAY))
        rng = np.random.default_rng(seed)
        for cell in cells[rng.integers(len(cells), size=DRAWS)] if len(cells) else ():
            x, y = spec.center_of(*cell.tolist())
            way = float(ways[cell[0], cell[1]])
            if not is_dead_end or way >= DETOUR * math.hypot(x, y):
                return name, (x, y), way
    raise BadInputError(f"{kind}-{seed}: no goal there has a way {DETOUR:g} times as long as the straight line")


def unknown_study(cases: Sequence[UnknownCase]) -> Study[UnknownCase]:
    """Return the study of these drives."""
    return Study("unknown", cases, run_case, line)


def run_case(case: UnknownCase, out: Path) -> dict[str, Any]:
    """Drive; the recording is kept only where something went wrong."""
    folder = RunFolder.new(out, case.label)
    step = NavigateStep(SE2(*case.goal, 0.0), TOLERANCE, math.pi)
    options = RunOptions(
        (step,),
        case.world,
        case.robot,
        case.seed,
        is_unknown=True,
        physics=case.physics,
        port=None,
        time_limit=TIME_LIMIT,
    )
    settings = StudySettings(merge(case.settings.profile, {"global_planner": case.planner}), case.settings.faults)
    run = SimulatedRun(settings.applied_to(options), folder)
    began = time.process_time()
    try:
        run.run(TIME_LIMIT)
    finally:
        run.close()
    result = judge(case, run, folder)
    if result["is_reached"] and not result["collisions"]:
        shutil.rmtree(folder.root)
    return {**result, "cpu_seconds": time.process_time() - began, "sim_seconds": run.run_seconds}


def judge(case: UnknownCase, run: SimulatedRun, folder: RunFolder) -> dict[str, Any]:
    """Say by the truth whether the goal was reached, in what time and along what path."""
    frame = TruthFrame(run.robot.world_from_map)
    truth, contacts = [], []
    for recorded in read_recording(folder.recording, [TRUE_POSE.ros_name, CONTACT.ros_name]):
        if recorded.topic == TRUE_POSE.ros_name:
            message = recorded.decode_as(Odometry)
            pose = frame.pose(message.pose.to_se2())
            truth.append((message.stamp_ns, pose.x, pose.y))
        else:
            contacts.append(recorded.decode_as(Contact))
    ends = () if run.end is None else run.end.ends
    rows = np.array(truth, np.float64).reshape(-1, 3)
    if ends:
        rows = rows[(rows[:, 0] >= ends[0].begun_ns) & (rows[:, 0] <= ends[0].ended_ns)]
    error = float(np.hypot(*(rows[-1, 1:] - case.goal))) if len(rows) else math.inf
    path = float(np.hypot(*np.diff(rows[:, 1:], axis=0).T).sum())
    return {
        "ended": run.ended,
        "is_reached": bool(ends and ends[0].is_success and error <= TOLERANCE + SLACK),
        "travel_seconds": (ends[0].ended_ns - ends[0].begun_ns) * 1e-9 if ends else TIME_LIMIT,
        "path_length_m": path,
        "error_m": error,
        "reversals": count_reversals(rows[:, 1:]) if len(rows) > 1 else 0,
        "collisions": len(find_collisions(contacts)),
    }


def line(result: dict[str, Any]) -> str:
    """Say in a few words how a drive ended."""
    return (
        f"{result['ended']}, {result['travel_seconds']:.0f} s, {result['path_length_m']:.0f} m of {result['way']:.0f} m, "
        f"{result['reversals']} reversals, {result['collisions']} collisions"
    )


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields: both planners in all places, `dead_end.` and `any.` for the halves. Ratios are of the visibility graph to the grid, of the
    drives that both finished."""
    fields = _summary(results)
    for name, wanted in (("dead_end", True), ("any", False)):
        part = [r for r in results if r["is_dead_end"] == wanted]
        fields |= {f"{name}.{what}": value for what, value in _summary(part).items()} if part else {}
    return fields


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether every goal was reached without a collision, in at most the grid's time in the median and 0.9 of it behind dead ends, with at most one
    reversal per 50 m."""
    return bool(
        fields["visibility_graph.reached"] == fields["visibility_graph.runs"]
        and fields["visibility_graph.collisions"] == 0
        and (fields["ratio_vs_grid"] or math.inf) <= 1.0
        and (fields.get("dead_end.ratio_vs_grid") or math.inf) <= 0.9
        and fields["visibility_graph.reversals_per_50m"] <= 1.0
    )


def _summary(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for planner in PLANNERS:
        mine = [r for r in results if r["planner"] == planner]
        metres = sum(r.get("path_length_m", 0.0) for r in mine)
        done = [r for r in mine if r.get("is_reached")]
        fields |= {
            f"{planner}.runs": len(mine),
            f"{planner}.reached": len(done),
            f"{planner}.collisions": sum(r.get("collisions", 0) for r in mine),
            f"{planner}.travel_median_s": statistics.median(r["travel_seconds"] for r in done) if done else None,
            f"{planner}.path_over_way_median": statistics.median(r["path_length_m"] / r["way"] for r in done)
            if done
            else None,
            f"{planner}.reversals_per_50m": 50.0 * sum(r.get("reversals", 0) for r in mine) / metres if metres else 0.0,
        }
    pairs = _pairs(results)
    ratios = [a["travel_seconds"] / b["travel_seconds"] for a, b in pairs]
    fields["pairs"] = len(pairs)
    fields["ratio_vs_grid"] = statistics.median(ratios) if ratios else None
    fields["ratio_vs_grid_min"], fields["ratio_vs_grid_max"] = min(ratios, default=None), max(ratios, default=None)
    return fields


def _pairs(results: Sequence[dict[str, Any]]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return the drives of both planners to one goal, where both reached it."""
    found = {(r["planner"], r["world"], r["is_dead_end"]): r for r in results if r.get("is_reached")}
    return [(r, found["grid", *k[1:]]) for k, r in found.items() if k[0] == PLANNERS[0] and ("grid", *k[1:]) in found]
