"""The measurement of source 002, section 5.1: localization in an aisle, along a wall and inside a building, standing and driving.

Every drive is recorded once; each method then replays the recording, its poses go to a recording of their own, from there to CSV, and
the numbers are taken from the CSV files.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ambler.apps.config import RobotConfig, robot_config
from ambler.apps.robot import MapGrid
from ambler.bridges.recorder import Recorder
from ambler.core.errors import BadInputError
from ambler.core.messages import Message, Odometry
from ambler.core.se2 import SE2
from ambler.evaluation.localization_quality import LocalizationErrors, localization_errors
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.localization import LocalizationNode, Source
from ambler.nodes.map_server import MapServerNode
from ambler.perception.scanner_profile import calibrated_robot
from ambler.runtime.clock import ReplayClock
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.stack import Stack
from ambler.runtime.topics import (
    IMU,
    LOCALIZED_POSE,
    MERGED_CLOUD,
    ODOMETRY,
    SCAN,
    TRUE_POSE,
    Topic,
    topic_named,
)
from ambler.sim.robots import robot_named
from ambler.sim.truth import truth_grid
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world
from ambler.studies.rail import SENSING, Route, record_drive
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.wire.csv_files import recording_to_csv
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

SENSORS: tuple[Topic[Any], ...] = (SCAN, MERGED_CLOUD, ODOMETRY, IMU)
ERROR_MOST, NEES_LEAST, NEES_MOST = 0.010, 0.5, 2.0  # metres; bars of moving robots
SET_VARIANCES = (0.01, 0.01, 0.003)  # of the pose that is set at the start (x, y, yaw), m² and rad²
Feed = Iterator[tuple[Topic[Any], Message, int]]


@dataclass(frozen=True, slots=True)
class Place:
    """A world, a route through it and where the robot stands for the measurement at rest, all in the frame of the world's start.
    `observable`: the axes of the map in which walls can tell the pose everywhere on the route."""

    name: str
    world: str
    route: Route
    drive_time: float
    stands: tuple[SE2, ...]
    observable: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Method:
    """A localizer and what it looks at."""

    name: str
    localizer: Literal["tracker", "particles", "reflectors"]
    source: Source


METHODS = (
    Method("particles_scan", "particles", "scan"),
    Method("particles_cloud", "particles", "cloud"),
    Method("particles_both", "particles", "both"),
    Method("tracker", "tracker", "scan"),
)

PLACES = (
    Place(
        "aisle",
        "corridor",
        Route(((8.0, 0.3), (18.0, -0.2), (26.0, 0.2), (34.0, 0.25)), speed=0.9),
        42.0,
        (SE2(3.0, 0.1, 0.2), SE2(12.0, -0.2, -0.1), SE2(22.0, 0.0, math.pi), SE2(36.0, 0.2, 0.05), SE2(48.0, 0.1, 3.0)),
        (1, 2),
    ),
    Place(
        "wall",
        "yard",
        Route(((6.0, 0.4), (12.0, -0.3), (18.0, 0.0)), speed=0.6),
        36.0,
        (SE2(0.0, 0.0, 0.0), SE2(4.0, 0.5, 0.4), SE2(9.0, -0.5, math.pi), SE2(13.0, 1.5, -0.3), SE2(18.0, 3.0, 1.57)),
        (1, 2),
    ),
    Place(
        "building",
        "building",
        Route(((16.0, -0.2), (16.9, -0.6), (16.9, -3.2), (18.6, -3.6), (16.9, -2.6), (16.9, -0.2), (22.5, -0.2)), 0.7),
        60.0,
        (SE2(5.0, 0.0, 0.3), SE2(16.9, -3.2, 1.0), SE2(20.8, 3.2, -2.0), SE2(3.2, 3.8, 0.0), SE2(27.0, -8.0, 2.2)),
        (0, 1, 2),
    ),
)


@dataclass(frozen=True, slots=True)
class Take:
    """One recorded drive, where the robot's start lies in the map, and where that map lies in the world."""

    recording: Path
    map_from_start: SE2
    truth: TruthFrame


@dataclass(frozen=True, slots=True)
class LocalizationCase:
    """Drive `number` of a place, with every method: moving along its route, or (`is_moving` False) standing at `place.stands[number]`. The map
    is drawn from the world at `resolution` metres."""

    place: Place
    number: int
    is_moving: bool
    seed: int
    robot: str = "amr_omni"
    resolution: float = 0.05
    stand_time: float = 6.0
    methods: tuple[Method, ...] = METHODS
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        how = f"drive-{self.seed}" if self.is_moving else f"stand-{self.seed}-{self.number}"
        return f"{self.place.name}-{self.robot}-{how}"


def cases_of(
    places: Sequence[Place], robot: str, seeds: Sequence[int], resolution: float, settings: StudySettings = DEFAULTS
) -> list[LocalizationCase]:
    """Return a moving drive per place and seed, and for the first seed every stand."""
    cases = []
    for place in places:
        for is_moving, numbers, drive_seeds in (
            (True, range(1), seeds),
            (False, range(len(place.stands)), seeds[:1]),
        ):
            cases += [
                LocalizationCase(place, k, is_moving, seed, robot, resolution, settings=settings)
                for seed in drive_seeds
                for k in numbers
            ]
    return cases


def localization_study(cases: Sequence[LocalizationCase]) -> Study[LocalizationCase]:
    """Return the study of these drives; a result has `place` and `errors`: those of each method by its name."""
    return Study("localization", cases, run_case, _line)


def run_case(case: LocalizationCase, folder: Path) -> dict[str, Any]:
    """Record the drive, replay it with every method, compare."""
    for name in ("drive", *(method.name for method in case.methods)):
        shutil.rmtree(folder / name, ignore_errors=True)
    take = record_take(case, folder / "drive")
    grid = drawn_map(case.place.world, case.robot, case.resolution)
    errors = {method.name: _measure(case, method, take, grid).to_dict() for method in case.methods}
    return {"place": case.place.name, "errors": errors}


def joined_errors(results: Sequence[dict[str, Any]]) -> dict[tuple[str, str, bool], LocalizationErrors]:
    """Return the errors of all drives together per (place, method, is_moving). Raises BadInputError when a drive crashed."""
    parts: dict[tuple[str, str, bool], list[LocalizationErrors]] = {}
    for result in results:
        if "errors" not in result:
            raise BadInputError(f"{result['label']} crashed: {result.get('why')}")
        for method, errors in result["errors"].items():
            key = result["place"], method, result["is_moving"]
            parts.setdefault(key, []).append(LocalizationErrors.from_dict(errors))
    return {key: LocalizationErrors.joined(group) for key, group in parts.items()}


def study_fields(places: Sequence[Place], results: dict[tuple[str, str, bool], LocalizationErrors]) -> dict[str, Any]:
    """Return the flat fields: of the moving drives without, of those at rest with `.static`; and the source's ratio of variances.

    `error_rms_m` is the worse of x and y where walls tell them. `variance_ratio_<d>` compares the particle filter's median variance with
    that of the tracker, which source 002 found to be 10 to 50."""
    fields: dict[str, Any] = {}
    for (place_name, method_name, is_moving), errors in results.items():
        place = next(p for p in places if p.name == place_name)
        prefix = f"{place_name}.{method_name}." + ("" if is_moving else "static.")
        rms = errors.rms
        worst = max(float(rms[axis]) for axis in place.observable if axis < 2)
        nees = float(errors.nees.mean())
        fields |= {
            f"{prefix}error_rms_m": worst,
            f"{prefix}error_x_rms_m": float(rms[0]),
            f"{prefix}error_y_rms_m": float(rms[1]),
            f"{prefix}error_yaw_rms_rad": float(rms[2]),
            f"{prefix}nees_mean": nees,
            f"{prefix}variance_x_m2": float(np.median(errors.variances[:, 0])),
            f"{prefix}variance_y_m2": float(np.median(errors.variances[:, 1])),
            f"{prefix}variance_yaw_rad2": float(np.median(errors.variances[:, 2])),
            f"{prefix}poses": len(errors.nees),
        }
        if is_moving:
            fields[f"{prefix}is_met"] = worst <= ERROR_MOST and NEES_LEAST <= nees <= NEES_MOST
    for place in places:
        for method in (m.name for m in METHODS if m.localizer == "particles"):
            for axis in ("x_m2", "y_m2", "yaw_rad2"):
                told, tracked = (f"{place.name}.{name}.variance_{axis}" for name in (method, "tracker"))
                fields[f"{place.name}.{method}.variance_ratio_{axis.split('_')[0]}"] = fields[told] / fields[tracked]
    return fields


def _line(result: dict[str, Any]) -> str:
    worst = {
        name: 1e3 * float(LocalizationErrors.from_dict(errors).rms[:2].max())
        for name, errors in result["errors"].items()
    }
    return ", ".join(f"{name} {value:.1f} mm" for name, value in worst.items())


def record_take(case: LocalizationCase, folder: Path) -> Take:
    """Record the drive of a case."""
    robot, home, place = robot_named(case.robot), load_world(case.place.world), case.place
    settings = robot_config(robot.model, case.settings.only(SENSING).profile)
    truth = TruthFrame(home.start)
    if case.is_moving:
        config = SimulationConfig(case.seed)
        record_drive(folder, home, robot, place.route, place.drive_time, config, settings=settings)
        return Take(folder, SE2(), truth)
    stand, config = place.stands[case.number], SimulationConfig(case.seed + 100 + case.number)
    record_drive(folder, home, robot, Route(), case.stand_time, config, home.start @ stand, settings)
    return Take(folder, stand, truth)


def drawn_map(world: str, robot: str, resolution: float) -> MapGrid:
    """Draw the map of a world from its plan at the height of the robot's scanners; its frame is that of the world's start."""
    return truth_grid(load_world(world).from_start(), robot_named(robot).sensor_height, resolution)


def localize(recording: Path, config: RobotConfig, robot: str, grid: MapGrid, out: Path, seed: int = 0) -> Path:
    """Replay the sensors of a recording into a localization in the map `grid` and record what it tells into `out`."""
    executor, recorder = localization_executor(config, robot, grid, seed), Recorder(out)
    with executor:
        executor.tap(recorder.on_message)
        executor.run(feed=sensor_feed(recording))
    recorder.close()
    return out


def localization_executor(config: RobotConfig, robot: str, grid: MapGrid, seed: int = 0) -> LockstepExecutor:
    """Return an executor of map server and localization alone, fed from outside by `sensor_feed`."""
    localizer = partial(config.make_localizer, seed=seed)
    node = LocalizationNode(calibrated_robot(robot_named(robot).model, config.scanners), localizer, config.localization)
    return LockstepExecutor(Stack([MapServerNode(*grid), node], external=SENSORS), ReplayClock())


def sensor_feed(recording: Path) -> Feed:
    """Yield what localization takes in, in the order of its recording."""
    for recorded in read_recording(recording, [t.ros_name for t in SENSORS]):
        topic = topic_named(recorded.topic)
        yield topic, decode(topic.type, recorded.data), recorded.log_time_ns


def study_config(case: LocalizationCase, method: Method, take: Take) -> RobotConfig:
    """Return the robot's configuration for a method that is told where it starts, as wrong as a person's click is."""
    rng = np.random.default_rng([case.seed, *case.label.encode()])
    return told_config(case.robot, case.settings, method, take.map_from_start, rng)


def told_config(
    robot: str, settings: StudySettings, method: Method, map_from_start: SE2, rng: np.random.Generator
) -> RobotConfig:
    """Return the configuration of a robot with a known map for a method; the pose that it is told is wrong as a person's click is."""
    config = robot_config(robot_named(robot).model, settings.profile, has_map=True)
    error = SE2.from_array(np.sqrt(SET_VARIANCES) * rng.standard_normal(3))
    pose = SE2.from_array(map_from_start.as_array() + error.as_array())
    localization = replace(config.localization, source=method.source, initial_pose=pose, covariance=SET_VARIANCES)
    return replace(config, localizer=method.localizer, localization=localization)


def _measure(case: LocalizationCase, method: Method, take: Take, grid: MapGrid) -> LocalizationErrors:
    out = take.recording.with_name(method.name)
    localize(take.recording, study_config(case, method, take), case.robot, grid, out, case.seed)
    estimates, truth = out / "localized_pose.csv", take.recording / "true_pose.csv"
    recording_to_csv(out, LOCALIZED_POSE.ros_name, Odometry, estimates)
    if not truth.exists():
        recording_to_csv(take.recording, TRUE_POSE.ros_name, Odometry, truth)
    return localization_errors(estimates, truth, take.truth.world_from_map.inverse())
