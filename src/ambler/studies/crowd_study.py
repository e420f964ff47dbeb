"""Explorations among people of whom some do not yield: contacts that the robot caused, all contacts, how the runs ended and how long they took."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.proportions import wilson_interval
from ambler.studies.demo_process import run_demo
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

MISSED = 2  # runs of 30 that may end without proof
COVERED = 0.98  # of the reachable floor, as of every other exploration: who stands in a doorway can end one early


@dataclass(frozen=True, slots=True)
class CrowdCase:
    """One exploration among `people`, `stubborn` of whom do not yield; `options` are further words of `ambler demo`. A world as `office-*` is drawn
    with the case's seed."""

    world: str
    robot: str
    people: int
    stubborn: int
    seed: int
    options: tuple[str, ...] = ()
    settings: StudySettings = DEFAULTS

    @property
    def place(self) -> str:
        """The world by its name."""
        return self.world.replace("*", str(self.seed))

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.place).stem}-{Path(self.robot).stem}-{self.people}of{self.stubborn}-{self.seed}"


def crowd_cases(
    worlds: Sequence[str],
    robots: Sequence[str],
    people: int,
    stubborn: int,
    seeds: Sequence[int],
    options: tuple[str, ...] = (),
    settings: StudySettings = DEFAULTS,
) -> list[CrowdCase]:
    """Return one case per seed; worlds and robots take turns, so that every robot comes to every world."""
    places = itertools.cycle(itertools.product(worlds, robots))
    return [
        CrowdCase(*place, people, stubborn, seed, options, settings) for place, seed in zip(places, seeds, strict=False)
    ]


def crowd_study(cases: Sequence[CrowdCase]) -> Study[CrowdCase]:
    """Return the study of these explorations."""
    return Study("crowd", cases, run_case, line)


def run_case(case: CrowdCase, folder: Path) -> dict[str, Any]:
    """Explore."""
    options = ("--fault", f"people@{case.people}/{case.stubborn}", *case.options)
    result = run_demo(folder, case.place, case.robot, case.seed, options, case.settings)
    return {**result, "world": Path(case.world).stem, "robot": case.robot}


def line(result: dict[str, Any]) -> str:
    """Say in a few words how a run ended."""
    early = " early" if _is_early(result) else ""
    return (
        f"{result['ended']}{early}, {result.get('collisions')} collisions of {result.get('contacts')} contacts, "
        f"{result.get('collisions_shoved')} shoved into, "
        f"{result.get('sim_seconds') or 0.0:.0f} s"
    )


def _is_early(result: dict[str, Any]) -> bool:
    """Whether a run ended with a proof although much of what can be reached was not seen."""
    return result.get("ended") == "finished" and (result.get("reachable_coverage_ratio") or 0.0) < COVERED


def meets_bar(fields: dict[str, Any]) -> bool:
    """Whether no contact was caused by a robot, and at most two of 30 runs ended without proof, or with one that came too early."""
    missed = fields["runs"] - fields["finished"]
    return bool(fields["collisions"] == 0 and missed * 30 <= MISSED * fields["runs"])


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields of all runs, and `<world>.<robot>.<what>` of those of one place and robot."""
    fields = _summary(results)
    hit = sum(bool(r.get("collisions")) for r in results)
    fields["runs_with_collision"], fields["runs_with_collision_ratio_max"] = hit, wilson_interval(hit, len(results))[1]
    groups: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        groups.setdefault(f"{result['world']}.{result['robot']}", []).append(result)
    for name, members in groups.items():
        fields |= {f"{name}.{what}": value for what, value in _summary(members).items()}
    return fields


def _summary(members: Sequence[dict[str, Any]]) -> dict[str, Any]:
    fields: dict[str, Any] = {
        "runs": len(members),
        "finished": sum(m.get("ended") == "finished" and not _is_early(m) for m in members),
        "finished_early": sum(_is_early(m) for m in members),
        "not_finished": ",".join(sorted(m["ended"] for m in members if m.get("ended") != "finished")),
        "collisions": sum(m.get("collisions") or 0 for m in members),
        "collisions_shoved": sum(m.get("collisions_shoved") or 0 for m in members),
        "contacts": sum(m.get("contacts") or 0 for m in members),
    }
    for what in ("sim_seconds", "reachable_coverage_ratio", "ate_rms_m", "path_length_m", "cpu_seconds"):
        values = [m[what] for m in members if m.get(what) is not None]
        if values:
            fields[f"{what}_median"] = statistics.median(values)
    return fields
