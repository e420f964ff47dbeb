"""Judges a demonstration from its recording and its saved map, and writes the report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ambler.apps.demo import Demo
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.collisions import Collision, find_collisions
from ambler.evaluation.exploration_run import ExplorationRecord, read_exploration
from ambler.evaluation.map_quality import MapQuality, compare_maps, reachable_coverage
from ambler.evaluation.pictures import draw_map_with_trajectory, draw_overlay, draw_series
from ambler.evaluation.report import Picture, collision_table, frontier_table, write_report
from ambler.evaluation.results import machine_class
from ambler.evaluation.trajectory import TrajectoryError, trajectory_error
from ambler.wire.glass_files import SUFFIX, load_glass
from ambler.wire.map_files import load_map, save_map


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The result of a demonstration: `fields` as they go into JSON, and what the report draws."""

    fields: dict[str, Any]
    record: ExplorationRecord
    quality: MapQuality | None
    trajectory: TrajectoryError | None
    collisions: tuple[Collision, ...]
    wall_seconds: float


def judge(demo: Demo) -> Verdict:
    """Compare what the robot believed with the ground truth of its recording; unknown values are None."""
    record = read_exploration(demo.folder.recording)
    save_map(demo.folder.truth_stem, *record.true_map)
    quality = _map_quality(demo.folder.map_stem.with_suffix(".yaml"), record)
    trajectory = None
    if len(record.stamps_ns) > 1:
        trajectory = trajectory_error(record.stamps_ns, record.poses, record.true_stamps_ns, record.true_poses)
    collisions = tuple(find_collisions(record.contacts))
    result = None if demo.outcome is None else demo.outcome.result
    fields: dict[str, Any] = {
        "world": demo.world.name,
        "robot": demo.options.robot,
        "ended": demo.ended,
        "coverage_ratio": None if quality is None else quality.coverage_ratio,
        "reachable_coverage_ratio": None if quality is None else _reachable(demo, record, quality),
        "false_free_ratio": None if quality is None else quality.false_free_ratio,
        "nne_cells": None if quality is None else quality.nne_cells,
        "nne_reverse_cells": None if quality is None else quality.nne_reverse_cells,
        "ssim": None if quality is None else quality.ssim,
        "collisions": len(collisions),
        "ate_rms_m": None if trajectory is None else trajectory.ate_rms_m,
        "ate_unaligned_rms_m": None if trajectory is None else trajectory.unaligned_rms_m,
        "path_length_m": record.path_length,
        "sim_seconds": demo.sim_seconds,
        "run_seconds": demo.wall_seconds,
        "real_time_factor": demo.sim_seconds / demo.wall_seconds,
        "frontiers_left": None if result is None else len(result.remaining),
        "goals_reached": None if result is None else result.goals_reached,
        "is_home": None if result is None else result.is_home,
        "peak_memory_mb": _peak_memory(),
        "recording": str(demo.folder.recording),
    }
    return Verdict(fields, record, quality, trajectory, collisions, demo.wall_seconds)


def write_demo_report(demo: Demo, verdict: Verdict) -> Path:
    """Draw the run and write `report.html` and `report.json` into its folder; returns the page."""
    folder, record = demo.folder.root, verdict.record
    pictures: list[Picture] = []
    remaining = () if demo.outcome is None or demo.outcome.result is None else demo.outcome.result.remaining
    if demo.folder.map_stem.with_suffix(".yaml").exists():
        spec, occupancy = load_map(demo.folder.map_stem.with_suffix(".yaml"))
        paths = {"estimated": record.poses, "true": record.true_poses}
        glass_file = demo.folder.map_stem.with_name(demo.folder.map_stem.name + SUFFIX)
        glass = load_glass(glass_file).segments if glass_file.exists() else None
        path = draw_map_with_trajectory(folder / "map.png", spec, occupancy, paths, remaining, glass)
        pictures.append(Picture("The map as it was built, with the estimated and the true path", path))
    if verdict.quality is not None:
        path = draw_overlay(verdict.quality, folder / "overlay.png")
        pictures.append(Picture("Walls of the true map (red) and of the built map (blue), thinned and aligned", path))
    if len(record.coverage):
        path = draw_series(
            folder / "coverage.png",
            "time, s",
            "truly free area known, %",
            {"coverage": (record.coverage[:, 0], 100.0 * record.coverage[:, 1])},
        )
        pictures.append(Picture("Coverage over time", path))
    if verdict.trajectory is not None:
        t = verdict.trajectory
        path = draw_series(
            folder / "trajectory_error.png",
            "time, s",
            "position error, cm",
            {"error": (t.stamps_ns * 1e-9, 100.0 * t.errors)},
        )
        pictures.append(Picture("Error of the estimated position", path))
    if len(record.speeds):
        path = draw_series(
            folder / "speed.png",
            "time, s",
            "true speed, m/s",
            {"speed": (record.true_stamps_ns[::10] * 1e-9, record.speeds[::10])},
        )
        pictures.append(Picture("Speed of the base", path))
    return write_report(
        folder,
        f"Exploration of {demo.world.name} with {demo.options.robot}",
        verdict.fields,
        pictures,
        (frontier_table(remaining), collision_table(verdict.collisions)),
        subtitle=f"seed {demo.options.seed}, {machine_class()}",
        configuration=demo.folder.config.read_text(encoding="utf-8"),
        passed={"ended": demo.ended == "finished", "collisions": not verdict.collisions},
    )


def print_result(fields: dict[str, Any], title: str = "exploration") -> None:
    """Print the result as a small table."""
    table = Table(title=title, show_header=False, title_justify="left")
    for name, value in fields.items():
        text = "unknown" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
        table.add_row(name, text)
    Console(width=100).print(table)


def _reachable(demo: Demo, record: ExplorationRecord, quality: MapQuality) -> float | None:
    if len(record.true_poses) == 0:
        return None
    start, radius = SE2.from_array(record.true_poses[0]), demo.robot.inscribed_radius
    built = load_map(demo.folder.map_stem.with_suffix(".yaml"))
    return reachable_coverage(built, record.true_map, quality.truth_from_built, start, radius)


def _map_quality(path: Path, record: ExplorationRecord) -> MapQuality | None:
    if not path.exists():
        return None
    try:
        return compare_maps(load_map(path), record.true_map)
    except BadInputError:
        return None


def _peak_memory() -> float:
    """Return the peak resident memory of this process, MB."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
