"""The campaign of localization in made maps: places drawn for it, each mapped on one day, driven and started in on another.

On the other day a fifth of the furniture stands elsewhere (`sim.generator.another_day`) and people walk about.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from ambler.core.errors import BadInputError
from ambler.studies.lost_robot_study import RELOCALIZED_LEAST, summarize_relocalization
from ambler.studies.made_drives import (
    ERROR_MOST,
    MADE_METHODS,
    NEES_LEAST,
    NEES_MOST,
    MadeDriveCase,
    MadeMap,
    drive_study,
    nees,
    rms,
)
from ambler.studies.made_lost import MadeLostCase, made_lost_study
from ambler.studies.made_map import MapCase, map_study
from ambler.studies.random_drives import DriveCase
from ambler.studies.study import CRASHED, Study
from ambler.studies.study_settings import StudySettings

Result = dict[str, Any]
Conduct = Callable[[Study[Any]], list[Result]]
PEOPLE = 6
DAY = 1
DRIVES, STARTS = 4, 40  # per place


def conduct_made_maps(
    worlds: Sequence[str],
    seeds: Sequence[int],
    robot: str,
    drives: int,
    starts: int,
    settings: StudySettings,
    conduct: Conduct,
) -> Result:
    """Map each world, drive and start in it on another day, and return the flat fields of all. `conduct` runs a study; raises BadInputError
    when a map could not be made."""
    maps = conduct(map_study([MapCase(w, robot, seed, settings) for w, seed in zip(worlds, seeds, strict=True)]))
    for result in maps:
        if result.get("ended") == CRASHED:
            raise BadInputError(f"the map of {result['label']} could not be made: {result.get('why')}")
    made = [MadeMap(r["map_file"], r["keyframes_file"], r["truth_file"]) for r in maps]
    days = [f"{world}-day{DAY}" for world in worlds]
    drive_cases = [
        MadeDriveCase(day, robot, k, seed, PEOPLE, known, settings)
        for day, seed, known in zip(days, seeds, made, strict=True)
        for k in range(drives)
    ]
    driven = conduct(drive_study(drive_cases))
    lost_cases = [
        MadeLostCase(DriveCase(day, robot, k, seed, settings), known, PEOPLE)
        for day, seed, known in zip(days, seeds, made, strict=True)
        for k in range(starts)
    ]
    started = conduct(made_lost_study(lost_cases)) if lost_cases else []
    return summarize(maps, driven, started)


def summarize(maps: Sequence[Result], driven: Sequence[Result], started: Sequence[Result]) -> Result:
    """Return the flat fields: `<method>.<what>` of all drives, `<world>.<what>` of each place, `relocalization.<what>`, `bars.<what>`."""
    whole = [r for r in driven if r.get("ended") != CRASHED]
    if not whole:
        raise BadInputError(f"every drive crashed: {driven[0].get('why') if driven else 'there is none'}")
    fields: Result = {"places": len(maps), "drives": len(driven), "crashed": len(driven) - len(whole)}
    for method in (m.name for m in MADE_METHODS):
        fields |= {f"{method}.{name}": value for name, value in errors_of_drives(whole, method).items()}
    for result in maps:
        world = str(result["world"])
        names = ("ate_rms_m", "ate_unaligned_rms_m", "bend_m", "bend_rad", "keyframes", "path_length_m")
        fields |= {f"{world}.{name}": result[name] for name in names}
        here = [r for r in whole if str(r["world"]).startswith(f"{world}-day")]
        for method in (m.name for m in MADE_METHODS) if here else ():
            told = errors_of_drives(here, method)
            fields |= {f"{world}.{method}.{name}": value for name, value in told.items()}
    if started:
        # Who stands where the map knows nothing cannot be told where; it may still not be told a wrong place.
        mapped = [r for r in started if r.get("is_mapped", True)]
        lost = summarize_relocalization(mapped or started)
        fields |= {f"relocalization.{name}": value for name, value in lost.items()}
        everywhere = summarize_relocalization(started)
        lost["wrong"] = fields["relocalization.wrong"] = everywhere["wrong"]
        fields["relocalization.wrong_ratio_at_most"] = everywhere["wrong_ratio_at_most"]
        fields["relocalization.unmapped"] = len(started) - len(mapped)
        fields["relocalization.success_ratio_with_unmapped"] = everywhere["success_ratio"]
        fields["relocalization.crashed"] = sum(r.get("ended") == CRASHED for r in started)
        fields["bars.relocalization"] = bool(lost["success_ratio"] >= RELOCALIZED_LEAST and lost["wrong"] == 0)
    for method in (m.name for m in MADE_METHODS):
        fields[f"bars.{method}.error"] = fields["crashed"] == 0 and fields[f"{method}.error_rms_m"] <= ERROR_MOST
        for how in ("", "static."):
            mean = fields[f"{method}.{how}nees_mean"]
            fields[f"bars.{method}.{how}nees"] = bool(NEES_LEAST <= mean <= NEES_MOST)
    return fields


def errors_of_drives(driven: Sequence[Result], method: str) -> Result:
    """Return the errors of some drives together, moving without, at rest with `static.`; and of the worst drive."""
    sums = {name: math.fsum(float(r[name]) for r in driven) for name in driven[0] if name.startswith(f"{method}.")}
    fields: Result = {}
    for how, prefix in (("moving", ""), ("rest", "static.")):
        each = [rms(r, method, how) for r in driven]
        fields |= {
            f"{prefix}error_rms_m": rms(sums, method, how),
            f"{prefix}error_rms_worst_drive_m": max((value for value in each if not math.isnan(value)), default=None),
            f"{prefix}error_max_m": max(float(r[f"{method}.{how}_error_max_m"]) for r in driven),
            f"{prefix}nees_mean": nees(sums, method, how),
            f"{prefix}poses": int(sums[f"{method}.{how}_poses"]),
        }
    return fields
