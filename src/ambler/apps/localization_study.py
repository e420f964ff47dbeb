"""The measurement of source 002, section 5.1: localization in an aisle, along a wall and inside a building, standing and driving.

Every drive is recorded once; each method then replays the recording, its poses go to a recording of their own, from there to CSV, and
the numbers are taken from the CSV files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ambler.apps.config import RobotConfig, robot_config
from ambler.apps.rail import SENSING, Route, record_drive
from ambler.apps.robot import MapGrid
from ambler.apps.study_settings import DEFAULTS, StudySettings
from ambler.bridges.recorder import Recorder
from ambler.core.messages import Message, Odometry
from ambler.core.se2 import SE2
from ambler.evaluation.localization_quality import AXES, LocalizationErrors, localization_errors
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
from ambler.wire.csv_files import recording_to_csv
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

SENSORS: tuple[Topic[Any], ...] = (SCAN, MERGED_CLOUD, ODOMETRY, IMU)
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
    is_moving: bool


@dataclass(frozen=True, slots=True)
class LocalizationStudy:
    """What to measure: `runs` drives per place with different seeds; the map is drawn from the world at `resolution` metres."""

    robot: str = "amr_omni"
    places: tuple[Place, ...] = PLACES
    methods: tuple[Method, ...] = METHODS
    seed: int = 0
    runs: int = 2
    resolution: float = 0.05
    stand_time: float = 6.0
    settings: StudySettings = DEFAULTS


def run_study(
    study: LocalizationStudy, out: Path, tell: Callable[[str], None]
) -> dict[tuple[str, str, bool], LocalizationErrors]:
    """Record, replay and compare; returns the errors per (place, method, is_moving)."""
    results: dict[tuple[str, str, bool], LocalizationErrors] = {}
    for place in study.places:
        grid = drawn_map(place.world, study.robot, study.resolution)
        takes = [*record_takes(study, place, out)]
        for method in study.methods:
            parts: dict[bool, list[LocalizationErrors]] = {True: [], False: []}
            for take in takes:
                parts[take.is_moving].append(_measure(study, method, take, grid))
            for is_moving, group in parts.items():
                errors = results[place.name, method.name, is_moving] = LocalizationErrors.joined(group)
                rms = ", ".join(f"{axis} {1e3 * v:.1f}" for axis, v in zip(AXES, errors.rms, strict=True))
                how = "moving" if is_moving else "static"
                tell(f"{place.name} {method.name} {how}: rms {rms} (mm, mrad), NEES {errors.nees.mean():.2f}")
    return results


def record_takes(study: LocalizationStudy, place: Place, out: Path) -> Iterator[Take]:
    """Record the drives of a place that are not there yet with these settings of odometry and scanners, moving and standing."""
    robot, home = robot_named(study.robot), load_world(place.world)
    sensing = study.settings.only(SENSING)
    settings = robot_config(robot.model, sensing.profile)
    for run in range(study.runs):
        seed = study.seed + run
        folder = out / f"{place.name}-{study.robot}-drive-{seed}{sensing.suffix}"
        if not folder.exists():
            record_drive(folder, home, robot, place.route, place.drive_time, SimulationConfig(seed), settings=settings)
        yield Take(folder, SE2(), TruthFrame(home.start), is_moving=True)
    for k, stand in enumerate(place.stands):
        folder = out / f"{place.name}-{study.robot}-stand-{study.seed}-{k}{sensing.suffix}"
        if not folder.exists():
            config = SimulationConfig(study.seed + 100 + k)
            record_drive(folder, home, robot, Route(), study.stand_time, config, home.start @ stand, settings)
        yield Take(folder, stand, TruthFrame(home.start), is_moving=False)


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


def study_config(study: LocalizationStudy, method: Method, take: Take) -> RobotConfig:
    """Return the robot's configuration for a method that is told where it starts, as wrong as a person's click is."""
    config = robot_config(robot_named(study.robot).model, study.settings.profile, has_map=True)
    rng = np.random.default_rng([study.seed, *take.recording.name.encode()])
    error = SE2.from_array(np.sqrt(SET_VARIANCES) * rng.standard_normal(3))
    pose = SE2.from_array(take.map_from_start.as_array() + error.as_array())
    localization = replace(config.localization, source=method.source, initial_pose=pose, covariance=SET_VARIANCES)
    return replace(config, localizer=method.localizer, localization=localization)


def _measure(study: LocalizationStudy, method: Method, take: Take, grid: MapGrid) -> LocalizationErrors:
    out = take.recording.with_name(f"{take.recording.name}.{method.name}-{study.resolution:g}{study.settings.suffix}")
    if not out.exists():
        localize(take.recording, study_config(study, method, take), study.robot, grid, out, study.seed)
    estimates, truth = out / "localized_pose.csv", take.recording / "true_pose.csv"
    recording_to_csv(out, LOCALIZED_POSE.ros_name, Odometry, estimates)
    if not truth.exists():
        recording_to_csv(take.recording, TRUE_POSE.ros_name, Odometry, truth)
    return localization_errors(estimates, truth, take.truth.world_from_map.inverse())
