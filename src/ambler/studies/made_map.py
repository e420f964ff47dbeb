"""Maps as robots have them: made by SLAM from a drive through a place on one day, and used on another."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import robot_config
from ambler.core.grid import GridSpec
from ambler.core.messages import Odometry
from ambler.core.se2 import SE2
from ambler.evaluation.made_map_truth import MadeMapTruth
from ambler.evaluation.trajectory import trajectory_error, truth_at
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.slam2d import Slam2dNode, save_slam_map
from ambler.perception.scanner_profile import calibrated_robot
from ambler.runtime.clock import ReplayClock
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.stack import Stack
from ambler.runtime.topics import TRUE_POSE
from ambler.sim.robots import robot_named
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world
from ambler.slam2d.keyframes import Keyframes, keyframes_of
from ambler.studies.localization_study import SENSORS, Feed, sensor_feed
from ambler.studies.rail import SENSING, record_drive
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.studies.survey_drive import PlaceRoutes, driving_time, route_from
from ambler.wire.map_files import load_bend
from ambler.wire.mcap_reader import read_recording
from ambler.wire.tum import read_tum, write_tum

MAP, KEYFRAMES, TRUTH = "map", "keyframes.tum", "truth.tum"
SPEED, REST = 0.6, 1.0  # m/s, seconds


@dataclass(frozen=True, slots=True)
class MapCase:
    """The mapping of a world by a robot."""

    world: str
    robot: str
    seed: int
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{Path(self.world).stem}-{self.robot}"


def map_study(cases: list[MapCase]) -> Study[MapCase]:
    """Return the study of these mappings; a result has `map_file`, `keyframes_file` and `truth_file` besides what the map is worth."""
    return Study("made_maps", cases, make_map, _line)


def make_map(case: MapCase, folder: Path) -> dict[str, Any]:
    """Drive a round that sees the whole floor, make the map, and keep it with its keyframes and where these truly were."""
    recording = folder / "drive"
    shutil.rmtree(recording, ignore_errors=True)
    way = _record(case, recording)
    keyframes, map_file = _mapped(case, recording, folder / MAP)
    stamps_ns, truth = true_poses(recording)
    is_known, true = truth_at(keyframes.stamps_ns, stamps_ns, truth, max_gap=0.1)
    stamps = keyframes.stamps_ns[is_known]
    seconds = stamps.astype(np.float64) * 1e-9
    write_tum(folder / KEYFRAMES, seconds, keyframes.map_from_base[is_known])
    write_tum(folder / TRUTH, seconds, true[is_known])
    start = TruthFrame(load_world(case.world).start)
    error = trajectory_error(stamps, keyframes.map_from_base[is_known], stamps_ns, start.poses(truth))
    shutil.rmtree(recording)
    return {
        "map_file": str(map_file),
        "keyframes_file": str(folder / KEYFRAMES),
        "truth_file": str(folder / TRUTH),
        "keyframes": len(stamps),
        "bend_m": load_bend(map_file)[0],
        "bend_rad": load_bend(map_file)[1],
        "path_length_m": way,
        "ate_rms_m": error.ate_rms_m,
        "ate_unaligned_rms_m": error.unaligned_rms_m,
    }


def made_truth(keyframes_file: str, truth_file: str) -> MadeMapTruth:
    """Return the truth in a map that was kept with its keyframes."""
    return _read_truth(keyframes_file, truth_file)


def is_mapped(cells: NDArray[np.int8], spec: GridSpec, map_from_base: SE2) -> bool:
    """Say whether a place is in a map, int8 [iy, ix], at all. Floor that could not be reached on the day of the map, behind furniture that stands
    elsewhere since, is not: what is unknown there is no place that anybody could recognize."""
    iy, ix = spec.cell_of(map_from_base.x, map_from_base.y)
    return spec.contains_cell(iy, ix) and int(cells[iy, ix]) >= 0


def true_poses(recording: Path) -> tuple[np.ndarray[Any, np.dtype[np.int64]], np.ndarray[Any, np.dtype[np.float64]]]:
    """Return the stamps (N,) and poses (N, 3) in the world that a recording tells."""
    stamps, poses = [], []
    for recorded in read_recording(recording, [TRUE_POSE.ros_name]):
        message = recorded.decode_as(Odometry)
        stamps.append(message.stamp_ns)
        poses.append(message.pose.to_se2().as_array())
    return np.array(stamps, np.int64), np.array(poses, np.float64).reshape(-1, 3)


@lru_cache(maxsize=8)
def _read_truth(keyframes_file: str, truth_file: str) -> MadeMapTruth:
    (_, estimated), (_, true) = read_tum(Path(keyframes_file)), read_tum(Path(truth_file))
    return MadeMapTruth(true, estimated)


def _record(case: MapCase, folder: Path) -> float:
    """Record the drive; returns its length in metres."""
    world, robot = load_world(case.world), robot_named(case.robot)
    points = PlaceRoutes(world, robot).survey()
    route = route_from(SE2(), points, SPEED, REST)
    seconds = driving_time(points, route.speed, route.turn_rate, route.rest)
    settings = robot_config(robot.model, case.settings.only(SENSING).profile)
    config = SimulationConfig(case.seed, physics="kinematic")
    record_drive(folder, world, robot, route, seconds, config, settings=settings)
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _mapped(case: MapCase, recording: Path, stem: Path) -> tuple[Keyframes, Path]:
    """Make the map of a recording; returns its keyframes and its file."""
    robot = robot_named(case.robot).model
    config = robot_config(robot, case.settings.profile)
    node = Slam2dNode(calibrated_robot(robot, config.scanners), config.slam2d)
    executor = LockstepExecutor(Stack([node], external=SENSORS), ReplayClock())
    with executor:
        executor.run(feed=_stopping(executor, sensor_feed(recording)))  # the node's timers would go on for ever
        node.slam.finish()
        description = save_slam_map(stem, node.slam)
    return keyframes_of(node.slam), description


def _stopping(executor: LockstepExecutor, feed: Feed) -> Feed:
    yield from feed
    executor.stop()


def _line(result: dict[str, Any]) -> str:
    return f"{result['path_length_m']:.0f} m, {result['keyframes']} keyframes, bent by {1e3 * result['bend_m']:.0f} mm, ATE {1e3 * result['ate_rms_m']:.0f} mm"
