"""Explorations of places that were drawn for the campaign, beside those with which the robots were developed; bars count on fresh ones."""

from __future__ import annotations

import os
import statistics
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ambler.core.errors import BadInputError
from ambler.evaluation.proportions import wilson_interval
from ambler.sim.generator.draw import KINDS
from ambler.studies.exploration_study import ExplorationCase, is_good
from ambler.studies.study import CRASHED
from ambler.studies.study_settings import DEFAULTS, StudySettings

FRESH, DEVELOPMENT = "fresh", "development"
LOAD = "cpu_per_sim_second"
CLOSED_KINDS = ("office", "flat", "ward", "warehouse", "corridor")
"""Kinds of at most 1500 m² that are closed on all sides."""
DEVELOPMENT_WORLDS = ("lab_obstacle", "two_rooms", "office", "warehouse", "maze", "corridor", "building")
PUBLIC_PLANS = ("nav2_warehouse/warehouse_closed.yaml",)
"""Below `$AMBLER_DATA`, where that is set."""

DONE_LEAST = 59 / 60
RMS_MEDIAN, RMS_95, RECOVERY_MOST = 0.05, 0.10, 0.05  # metres in the frame of the start; share of the time
ROW = (
    "runs",
    "done",
    "collisions",
    "coverage_worst",
    "start_rms_m_median",
    "start_rms_m_95",
    "start_max_m_worst",
    "recovery_time_ratio",
)


def parse_places(words: Sequence[str]) -> tuple[int, bool]:
    """Read `fresh:N` and `development` as (number of fresh places, whether the others are wanted). Raises BadInputError."""
    fresh, has_development = 0, False
    for word in words:
        name, _, count = word.partition(":")
        if word == DEVELOPMENT:
            has_development = True
        elif name == FRESH and count.isdecimal() and int(count) > 0:
            fresh = int(count)
        else:
            raise BadInputError(f"--places {word!r}: fresh:N (N drawn places) or development")
    return fresh, has_development


def check_kinds(kinds: Sequence[str]) -> None:
    """Raise BadInputError for a kind that is none."""
    for kind in kinds:
        if kind not in KINDS:
            raise BadInputError(f"--kinds {kind!r}: there are {', '.join(KINDS)}")


def fresh_places(kinds: Sequence[str], seeds: Sequence[int]) -> tuple[str, ...]:
    """Return the names of drawn places, one per seed, the kinds in turn."""
    return tuple(f"{kinds[k % len(kinds)]}-{seed}" for k, seed in enumerate(seeds))


def development_places() -> tuple[str, ...]:
    """Return the built-in worlds, and the public plans that are there."""
    data = os.environ.get("AMBLER_DATA")
    plans = [str(Path(data) / plan) for plan in PUBLIC_PLANS] if data else []
    return DEVELOPMENT_WORLDS + tuple(plan for plan in plans if Path(plan).is_file())


def cases_of(
    fresh: Sequence[str],
    development: Sequence[str],
    robots: Sequence[str],
    seeds: Sequence[int],
    options: tuple[str, ...] = (),
    settings: StudySettings = DEFAULTS,
) -> list[ExplorationCase]:
    """Return a run per place and robot; the noise of a run has the seed of its place, development places have the first one."""
    strategy = str(settings.profile.get("strategy", "tour"))
    drawn = [(FRESH, world, seed) for world, seed in zip(fresh, seeds, strict=True)]
    known = [(DEVELOPMENT, world, seeds[0]) for world in development]
    return [
        ExplorationCase(world, robot, strategy, seed, options, settings, places)
        for places, world, seed in (*drawn, *known)
        for robot in robots
    ]


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<places>.<robot>.<what>` (robot `all`: all of them), where kinds of fresh places differ `<places>.<kind>.<what>`, each run's own
    `<places>.<world>.<robot>.<what>`, and whether the bars are met on fresh places."""
    fields: dict[str, Any] = {}
    sets = [name for name in (FRESH, DEVELOPMENT) if any(r["places"] == name for r in results)]
    for places in sets:
        members = [r for r in results if r["places"] == places]
        robots = list(dict.fromkeys(str(r["robot"]) for r in members))
        for robot in (*robots, "all"):
            group = [r for r in members if robot in (r["robot"], "all")]
            fields |= {f"{places}.{Path(robot).stem}.{what}": value for what, value in group_fields(group).items()}
        kinds = dict.fromkeys(kind_of(r) for r in members if places == FRESH)
        for kind in kinds if len(kinds) > 1 else ():
            group = [r for r in members if kind_of(r) == kind]
            fields |= {f"{places}.{kind}.{what}": value for what, value in group_fields(group).items()}
        for r in members:
            prefix = f"{places}.{Path(str(r['world'])).stem}.{Path(str(r['robot'])).stem}"
            fields |= {f"{prefix}.{what}": value for what, value in run_fields(r).items()}
    fresh = [r for r in results if r["places"] == FRESH]
    if fresh:
        fields |= {f"bars.{name}": is_met for name, is_met in bars(group_fields(fresh)).items()}
    return fields


def group_fields(group: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return counts, medians and worst values of some runs. A run is `done` that is finished with proof, without a collision, with 98 % of
    the reachable floor."""
    done = sum(map(is_done, group))
    low, high = wilson_interval(done, len(group))
    ends = Counter(str(r.get("ended")) for r in group if not is_done(r))
    fields: dict[str, Any] = {
        "runs": len(group),
        "done": done,
        "done_ratio_low_95": low,
        "done_ratio_high_95": high,
        "crashed": sum(r.get("ended") == CRASHED for r in group),
        "not_done": ", ".join(f"{name} {count}" for name, count in sorted(ends.items())),
        "collisions": sum(r.get("collisions") or 0 for r in group),
    }
    names = {
        "reachable_coverage_ratio": "coverage",
        "ate_unaligned_rms_m": "start_rms_m",
        "ate_unaligned_max_m": "start_max_m",
        "path_length_m": "path_length_m",
        "sim_seconds": "sim_seconds",
        "run_memory_mb": "run_memory_mb",
        "peak_memory_mb": "peak_memory_mb",
        LOAD: LOAD,
    }
    group = [{**r, LOAD: load_of(r)} for r in group]
    for what, name in names.items():
        values = [float(r[what]) for r in group if r.get(what) is not None]
        if values:
            fields[f"{name}_median"] = statistics.median(values)
            fields[f"{name}_worst"] = min(values) if name == "coverage" else max(values)
            if name == "start_rms_m":
                fields["start_rms_m_95"] = float(np.quantile(values, 0.95, method="higher"))
    seconds = sum(float(r.get("sim_seconds") or 0.0) for r in group)
    lost = sum(float(r.get("sim_seconds") or 0.0) * float(r.get("recovery_time_ratio") or 0.0) for r in group)
    fields["recovery_time_ratio"] = lost / seconds if seconds > 0.0 else None
    return fields


def run_fields(result: dict[str, Any]) -> dict[str, Any]:
    """Return what is told of one run."""
    names = ("ended", "reachable_coverage_ratio", "collisions", "ate_unaligned_rms_m", "ate_unaligned_max_m")
    more = ("recovery_time_ratio", "path_length_m", "sim_seconds", "run_memory_mb", "peak_memory_mb")
    return {"done": is_done(result), LOAD: load_of(result)} | {name: result.get(name) for name in (*names, *more)}


def kind_of(result: dict[str, Any]) -> str:
    """Return the kind of a drawn place."""
    return str(result["world"]).partition("-")[0]


def load_of(result: dict[str, Any]) -> float | None:
    """Return the processor seconds per simulated second that a run took with everything, the simulator too, until it was judged."""
    spent, seconds = result.get("run_cpu_seconds"), result.get("sim_seconds")
    return float(spent) / float(seconds) if spent and seconds else None


def is_done(result: dict[str, Any]) -> bool:
    """Say whether a run was finished without a collision and with the floor in its map."""
    return is_good(result) and result.get("reachable_coverage_ratio") is not None


def bars(fresh: dict[str, Any]) -> dict[str, bool]:
    """Return which bars the runs on fresh places meet."""

    def at_most(name: str, bar: float) -> bool:
        value = fresh.get(name)
        return value is not None and value <= bar

    return {
        "done": fresh["done"] >= DONE_LEAST * fresh["runs"],
        "collisions": fresh["collisions"] == 0,
        "start_rms_m_median": at_most("start_rms_m_median", RMS_MEDIAN),
        "start_rms_m_95": at_most("start_rms_m_95", RMS_95),
        "recovery_time_ratio": at_most("recovery_time_ratio", RECOVERY_MOST),
    }


def table(fields: dict[str, Any]) -> list[str]:
    """Return the rows of the sets of places side by side, robot by robot, as lines of text."""
    groups = [name.removesuffix(".runs") for name in fields if name.endswith(".runs")]
    head = f"{'places, robot':28s}" + "".join(f"{name:>20s}" for name in ROW)
    lines = [head]
    for group in groups:
        cells = [fields.get(f"{group}.{name}") for name in ROW]
        lines.append(
            f"{group:28s}" + "".join(f"{_told(cell):>20s}" for cell in cells) + f"  {fields[f'{group}.not_done']}"
        )
    return lines


def _told(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
