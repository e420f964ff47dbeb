"""Short drives from random places of a world, for every study that needs a robot that is anywhere."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.apps.config import robot_config
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.evaluation.truth_frame import TruthFrame
from ambler.sim.faults import Fault
from ambler.sim.robots import robot_named
from ambler.sim.truth import truth_grid
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world
from ambler.studies.rail import SENSING, Route, record_drive
from ambler.studies.study_settings import DEFAULTS, StudySettings

MARGIN = 0.1
LEG = (0.8, 3.5)
DRIVE_TIME = 8.0


@dataclass(frozen=True, slots=True)
class DriveCase:
    """Drive `number` of a world and a seed. Of the settings only what `rail.SENSING` names, and faults, make another drive."""

    world: str
    robot: str
    number: int
    seed: int
    settings: StudySettings = DEFAULTS


class Truth(Protocol):
    """Where a map lies in the world."""

    def pose(self, world_from_base: SE2) -> SE2:
        """Return a true pose in the map."""
        ...


@dataclass(frozen=True, slots=True)
class RandomDrive:
    """A recorded drive that began at `map_from_start` in the drawn map of its world, which lies where `truth` says."""

    world: str
    recording: Path
    map_from_start: SE2
    truth: Truth


def record_random_drive(case: DriveCase, folder: Path) -> RandomDrive:
    """Record a drive of 8 s from a random pose of a world into a folder that is not there yet: half a second at rest, then straight legs
    between random places that see each other. Raises BadInputError where the robot fits nowhere."""
    sim_robot, home = robot_named(case.robot), load_world(case.world)
    start, points = _route_of(case)
    local = tuple((float(x), float(y)) for x, y in start.inverse().transform(points))
    route = Route(local, speed=0.5, turn_rate=0.7, rest=0.5)
    faults = tuple(Fault.parse(text) for text in case.settings.faults)
    simulated = SimulationConfig(case.seed + case.number, physics="kinematic", faults=faults)
    config = robot_config(sim_robot.model, case.settings.only(SENSING).profile)
    record_drive(folder, home, sim_robot, route, DRIVE_TIME, simulated, home.start @ start, config)
    return RandomDrive(case.world, folder, start, TruthFrame(home.start))


def start_of(case: DriveCase) -> SE2:
    """Return where a drive begins in the drawn map of its world."""
    return _route_of(case)[0]


def _route_of(case: DriveCase) -> tuple[SE2, NDArray[np.float64]]:
    spec, clear = _clear_places(case.world, case.robot)
    return _random_route(spec, clear, np.random.default_rng([case.seed, case.number, *case.world.encode()]))


@functools.lru_cache(maxsize=4)
def _clear_places(world: str, robot: str) -> tuple[GridSpec, NDArray[np.bool_]]:
    sim_robot = robot_named(robot)
    spec, occupancy = truth_grid(load_world(world).from_start(), sim_robot.sensor_height, 0.05)
    return spec, _clear_cells(spec, occupancy, sim_robot.model.circumscribed_radius + MARGIN)


def _clear_cells(spec: GridSpec, occupancy: NDArray[np.int8], radius: float) -> NDArray[np.bool_]:
    """Cells in which a disc of `radius` metres meets nothing but free ones, bool [iy, ix]."""
    distance = ndimage.distance_transform_edt(occupancy == 0) * spec.resolution
    return np.asarray(distance > radius)


def _random_route(
    spec: GridSpec, clear: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[SE2, NDArray[np.float64]]:
    """Draw a start pose and way points (K, 2) joined by clear straight legs, all in the map frame."""
    cells = np.argwhere(clear)
    if len(cells) == 0:
        raise BadInputError("the robot fits nowhere in this world")
    here = _centre(spec, cells[rng.integers(len(cells))])
    start = SE2(float(here[0]), float(here[1]), float(rng.uniform(-math.pi, math.pi)))
    points = []
    for _ in range(3):
        for _ in range(200):
            bearing, length = rng.uniform(-math.pi, math.pi), rng.uniform(*LEG)
            there = here + length * np.array([math.cos(bearing), math.sin(bearing)])
            if _is_clear(spec, clear, here, there):
                points.append(there)
                here = there
                break
    return start, np.array(points).reshape(-1, 2)


def _centre(spec: GridSpec, cell: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.array(
        [spec.origin_x + (cell[1] + 0.5) * spec.resolution, spec.origin_y + (cell[0] + 0.5) * spec.resolution]
    )


def _is_clear(spec: GridSpec, clear: NDArray[np.bool_], a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    steps = np.linspace(0.0, 1.0, 2 + int(np.hypot(*(b - a)) / spec.resolution))[:, None]
    cells = spec.cells_of(a + steps * (b - a))
    inside = (cells >= 0).all(axis=1) & (cells < np.array(clear.shape)).all(axis=1)
    return bool(inside.all() and clear[cells[:, 0], cells[:, 1]].all())
