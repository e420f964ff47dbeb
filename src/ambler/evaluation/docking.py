"""Numbers of docking: how precisely markers and docks are seen, how exactly, how often and how fast a robot docks.

Errors are told against the truth of the simulation, never against what the stack says of itself. What the source reports stands beside.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

F64 = NDArray[np.float64]

AXES = ("x_mm", "y_mm", "yaw_deg")
SOURCE_APPROACH: dict[float, float] = {1.0: 15.0, 3.0: 20.0, 9.0: 34.0, 12.5: 40.0, 25.0: 55.0}
"""Seconds of approach by metres of path (source 002, table 1)."""
SOURCE_DOCKING_SECONDS = 17.0
SOURCE_ERROR = (10.0, 0.3)
"""Millimetres and degrees of the final error (source 002, 5.3.2): "± 1 cm", "± 0.3 degrees"."""
STANDARD = {"random", "taught", "approach"}
"""Kinds of dockings without a fault."""
SOURCE_MARKER_MM = 3.0
"""Worst axis of a marker's place while the robot moves (source 002, 5.2.4)."""


@dataclass(frozen=True, slots=True)
class DockingOutcome:
    """One docking. `kind` groups runs: `random`, `taught` (random, of a robot that was taught the dock), `approach` (with `distance`, metres of path from the start to the staging pose) or the
    name of a fault. Seconds and errors (docked pose in the dock's frame, m and degrees) are None where there was none."""

    kind: str
    seed: int
    code: str
    text: str
    attempts: int
    distance: float
    approach_seconds: float | None
    docking_seconds: float | None
    error_x: float | None
    error_y: float | None
    error_yaw_deg: float | None
    collisions: int

    @property
    def is_docked(self) -> bool:
        return self.code == "SUCCEEDED"

    @property
    def error(self) -> float | None:
        """Metres between where the robot stands and where it should."""
        if self.error_x is None or self.error_y is None:
            return None
        return math.hypot(self.error_x, self.error_y)

    def to_dict(self) -> dict[str, Any]:
        """Return it as one line of a results file."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class DetectionErrors:
    """Errors float64 (N, 3) of poses seen in a series of pictures: millimetres along and across the line of sight (or the dock's x and y),
    degrees of yaw."""

    name: str
    errors: F64

    def summary(self) -> dict[str, float]:
        """Return what 95 % of the pictures stay below, the largest, and the spread about the mean, by axis."""
        fields: dict[str, float] = {f"{self.name}_pictures": len(self.errors)}
        for k, axis in enumerate(AXES):
            values = self.errors[:, k]
            fields[f"{self.name}_p95_{axis}"] = float(np.percentile(np.abs(values), 95))
            fields[f"{self.name}_max_{axis}"] = float(np.abs(values).max())
            fields[f"{self.name}_std_{axis}"] = float(values.std())
        return fields


def summarize(outcomes: Sequence[DockingOutcome]) -> dict[str, Any]:
    """Return the flat fields of the random runs, of the approaches, and of every fault."""
    fields: dict[str, Any] = {}
    for kind, prefix in (("random", ""), ("taught", "taught_")):
        runs = [o for o in outcomes if o.kind == kind]
        if runs:
            fields |= {prefix + name: value for name, value in _of_random(runs).items()}
    for distance, expected in SOURCE_APPROACH.items():
        runs = [o for o in outcomes if o.kind == "approach" and math.isclose(o.distance, distance, abs_tol=0.26)]
        times = [o.approach_seconds for o in runs if o.approach_seconds is not None]
        if runs:
            fields[f"approach_{distance:g}m_s"] = statistics.median(times) if times else None
            fields[f"source_approach_{distance:g}m_s"] = expected
    errors = [o.error for o in outcomes if o.kind == "approach" and o.error is not None]
    if errors:
        fields["approach_position_error_max_m"] = max(errors)
    standard = [o for o in outcomes if o.kind in STANDARD]
    times = [o.docking_seconds for o in standard if o.is_docked and o.docking_seconds is not None]
    if times:
        fields["docking_time_median_s"] = statistics.median(times)
        fields["docking_time_max_s"] = max(times)
        fields["source_docking_time_s"] = SOURCE_DOCKING_SECONDS
    for kind in sorted({o.kind for o in outcomes} - STANDARD):
        fields |= _of_fault(kind, [o for o in outcomes if o.kind == kind])
    fields["collisions"] = sum(o.collisions for o in outcomes)
    return fields


def _of_random(runs: Sequence[DockingOutcome]) -> dict[str, Any]:
    errors = [o.error for o in runs if o.is_docked and o.error is not None]
    yaws = [abs(o.error_yaw_deg) for o in runs if o.is_docked and o.error_yaw_deg is not None]
    good = sum(o.is_docked and o.attempts <= 2 for o in runs)
    return {
        "runs": len(runs),
        "success_ratio": sum(o.is_docked for o in runs) / len(runs),
        "within_two_attempts": good,
        "within_two_attempts_lower95": lower_bound(good, len(runs)),
        "first_attempt": sum(o.is_docked and o.attempts == 1 for o in runs),
        "attempts_mean": statistics.fmean(o.attempts for o in runs),
        "position_error_median_m": float(np.median(errors)) if errors else None,
        "position_error_p95_m": float(np.percentile(errors, 95)) if errors else None,
        "position_error_max_m": max(errors, default=None),
        "yaw_error_p95_deg": float(np.percentile(yaws, 95)) if yaws else None,
        "yaw_error_max_deg": max(yaws, default=None),
        "source_position_error_m": SOURCE_ERROR[0] * 1e-3,
        "source_yaw_error_deg": SOURCE_ERROR[1],
    }


def _of_fault(kind: str, runs: Sequence[DockingOutcome]) -> dict[str, Any]:
    """A fault ends in a docking or in a failure with a name, never in a collision."""
    errors = [o.error for o in runs if o.is_docked and o.error is not None]
    return {
        f"fault_{kind}_runs": len(runs),
        f"fault_{kind}_docked": sum(o.is_docked for o in runs),
        f"fault_{kind}_failures": ", ".join(sorted({o.code for o in runs if not o.is_docked})) or "none",
        f"fault_{kind}_position_error_max_m": max(errors, default=None),
        f"fault_{kind}_collisions": sum(o.collisions for o in runs),
    }


def lower_bound(good: int, runs: int) -> float:
    """Return the lower end of the exact two-sided 95 % interval of a ratio."""
    return 0.0 if good == 0 else float(stats.beta.ppf(0.025, good, runs - good + 1))


def table(fields: dict[str, Any]) -> str:
    """Return the measured values beside those of the source, as a Markdown table."""
    rows = ["| what | source | measured |", "|---|---|---|"]

    def row(what: str, source: str, name: str, text: str, scale: float = 1.0) -> None:
        value = fields.get(name)
        if value is not None:
            rows.append(f"| {what} | {source} | {text.format(scale * value)} |")

    marker = f"± {SOURCE_MARKER_MM:g} mm, worst axis, moving"
    row("marker along the sight at 1 m, still, 95 %", "not told", "marker_still_p95_x_mm", "{:.2f} mm")
    row("marker across the sight at 1 m, still, 95 %", "not told", "marker_still_p95_y_mm", "{:.2f} mm")
    row("marker along the sight, moving, 95 %", marker, "marker_moving_p95_x_mm", "{:.2f} mm")
    row("marker across the sight, moving, 95 %", marker, "marker_moving_p95_y_mm", "{:.2f} mm")
    row("dock x, still, 95 %", "± 4 mm", "dock_still_p95_x_mm", "{:.2f} mm")
    row("dock y, still, 95 %", "± 4 mm", "dock_still_p95_y_mm", "{:.2f} mm")
    row("dock x, moving, 95 %", "± 4 mm", "dock_moving_p95_x_mm", "{:.2f} mm")
    row("dock y, moving, 95 %", "± 4 mm", "dock_moving_p95_y_mm", "{:.2f} mm")
    row("final error, 95 %", f"± {SOURCE_ERROR[0]:g} mm", "position_error_p95_m", "{:.2f} mm", 1e3)
    row("final error, worst", "not told", "position_error_max_m", "{:.2f} mm", 1e3)
    row("final yaw error, 95 %", f"± {SOURCE_ERROR[1]:g}°", "yaw_error_p95_deg", "{:.3f}°")
    row(
        "final error of a taught dock, 95 %",
        f"± {SOURCE_ERROR[0]:g} mm",
        "taught_position_error_p95_m",
        "{:.2f} mm",
        1e3,
    )
    row("final error of a taught dock, worst", "not told", "taught_position_error_max_m", "{:.2f} mm", 1e3)
    row("final yaw error of a taught dock, 95 %", f"± {SOURCE_ERROR[1]:g}°", "taught_yaw_error_p95_deg", "{:.3f}°")
    row("docking from 1 m, median", f"{SOURCE_DOCKING_SECONDS:g} s", "docking_time_median_s", "{:.1f} s")
    for distance, seconds in SOURCE_APPROACH.items():
        row(f"approach, {distance:g} m", f"{seconds:g} s", f"approach_{distance:g}m_s", "{:.1f} s")
    return "\n".join(rows)


def shapes_table(results: dict[str, dict[str, Any]]) -> str:
    """Return the measured values of docks that scanners recognize, a column for each, as a Markdown table."""
    looks = {
        "dock_still": "1 m, standing",
        "dock_moving": "1 m, moving",
        "dock_half_metre": "0.5 m, standing",
        "dock_contact": "docked",
    }
    axes = (("x_mm", "{:.1f} mm"), ("y_mm", "{:.1f} mm"), ("yaw_deg", "{:.2f}°"))
    rows = [f"| what | {' | '.join(results)} |", "|---" * (len(results) + 1) + "|"]

    def row(what: str, *cells: tuple[str, str, float]) -> None:
        told = [", ".join(text.format(scale * f[name]) for name, text, scale in cells) for f in results.values()]
        rows.append(f"| {what} | {' | '.join(told)} |")

    for name, where in looks.items():
        row(f"one cloud, {where}: x, y, yaw (std)", *((f"{name}_std_{axis}", text, 1.0) for axis, text in axes))
    row("final error, 95 %, worst", *((f"position_error_{of}_m", "{:.2f} mm", 1e3) for of in ("p95", "max")))
    row("final yaw error, 95 %, worst", *((f"yaw_error_{of}_deg", "{:.3f}°", 1.0) for of in ("p95", "max")))
    row(
        "dockings, at the first attempt, collisions",
        *((n, "{:.0f}", 1.0) for n in ("runs", "first_attempt", "collisions")),
    )
    row("docking from 1 m, median", ("docking_time_median_s", "{:.1f} s", 1.0))
    return "\n".join(rows)
