"""Scanners calibrated from simulated drives, against the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import recorded_config
from ambler.core.robot import DriveKind
from ambler.evaluation.calibration import CalibrationDrive, evaluate_drive, simulate_drive
from ambler.evaluation.robot_calibration import simulate_robot_drive
from ambler.sim.robots import robot_named
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

BARS = {"position_error_mm": 5.0, "yaw_error_deg": 0.1, "offset_error_ms": 2.0}


@dataclass(frozen=True, slots=True)
class CalibrationCase:
    """One drive of so many seconds; `robot`: a robot's name, or that of a kind of drive for a base with three scanners anywhere."""

    robot: str
    seed: int
    seconds: float
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.robot}-{self.seed}"


def calibration_study(cases: Sequence[CalibrationCase]) -> Study[CalibrationCase]:
    """Return the study of these drives."""
    return Study("calibration", cases, run_case, _line)


def run_case(case: CalibrationCase, folder: Path) -> dict[str, Any]:
    """Drive and calibrate."""
    config = recorded_config(case.settings.profile).calibration
    errors = evaluate_drive(drive_of(case), config)
    return {
        "position_error_mm": 1e3 * errors.position,
        "yaw_error_deg": math.degrees(errors.yaw),
        "offset_error_ms": 1e3 * errors.offset,
        "nees": float(errors.nees),
        "pairs": errors.result.pairs,
        "residual_rms_mm": 1e3 * errors.result.residual_rms,
    }


def is_within(result: dict[str, Any]) -> bool:
    """Say whether every error is within its bar."""
    return all(result.get(name, math.inf) <= bar for name, bar in BARS.items())


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return worst and median errors, and how many drives are within the bars; None where a drive crashed."""
    known = [r for r in results if set(BARS) <= r.keys()]
    fields: dict[str, Any] = {"runs": len(results), "within_bars": sum(map(is_within, results))}
    for of, what in ((max, "max"), (np.median, "median")):
        for name in BARS:
            kind, unit = name.rsplit("_", 1)
            fields[f"{kind}_{what}_{unit}"] = float(of([r[name] for r in known])) if known else None
    fields["nees_mean"] = float(np.mean([r["nees"] for r in known])) if known else None
    return fields


def drive_of(case: CalibrationCase) -> CalibrationDrive:
    """Simulate the drive of a case."""
    if case.robot in {kind.value for kind in DriveKind}:
        return simulate_drive(case.seed, DriveKind(case.robot), case.seconds)
    return simulate_robot_drive(robot_named(case.robot), case.seed, case.seconds)


def _line(result: dict[str, Any]) -> str:
    return (
        f"position {result['position_error_mm']:.2f} mm, yaw {result['yaw_error_deg']:.3f}°, clock {result['offset_error_ms']:.2f} ms;"
        f" NEES {result['nees']:.2f}, {result['pairs']} pairs of scans, residual {result['residual_rms_mm']:.1f} mm"
    )
