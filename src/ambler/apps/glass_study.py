"""The glass scenario: the same robots explore the world `glass` with and without ultrasonic ring and glass layers."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.glass_quality import compare_glass
from ambler.sim.world import load_world
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

    def runs(self) -> list[tuple[str, str, int]]:
        """Return (robot, variant, seed) of every run."""
        return [(r, v, s) for r in self.robots for v in self.variants for s in self.seeds]


def run_study(study: GlassStudy, out: Path, processes: int) -> list[dict[str, Any]]:
    """Run everything, each run in a process of its own, and return one result per run, in order."""
    out.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(processes) as pool:
        return list(pool.map(lambda job: _run_one(study, job, out), study.runs()))


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<robot>.<variant>.<what>`: contacts of all runs together, worst values, medians."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        groups.setdefault(f"{result['base']}.{result['variant']}", []).append(result)
    fields: dict[str, Any] = {}
    for name, members in groups.items():
        fields[f"{name}.runs"] = len(members)
        fields[f"{name}.finished"] = sum(m["ended"] == "finished" for m in members)
        fields[f"{name}.contacts"] = sum(m.get("collisions") or 0 for m in members)
        fields[f"{name}.runs_with_contact"] = sum(bool(m.get("collisions")) for m in members)
        for what, worst in (("coverage_ratio", min), ("ate_rms_m", max), ("found_ratio", min), ("invented_m", max)):
            values = [m[what] for m in members if m.get(what) is not None]
            if values:
                fields[f"{name}.{what}_worst"] = worst(values)
        for what in ("seen_through_m2", "sim_seconds", "path_length_m"):
            values = [m[what] for m in members if m.get(what) is not None]
            if values:
                fields[f"{name}.{what}_median"] = statistics.median(values)
    return fields


def _run_one(study: GlassStudy, job: tuple[str, str, int], out: Path) -> dict[str, Any]:
    base, variant, seed = job
    robot = f"{base}+ultrasonic" if variant == WITH else base
    label = f"{Path(study.world).stem}-{robot}-{seed}"
    result_file = out / f"{label}.json"
    result_file.unlink(missing_ok=True)
    command = [
        *(sys.executable, "-m", "ambler.cli.main", "demo", "--exit", "--no-view"),
        *("--world", study.world, "--robot", robot, "--seed", str(seed), "--time-limit", str(study.time_limit)),
        *("--out", str(out), "--json", str(result_file), *(("--kinematic",) if study.is_kinematic else ())),
    ]
    with (out / f"{label}.log").open("w") as log:
        subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False)
    result: dict[str, Any] = {"ended": "crashed"}
    if result_file.exists():
        result = json.loads(result_file.read_text())
        result |= _judge_glass(study.world, Path(result["recording"]).with_name(f"map{SUFFIX}"))
    print(f"{label}: {result['ended']}, {result.get('collisions')} contacts", flush=True)
    return {**result, "base": base, "variant": variant}


def _judge_glass(world: str, path: Path) -> dict[str, Any]:
    """Compare the glass beside a run's map with the world's panes; nothing where the run saved none."""
    if not path.exists():
        return {}
    glass = load_glass(path)
    return {**asdict(compare_glass(glass.segments, load_world(world).solids)), "seen_through_m2": glass.seen_through_m2}
