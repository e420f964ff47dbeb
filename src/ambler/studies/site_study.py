"""Explorations of sites with three dimensions that nobody has seen: plots outdoors and garages of two levels, drawn for the study."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.proportions import wilson_interval
from ambler.studies.demo_process import demo_line, run_demo
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

KINDS = ("plot", "garage")
SURFACE_LEAST, TOUR_MOST = 0.98, 2.0


@dataclass(frozen=True, slots=True)
class SiteCase:
    """A robot in a drawn site; `options` are further words of `ambler demo`."""

    seed: int
    kind: str
    robot: str
    options: tuple[str, ...] = ()
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.kind}-{self.seed}-{self.robot}"


def site_study(
    seeds: Sequence[int],
    kinds: Sequence[str],
    robots: Sequence[str],
    options: tuple[str, ...] = (),
    settings: StudySettings = DEFAULTS,
) -> Study[SiteCase]:
    """Return the study of a site per seed, the kinds in turn, with every robot."""
    cases = [
        SiteCase(seed, kinds[k % len(kinds)], robot, options, settings)
        for k, seed in enumerate(seeds)
        for robot in robots
    ]
    return Study("sites", cases, run_case, demo_line)


def run_case(case: SiteCase, folder: Path) -> dict[str, Any]:
    """Explore; the noise of a run has the seed of its place."""
    result = run_demo(folder, f"{case.kind}-{case.seed}", case.robot, case.seed, case.options, case.settings)
    path, tour = result.get("path_length_m"), result.get("known_tour_m")
    ratio = None
    if path and tour and result.get("ended") == "finished":  # a way that was broken off is short
        ratio = path / tour
    return {**result, "kind": case.kind, "ratio_vs_known_tour": ratio}


def is_done(result: dict[str, Any]) -> bool:
    """Say whether a site was explored: with proof, at home, without a collision, and with what can be seen in the map."""
    surface = result.get("surface_coverage_ratio") or 0.0
    is_over = result.get("ended") == "finished" and bool(result.get("is_home"))
    return is_over and result.get("collisions") == 0 and surface >= SURFACE_LEAST


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<kind>.<robot>.<what>` and `all.<what>`, each run's own, and which bars are met."""
    fields: dict[str, Any] = {}
    names = list(dict.fromkeys((str(r["kind"]), str(r["robot"])) for r in results))
    for kind, robot in names:
        group = [r for r in results if (r["kind"], r["robot"]) == (kind, robot)]
        fields |= {f"{kind}.{robot}.{what}": value for what, value in _group(group).items()}
    whole = _group(results)
    fields |= {f"all.{what}": value for what, value in whole.items()}
    for r in results:
        told = ("ended", "is_home", "collisions", "levels", "surface_coverage_ratio", "reachable_coverage_ratio")
        more = ("false_free_ratio", "ratio_vs_known_tour", "path_length_m", "ate_unaligned_rms_m", "sim_seconds")
        run = f"run.{r['kind']}-{r['seed']}.{r['robot']}"
        fields |= {f"{run}.{what}": r.get(what) for what in (*told, *more)}
    ratio = whole["ratio_vs_known_tour_median"]
    fields |= {
        "bars.done": whole["done"] == whole["runs"],
        "bars.collisions": whole["collisions"] == 0,
        "bars.path": ratio is not None and ratio <= TOUR_MOST,
    }
    return fields


def _group(group: Sequence[dict[str, Any]]) -> dict[str, Any]:
    done = sum(map(is_done, group))
    low, high = wilson_interval(done, len(group))
    fields: dict[str, Any] = {
        "runs": len(group),
        "done": done,
        "done_ratio_low_95": low,
        "done_ratio_high_95": high,
        "finished": sum(r.get("ended") == "finished" for r in group),
        "at_home": sum(bool(r.get("is_home")) for r in group),
        "collisions": sum(r.get("collisions") or 0 for r in group),
    }
    for name in ("surface_coverage_ratio", "reachable_coverage_ratio", "ratio_vs_known_tour", "ate_unaligned_rms_m"):
        values = [float(r[name]) for r in group if r.get(name) is not None]
        worst = min if name.endswith("coverage_ratio") else max
        fields[f"{name}_median"] = statistics.median(values) if values else None
        fields[f"{name}_worst"] = worst(values) if values else None
    return fields
