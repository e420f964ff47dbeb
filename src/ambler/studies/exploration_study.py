"""Explorations over worlds, robots, strategies and seeds, each a demonstration in a process of its own, and their summary."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.apps.judgement import LEAST_COVERAGE
from ambler.studies.demo_process import demo_line, run_demo
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

WORST = {
    "coverage_ratio": min,
    "reachable_coverage_ratio": min,
    "nne_cells": max,
    "nne_reverse_cells": max,
    "ssim": min,
    "ate_rms_m": max,
    "sim_seconds": max,
}
MEDIANS = (*WORST, "path_length_m", "real_time_factor", "peak_memory_mb")


@dataclass(frozen=True, slots=True)
class ExplorationCase:
    """One exploration; `options` are further words of `ambler demo`, `places` is the set that the world belongs to, in campaigns."""

    world: str
    robot: str
    strategy: str
    seed: int
    options: tuple[str, ...] = ()
    settings: StudySettings = DEFAULTS
    places: str = ""

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.world).stem}-{Path(self.robot).stem}-{self.strategy}-{self.seed}"


def exploration_study(cases: Sequence[ExplorationCase]) -> Study[ExplorationCase]:
    """Return the study of these explorations."""
    return Study("exploration", cases, run_case, demo_line)


def run_case(case: ExplorationCase, folder: Path) -> dict[str, Any]:
    """Explore."""
    options = ("--strategy", case.strategy, *case.options)
    result = run_demo(folder, case.world, case.robot, case.seed, options, case.settings)
    return {**result, "world": Path(case.world).stem, "strategy": case.strategy}


def is_good(result: dict[str, Any]) -> bool:
    """Say whether an exploration ended with proof, without a collision, and with the floor in its map where the truth is known."""
    share = result.get("reachable_coverage_ratio")
    has_floor = share is None or share >= LEAST_COVERAGE
    return result.get("ended") == "finished" and result.get("collisions") == 0 and has_floor


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<world>.<robot>.<strategy>.<what>` with medians, worst values and counts."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        groups.setdefault(f"{result['world']}.{result['robot']}.{result['strategy']}", []).append(result)
    fields: dict[str, Any] = {}
    for name, members in groups.items():
        fields[f"{name}.runs"] = len(members)
        fields[f"{name}.finished"] = sum(m.get("ended") == "finished" for m in members)
        fields[f"{name}.collisions"] = sum(m.get("collisions") or 0 for m in members)
        for what in MEDIANS:
            values = [m[what] for m in members if m.get(what) is not None]
            if values:
                fields[f"{name}.{what}_median"] = statistics.median(values)
            if values and what in WORST:
                fields[f"{name}.{what}_worst"] = WORST[what](values)
    return fields
