"""The reports of recorded drives: what SLAM made of one, or where it was in a known map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.recorded_localization import RecordedLocalization
from ambler.core.grid import GridSpec
from ambler.evaluation.curves import draw_errors, draw_speed, worst_mark
from ambler.evaluation.pictures import draw_map_with_trajectory
from ambler.evaluation.relations import RelationErrors
from ambler.evaluation.report import Picture, Table, write_report
from ambler.evaluation.results import machine_class
from ambler.slam2d.offline import OfflineResult


def write_mapping_report(
    folder: Path,
    log: Path,
    stamps: Sequence[float],
    result: OfflineResult,
    fields: Mapping[str, Any],
    notes: Sequence[str],
    errors: RelationErrors | None = None,
) -> Path:
    """Draw and write what SLAM made of a recording: `stamps` are the seconds of its poses, `notes` what was told while it was read,
    `errors` those of given relations."""
    stamps_ns = np.rint(1e9 * np.asarray(stamps)).astype(np.int64)
    begin_ns = int(stamps_ns.min())
    marks, curves = [], []
    if errors is not None:
        order = np.argsort(errors.to_us, kind="stable")
        at, sizes = 1000 * errors.to_us[order], errors.translation[order]
        poses = result.poses[np.abs(stamps_ns - at[np.argmax(sizes)]).argmin()]
        marks = [worst_mark(at, sizes, np.tile(poses, (len(at), 1)), begin_ns, "error of a relation")]
        path = draw_errors(folder / "relations.png", at, sizes, begin_ns, "error of a relation")
        curves = [Picture("Errors of the relations, at the time of their second pose", path)]
    path = folder / "map.png"
    draw_map_with_trajectory(path, result.spec, result.occupancy, {"trajectory": result.poses}, marks=marks)
    pictures = [Picture("The map as it was built, with the trajectory", path), *curves]
    pictures += _speed(folder, stamps_ns, result.poses)
    shown = {"ended": "mapped", "text": _cuts(notes), **fields, "recording": str(log)}
    return _write(folder, f"{log.name}: mapped", shown, pictures, notes, is_good=True)


def write_localization_report(
    folder: Path,
    recording: Path,
    known: tuple[GridSpec, NDArray[np.int8]],
    result: RecordedLocalization,
    fields: Mapping[str, Any],
    notes: Sequence[str],
) -> Path:
    """Draw and write where a recorded drive was in a known map; `notes` as for mapping."""
    has_poses = len(result.poses) > 0
    errors = (result.stamps_ns, result.corrections)
    marks = [worst_mark(*errors, result.poses, result.first_ns, "correction")] if has_poses else []
    path = folder / "map.png"
    draw_map_with_trajectory(path, *known, {"localized": result.poses}, marks=marks)
    pictures = [Picture("The known map with the drive, and where the map corrected the odometry most", path)]
    if has_poses:
        path = folder / "correction.png"
        draw_errors(path, *errors, result.first_ns, "correction")
        pictures.append(Picture("How far each pose lies from what the odometry said", path))
    pictures += _speed(folder, result.stamps_ns, result.poses)
    ended = "found" if result.is_found_at_the_end else "not localized"
    lost = "" if result.is_found_at_the_end else "no place was believed at the end of the recording"
    told = "; ".join(text for text in (lost, _cuts(notes)) if text)
    shown = {"ended": ended, "text": told, **fields, "recording": str(recording)}
    title = f"{recording.name}: localized in a known map"
    return _write(folder, title, shown, pictures, notes, is_good=result.is_found_at_the_end)


def _write(
    folder: Path,
    title: str,
    shown: Mapping[str, Any],
    pictures: Sequence[Picture],
    notes: Sequence[str],
    *,
    is_good: bool,
) -> Path:
    tables = [Table("What was read", ("from the recording",), tuple((note,) for note in notes))] if notes else []
    return write_report(folder, title, shown, pictures, tables, subtitle=machine_class(), passed={"ended": is_good})


def _speed(folder: Path, stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> list[Picture]:
    if len(poses) < 2:
        return []
    path = draw_speed(folder / "speed.png", stamps_ns, poses, int(stamps_ns[0]))
    return [Picture("Speed of the base, from its poses", path)]


def _cuts(notes: Sequence[str]) -> str:
    """What must be seen first: that the recording has no end."""
    return "; ".join(note for note in notes if "cut off" in note)
