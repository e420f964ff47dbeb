"""2-D SLAM on dense logs of drawn campuses, against the truth: errors, false closures, bend."""

from __future__ import annotations

import shutil
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import recorded_config
from ambler.evaluation.loop_errors import FALSE_FROM, loop_errors
from ambler.evaluation.proportions import wilson_interval
from ambler.evaluation.trajectory import trajectory_error
from ambler.recordings.log_scans import LogScanConfig
from ambler.recordings.scan_recording import open_recording
from ambler.slam2d.offline import OfflineResult, run_offline
from ambler.studies.campus_log import SCANNERS, CampusLog, record_campus
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

ATE_MEDIAN, BEND_MOST = 0.1, 0.3  # metres; bars of generated campuses


@dataclass(frozen=True, slots=True)
class CampusCase:
    """A drawn campus and a drive through it; `scanner` None: drawn, too. `keeps_log` keeps the recording."""

    seed: int
    scanner: str | None = None
    keeps_log: bool = False
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"campus-{self.seed}" + (f"-{self.scanner}" if self.scanner else "")


def campus_study(cases: Sequence[CampusCase]) -> Study[CampusCase]:
    """Return the study of these drives."""
    return Study("campus", cases, run_case, _line)


def run_case(case: CampusCase, folder: Path) -> dict[str, Any]:
    """Draw, drive, map, compare."""
    shutil.rmtree(folder / "recording", ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    log = record_campus(case.seed, folder, case.scanner)
    config = recorded_config(case.settings.profile).slam2d.slam
    scans = open_recording(log.recording, config=LogScanConfig(range_max=SCANNERS[log.scanner].range_max))
    stamps_ns = np.array([scan.stamp_ns for scan in scans.scans], np.int64)
    cpu = time.process_time()
    result = run_offline(scans.scans, config)
    cpu_seconds = time.process_time() - cpu
    fields = judged(log, stamps_ns, result)
    if not case.keeps_log:
        shutil.rmtree(log.recording)
    return {
        "drawn_scanner": log.scanner,
        "path_length_m": log.motion.length,
        "longest_loop_m": max(log.motion.loops, default=None),
        "loops_driven": len(log.motion.loops),
        "scans": len(stamps_ns),
        "slam_cpu_seconds": cpu_seconds,
        "scans_per_second_hz": len(stamps_ns) / cpu_seconds,
        **fields,
    }


def judged(log: CampusLog, stamps_ns: np.ndarray[Any, np.dtype[np.int64]], result: OfflineResult) -> dict[str, Any]:
    """Compare a map's poses and closures with the truth.

    `ate_rms_m` and `bend_m` (the largest error, which is how far the map is bent anywhere) after the best rigid alignment of the whole way;
    `start_rms_m` and `start_max_m` in the frame of the start.
    """
    error = trajectory_error(stamps_ns, result.poses, stamps_ns, log.true_poses(stamps_ns))
    ends = [np.array([getattr(loop, name) for loop in result.loops], np.int64) for name in ("from_ns", "to_ns")]
    away = loop_errors([loop.from_from_to for loop in result.loops], *(log.true_poses(end) for end in ends))
    return {
        "ate_rms_m": error.ate_rms_m,
        "bend_m": error.ate_max_m,
        "start_rms_m": error.unaligned_rms_m,
        "start_max_m": float(error.offsets.max()),
        "yaw_rms_rad": error.yaw_rms_rad,
        "closures": len(away),
        "false_closures": sum(loop.is_false for loop in away),
        "worst_closure_m": max((loop.distance for loop in away), default=None),
        "worst_closure_rad": max((loop.angle for loop in away), default=None),
        "points_on_walls_ratio": result.points_on_walls_ratio,
    }


def is_good(result: dict[str, Any]) -> bool:
    """Say whether a map has no false closure and is nowhere bent by more than the bar."""
    return result.get("false_closures") == 0 and result.get("bend_m", float("inf")) <= BEND_MOST


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields with medians, worst values, counts and intervals, and each run's own (`<label>.…`)."""
    good = sum(map(is_good, results))
    low, high = wilson_interval(good, len(results))
    fields: dict[str, Any] = {
        "runs": len(results),
        "maps_good": good,
        "maps_good_ratio_low_95": low,
        "maps_good_ratio_high_95": high,
        "false_closures": sum(r.get("false_closures", 0) for r in results),
        "false_closure_from_m": FALSE_FROM[0],
        "false_closure_from_rad": FALSE_FROM[1],
    }
    for what, worst in (
        ("ate_rms_m", max),
        ("bend_m", max),
        ("start_rms_m", max),
        ("start_max_m", max),
        ("scans_per_second_hz", min),
        ("path_length_m", max),
        ("longest_loop_m", max),
    ):
        values = [r[what] for r in results if r.get(what) is not None]
        if values:
            fields |= {f"{what}_median": statistics.median(values), f"{what}_worst": worst(values)}
    for r in results:
        for what in (
            "drawn_scanner",
            "path_length_m",
            "longest_loop_m",
            "ate_rms_m",
            "bend_m",
            "start_max_m",
            "closures",
            "false_closures",
        ):
            fields[f"{r['label']}.{what}"] = r.get(what)
    ate = fields.get("ate_rms_m_median")
    fields["is_met"] = good == len(results) and ate is not None and ate <= ATE_MEDIAN
    return fields


def _line(result: dict[str, Any]) -> str:
    return (
        f"{result['path_length_m']:.0f} m, {result['drawn_scanner']}: ATE {result['ate_rms_m']:.3f} m, bent by {result['bend_m']:.3f} m,"
        f" {result['false_closures']} of {result['closures']} closures false, {result['scans_per_second_hz']:.0f} scans/s"
    )
