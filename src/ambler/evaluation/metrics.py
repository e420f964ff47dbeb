"""What the numbers of results mean: words, unit, one sentence and importance of each field, as reports show them."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Any

_UNITS = {
    "m": "m",
    "s": "s",
    "seconds": "s",
    "ms": "ms",
    "hz": "Hz",
    "deg": "°",
    "rad": "rad",
    "pct": "%",
    "cells": "cells",
    "m2": "m²",
    "mb": "MB",
}


class Group(enum.Enum):
    """What a field tells, what matters first; SETTING is what was given and SMALL what only a later look needs."""

    OUTCOME = "What came of it"
    ACCURACY = "Accuracy"
    MAP = "Map and coverage"
    TIME = "Way and time"
    OTHER = "Results"
    SETTING = "Setting"
    SMALL = "Small print"


@dataclass(frozen=True, slots=True)
class Metric:
    """A field in words; `meaning` is a sentence, empty for a field that nobody explained."""

    label: str
    group: Group
    meaning: str = ""


_O, _A, _M, _T, _S = Group.OUTCOME, Group.ACCURACY, Group.MAP, Group.TIME, Group.SMALL
METRICS = {
    "ended": Metric("Ended", _O, "How the program ended: finished or succeeded, else the name of what went wrong."),
    "text": Metric("Why", _O, "Why it ended so."),
    "collisions": Metric(
        "Collisions",
        _O,
        "Contacts with anything but a dock's contacts while it moved faster than 0.05 m/s, with people only if it moved towards them within the "
        "half second before; judged from the simulator's truth.",
    ),
    "collisions_shoved": Metric(
        "Shoved into",
        _O,
        "What somebody who touched it shoved the robot into, while its gate told it to stand for the 0.8 s before; no collisions.",
    ),
    "contacts": Metric("Contacts", _O, "All contacts with anything but a dock's contacts, whoever caused them."),
    "goals_reached": Metric("Goals reached", _O, "Goals at which the robot said that it had arrived."),
    "goals": Metric("Goals given", _O, "Goals that it was sent to."),
    "is_home": Metric("Came home", _O, "Whether it drove back to its start when nothing was left to explore."),
    "targets_reached": Metric("Targets reached", _O, "Places at the edge of the unknown that it drove to."),
    "dock_code": Metric("Docking", _O, "How the last docking ended, by its code."),
    "dock_attempts": Metric("Attempts to dock", _O, "Approaches that it took to dock; 1 is best."),
    "undock_code": Metric("Undocking", _O, "How leaving the dock ended, by its code."),
    "teach_code": Metric("Teaching", _O, "How learning the dock's pose ended, by its code."),
    "battery_supply": Metric("Battery at the end", _O, "What the battery said last: charging, discharging or full."),
    "found_after_s": Metric(
        "Place found after", _O, "Time from the first scan until it believed to know where it was."
    ),
    "believed_ratio": Metric(
        "Scans with a place", _O, "Share of the scans for which it believed to know where it was."
    ),
    "times_lost": Metric("Times lost", _O, "How often a place that it had believed was given up."),
    "worst_goal_error_m": Metric(
        "Worst error at a goal", _A, "Largest true distance from a goal when the robot said that it had arrived."
    ),
    "dock_error_m": Metric("Error in the dock", _A, "True distance between where it stood docked and where it should."),
    "dock_error_deg": Metric("Heading error in the dock", _A, "True angle between its docked heading and the dock's."),
    "dock_error_x_m": Metric(
        "Error along the dock", _A, "The part of the docking error towards or away from the dock."
    ),
    "dock_error_y_m": Metric("Error across the dock", _A, "The part of the docking error to the side."),
    "dock_error_yaw_deg": Metric("Signed heading error", _A, "The heading error with its sign, positive to the left."),
    "undock_x_m": Metric("Place after undocking, along", _A, "Where it stood after leaving, along the dock's axis."),
    "undock_y_m": Metric("Place after undocking, across", _A, "Where it stood after leaving, beside the dock's axis."),
    "position_error_max_m": Metric(
        "Largest position error",
        _A,
        "Largest distance between where it believed to be in the known map and where it was.",
    ),
    "position_error_rms_m": Metric(
        "Position error (RMS)", _A, "Root mean square of that distance over the whole run; large errors count more."
    ),
    "ate_rms_m": Metric(
        "Trajectory error (ATE)",
        _A,
        "Absolute trajectory error: root mean square distance of the estimated from the true path, the best rigid motion taken out.",
    ),
    "ate_max_m": Metric("Largest trajectory error", _A, "The largest of the distances of which the ATE is the mean."),
    "ate_unaligned_rms_m": Metric(
        "Trajectory error, unaligned", _A, "The same as the ATE without taking a rigid motion out first."
    ),
    "ate_unaligned_max_m": Metric(
        "Largest error, unaligned", _A, "The farthest that the map's frame was off anywhere."
    ),
    "points_on_walls_ratio": Metric(
        "Returns on walls",
        _A,
        "Share of the scanner's returns within one cell of a wall of the map; people, glass and wrong poses are what is missing.",
    ),
    "largest_correction_m": Metric(
        "Largest correction", _A, "The longest step that the map put the robot away from what its odometry said."
    ),
    "translation_mean_m": Metric("Relations, translation", _A, "Mean error of distances between given pairs of poses."),
    "translation_std_m": Metric("Translation, spread", _A, "Standard deviation of those errors."),
    "rotation_mean_deg": Metric("Relations, rotation", _A, "Mean error of the turn between given pairs of poses."),
    "rotation_std_deg": Metric("Rotation, spread", _A, "Standard deviation of those errors."),
    "relations_used": Metric("Relations used", _A, "Given pairs of poses of which both are in the trajectory."),
    "relations_given": Metric("Relations given", _A, "Pairs of poses in the file of relations."),
    "reachable_coverage_ratio": Metric(
        "Reachable floor mapped",
        _M,
        "Share of the floor that the robot's centre can reach, with 15 cm on each side, which the map calls free.",
    ),
    "coverage_ratio": Metric("Free space mapped", _M, "Share of all truly free cells which the map calls free."),
    "false_free_ratio": Metric("Wrongly free", _M, "Share of the cells that the map calls free and that are not."),
    "nne_cells": Metric(
        "Walls missed (NNE)",
        _M,
        "Nearest-neighbour error: mean distance of the true walls from the nearest built wall, in cells; below 1 is good.",
    ),
    "nne_reverse_cells": Metric(
        "Walls invented (reverse NNE)", _M, "Mean distance of the built walls from the nearest true wall, in cells."
    ),
    "ssim": Metric(
        "Likeness of the maps (SSIM)",
        _M,
        "Structural similarity of the pictures of true and built walls; 1 is equal, 0 has nothing in common.",
    ),
    "frontiers_left": Metric(
        "Frontiers left", _M, "Edges between free and unknown that remain, each with its reason, mostly dust."
    ),
    "loop_closures": Metric("Loop closures", _M, "Places that were recognized when the robot came back to them."),
    "submaps": Metric("Submaps", _M, "Local maps of which the whole map is put together."),
    "nodes": Metric("Nodes", _M, "Poses in the graph that is optimized."),
    "alignment_x_m": Metric("Shift along x", _M, "How far the built map was moved along x to lie on the true one."),
    "alignment_y_m": Metric("Shift along y", _M, "How far the built map was moved along y to lie on the true one."),
    "alignment_yaw_rad": Metric("Turn", _M, "How far the built map was turned to lie on the true one."),
    "path_length_m": Metric("Path length", _T, "Length of the true path."),
    "recovery_time_ratio": Metric("Time in recoveries", _T, "Share of the run in which a navigation was recovering."),
    "dock_seconds": Metric("Docking took", _T, "Time from the order to dock to its end."),
    "dock_final_seconds": Metric("Final approach took", _T, "Time from the staging pose before the dock until docked."),
    "undock_seconds": Metric("Undocking took", _T, "Time from the order to leave to its end."),
    "sim_seconds": Metric("Time of the run", _T, "Time that passed for the robot."),
    "data_seconds": Metric("Time of the recording", _T, "Time between the first and the last scan."),
    "run_seconds": Metric("Computed in", _T, "Time that passed for whoever waited."),
    "cpu_seconds": Metric("Processor time", _T, "Time of the processor that it took."),
    "real_time_factor": Metric("Times real time", _T, "Time of the run over the time that it took to compute."),
    "scans": Metric("Scans", _T, "Scans of the recording."),
    "run_cpu_seconds": Metric(
        "Processor time of the run", _T, "Time of the processor that the run took, before it was judged."
    ),
    "run_memory_mb": Metric("Memory of the run", _T, "The most memory that the process held until the run ended."),
    "peak_memory_mb": Metric("Peak memory", _T, "The most memory that the process held, until the run was judged."),
    "world": Metric("World", Group.SETTING),
    "robot": Metric("Robot", Group.SETTING),
    "localizer": Metric("Localizer", Group.SETTING),
    "source": Metric("Localized by", Group.SETTING),
    "dock_text": Metric("Docking", _S),
    "undock_text": Metric("Undocking", _S),
    "teach_text": Metric("Teaching", _S),
    "undock_attempts": Metric("Attempts to undock", _S),
    "undock_final_seconds": Metric("Final approach of undocking, s", _S),
    "recording": Metric("Recording", _S),
}
_ORDER = {name: k for k, name in enumerate(METRICS)}


def metric_of(name: str) -> Metric:
    """Return what a field means; one that nobody explained has its name as words."""
    if name in METRICS:
        return METRICS[name]
    words = name.split("_")
    last = words[-1] in _UNITS or words[-1] == "ratio"
    return Metric(" ".join(words[:-1] if last and len(words) > 1 else words), Group.OTHER)


def ordered(names: list[str]) -> list[str]:
    """Return names with what matters first; those that nobody explained stay as they were, at the end."""
    return sorted(names, key=lambda name: _ORDER.get(name, len(_ORDER)))


def is_known(value: Any) -> bool:
    """Say whether there is a value."""
    return value is not None and not (isinstance(value, float) and not math.isfinite(value))


def shown(name: str, value: Any) -> str:
    """Return a value with its unit, in a size that is easy to read: shares in per cent, small lengths in cm or mm."""
    words = name.split("_")
    unit = _UNITS.get(words[-1], "") if len(words) > 1 else ""
    if not is_known(value):
        return "unknown"
    if words[-1] == "code":
        return str(value).lower().replace("_", " ")
    if isinstance(value, bool) or not isinstance(value, int | float):
        return plain_text(value)
    if words[-1] == "ratio":
        return f"{100.0 * value:.2f} %"
    if unit == "m" and isinstance(value, float):
        return length(value)
    return f"{plain_text(value)} {unit}".strip()


def length(metres: float) -> str:
    """Return a length in m, cm or mm."""
    size = abs(metres)
    if size >= 1.0 or size == 0.0:
        return f"{metres:.2f} m"
    return f"{100.0 * metres:.1f} cm" if size >= 0.01 else f"{1000.0 * metres:.2g} mm"


def plain_text(value: Any) -> str:
    """Return a value without its unit; numbers with three or four digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "unknown"
        return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return str(value)
