"""Many demonstrations: each in a process of its own, their JSON results collected and summarized."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.apps.demo_process import DemoJob, run_demo
from ambler.apps.study_settings import DEFAULTS, StudySettings

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
class Campaign:
    """Every combination of these is one run, with these settings."""

    worlds: tuple[str, ...]
    robots: tuple[str, ...]
    strategies: tuple[str, ...]
    seeds: tuple[int, ...]
    settings: StudySettings = DEFAULTS

    def runs(self) -> list[tuple[str, str, str, int]]:
        """Return (world, robot, strategy, seed) of every run."""
        return list(itertools.product(self.worlds, self.robots, self.strategies, self.seeds))


def run_campaign(campaign: Campaign, out: Path, processes: int, *, is_resumed: bool = False) -> list[dict[str, Any]]:
    """Run everything and return one result per run, in order; a run that died has `ended` = crashed. A resumed campaign keeps the
    results that `out` holds already."""
    with ThreadPoolExecutor(processes) as pool:
        return list(pool.map(lambda job: _run_one(job, campaign.settings, out, is_resumed=is_resumed), campaign.runs()))


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


def _run_one(job: tuple[str, str, str, int], settings: StudySettings, out: Path, *, is_resumed: bool) -> dict[str, Any]:
    world, robot, strategy, seed = job
    demo = DemoJob(world, robot, seed, strategy, ("--strategy", strategy), settings)
    return {**run_demo(demo, out, is_resumed=is_resumed), "strategy": strategy}
