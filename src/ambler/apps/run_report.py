"""The report of a run: pictures, what its steps came to, frontiers that remain, collisions; and its result in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as TerminalTable

from ambler.apps.docks import dock_of_world
from ambler.apps.judgement import Verdict, is_good, true_pose_at
from ambler.apps.simulated import SimulatedRobot
from ambler.apps.site_judgement import SITE_PICTURE
from ambler.core.messages import Frontier
from ambler.evaluation.curves import draw_errors, draw_speed, worst_mark
from ambler.evaluation.pictures import Mark, draw_graph, draw_map_with_trajectory, draw_overlay, draw_series
from ambler.evaluation.report import Picture, Table, collision_table, frontier_table, write_report
from ambler.evaluation.results import machine_class
from ambler.evaluation.trajectory import TrajectoryError
from ambler.nodes.planner import GlobalPlannerNode
from ambler.nodes.steps import ExploreStep, NavigateStep, Step, TaskStep, name_of
from ambler.planning.visibility_planner import VisibilityPlanner
from ambler.wire.glass_files import SUFFIX, load_glass
from ambler.wire.map_files import load_map


def write_run_report(robot: SimulatedRobot, verdict: Verdict) -> Path:
    """Draw what a robot did and write `report.html` and `report.json` into its folder; returns the page."""
    frontiers = _frontiers(robot)
    is_known = verdict.fields["collisions"] is not None
    tables = [_steps(robot), collision_table(verdict.collisions, is_whole=is_known)]
    if frontiers is not None:
        tables.append(frontier_table(frontiers))
    steps = ", ".join(dict.fromkeys(name_of(step) for step in robot.steps)) or "nothing to do"
    return write_report(
        robot.folder.root,
        f"{robot.options.robot} in {robot.scene.world.name}: {steps}",
        verdict.fields,
        _pictures(robot, verdict, frontiers or ()),
        tables,
        subtitle=f"seed {robot.options.seed}, {machine_class()}",
        configuration=robot.folder.config.read_text(encoding="utf-8"),
        passed={"ended": is_good(verdict), "collisions": verdict.fields["collisions"] == 0},
    )


def print_result(fields: dict[str, Any], title: str) -> None:
    """Print the result as a small table."""
    table = TerminalTable(title=title, show_header=False, title_justify="left")
    for name, value in fields.items():
        if name == "text" and value is None:
            continue  # nothing went wrong
        text = "unknown" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
        table.add_row(name, text)
    Console(width=100).print(table)


def _frontiers(robot: SimulatedRobot) -> tuple[Frontier, ...] | None:
    """The frontiers that an exploration left, None when it was not over: then nothing is known of them."""
    for end in () if robot.end is None else robot.end.ends:
        if isinstance(end.step, ExploreStep) and end.result is not None:
            remaining: tuple[Frontier, ...] = end.result.remaining
            return remaining
    return None


def _steps(robot: SimulatedRobot) -> Table:
    ends = () if robot.end is None else robot.end.ends
    rows = tuple(
        (
            k + 1,
            _title(end.step),
            end.code.lower().replace("_", " "),
            end.text,
            f"{(end.ended_ns - end.begun_ns) * 1e-9:.1f}",
        )
        for k, end in enumerate(ends)
    )
    return Table("Steps", ("step", "what", "ended", "why", "seconds"), rows, "no step was begun")


def _title(step: Step) -> str:
    if isinstance(step, ExploreStep):
        return "explore"
    if isinstance(step, NavigateStep):
        x, y, _ = step.map_from_goal.as_array()
        return f"drive to {x:.2f}, {y:.2f} m" + ("" if step.level is None else f" on level {step.level}")
    if isinstance(step, TaskStep):
        return f"task {step.task.name}"
    return f"{name_of(step)} {step.dock}"


def _pictures(robot: SimulatedRobot, verdict: Verdict, frontiers: tuple[Frontier, ...]) -> list[Picture]:
    folder, record = robot.folder, verdict.record
    pictures = _map_picture(robot, verdict, frontiers) + _site_picture(robot) + _graph_picture(robot, verdict)
    if verdict.quality is not None:
        path = draw_overlay(verdict.quality, folder.root / "overlay.png")
        pictures.append(Picture("Walls of the true map (red) and of the built map (blue), thinned and aligned", path))
    if verdict.trajectory is not None:
        t, path = verdict.trajectory, folder.root / "trajectory_error.png"
        draw_errors(path, t.stamps_ns, _errors(robot, t), _begin_ns(verdict), "position error")
        how = "after the best rigid motion" if robot.options.makes_map else "in the known map"
        pictures.append(Picture(f"Error of the estimated position, {how}", path))
    if robot.options.makes_map and len(record.coverage):
        curve = {"coverage": (record.coverage[:, 0], 100.0 * record.coverage[:, 1])}
        path = draw_series(folder.root / "coverage.png", "time, s", "truly free area known, %", curve)
        pictures.append(Picture("Coverage over time", path))
    if len(record.true_poses) > 1:
        path = draw_speed(folder.root / "speed.png", record.true_stamps_ns, record.true_poses, _begin_ns(verdict))
        pictures.append(Picture("True speed of the base, smoothed so that a gait does not show", path))
    return pictures


def _map_picture(robot: SimulatedRobot, verdict: Verdict, frontiers: tuple[Frontier, ...]) -> list[Picture]:
    """The map with the paths and everything that went wrong; none when there is no map."""
    folder, record = robot.folder, verdict.record
    stem = folder.map_stem if robot.options.makes_map else folder.known_map_stem
    if not stem.with_suffix(".yaml").exists():
        return []
    spec, occupancy = load_map(stem.with_suffix(".yaml"))
    paths = {"estimated": record.poses, "true": record.true_poses}
    glass_file = stem.with_name(stem.name + SUFFIX)
    glass = load_glass(glass_file).segments if glass_file.exists() else None
    path = folder.root / "map.png"
    draw_map_with_trajectory(path, spec, occupancy, paths, frontiers, glass, _marks(robot, verdict))
    what = "The map as it was built" if robot.options.makes_map else "The known map"
    return [Picture(f"{what}, with the estimated and the true path, the largest error and what was hit", path)]


def _site_picture(robot: SimulatedRobot) -> list[Picture]:
    """The levels of a map of ground, as its judgement drew them; none of other maps."""
    path = robot.folder.root / SITE_PICTURE
    if not path.exists():
        return []
    return [Picture("The levels of the site, their heights, the estimated path and the passages between them", path)]


def _graph_picture(robot: SimulatedRobot, verdict: Verdict) -> list[Picture]:
    """The visibility graph of a planner that has one, over the map; none when there is no map."""
    folder, node = robot.folder, robot.stack.node("planner")
    stem = folder.map_stem if robot.options.makes_map else folder.known_map_stem
    planner = node.planner if isinstance(node, GlobalPlannerNode) else None
    if not isinstance(planner, VisibilityPlanner) or not stem.with_suffix(".yaml").exists():
        return []
    path = folder.root / "graph.png"
    draw_graph(path, *load_map(stem.with_suffix(".yaml")), planner.view(0, "map"), verdict.record.true_poses)
    return [Picture("The visibility graph as the last plan left it, and the true path", path)]


def _marks(robot: SimulatedRobot, verdict: Verdict) -> list[Mark]:
    """What must be seen on the map: goals, docks, the largest error, collisions."""
    marks = []
    goals = [step for step in robot.steps if isinstance(step, NavigateStep)]
    for k, goal in enumerate(goals):
        marks.append(Mark(goal.map_from_goal.x, goal.map_from_goal.y, f"goal {k + 1}", "goal"))
    world = robot.scene.world.seen_from(robot.world_from_map)
    for dock in world.docks if robot.options.docks_wanted else ():
        pose = dock_of_world(world, dock.name).world_from_dock
        marks.append(Mark(pose.x, pose.y, dock.name, "dock"))
    t = verdict.trajectory
    if t is not None:
        marks.append(worst_mark(t.stamps_ns, _errors(robot, t), t.estimate, _begin_ns(verdict)))
    for collision in verdict.collisions:
        at = true_pose_at(verdict.record, collision.begin_ns)
        if at is not None:
            seconds = (collision.begin_ns - _begin_ns(verdict)) * 1e-9
            marks.append(Mark(at.x, at.y, f"{collision.other_geom} hit at {seconds:.1f} s", "collision"))
    return marks


def _errors(robot: SimulatedRobot, trajectory: TrajectoryError) -> NDArray[np.float64]:
    """Position errors, m: of a map that the robot made itself after the best rigid motion, in a known map as they are."""
    return trajectory.errors if robot.options.makes_map else trajectory.offsets


def _begin_ns(verdict: Verdict) -> int:
    """When the run began, by the clock of its truth."""
    stamps = verdict.record.true_stamps_ns
    return int(stamps[0]) if len(stamps) else 0
