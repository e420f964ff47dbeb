"""A drive through a whole place for making its map: a round of viewpoints that see all of its floor, driven on rails.

The places are the art-gallery tour of somebody who knows the plan, the way between them keeps off walls as a planner does; scans and odometry of
the drive are all that SLAM gets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError, NoValidPathError
from ambler.core.grid import COST_LETHAL, OCC_FREE, OCC_OCCUPIED
from ambler.core.se2 import SE2
from ambler.exploration.grid_world import GridWorld
from ambler.exploration.known_tour import KnownTourConfig, known_tour
from ambler.planning.distance import distance_field
from ambler.planning.grid_planner import GridPlanner, PlannerConfig
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec
from ambler.sim.truth import reachable_floor
from ambler.studies.rail import Route

F64 = NDArray[np.float64]
RESOLUTION = 0.05
CLEARANCE = 0.08  # metres beside the robot's circumscribed circle
SIGHT = 4.0  # metres that a viewpoint is trusted to see; less than scanners reach, so that walls are seen from near by
SPACING = 0.3  # metres between the points of a route: the rail cuts corners by less than its clearance
ROOM = 0.45  # metres to somebody ahead at which it waits; who yields halts half a metre before a robot
SOFT = 0.5  # metres from what is in the way within which a way costs more


class PlaceRoutes:
    """Where a robot can drive in a world, and ways there, in the frame of the world's start. Raises BadInputError where it fits nowhere."""

    def __init__(self, world: WorldSpec, robot: SimRobot) -> None:
        home = world.from_start()
        radius = robot.model.circumscribed_radius + CLEARANCE
        heights = (robot.body_bottom, robot.visible_height)
        self.spec, self.clear, self.reached = reachable_floor(home, radius, RESOLUTION, heights)
        if not self.reached.any():
            raise BadInputError(f"world {world.name}: the robot does not fit where it starts")
        self._costs = _costs(self.clear)
        self._planner = GridPlanner(PlannerConfig(spacing=SPACING))

    def survey(self) -> F64:
        """Return the points (N, 2) of a round from the start that sees the whole floor."""
        truth = np.where(self.clear, OCC_FREE, OCC_OCCUPIED).astype(np.int8)
        world = GridWorld(self.spec, truth, SE2(), distance_field, sensor_range=SIGHT, robot_radius=0.0)
        cells = known_tour(world, KnownTourConfig(spacing=1.0, step=1.0)).cells
        return self.along([self.spec.center_of(*cell) for cell in (*cells, cells[0])])

    def along(self, places: Sequence[tuple[float, float]]) -> F64:
        """Return the points (N, 2) of a way from each place to the next; those that cannot be reached are left out."""
        points, here = [np.array([places[0]])], places[0]
        for there in places[1:]:
            try:
                path = self._planner.plan(self._costs, self.spec, SE2(*here), SE2(*there)).path
            except NoValidPathError:
                continue
            points.append(path[1:, :2])
            here = there
        return np.concatenate(points)

    def drawn_places(self, count: int, rng: np.random.Generator) -> list[tuple[float, float]]:
        """Draw places that the robot can reach."""
        cells = np.argwhere(self.reached)
        return [self.spec.center_of(*cells[k]) for k in rng.integers(len(cells), size=count).tolist()]


def route_from(start: SE2, points: F64, speed: float, rest: float) -> Route:
    """Return a route along points (N, 2) of a frame in which the drive begins at `start`, with `rest` seconds before and after it; it waits
    for people."""
    local = start.inverse().transform(points)
    return Route(
        tuple((float(x), float(y)) for x, y in local), speed=speed, turn_rate=0.8, rest=rest, room=ROOM, rest_after=rest
    )


def driving_time(points: F64, speed: float, turn_rate: float, rest: float) -> float:
    """Return the seconds that a route takes at most: its way, all its turning in place, and as long again waiting for people."""
    steps = np.diff(points, axis=0)
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    way = float(np.hypot(*steps.T).sum())
    return rest + 2.0 * (way / (0.8 * speed) + float(np.abs(turns).sum() + math.pi) / turn_rate)


def _costs(clear: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return costs uint8 [iy, ix]: lethal where the robot cannot be, less with the distance from there."""
    away = cv2.distanceTransform(clear.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * RESOLUTION
    soft = np.clip(1.0 - away / SOFT, 0.0, 1.0) * 200.0
    return np.where(clear, soft, COST_LETHAL).astype(np.uint8)
