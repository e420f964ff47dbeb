"""Judges a run from its recording and its saved map, whatever its steps were; what is not known is None."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.docks import dock_of_world
from ambler.apps.simulated import SimulatedRobot, SimulatedRun
from ambler.apps.site_judgement import site_fields, site_quality
from ambler.core.errors import BadInputError
from ambler.core.messages import BatteryState
from ambler.core.se2 import SE2, wrap_angle
from ambler.evaluation.collisions import Collision, find_collisions, find_contacts, split_shoved
from ambler.evaluation.exploration_run import ExplorationRecord, read_exploration
from ambler.evaluation.map_quality import MapQuality, compare_maps, floor_coverage, reachable_coverage
from ambler.evaluation.process_memory import peak_memory_mb
from ambler.evaluation.trajectory import TrajectoryError, trajectory_error
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.steps import DockStep, NavigateStep, StepEnd, TeachStep, UndockStep, name_of
from ambler.runtime.topics import BATTERY
from ambler.sim.dock_body import CONTACTS
from ambler.sim.truth import reachable_floor
from ambler.wire.map_files import load_map, save_map
from ambler.wire.mcap_reader import read_recording

LEAST_COVERAGE = 0.98  # of the reachable floor, for an exploration to count as done
NOT_RECORDED = "not_recorded"  # the end of a run whose recording ends before it
OF_RECORDING = (
    *("collisions", "collisions_shoved", "contacts", "path_length_m", "recovery_time_ratio"),
    *("ate_rms_m", "ate_max_m", "ate_unaligned_rms_m", "ate_unaligned_max_m"),
    *("position_error_rms_m", "position_error_max_m", "goals_reached", "worst_goal_error_m", "battery_supply"),
    *("dock_error_m", "dock_error_deg", "dock_error_x_m", "dock_error_y_m", "dock_error_yaw_deg"),
    *("undock_x_m", "undock_y_m"),
)  # what nobody knows of such a run
CLEARANCE = 0.15  # metres beside the robot on a way that it must take: what its planner keeps (2 x 5 cm), and a cell


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The result of a run: `fields` as they go into JSON, and what the report draws."""

    fields: dict[str, Any]
    record: ExplorationRecord
    quality: MapQuality | None
    trajectory: TrajectoryError | None
    collisions: tuple[Collision, ...]


def judge(
    run: SimulatedRun, robot: SimulatedRobot | None = None, on_stage: Callable[[str], None] = lambda _: None
) -> Verdict:
    """Compare what a robot (None: the first) believed with the ground truth of its recording, told in the frame of its map. `on_stage` is
    told what is being done."""
    robot = robot if robot is not None else run.robot
    on_stage("reading the recording")
    record = read_exploration(
        robot.folder.recording, TruthFrame(robot.world_from_map), robot.truth if robot.options.is_apart else None
    )
    spec = record.true_map[0]
    if spec.width:
        on_stage(f"judging the map against the truth, {spec.width} x {spec.height} cells")
        save_map(robot.folder.truth_stem, *record.true_map)
    quality = _map_quality(robot, record)
    trajectory = None
    if len(record.stamps_ns) > 1:
        trajectory = trajectory_error(record.stamps_ns, record.poses, record.true_stamps_ns, record.true_poses)
    allowed = frozenset(dock.name + CONTACTS for dock in robot.scene.world.docks)
    hits = find_collisions(record.contacts, allowed=allowed)
    collisions, shoved = split_shoved(hits, record.contacts, robot.folder.recording, robot.model.footprint)
    fields: dict[str, Any] = {
        "world": robot.scene.world.name,
        "robot": robot.options.robot,
        "ended": run.ended_of(robot),
        "text": run.text_of(robot) or None,
    }
    if robot.options.is_unknown:
        error = trajectory.ate_rms_m if trajectory is not None else None
        fields |= {"planner": robot.config.global_planner, "ate_rms_m": error}
    elif robot.options.makes_map:
        fields |= _exploration(robot, record, quality, trajectory)
        if robot.config.mapping == "ground":
            on_stage("judging the ground and the surfaces against the truth")
            fields |= site_fields(site_quality(robot))
        fields["recovery_time_ratio"] = record.recovery_seconds / run.run_seconds if run.run_seconds > 0.0 else 0.0
    else:
        is_site = robot.scene.site is not None
        fields |= {
            "localizer": "cloud" if is_site else robot.config.localizer,
            "source": "cloud" if is_site else robot.config.localization.source,
        }
        fields |= {
            "position_error_rms_m": None if trajectory is None else trajectory.unaligned_rms_m,
            "position_error_max_m": None if trajectory is None else float(trajectory.offsets.max()),
        }
    contacts = len(find_contacts(record.contacts, allowed=allowed))
    fields |= {"collisions": len(collisions), "collisions_shoved": len(shoved), "contacts": contacts}
    fields["path_length_m"] = record.path_length
    fields |= _drives(robot, record)
    if robot.options.docks_wanted:
        fields |= _docking(robot, record)
    fields |= {
        "sim_seconds": run.run_seconds,
        "run_seconds": run.wall_seconds,
        "real_time_factor": run.run_seconds / run.wall_seconds,
        "run_cpu_seconds": run.cpu_seconds,
        "run_memory_mb": run.memory_mb,
        "peak_memory_mb": peak_memory_mb(),
        "recording": str(robot.folder.recording),
    }
    failure = run.recording_failure_of(robot)
    if failure is not None:
        text = f"the run ended as {fields['ended']}, but its recording ends before it, and what came after is not known: {failure}"
        fields |= {"ended": NOT_RECORDED, "text": text, **dict.fromkeys(OF_RECORDING & fields.keys())}
    return Verdict(fields, record, quality, trajectory, collisions)


def is_good(verdict: Verdict) -> bool:
    """Say whether a robot did all that it was asked, without a collision, and has mapped the floor that it can reach."""
    is_done = verdict.fields["ended"] in ("finished", "succeeded") and verdict.fields["collisions"] == 0
    return is_done and missing_floor(verdict) is None


def missing_floor(verdict: Verdict) -> str | None:
    """Say in words what a map lacks of the floor that its robot can reach; None when it lacks no more than 2 %, or the truth is unknown."""
    share = verdict.fields.get("reachable_coverage_ratio")
    if share is None or share >= LEAST_COVERAGE:
        return None
    return f"the map holds {100 * share:.1f} % of the floor that the robot can reach; {100 * LEAST_COVERAGE:.0f} % are asked"


def _exploration(
    robot: SimulatedRobot, record: ExplorationRecord, quality: MapQuality | None, trajectory: TrajectoryError | None
) -> dict[str, Any]:
    result = next((end.result for end in _ends(robot) if name_of(end.step) == "explore"), None)
    return {
        "coverage_ratio": None if quality is None else quality.coverage_ratio,
        "reachable_coverage_ratio": None if quality is None else _reachable(robot, record, quality),
        "false_free_ratio": None if quality is None else quality.false_free_ratio,
        "nne_cells": None if quality is None else quality.nne_cells,
        "nne_reverse_cells": None if quality is None else quality.nne_reverse_cells,
        "ssim": None if quality is None else quality.ssim,
        "ate_rms_m": None if trajectory is None else trajectory.ate_rms_m,
        "ate_max_m": None if trajectory is None else trajectory.ate_max_m,
        "ate_unaligned_rms_m": None if trajectory is None else trajectory.unaligned_rms_m,
        "ate_unaligned_max_m": None if trajectory is None else float(trajectory.offsets.max()),
        "frontiers_left": None if result is None else len(result.remaining),
        "targets_reached": None if result is None else result.goals_reached,
        "is_home": None if result is None else result.is_home,
    }


def _drives(robot: SimulatedRobot, record: ExplorationRecord) -> dict[str, Any]:
    """How the drives to goals went; errors are those of the true pose when the robot said that it had arrived."""
    wanted = sum(isinstance(step, NavigateStep) for step in robot.steps)
    if not wanted:
        return {}
    errors, reached = [], 0
    for end in _ends(robot):
        if isinstance(end.step, NavigateStep) and end.is_success:
            reached += 1
            pose = true_pose_at(record, end.ended_ns)
            if pose is not None:
                errors.append(pose.distance_to(end.step.map_from_goal))
    return {"goals": wanted, "goals_reached": reached, "worst_goal_error_m": max(errors, default=None)}


def _docking(robot: SimulatedRobot, record: ExplorationRecord) -> dict[str, Any]:
    """How docking went, kind by kind (the last of each), and where the robot truly stood in that dock's frame at its end."""
    fields: dict[str, Any] = {
        "dock_error_m": None,
        "dock_error_deg": None,
        "battery_supply": _supply(robot.folder.recording),
    }
    world = robot.scene.world.seen_from(robot.world_from_map)
    for end in _ends(robot):
        if not isinstance(end.step, DockStep | UndockStep | TeachStep):
            continue
        kind = name_of(end.step)
        fields |= {f"{kind}_code": end.code, f"{kind}_text": end.text}
        if not isinstance(end.step, TeachStep) and end.result is not None:
            fields |= {
                f"{kind}_attempts": end.result.attempts,
                f"{kind}_seconds": end.result.seconds,
                f"{kind}_final_seconds": end.result.docking_seconds,
            }
        pose = true_pose_at(record, end.ended_ns)
        if pose is None:
            continue
        away = dock_of_world(world, end.step.dock).world_from_dock.inverse() @ pose
        if isinstance(end.step, UndockStep):
            fields |= {"undock_x_m": away.x, "undock_y_m": away.y}
            continue
        angle = math.degrees(wrap_angle(away.yaw))
        fields |= {"dock_error_x_m": away.x, "dock_error_y_m": away.y, "dock_error_yaw_deg": angle}
        fields |= {"dock_error_m": math.hypot(away.x, away.y), "dock_error_deg": abs(angle)}
    return fields


def true_pose_at(record: ExplorationRecord, stamp_ns: int) -> SE2 | None:
    """Return the true pose nearest to an instant, None when none was recorded."""
    if not len(record.true_stamps_ns):
        return None
    k = int(np.argmin(np.abs(record.true_stamps_ns - stamp_ns)))
    return SE2.from_array(record.true_poses[k])


def _ends(robot: SimulatedRobot) -> tuple[StepEnd, ...]:
    return () if robot.end is None else robot.end.ends


def _reachable(robot: SimulatedRobot, record: ExplorationRecord, quality: MapQuality) -> float | None:
    if len(record.true_poses) == 0:
        return None
    start, radius = SE2.from_array(record.true_poses[0]), robot.model.inscribed_radius + CLEARANCE
    built = load_map(robot.folder.map_stem.with_suffix(".yaml"))
    device, world = robot.scene.robot, replace(robot.scene.world.seen_from(robot.world_from_map), start=start)
    if world.is_flat:
        heights = (device.body_bottom, device.visible_height)
        spec, _, reached = reachable_floor(world, radius, record.true_map[0].resolution, heights)
        return floor_coverage(built, (spec, reached), quality.truth_from_built)
    return reachable_coverage(built, record.true_map, quality.truth_from_built, start, radius)


def _map_quality(robot: SimulatedRobot, record: ExplorationRecord) -> MapQuality | None:
    path = robot.folder.map_stem.with_suffix(".yaml")
    if not path.exists() or not record.true_map[0].width:
        return None
    try:
        return compare_maps(load_map(path), record.true_map)
    except BadInputError:
        return None


def _supply(recording: Path) -> str | None:
    """The last word of the battery."""
    told = None
    for recorded in read_recording(recording, [BATTERY.ros_name]):
        told = recorded.decode_as(BatteryState)
    return None if told is None else told.supply.name.lower()
