"""Every fault of driving and scanning that the simulator knows, each in an exploration of its own, held against limits that are stated here.

The world is `two_rooms`; with `diff` an exploration without faults takes about a minute, so the faults fall into the drive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.exploration_run import read_exploration
from ambler.evaluation.fault_limits import FaultLimits, FaultOutcome, broken_limits, top_speed_while_standing
from ambler.studies.demo_process import demo_line, run_demo
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

WORLD = "two_rooms"
TIME_LIMIT = 240.0
MOST = 1.0


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One fault, written as in `sim.faults`, for one robot, and what must hold."""

    name: str
    fault: str
    robot: str
    limits: FaultLimits


def fault_cases() -> tuple[FaultCase, ...]:
    """Return every case; a name stands once per robot."""
    return (*_world_cases(), *_scanner_cases(), *_motion_cases())


def _motion_cases() -> list[FaultCase]:
    """Wheels that slip and stamps that lie cost accuracy, nothing else."""
    slip = FaultLimits(coverage=(0.98, MOST), ate_rms_max=0.10)
    late = FaultLimits(coverage=(0.95, MOST), ate_rms_max=0.25)
    return [
        *(FaultCase("wheel_slip", "wheel_slip:4:20", robot, slip) for robot in ("diff", "amr_omni")),
        *(FaultCase("delayed_stamps", "delayed_stamps@all:4:25", robot, late) for robot in ("diff", "amr_omni")),
    ]


def _scanner_cases() -> list[FaultCase]:
    """A scanner that is silent or stuck stops the robot at once; it goes on afterwards, or gives up with a name."""

    def limits(begin: float, end: float, *says: str) -> FaultLimits:
        return FaultLimits(coverage=(0.97, MOST), ate_rms_max=0.10, stands=(begin, end), says=says)

    lasting = FaultLimits(("stuck",), stands=(15.0, math.inf), says=("STALE_POINTS",))
    return [
        FaultCase("scanner_dropout", "scanner_dropout:15:19", "diff", limits(15.0, 19.0, "STALE_POINTS")),
        FaultCase(
            "one_of_three_scanners", "scanner_dropout@rear_left:15:19", "amr_omni", limits(15.0, 19.0, "rear_left")
        ),
        FaultCase("scanner_dead", "scanner_dropout:15", "diff", lasting),
        FaultCase("one_of_three_dead", "scanner_dropout@rear_left:15", "amr_omni", lasting),
        FaultCase("scanner_stuck", "scanner_stuck:15:19", "diff", limits(15.0, 19.0, "SCANNER_STUCK")),
        FaultCase("scanner_stuck", "scanner_stuck@rear_left:15:19", "amr_omni", limits(15.0, 19.0, "SCANNER_STUCK")),
    ]


def _world_cases() -> list[FaultCase]:
    """People, a door, and panes of glass: nothing is touched, what cannot be reached is left out, and a robot shut out says so."""
    shut_out = FaultLimits(("return_failed",), coverage=(0.97, MOST), says=("RETURN_FAILED",))
    return [
        FaultCase("people", "people", "diff", FaultLimits(coverage=(0.95, MOST))),
        FaultCase("people", "people", "amr_omni", FaultLimits(coverage=(0.85, MOST))),
        *(FaultCase("door_shut", "door:1", r, FaultLimits(coverage=(0.5, 0.8))) for r in ("diff", "amr_omni")),
        FaultCase("door_shuts_behind", "door:30", "diff", shut_out),
        FaultCase(
            "door_opens_again", "door:30:75", "diff", FaultLimits(coverage=(0.97, MOST), says=("the way home is shut",))
        ),
        *(
            FaultCase("glass", "glass", f"{r}+ultrasonic", FaultLimits(coverage=(0.95, MOST)))
            for r in ("diff", "amr_omni")
        ),
    ]


@dataclass(frozen=True, slots=True)
class FaultRun:
    """One run of a case."""

    case: FaultCase
    seed: int
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.case.name}-{self.case.robot}-{self.seed}"


def fault_study(runs: Sequence[FaultRun]) -> Study[FaultRun]:
    """Return the study of these runs."""
    return Study("faults", runs, run_case, demo_line)


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<case>.<robot>.<what>`: how the runs ended, collisions of all together, worst values, what was broken."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        groups.setdefault(f"{result['case']}.{result['robot']}", []).append(result)
    fields: dict[str, Any] = {
        "runs": len(results),
        "passed": sum(not r["broken"] for r in results),
        "collisions": sum(r.get("collisions") or 0 for r in results),
    }
    for name, members in groups.items():
        fields[f"{name}.fault"] = members[0]["fault"]
        fields[f"{name}.limits"] = members[0]["limits"]
        fields[f"{name}.ended"] = ", ".join(sorted({m["ended"] for m in members}))
        fields[f"{name}.collisions"] = sum(m.get("collisions") or 0 for m in members)
        for what, worst in (("coverage_ratio", min), ("ate_rms_m", max), ("top_speed", max)):
            values = [m[what] for m in members if m.get(what) is not None]
            if values:
                fields[f"{name}.{what}_worst"] = worst(values)
        fields[f"{name}.broken"] = "; ".join(f"seed {m['seed']}: {b}" for m in members for b in m["broken"])
    return fields


def run_case(run: FaultRun, folder: Path) -> dict[str, Any]:
    """Explore under the fault, and hold the outcome against the limits: `broken` says what was broken."""
    case = run.case
    options = ("--fault", case.fault, "--time-limit", str(TIME_LIMIT))
    result = run_demo(folder, WORLD, case.robot, run.seed, options, run.settings)
    top_speed, log = None, ""
    if "recording" in result:
        recording = Path(result["recording"])
        log = recording.with_name("log.jsonl").read_text(encoding="utf-8")
        if case.limits.stands is not None:
            top_speed = top_speed_while_standing(read_exploration(recording), case.limits.stands)
    outcome = FaultOutcome(
        result["ended"], result.get("collisions"), result.get("coverage_ratio"), result.get("ate_rms_m"), top_speed, log
    )
    return {**result, "top_speed": top_speed, "broken": list(broken_limits(case.limits, outcome))}


def told(run: FaultRun, result: dict[str, Any]) -> dict[str, Any]:
    """Return a result with what its case says; one that crashed broke every limit."""
    case = run.case
    said = {"case": case.name, "fault": case.fault, "robot": case.robot, "limits": str(case.limits)}
    return {"broken": [result.get("why", "crashed")], **result, **said}
