"""Box plots of docking: markers and docks as seen, final errors, and times beside the source's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np

from ambler.evaluation.docking import AXES, SOURCE_APPROACH, SOURCE_DOCKING_SECONDS, DetectionErrors, DockingOutcome

matplotlib.use("Agg")

DPI = 130
UNITS = ("x, mm", "y, mm", "yaw, °")
INK, SOURCE_INK = "#2563eb", "#f97316"


def draw_all(folder: Path, outcomes: Sequence[DockingOutcome], sights: Sequence[DetectionErrors]) -> None:
    """Draw what there is into a folder."""
    if sights:
        draw_detections(folder / "docking_sights.png", sights)
    if any(outcome.is_docked for outcome in outcomes):
        draw_final_errors(folder / "docking_errors.png", outcomes)
        draw_times(folder / "docking_times.png", outcomes)


def draw_detections(path: Path, series: Sequence[DetectionErrors]) -> None:
    """Draw one box per series and axis: errors against the truth."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(AXES), figsize=(3.6 * len(AXES), 4.0))
    for k, (axis, unit) in enumerate(zip(axes, UNITS, strict=True)):
        axis.boxplot([s.errors[:, k] for s in series], tick_labels=[s.name.replace("_", "\n") for s in series])
        axis.axhline(0.0, color="#9ca3af", linewidth=0.8)
        axis.set_title(f"error in {unit}")
    _save(figure, path)


def draw_final_errors(path: Path, outcomes: Sequence[DockingOutcome]) -> None:
    """Draw where robots stand when docked: boxes of x, y and yaw, and the places about the wanted one."""
    from matplotlib import pyplot
    from matplotlib.patches import Circle

    docked = [o for o in outcomes if o.is_docked and o.error_x is not None]
    x, y = (1e3 * np.array([getattr(o, name) for o in docked], float) for name in ("error_x", "error_y"))
    yaw = np.array([o.error_yaw_deg for o in docked], float)
    figure, axes = pyplot.subplots(1, 3, figsize=(11.0, 4.0))
    axes[0].boxplot([x, y], tick_labels=["x", "y"])
    axes[0].set_title(f"final error, mm ({len(docked)} dockings)")
    axes[1].boxplot([yaw], tick_labels=["yaw"])
    axes[1].set_title("final error, °")
    axes[2].plot(x, y, ".", color=INK)
    axes[2].add_patch(Circle((0.0, 0.0), 3.0, fill=False, color="#9ca3af"))
    axes[2].set_aspect("equal")
    axes[2].set_title("places, mm; circle: 3 mm")
    _save(figure, path)


def draw_times(path: Path, outcomes: Sequence[DockingOutcome]) -> None:
    """Draw the times of approach over the distance beside those of the source, and boxes of the time of docking."""
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9.0, 4.0), width_ratios=(2, 1))
    timed = [o for o in outcomes if o.approach_seconds is not None and o.kind in ("random", "approach")]
    left.plot([o.distance for o in timed], [o.approach_seconds for o in timed], ".", color=INK, label="measured")
    left.plot(list(SOURCE_APPROACH), list(SOURCE_APPROACH.values()), "o-", color=SOURCE_INK, label="source")
    left.set_xlabel("path to the staging pose, m")
    left.set_title("approach, s")
    left.legend()
    docking = [o.docking_seconds for o in timed if o.is_docked and o.docking_seconds is not None]
    right.boxplot([docking], tick_labels=["measured"])
    right.axhline(SOURCE_DOCKING_SECONDS, color=SOURCE_INK, label="source")
    right.set_ylim(bottom=0.0)
    right.set_title("docking, s")
    right.legend()
    _save(figure, path)


def _save(figure: matplotlib.figure.Figure, path: Path) -> None:
    from matplotlib import pyplot

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout()
    figure.savefig(path, dpi=DPI)
    pyplot.close(figure)
