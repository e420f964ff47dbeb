"""The glass scenario: the same robots explore the world `glass` with an ultrasonic ring, and with planar scanners alone."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.collisions import find_contacts
from ambler.evaluation.exploration_run import read_exploration
from ambler.evaluation.glass_quality import compare_glass
from ambler.evaluation.truth_frame import start_frame
from ambler.sim.world_file import load_world
from ambler.studies.demo_process import demo_line, run_demo
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.wire.glass_files import SUFFIX, load_glass

RING, LIGHT = "ring", "light"


@dataclass(frozen=True, slots=True)
class GlassCase:
    """One exploration of `base`, which knows glass by sound and light (`ring`) or by light alone; after `time_limit` simulated seconds it ends."""

    base: str
    variant: str
    seed: int
    world: str = "glass"
    time_limit: float = 600.0
    is_kinematic: bool = False
    settings: StudySettings = DEFAULTS

    @property
    def robot(self) -> str:
        """The robot that runs."""
        return f"{self.base}+ultrasonic" if self.variant == RING else self.base

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.world).stem}-{self.base}-{self.variant}-{self.seed}"


def glass_study(cases: Sequence[GlassCase]) -> Study[GlassCase]:
    """Return the study of these explorations."""
    return Study("glass", cases, run_case, demo_line)


def run_case(case: GlassCase, folder: Path) -> dict[str, Any]:
    """Explore, count contacts, and compare the glass that was found with the world's."""
    options = ("--time-limit", str(case.time_limit), *(("--kinematic",) if case.is_kinematic else ()))
    result = run_demo(folder, case.world, case.robot, case.seed, options, case.settings)
    return {**result, **_judge_run(case.world, Path(result["recording"]))} if "recording" in result else result


def is_good(result: dict[str, Any]) -> bool:
    """Say whether a run ended with proof and without a contact."""
    return bool(result["ended"] == "finished" and result.get("contacts") == 0)


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


def _judge_run(world: str, recording: Path) -> dict[str, Any]:
    """Count contacts at any speed, with panes apart, and compare the glass beside the map with the world's panes, where the run saved any."""
    solids = load_world(world).solids
    panes = {s.name for s in solids if s.is_glass}
    contacts = read_exploration(recording).contacts
    fields: dict[str, Any] = {
        "contacts": len(find_contacts(contacts)),
        "glass_contacts": len(find_contacts([c for c in contacts if c.other_geom in panes])),
    }
    path = recording.with_name(f"map{SUFFIX}")
    if path.exists():
        glass = load_glass(path)
        fields |= {
            **asdict(compare_glass(glass.segments, solids, start_frame(recording).world_from_map)),
            "seen_through_m2": glass.seen_through_m2,
        }
    return fields
