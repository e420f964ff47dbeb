"""What docking is measured by: dockings from given and from random starts, with faults, and series of pictures of a dock.

Every docking is a run of the whole robot in simulation with full noise.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import robot_config
from ambler.apps.docks import dock_of_world, docks_of_world
from ambler.apps.judgement import NOT_RECORDED, judge
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import BadInputError
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.detection import DockObservation
from ambler.docking.marker_dock import MarkerDockDetector
from ambler.evaluation.docking import DetectionErrors, DockingOutcome
from ambler.nodes.steps import DockStep, TeachStep
from ambler.perception.fiducials import FiducialDetector
from ambler.runtime.tasks import DOCK_FAILURES
from ambler.sim.dock_body import marker_poses
from ambler.sim.imperfections import draw_imperfections
from ambler.sim.robots import robot_named
from ambler.sim.sensors import named_generator
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.truth import reachable_cells
from ambler.sim.world_file import load_world
from ambler.studies.docking_scans import measure_scan_detections
from ambler.studies.study import CRASHED, Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

WORLD, ROBOT, NAME = "dock_hall", "amr_omni", "charger_1"
EXACT, DRAWN = "exact", "drawn"
TAUGHT = "taught"  # the kind of a random start of a robot that was taught the dock
LESSON_SEED = 500_000_003  # the noise of the lesson is another one than that of the docking
PARTS = ("sights", "approach", "random", "faults")
ROOM = 0.85  # metres from a random start to anything
APPROACHES: dict[float, SE2] = {
    1.0: SE2(-2.0, 0.2, 0.3),
    3.0: SE2(-3.95, 0.6, -0.4),
    9.0: SE2(-9.95, 0.7, 0.5),
    12.5: SE2(-13.4, 1.2, -0.6),
    25.0: SE2(-25.9, -1.0, 0.4),
}
"""Starts in the dock's frame by the metres of path to the staging pose 1 m before the dock, as in table 1 of source 002."""
FAULTS = ("light", "shadow", "blur", "occlusion", "marker_missing", "no_power")
TIME_LIMIT = 180.0
PICTURES = 100
CAMERA_TO_PANEL = 0.37  # metres that the camera of a docked robot is before the markers


@dataclass(frozen=True, slots=True)
class DockingCase:
    """One docking: `start` in the dock's frame; `distance` is about the path to the staging pose. What is off (`imperfections`: "exact", nothing,
    or "drawn") follows from the seed; a robot that `is_taught` stood in the dock once before."""

    kind: str
    seed: int
    start: SE2
    distance: float
    world: str = WORLD
    name: str = NAME
    settings: StudySettings = DEFAULTS
    imperfections: str = EXACT
    is_taught: bool = False

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.world}-{self.name}-{self.kind}-{self.seed}"


def imperfect(cases: Sequence[DockingCase]) -> list[DockingCase]:
    """Return the cases as on a real site: every random start untaught and taught, the others taught."""
    out = []
    for case in cases:
        if case.kind == "random":
            out.append(replace(case, imperfections=DRAWN))
            case = replace(case, kind=TAUGHT)
        out.append(replace(case, imperfections=DRAWN, is_taught=True))
    return out


def random_cases(runs: int, seed: int, world_name: str = WORLD, name: str = NAME) -> list[DockingCase]:
    """Return starts anywhere in the world that the robot can stand in, with any heading."""
    world = load_world(world_name).from_start()
    rng = named_generator(seed, "docking starts")
    spec, is_clear = reachable_cells(world, ROOM, 0.1, 0.2)
    cells = np.argwhere(is_clear)
    map_from_dock = dock_of_world(world, name).world_from_dock
    staging = map_from_dock @ SE2(-1.0, 0.0, 0.0)
    cases = []
    for k in range(runs):
        iy, ix = cells[int(rng.integers(len(cells)))]
        x, y = spec.center_of(int(iy), int(ix))
        start = SE2(x, y, float(rng.uniform(-math.pi, math.pi)))
        distance = math.hypot(x - staging.x, y - staging.y)
        cases.append(DockingCase("random", seed + k, map_from_dock.inverse() @ start, distance, world_name, name))
    return cases


def approach_cases(seed: int) -> list[DockingCase]:
    """Return the five starts of the source."""
    return [DockingCase("approach", seed + k, start, d) for k, (d, start) in enumerate(APPROACHES.items())]


def fault_cases(runs: int, seed: int) -> list[DockingCase]:
    """Return `runs` dockings from near for every fault of the camera and the charger."""
    rng = named_generator(seed, "docking faults")
    out = []
    for fault in FAULTS:
        for k in range(runs):
            start = SE2(-2.0, float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5)))
            out.append(DockingCase(fault, seed + k, start, 1.0))
    return out


def parts_of(world: str, name: str, wanted: Sequence[str] = ()) -> tuple[str, ...]:
    """Return those `PARTS` that concern a dock, or those `wanted`; raises BadInputError for what it does not have."""
    is_standard = (world, name) == (WORLD, NAME)
    known = PARTS if is_standard else ("sights", "random")
    parts = tuple(wanted) or known
    if not set(parts) <= set(known):
        raise BadInputError(
            f"approaches and faults are those of {NAME} in {WORLD}; other docks have {', '.join(known)}"
        )
    if is_marked(world, name) and not is_standard and "sights" in parts:
        raise BadInputError(f"looks at markers are those at {NAME} in {WORLD}: choose --only random")
    return parts


def cases_of(
    parts: Sequence[str], runs: int, fault_runs: int, faults: Sequence[str], seed: int, world: str, name: str
) -> list[DockingCase]:
    """Return the dockings of these parts, from the seed on; raises BadInputError for unknown faults."""
    if unknown := set(faults) - set(FAULTS):
        raise BadInputError(f"no fault {min(unknown)!r}; there are {', '.join(FAULTS)}")
    cases = []
    if "approach" in parts:
        cases += approach_cases(seed)
    if "random" in parts:
        cases += random_cases(runs, seed, world, name)
    if "faults" in parts:
        cases += [case for case in fault_cases(fault_runs, seed) if case.kind in (faults or FAULTS)]
    return cases


def detections_of(seed: int, looks: int, world: str, name: str, settings: StudySettings) -> list[DetectionErrors]:
    """Measure how precisely a dock is seen, by the camera or by the scanners."""
    if is_marked(world, name):
        return measure_detections(seed, looks)
    scanners = robot_config(robot_named(ROBOT).model, settings.profile, has_map=True).scanners
    return measure_scan_detections(seed, looks, world, ROBOT, name, scanners)


def docking_study(cases: Sequence[DockingCase], settings: StudySettings = DEFAULTS) -> Study[DockingCase]:
    """Return the study of these dockings with these settings."""
    return Study("docking", [replace(case, settings=settings) for case in cases], run_case, docking_line)


def outcome_of(result: dict[str, Any]) -> DockingOutcome:
    """Return the outcome of a result; a docking whose process died has the code CRASHED."""
    known = {field.name for field in fields(DockingOutcome)}
    if result.get("ended") == CRASHED:
        return DockingOutcome(
            result["kind"],
            result["seed"],
            "CRASHED",
            result["why"],
            0,
            result["distance"],
            None,
            None,
            None,
            None,
            None,
            0,
        )
    return DockingOutcome(**{name: value for name, value in result.items() if name in known})


def docking_line(result: dict[str, Any]) -> str:
    """Say how a docking went."""
    outcome = outcome_of(result)
    error = "" if outcome.error is None else f" {1e3 * outcome.error:.2f} mm {outcome.error_yaw_deg:+.3f}°"
    approach = "" if outcome.approach_seconds is None else f" approach {outcome.approach_seconds:.1f} s"
    docking = "" if outcome.docking_seconds is None else f" docking {outcome.docking_seconds:.1f} s"
    return f"{outcome.code} in {outcome.attempts}{error}{approach}{docking}"


def is_good(outcome: DockingOutcome) -> bool:
    """Say whether a robot docked within two attempts, or failed under a fault with a name, without a collision."""
    is_fault = outcome.kind in FAULTS
    is_ended = (outcome.is_docked and outcome.attempts <= 2) or (is_fault and outcome.code in DOCK_FAILURES)
    return is_ended and outcome.collisions == 0


def run_case(case: DockingCase, folder: Path) -> dict[str, Any]:
    """Run one docking and judge it by its recording, which is deleted when the robot docked without a collision."""
    folder = folder / "run"
    shutil.rmtree(folder, ignore_errors=True)
    world = load_world(case.world)
    dock = dock_of_world(world.from_start(), case.name)
    off = draw_imperfections(case.seed, dock).beginning_at(case.start) if case.imperfections == DRAWN else None
    options = RunOptions(
        (DockStep(case.name),),
        case.world,
        ROBOT,
        case.seed,
        start=dock.world_from_dock @ case.start,
        port=None,
        faults=(case.kind,) if case.kind in FAULTS else (),
        imperfections=off,
    )
    options = case.settings.applied_to(options)
    told = {} if off is None else {f"off_{name}": value for name, value in off.told().items()}
    if case.is_taught:
        options, refusal = _teach(case, options, folder / "lesson")
        if refusal is not None:
            return {**_refused(case, refusal).to_dict(), **told}
    run = SimulatedRun(options, RunFolder(folder / "docking"))
    try:
        run.run(TIME_LIMIT)
        outcome = _outcome(case, run, judge(run).fields)
    finally:
        run.close()
    if outcome.is_docked and outcome.collisions == 0:
        shutil.rmtree(folder)
    return {**outcome.to_dict(), **told}


def _teach(case: DockingCase, options: RunOptions, folder: Path) -> tuple[RunOptions, str | None]:
    """Put the robot into the dock by hand and let it look; returns the options with what it learned, or why it did not."""
    docks = docks_of_world(load_world(case.world).from_start(), folder / "docks.yaml")
    folder.mkdir(parents=True, exist_ok=True)
    docks.save()
    options = replace(options, docks_file=folder / "docks.yaml")
    assert options.imperfections is not None
    lesson = replace(
        options,
        steps=(TeachStep(case.name),),
        seed=case.seed + LESSON_SEED,
        start=None,
        starts_docked=case.name,
        faults=(),
        imperfections=options.imperfections.beginning_at(SE2()),
    )
    run = SimulatedRun(lesson, RunFolder(folder))
    try:
        run.run(TIME_LIMIT)
    finally:
        run.close()
    return options, None if run.ended == "succeeded" else f"{run.ended}: {run.text}"


def _refused(case: DockingCase, text: str) -> DockingOutcome:
    return DockingOutcome(case.kind, case.seed, "NOT_TAUGHT", text, 0, case.distance, None, None, None, None, None, 0)


def _outcome(case: DockingCase, run: SimulatedRun, verdict: dict[str, Any]) -> DockingOutcome:
    end = run.end.ends[0] if run.end is not None and run.end.ends else None
    is_told = end is not None and verdict["ended"] != NOT_RECORDED
    code = end.code if end is not None and is_told else str(verdict["ended"]).upper()
    is_docked = code == "SUCCEEDED"
    approach = docking = None
    if end is not None and end.result is not None and end.result.docking_seconds > 0.0:
        approach = end.result.seconds - end.result.docking_seconds
        docking = end.result.docking_seconds if is_docked else None
    return DockingOutcome(
        case.kind,
        case.seed,
        code,
        "" if end is None else end.text,
        0 if end is None or end.result is None else end.result.attempts,
        case.distance,
        approach,
        docking,
        verdict["dock_error_x_m"] if is_docked else None,
        verdict["dock_error_y_m"] if is_docked else None,
        verdict["dock_error_yaw_deg"] if is_docked else None,
        int(verdict["collisions"] or 0),
    )


def is_marked(world: str, name: str) -> bool:
    """Say whether a camera recognizes the dock; scanners recognize the others."""
    return bool(dock_of_world(load_world(world), name).markers)


def measure_detections(seed: int, pictures: int = PICTURES, world: str = WORLD) -> list[DetectionErrors]:
    """Look at the dock's first marker and at the dock from 1 m while the robot stands, and while it backs away at a slight angle."""
    still = _series(seed, pictures, world, BodyVelocity())
    moving = _series(seed + 1, pictures, world, BodyVelocity(-0.1, 0.02, 0.0))
    names = ("marker_still", "dock_still"), ("marker_moving", "dock_moving")
    return [
        DetectionErrors(name, errors)
        for pair, series in zip(names, (still, moving), strict=True)
        for name, errors in zip(pair, series, strict=True)
    ]


def _series(seed: int, pictures: int, world: str, velocity: BodyVelocity) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (N, 3) of the marker (along, across, yaw) and of the dock (x, y, yaw) in millimetres and degrees."""
    plan = load_world(world)
    begin = SE2(CAMERA_TO_PANEL - 1.0, 0.0, 0.0 if velocity == BodyVelocity() else 0.05)
    sim = Simulation(plan, robot_named(ROBOT), SimulationConfig(seed), plan.docks[0].world_from_dock @ begin)
    marker_errors, dock_errors = [], []
    look = _Look(sim)
    for k in range(pictures):
        for tick in range(8):
            sim.command(velocity)
            sim.step(10_000_000 * (8 * k + tick + 1))
        seen = look.errors()
        if seen is not None:
            marker_errors.append(seen[0])
            dock_errors.append(seen[1])
    return np.array(marker_errors), np.array(dock_errors)


class _Look:
    """Compares what the detectors say of one picture with the truth at the middle of its exposure; all in the world's frame."""

    def __init__(self, sim: Simulation) -> None:
        assert sim.camera is not None
        self._sim, self._world, self._mount = sim, sim.world, sim.robot.model.sensor(sim.camera.frame).base_from_sensor
        self._dock = docks_of_world(self._world, Path("unsaved")).dock(NAME)
        finder = FiducialDetector(sim.camera.spec.model, [m.spec for m in self._dock.markers])
        self._finder, self._detector = finder, MarkerDockDetector(self._dock, finder, self._mount)

    def errors(self) -> tuple[list[float], list[float]] | None:
        """Return the errors of the first marker and of the dock; None when one was not seen."""
        picture = self._sim.take_picture()
        world_from_base = self._sim.pose_at(picture.stamp_ns)
        first = self._dock.markers[0].spec
        marker = next((s for s in self._finder.detect(picture.grey) if s.marker == first), None)
        dock = self._detector.detect(DockObservation(picture.stamp_ns, picture.grey))
        if marker is None or dock is None:
            return None
        camera_from_true = (world_from_base @ self._mount).inverse() @ marker_poses(dock_of_world(self._world, NAME))[0]
        turn = camera_from_true.inverse() @ marker.camera_from_marker
        tx, _, tz = camera_from_true.translation
        x, _, z = marker.camera_from_marker.translation
        w, _, qy, _ = turn.rotation
        along_across = [1e3 * (z - tz), 1e3 * (x - tx), math.degrees(wrap_angle(2.0 * math.atan2(qy, w)))]
        world_from_dock = self._dock.map_from_dock  # the database was drawn in the world's frame
        away = (world_from_base.to_se2() @ dock.base_from_dock).inverse() @ world_from_dock
        return along_across, [-1e3 * away.x, -1e3 * away.y, -math.degrees(wrap_angle(away.yaw))]
