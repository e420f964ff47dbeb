"""The glass scenario: the same robots explore the world `glass` with and without ultrasonic ring and glass layers."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ambler.apps.demo_process import DemoJob, run_demo
from ambler.apps.study_settings import DEFAULTS, StudySettings
from ambler.evaluation.collisions import find_collisions
from ambler.evaluation.exploration_run import read_exploration
from ambler.evaluation.glass_quality import compare_glass
from ambler.sim.world_file import load_world
from ambler.wire.glass_files import SUFFIX, load_glass

WITH, WITHOUT = "with_layers", "without_layers"


@dataclass(frozen=True, slots=True)
class GlassStudy:
    """What to run. A run without the layers may end nowhere: `time_limit` (simulated seconds) ends all."""

    world: str = "glass"
    robots: tuple[str, ...] = ("diff", "amr_omni")
    variants: tuple[str, ...] = (WITH, WITHOUT)
    seeds: tuple[int, ...] = (0, 1, 2)
    time_limit: float = 600.0
    is_kinematic: bool = False
    settings: StudySettings = DEFAULTS

    def runs(self) -> list[tuple[str, str, int]]:
        """Return (robot, variant, seed) of every run."""
        return [(r, v, s) for r in self.robots for v in self.variants for s in self.seeds]


def run_study(study: GlassStudy, out: Path, processes: int, *, is_resumed: bool = False) -> list[dict[str, Any]]:
    """Run everything, each run in a process of its own, and return one result per run, in order; `is_resumed` keeps those that `out` has."""
    with ThreadPoolExecutor(processes) as pool:
        return list(pool.map(lambda job: _run_one(study, job, out, is_resumed=is_resumed), study.runs()))


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<robot>.<variant>.<what>`: contacts of all runs together, worst values, medians."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        groups.setdefault(f"{result['base']}.{result['variant']}", []).append(result)
    fields: dict[str, Any] = {}
    for name, members in groups.items():
        fields[f"{name}.runs"] = len(members)
        fields[f"{name}.finished"] = sum(m["ended"] == "finished" for m in members)
        for what in ("contacts", "glass_contacts", "collisions"):
            fields[f"{name}.{what}"] = sum(m.get(what) or 0 for m in members)
        fields[f"{name}.runs_with_contact"] = sum(bool(m.get("contacts")) for m in members)
        for what, worst in (("coverage_ratio", min), ("ate_rms_m", max), ("found_ratio", min), ("invented_m", max)):
            values = [m[what] for m in members if m.get(what) is not None]
            if values:
                fields[f"{name}.{what}_worst"] = worst(values)
        for what in ("seen_through_m2", "sim_seconds", "path_length_m"):
            values = [m[what] for m in members if m.get(what) is not None]
            if values:
                fields[f"{name}.{what}_median"] = statistics.median(values)
    return fields


def _run_one(study: GlassStudy, job: tuple[str, str, int], out: Path, *, is_resumed: bool) -> dict[str, Any]:
    base, variant, seed = job
    robot = f"{base}+ultrasonic" if variant == WITH else base
    options = ("--time-limit", str(study.time_limit), *(("--kinematic",) if study.is_kinematic else ()))
    result = run_demo(
        DemoJob(study.world, robot, seed, options=options, settings=study.settings), out, is_resumed=is_resumed
    )
    if "recording" in result:
        result |= _judge_run(study.world, Path(result["recording"]))
    return {**result, "base": base, "variant": variant}


def _judge_run(world: str, recording: Path) -> dict[str, Any]:
    """Count contacts at any speed, with panes apart, and compare the glass beside the map with the world's panes, where the run saved any."""
    solids = load_world(world).solids
    panes = {s.name for s in solids if s.is_glass}
    contacts = read_exploration(recording).contacts
    fields: dict[str, Any] = {
        "contacts": len(find_collisions(contacts, min_speed=0.0)),
        "glass_contacts": len(find_collisions([c for c in contacts if c.other_geom in panes], min_speed=0.0)),
    }
    path = recording.with_name(f"map{SUFFIX}")
    if path.exists():
        glass = load_glass(path)
        fields |= {**asdict(compare_glass(glass.segments, solids)), "seen_through_m2": glass.seen_through_m2}
    return fields
