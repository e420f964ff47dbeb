"""Campaigns of robots that do not know where they are: relocalization at random places, and kidnappings."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import RobotConfig, robot_config
from ambler.apps.robot import MapGrid
from ambler.evaluation.proportions import wilson_interval
from ambler.sim.robots import robot_named
from ambler.studies.localization_study import drawn_map
from ambler.studies.lost_robot import kidnap, pairs_far_apart, relocalize
from ambler.studies.random_drives import DRIVE_TIME, DriveCase, RandomDrive, record_random_drive
from ambler.studies.study import Study
from ambler.studies.study_settings import StudySettings

TIME_LIMIT = 5.0
RELOCALIZED_LEAST = 0.97
NOTICE_LIMIT, RECOVERY_LIMIT, RECOVERED_LEAST = 2.0, 10.0, 0.95


@dataclass(frozen=True, slots=True)
class LostCase:
    """A robot switched on in `drive`, whose map has cells of `resolution` metres."""

    drive: DriveCase
    resolution: float

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.drive.world).stem}-{self.drive.robot}-{self.drive.seed}-{self.drive.number}"


@dataclass(frozen=True, slots=True)
class KidnapCase:
    """A robot carried from one drive to where another begins: number `number` of its world."""

    before: DriveCase
    after: DriveCase
    number: int
    resolution: float

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.before.world).stem}-{self.before.robot}-{self.before.seed}-{self.number}"


def lost_config(robot: str, settings: StudySettings) -> RobotConfig:
    """Return what a robot with a known map is told; raises BadInputError."""
    config = robot_config(robot_named(robot).model, settings.profile, has_map=True)
    config.check_localizer()
    return config


def relocalization_study(
    worlds: Sequence[str], robot: str, runs: int, seed: int, resolution: float, settings: StudySettings
) -> Study[LostCase]:
    """Return the study of `runs` starts in all worlds together."""
    cases = [
        LostCase(DriveCase(world, robot, k, seed, settings), resolution)
        for world, count in _shared_out(worlds, runs)
        for k in range(count)
    ]
    return Study("relocalization", cases, run_relocalization, lambda r: f"{_seconds(r['found'])}, {_ending(r)}")


def kidnapping_study(
    worlds: Sequence[str], robot: str, runs: int, drives: int, seed: int, resolution: float, settings: StudySettings
) -> Study[KidnapCase]:
    """Return the study of `runs` kidnappings in all worlds together, between `drives` drives of each."""
    cases = []
    for world, count in _shared_out(worlds, runs):
        known = [DriveCase(world, robot, k, seed, settings) for k in range(drives)]
        pairs = pairs_far_apart(known, count, np.random.default_rng([seed, *world.encode()]))
        cases += [KidnapCase(before, after, k, resolution) for k, (before, after) in enumerate(pairs)]
    return Study(
        "kidnapping",
        cases,
        run_kidnapping,
        lambda r: f"noticed {_seconds(r['noticed'])}, found {_seconds(r['found'])}, {_ending(r)}",
    )


def run_relocalization(case: LostCase, folder: Path) -> dict[str, Any]:
    """Record the drive and switch the robot on in it."""
    drive, robot = case.drive, case.drive.robot
    config = lost_config(robot, drive.settings)
    found = relocalize(_recorded(drive, folder), robot, config, _map(drive.world, robot, case.resolution), DRIVE_TIME)
    shutil.rmtree(folder / str(drive.number))
    return {"world": drive.world, **asdict(found)}


def run_kidnapping(case: KidnapCase, folder: Path) -> dict[str, Any]:
    """Record both drives and carry the robot from one to the other."""
    robot, world = case.before.robot, case.before.world
    before, after = (_recorded(drive, folder) for drive in (case.before, case.after))
    config = lost_config(robot, case.before.settings)
    result = kidnap(before, after, robot, config, _map(world, robot, case.resolution))
    for drive in (before, after):
        shutil.rmtree(drive.recording)
    return {"world": world, **asdict(result)}


def is_relocalized(result: dict[str, Any]) -> bool:
    """Say whether a robot knew its place in time and told no wrong one."""
    found = result.get("found")
    return found is not None and found <= TIME_LIMIT and result["wrong"] == 0


def is_recovered(result: dict[str, Any]) -> bool:
    """Say whether a robot noticed in time that it was carried away, and was right again in time."""
    noticed, found = result.get("noticed"), result.get("found")
    return noticed is not None and noticed <= NOTICE_LIMIT and found is not None and found <= RECOVERY_LIMIT


def summarize_relocalization(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields of all, and `<world>.<what>`."""
    wrong = sum(bool(r.get("wrong")) for r in results)
    fields: dict[str, Any] = {
        **_success(sum(map(is_relocalized, results)), len(results)),
        "wrong": wrong,
        "wrong_ratio_at_most": wilson_interval(wrong, len(results))[1],
        "ambiguous": sum(r.get("found") is None and not r.get("wrong") for r in results),
        **_times(r.get("found") for r in results),
    }
    for world in dict.fromkeys(_world(r) for r in results):
        here = [r for r in results if _world(r) == world]
        fields[f"{world}.runs"] = len(here)
        fields[f"{world}.success_ratio"] = sum(map(is_relocalized, here)) / len(here)
    return fields


def summarize_kidnapping(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields of all."""
    noticed = [r["noticed"] for r in results if r.get("noticed") is not None]
    found = [r["found"] for r in results if r.get("found") is not None]
    return {
        **_success(sum(map(is_recovered, results)), len(results)),
        "noticed": len(noticed),
        "noticed_in_time": sum(t <= NOTICE_LIMIT for t in noticed),
        "recovered_in_time": sum(t <= RECOVERY_LIMIT for t in found),
        "wrong": sum(bool(r.get("wrong")) for r in results),
        **_times(noticed, "noticed_"),
        **_times(found, "recovered_"),
    }


def _success(count: int, runs: int) -> dict[str, Any]:
    low, high = wilson_interval(count, runs)
    return {
        "runs": runs,
        "success_ratio": count / runs,
        "success_interval_low": low,
        "success_interval_high": high,
    }


def _times(values: Iterable[float | None], prefix: str = "") -> dict[str, float | None]:
    """Return median and 95th percentile of the known times in seconds; None without any."""
    times = [value for value in values if value is not None]
    median, p95 = np.percentile(times, [50, 95]).tolist() if times else (None, None)
    return {f"{prefix}time_median_s": median, f"{prefix}time_p95_s": p95}


def _shared_out(worlds: Sequence[str], runs: int) -> list[tuple[str, int]]:
    return [(world, runs // len(worlds) + (k < runs % len(worlds))) for k, world in enumerate(worlds)]


def _recorded(drive: DriveCase, folder: Path) -> RandomDrive:
    place = folder / str(drive.number)
    shutil.rmtree(place, ignore_errors=True)
    return record_random_drive(drive, place)


@functools.lru_cache(maxsize=4)
def _map(world: str, robot: str, resolution: float) -> MapGrid:
    return drawn_map(world, robot, resolution)


def _world(result: dict[str, Any]) -> str:
    return str(result.get("world", "crashed"))


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.1f} s"


def _ending(result: dict[str, Any]) -> str:
    return f"{result['wrong']} wrong poses, {result['last_state']}"
