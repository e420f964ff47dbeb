"""The report of a tuning study: the ranking, and for every parameter the objective over its values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
import yaml
from scipy.stats import rankdata

from ambler.evaluation.pictures import COLOURS, DPI, GRID, INK, MUTED
from ambler.evaluation.report import Picture, Table, write_report
from ambler.evaluation.tuning import Ranked
from ambler.evaluation.tuning_space import Choice, TuningSpace
from ambler.settings.profiles import as_values

matplotlib.use("Agg")
TOP = 25
QUARTERS = 4


def effect(values: Sequence[Choice], objectives: Sequence[float]) -> float:
    """Return how much a parameter matters: the share of the objective's variance that lies between its choices, or between the
    quarters of its values, corrected for chance (epsilon squared, Kelley 1935); NaN when it cannot be told."""
    y = np.array(objectives)
    is_number = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    if is_number and len(set(values)) > QUARTERS:
        group = rankdata(np.array(values, float), method="ordinal").astype(int) * QUARTERS // (len(y) + 1)
    else:
        group = np.unique([str(v) for v in values], return_inverse=True)[1] if len(y) else np.zeros(0, int)
    groups = [y[group == g] for g in np.unique(group)]
    total = float(((y - y.mean()) ** 2).sum()) if len(y) else 0.0
    if len(groups) < 2 or len(y) <= len(groups) + 1 or total == 0.0:
        return math.nan
    within = sum(float(((g - g.mean()) ** 2).sum()) for g in groups)
    return max(0.0, 1.0 - within / total * (len(y) - 1) / (len(y) - len(groups)))


def draw_effects(path: Path, space: TuningSpace, ranking: Sequence[Ranked]) -> Path:
    """Draw one panel per parameter: objective over value, the best trial marked, broken constraints as crosses at the top."""
    from matplotlib.figure import Figure

    names = sorted(space.parameters)
    columns = min(3, len(names))
    rows = math.ceil(len(names) / columns)
    figure = Figure(figsize=(4.2 * columns, 3.2 * rows), dpi=DPI, layout="constrained")
    tried = [r for r in ranking if r.values]
    valid, broken = [r for r in tried if r.is_valid], [r for r in tried if not r.is_valid]
    top = max((r.objective for r in valid), default=1.0)
    for k, name in enumerate(names):
        axes = figure.add_subplot(rows, columns, k + 1)
        choices = space.parameters[name].choices
        shown = {str(c): i for i, c in enumerate(choices)} if choices else None

        def place(r: Ranked, name: str = name, shown: dict[str, int] | None = shown) -> float:
            return float(shown[str(r.values[name])]) if shown else float(r.values[name])

        axes.scatter([place(r) for r in valid], [r.objective for r in valid], s=18, color=COLOURS[0], label="valid")
        axes.scatter(
            [place(r) for r in broken],
            [top] * len(broken),
            s=26,
            marker="x",
            color=COLOURS[4],
            label="breaks a constraint",
        )
        if valid:
            axes.scatter(
                [place(valid[0])], [valid[0].objective], s=90, facecolors="none", edgecolors=COLOURS[1], label="best"
            )
        if shown:
            axes.set_xticks(list(shown.values()), list(shown))
        elif space.parameters[name].scale == "log":
            axes.set_xscale("log")
        size = effect([r.values[name] for r in valid], [r.objective for r in valid])
        axes.set_title(f"{name}   effect {size:.2f}" if math.isfinite(size) else name, fontsize=9, color=INK)
        axes.tick_params(which="both", labelsize=8, colors=MUTED)
        axes.grid(color=GRID)
        axes.set_axisbelow(True)
        if k == 0:
            axes.set_ylabel("objective (defaults = sum of weights)", fontsize=8, color=MUTED)
            axes.legend(fontsize=7)
    figure.savefig(path)
    return path


def study_fields(space: TuningSpace, ranking: Sequence[Ranked]) -> dict[str, float | int | str | None]:
    """Return the flat fields of a study."""
    best, default = ranking[0], next(r for r in ranking if r.trial == 0)
    complete = len(space.cases())
    fields: dict[str, float | int | str | None] = {
        "trials": len(ranking),
        "trials_valid": sum(r.is_valid for r in ranking),
        "trials_complete": sum(r.cases == complete for r in ranking),
        "cases": complete,
        "best_trial": best.trial,
        "best_objective": best.objective,
        "default_objective": default.objective,
    }
    for name in space.objective:
        fields[f"best.{name}"] = best.metrics.get(name)
        fields[f"default.{name}"] = default.metrics.get(name)
    tried = [r for r in ranking if r.values and r.is_valid]
    for name in sorted(space.parameters):
        fields[f"effect.{name}"] = effect([r.values[name] for r in tried], [r.objective for r in tried])
    return fields


def write_study_report(folder: Path, space: TuningSpace, ranking: Sequence[Ranked]) -> Path:
    """Write `report.html`, `report.json` and `effects.png`; returns the page."""
    picture = draw_effects(folder / "effects.png", space, ranking)
    names = sorted(space.parameters)
    header = ("place", "trial", "cases", "objective", *space.objective, *names, "breaks")
    lines = [
        (
            str(place),
            "defaults" if r.trial == 0 else str(r.trial),
            str(r.cases),
            f"{r.objective:.4f}" if math.isfinite(r.objective) else "-",
            *(f"{r.metrics[m]:.4g}" if m in r.metrics else "-" for m in space.objective),
            *(str(r.values.get(n, "default")) for n in names),
            "; ".join(r.broken[:2]),
        )
        for place, r in enumerate(ranking[:TOP], start=1)
    ]
    title = f"Tuning over {', '.join(space.worlds)} with {', '.join(space.robots)}"
    return write_report(
        folder,
        title,
        study_fields(space, ranking),
        [Picture("Objective over each parameter; lower is better", picture)],
        [Table("Ranking", header, tuple(lines))],
        configuration=yaml.safe_dump(as_values(space), sort_keys=False),
    )
