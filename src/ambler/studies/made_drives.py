"""Localization in maps that SLAM made on another day: drives among people, with a part of the furniture elsewhere.

A drive begins at rest at a drawn place, goes to drawn goals on rails, and ends at rest. Errors are measured against the map's own keyframes
(`evaluation.made_map_truth`), in the directions that what is seen determines.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import robot_config
from ambler.apps.scene import with_map_bend
from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan, Odometry
from ambler.core.se2 import SE2
from ambler.evaluation.determined import determined_directions
from ambler.evaluation.localization_quality import LocalizationErrors, errors_of
from ambler.evaluation.made_map_truth import MadeMapTruth
from ambler.localization.surface_map import SurfaceMap
from ambler.perception.planar import scan_to_points
from ambler.perception.scanner_profile import calibrated_robot
from ambler.runtime.topics import LOCALIZED_POSE, SCAN
from ambler.sim.faults import Fault, people_that_fit
from ambler.sim.robots import robot_named
from ambler.sim.solids import WorldSpec
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world
from ambler.studies.localization_study import METHODS, Method, localize, told_config
from ambler.studies.made_map import is_mapped, made_truth, true_poses
from ambler.studies.rail import SENSING, record_drive
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.studies.survey_drive import PlaceRoutes, driving_time, route_from
from ambler.wire.csv_files import recording_to_csv
from ambler.wire.map_files import load_map
from ambler.wire.mcap_reader import read_recording

F64 = NDArray[np.float64]
SPEED, REST = 0.6, 6.0  # m/s; seconds at rest before and after the drive
GOALS = 3
DRAWS = 200  # places, of which those count that are in the map at all
LONGEST = 90.0  # seconds of driving
ERROR_MOST, NEES_LEAST, NEES_MOST = 0.015, 0.5, 2.0  # metres per determined direction
STILL = 0.01  # m/s and rad/s below which the robot is at rest
STILL_FOR = 0.2  # seconds over which that is judged
SETTLE = 1.0  # seconds at the begin, in which a set pose becomes a known one
SCAN_EVERY = 5  # scans of which one is asked what it determines
MADE_METHODS = tuple(method for method in METHODS if method.name in ("tracker", "particles_scan"))


@dataclass(frozen=True, slots=True)
class MadeMap:
    """The files of a map that was made, its keyframes, and where these truly were."""

    map_file: str
    keyframes_file: str
    truth_file: str


@dataclass(frozen=True, slots=True)
class MadeDriveCase:
    """Drive `number` in `world`, a later day of the place in which `made` was made; `people` more than the plan has walk about."""

    world: str
    robot: str
    number: int
    seed: int
    people: int
    made: MadeMap
    settings: StudySettings = DEFAULTS
    methods: tuple[Method, ...] = MADE_METHODS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.world).stem}-{self.robot}-{self.number}"


@dataclass(frozen=True, slots=True, eq=False)
class DriveErrors:
    """Errors of a localization; per pose whether the robot moved, bool (N,), and the projection (N, 2, 2) on what was determined."""

    errors: LocalizationErrors
    is_moving: NDArray[np.bool_]
    determined: F64

    def fields(self) -> dict[str, float]:
        """Return what is told of a drive: sums that can be added to those of others."""
        fields: dict[str, float] = {}
        xy = self.errors.errors[:, :2]
        squares = np.einsum("na,nab,nb->n", xy, self.determined, xy)
        directions = np.trace(self.determined, axis1=1, axis2=2)
        for name, chosen in (("moving", self.is_moving), ("rest", ~self.is_moving)):
            fields |= {
                f"{name}_poses": int(chosen.sum()),
                f"{name}_squares_m2": float(squares[chosen].sum()),
                f"{name}_directions": float(directions[chosen].sum()),
                f"{name}_nees_sum": float(self.errors.nees[chosen].sum()),
                f"{name}_error_max_m": float(np.hypot(*xy[chosen].T).max(initial=0.0)),
            }
        return fields


def drive_study(cases: Sequence[MadeDriveCase]) -> Study[MadeDriveCase]:
    """Return the study of these drives; a result has `<method>.<what>` as `DriveErrors.fields` names it."""
    return Study("made_drives", cases, run_drive, _line)


def run_drive(case: MadeDriveCase, folder: Path) -> dict[str, Any]:
    """Record the drive, localize by each method in the made map, compare."""
    recording = folder / "drive"
    shutil.rmtree(recording, ignore_errors=True)
    way = record_made_drive(case, recording)
    truth = made_truth(case.made.keyframes_file, case.made.truth_file)
    spec, cells = load_map(Path(case.made.map_file))
    seen = _seen(case, recording, truth, SurfaceMap.from_occupancy(cells, spec))
    stamps_ns, poses = true_poses(recording)
    start = SE2.from_array(truth.poses(poses[:1])[0])
    fields: dict[str, Any] = {"path_length_m": way, "seconds": float(stamps_ns[-1] - stamps_ns[0]) * 1e-9}
    for method in case.methods:
        out = folder / method.name
        shutil.rmtree(out, ignore_errors=True)
        rng = np.random.default_rng([case.seed, case.number])
        config = with_map_bend(told_config(case.robot, case.settings, method, start, rng), Path(case.made.map_file))
        localize(recording, config, case.robot, (spec, cells), out, case.seed)
        estimates = out / "localized_pose.csv"
        recording_to_csv(out, LOCALIZED_POSE.ros_name, Odometry, estimates)
        errors = errors_of(estimates, stamps_ns, truth.poses(poses), SETTLE)
        drive = judged(errors, stamps_ns, poses, *seen)
        fields |= {f"{method.name}.{name}": value for name, value in drive.fields().items()}
    return fields


def judged(
    errors: LocalizationErrors, stamps_ns: NDArray[np.int64], poses: F64, seen_ns: F64, seen: F64
) -> DriveErrors:
    """Say of each estimate whether the robot moved then, by true poses (M, 3) at `stamps_ns`, and what the scan nearest in time determined."""
    t, at = stamps_ns.astype(np.float64), errors.stamps_ns
    half = 0.5e9 * STILL_FOR
    columns = (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))
    x, y, yaw = (np.interp(at + half, t, c) - np.interp(at - half, t, c) for c in columns)
    is_moving = (np.hypot(x, y) > STILL * STILL_FOR) | (np.abs(yaw) > STILL * STILL_FOR)
    after = np.clip(np.searchsorted(seen_ns, at), 1, len(seen_ns) - 1)
    nearest = np.where(at - seen_ns[after - 1] < seen_ns[after] - at, after - 1, after)
    return DriveErrors(errors, np.asarray(is_moving), seen[nearest])


def record_made_drive(case: MadeDriveCase, folder: Path) -> float:
    """Record the drive between places that the map knows; returns its length in metres. Raises BadInputError where there is none."""
    world, robot = load_world(case.world), robot_named(case.robot)
    rng = np.random.default_rng([case.seed, case.number, *case.world.encode()])
    routes = PlaceRoutes(world, robot)
    truth = made_truth(case.made.keyframes_file, case.made.truth_file)
    spec, cells = load_map(Path(case.made.map_file))
    drawn = [SE2(*place, 0.0) for place in routes.drawn_places(DRAWS, rng)]
    known = [place for place in drawn if is_mapped(cells, spec, truth.pose(world.start @ place))]
    points = routes.along([(place.x, place.y) for place in known[: GOALS + 1]]) if known else np.empty((0, 2))
    if len(points) < 2:
        raise BadInputError(f"{case.label}: no way between the places that were drawn")
    start = SE2(float(points[0, 0]), float(points[0, 1]), float(rng.uniform(-math.pi, math.pi)))
    route = route_from(start, points[1:], SPEED, REST)
    seconds = min(driving_time(points, SPEED, route.turn_rate, REST), LONGEST)
    settings = robot_config(robot.model, case.settings.only(SENSING).profile)
    seed, world_from_start = case.seed + case.number, world.start @ start
    faults = tuple(Fault.parse(text) for text in people_fault(case.people, world, seed, world_from_start))
    config = SimulationConfig(seed, faults=faults)
    record_drive(folder, world, robot, route, seconds, config, world_from_start, settings)
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def people_fault(wanted: int, world: WorldSpec, seed: int, start: SE2) -> tuple[str, ...]:
    """Return the faults that let so many people more walk about, or as many as the place has room for: a ward that is full of beds, and a robot in the
    middle of its only free floor, are places like others. Ways are those that can be reached from where the robot starts."""
    people = people_that_fit(replace(world, start=start), seed, (start,), wanted) if wanted else 0
    return (f"people@{people}",) if people else ()


def _seen(case: MadeDriveCase, recording: Path, truth: MadeMapTruth, surfaces: SurfaceMap) -> tuple[F64, F64]:
    """Return the stamps (K,) of some scans and what each determines at its true pose, float64 (K, 2, 2)."""
    config = robot_config(robot_named(case.robot).model, case.settings.profile, has_map=True)
    robot = calibrated_robot(robot_named(case.robot).model, config.scanners)
    stamps_ns, poses = true_poses(recording)
    poses = truth.poses(poses)
    stamps, known = [], []
    for k, recorded in enumerate(read_recording(recording, [SCAN.ros_name])):
        if k % SCAN_EVERY:
            continue
        scan = recorded.decode_as(LaserScan)
        mount = robot.sensor(scan.frame).base_from_sensor
        points = scan_to_points(scan, mount, np.zeros(3), config.localization.planar).points
        at = int(np.argmin(np.abs(stamps_ns - scan.stamp_ns)))
        stamps.append(float(scan.stamp_ns))
        known.append(determined_directions(surfaces, points, poses[at]))
    return np.array(stamps), np.array(known)


def _line(result: dict[str, Any]) -> str:
    return ", ".join(
        f"{method.name} {1e3 * rms(result, method.name, 'moving'):.1f} mm, NEES {nees(result, method.name, 'moving'):.2f}"
        f" (at rest {1e3 * rms(result, method.name, 'rest'):.1f} mm, {nees(result, method.name, 'rest'):.2f})"
        for method in MADE_METHODS
    )


def rms(sums: dict[str, Any], method: str, how: str) -> float:
    """Return the RMS error per determined direction, metres; nan where nothing was determined."""
    directions = float(sums[f"{method}.{how}_directions"])
    return math.sqrt(float(sums[f"{method}.{how}_squares_m2"]) / directions) if directions > 0.0 else math.nan


def nees(sums: dict[str, Any], method: str, how: str) -> float:
    """Return the mean NEES per dimension, nan without a pose."""
    poses = int(sums[f"{method}.{how}_poses"])
    return float(sums[f"{method}.{how}_nees_sum"]) / poses if poses else math.nan
