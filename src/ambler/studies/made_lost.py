"""Robots that are switched on in a place of which they have a map that SLAM made on another day."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ambler.apps.scene import with_map_bend
from ambler.sim.world_file import load_world
from ambler.studies.lost_robot import relocalize
from ambler.studies.lost_robot_study import lost_config
from ambler.studies.made_drives import MadeMap, people_fault
from ambler.studies.made_map import is_mapped, made_truth
from ambler.studies.random_drives import DRIVE_TIME, DriveCase, record_random_drive, start_of
from ambler.studies.study import Study
from ambler.wire.map_files import load_map


@dataclass(frozen=True, slots=True)
class MadeLostCase:
    """A robot switched on in `drive`, on a later day than that on which its map was made; `people` more than the plan has walk about."""

    drive: DriveCase
    made: MadeMap
    people: int = 0

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.drive.world).stem}-{self.drive.robot}-{self.drive.number}"


def made_lost_study(cases: Sequence[MadeLostCase]) -> Study[MadeLostCase]:
    """Return the study of these starts; results as those of `lost_robot_study.relocalization_study`."""
    return Study("made_lost", cases, run_lost, _line)


def run_lost(case: MadeLostCase, folder: Path) -> dict[str, Any]:
    """Record the drive and switch the robot on in it. `is_mapped`: whether it stands where the map knows anything."""
    recording = folder / "drive"
    shutil.rmtree(recording, ignore_errors=True)
    drive, made, robot = case.drive, case.made, case.drive.robot
    world = load_world(drive.world)
    start = world.start @ start_of(drive)
    people = people_fault(case.people, world, drive.seed + drive.number, start)
    settings = replace(drive.settings, faults=(*drive.settings.faults, *people))
    recorded = record_random_drive(replace(drive, settings=settings), recording)
    recorded = replace(recorded, truth=made_truth(made.keyframes_file, made.truth_file))
    config = with_map_bend(lost_config(robot, drive.settings), Path(made.map_file))
    spec, cells = load_map(Path(made.map_file))
    found = relocalize(recorded, robot, config, (spec, cells), DRIVE_TIME)
    shutil.rmtree(recording)
    return {"world": drive.world, "is_mapped": is_mapped(cells, spec, recorded.truth.pose(start)), **asdict(found)}


def _line(result: dict[str, Any]) -> str:
    found = "never" if result["found"] is None else f"{result['found']:.1f} s"
    return f"{found}, {result['wrong']} wrong poses, {result['last_state']}"
