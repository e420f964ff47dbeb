"""A place to stand aside: off the way of somebody whom the robot cannot pass, so that he can walk past it.

In a corridor that is too narrow for both, only a door, a bay or a wider place lets two get by each other. A niche is taken first that leaves him room to spare, then a
nearer one that leaves him just enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.core.errors import BadInputError, PlanningError
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.kernels.footprint import footprint_edges, lethal_cells_inside, lethal_distance, lethal_row_sums
from ambler.planning.distance import distance_field

F64 = NDArray[np.float64]
TRIED = 2000  # poses whose footprint is looked at, at most
PADDING = 0.03  # metres around the footprint that must be free where it stands aside


@dataclass(frozen=True, slots=True)
class RefugeConfig:
    """Numbers of standing aside, SI.

    least, enough    metres between the footprint and the line on which somebody walks: half of him and what he sways, and with room to spare
    detour           metres of way that it is worth to leave him room to spare
    turn             metres of way that it is worth to be able to turn there: who came in nose first drives out at once
    person           radius of what the robot does not pass through on its way
    reach            how far the way to the refuge may be
    """

    least: float = 0.45
    enough: float = 0.8
    detour: float = 4.0
    turn: float = 2.0
    person: float = 0.35
    reach: float = 10.0

    def __post_init__(self) -> None:
        if min(self.least, self.reach) <= 0.0 or min(self.enough, self.detour, self.turn, self.person) < 0.0:
            raise BadInputError("refuge: `least` and `reach` must be positive, nothing negative")


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """Somebody's way in the map frame: where he is, the unit vector along which he comes, and where he and others walked lately, `places` float64 (N, 2)."""

    place: tuple[float, float]
    along: tuple[float, float]
    places: F64

    def lengthwise(self, points: F64) -> F64:
        """Return how far points (N, 2) lie ahead of him along his line, (N,)."""
        return np.asarray((points - self.place) @ np.array(self.along))

    def sideways(self, points: F64) -> F64:
        """Return how far points (N, 2) lie to the left of his line, (N,)."""
        return np.asarray((points - self.place) @ np.array((-self.along[1], self.along[0])))


def find_refuge(
    costs: NDArray[np.uint8],
    spec: GridSpec,
    map_from_base: SE2,
    robot: RobotModel,
    walk: Walk,
    config: RefugeConfig | None = None,
) -> SE2 | None:
    """Return the pose of the base, in the frame of `spec`, at which the robot is off somebody's way, and to which the way that does not lead through him is shortest; None where there is none.

    `costs` uint8 [iy, ix]. The heading is that of arrival, or one along his line. Everything from his place on, ahead and behind, counts as his way, and so do the places at which he and others walked lately.
    """
    c = config or RefugeConfig()
    costs, spec = _cut(costs, spec, map_from_base, c.reach)
    distance = _distances(costs, spec, map_from_base, robot, walk, c)
    if distance is None:
        return None
    iy, ix = np.nonzero(distance <= c.reach)
    centers = spec.centers_of(np.stack((iy, ix), axis=1))
    if len(walk.places) > 0:
        away, _ = cKDTree(walk.places).query(centers)
        is_far = away >= robot.inscribed_radius + c.least
        iy, ix, centers = iy[is_far], ix[is_far], centers[is_far]
    line_yaw = math.atan2(walk.along[1], walk.along[0])
    arrival = _arrivals(distance, iy, ix)
    sums = np.empty((spec.height, spec.width + 1), np.int32)
    lethal_row_sums(costs, COST_LETHAL, sums)
    yaws = np.concatenate((arrival, np.full(len(iy), line_yaw), np.full(len(iy), line_yaw + math.pi)))
    places = np.tile(centers, (3, 1))
    turned = np.abs(np.angle(np.exp(1j * (yaws - np.tile(arrival, 3)))))
    gap = np.empty(costs.shape)
    lethal_distance(sums, spec.resolution, gap)
    is_tight = np.tile(gap[iy, ix] < robot.circumscribed_radius + PADDING, 3)
    room = _room_beside(places, yaws, robot, walk)
    cost = (
        np.tile(distance[iy, ix].astype(np.float64), 3)
        + 0.5 * turned
        + c.detour * (room < c.enough)
        + c.turn * is_tight
    )
    is_aside = (room >= c.least) & np.isfinite(cost)
    chosen = np.nonzero(is_aside)[0][np.argsort(cost[is_aside], kind="stable")][:TRIED]
    normals, offsets = footprint_edges(robot.footprint, PADDING)
    for k in chosen:
        (x, y), yaw = places[k], float(yaws[k])
        gx, gy = x - spec.origin_x, y - spec.origin_y
        if lethal_cells_inside(sums, spec.resolution, gx, gy, math.cos(yaw), math.sin(yaw), normals, offsets) > 0:
            continue
        pose = SE2(float(x), float(y), yaw)
        if _is_clear_of(walk.places, pose, normals, offsets, c.least):
            return pose
    return None


def _cut(costs: NDArray[np.uint8], spec: GridSpec, at: SE2, reach: float) -> tuple[NDArray[np.uint8], GridSpec]:
    """Return the part of the grid that a way of that length can lie in."""
    cells = math.ceil(reach / spec.resolution)
    iy, ix = spec.cell_of(at.x, at.y)
    top, left = max(0, iy - cells), max(0, ix - cells)
    part = np.ascontiguousarray(costs[top : max(top, iy + cells + 1), left : max(left, ix + cells + 1)])
    origin = (spec.origin_x + left * spec.resolution, spec.origin_y + top * spec.resolution)
    return part, GridSpec(spec.resolution, part.shape[1], part.shape[0], *origin)


def _distances(
    costs: NDArray[np.uint8], spec: GridSpec, at: SE2, robot: RobotModel, walk: Walk, c: RefugeConfig
) -> NDArray[np.float32] | None:
    """Return the way's length to every cell, not through the person; None where the robot cannot leave its place."""
    x = spec.origin_x + (np.arange(spec.width) + 0.5) * spec.resolution - walk.place[0]
    y = spec.origin_y + (np.arange(spec.height) + 0.5) * spec.resolution - walk.place[1]
    closed = costs.copy()
    closed[np.hypot(x[None, :], y[:, None]) < c.person + robot.inscribed_radius] = COST_LETHAL
    try:
        return distance_field(closed, spec, at)
    except PlanningError:
        return None


def _arrivals(distance: NDArray[np.float32], iy: NDArray[np.int64], ix: NDArray[np.int64]) -> F64:
    """Return with what yaw the way to each of the cells ends, (N,)."""
    padded = np.pad(distance, 1, constant_values=np.inf)
    here = distance[iy, ix]
    pull = np.zeros((len(iy), 2))
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            drop = here - padded[iy + 1 + dy, ix + 1 + dx]
            is_down = np.isfinite(drop) & (drop > 0.0)
            pull -= np.where(is_down, drop, 0.0)[:, None] * (dx, dy)
    return np.arctan2(pull[:, 1], pull[:, 0])


def _room_beside(places: F64, yaws: F64, robot: RobotModel, walk: Walk) -> F64:
    """Return how far the footprint at each pose stays off the line, (N,); negative where it lies across it."""
    corners = np.asarray(robot.footprint, np.float64)
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    normal = np.array((-walk.along[1], walk.along[0]))
    swung = (cos * corners[:, 0] - sin * corners[:, 1]) * normal[0] + (
        sin * corners[:, 0] + cos * corners[:, 1]
    ) * normal[1]
    aside = walk.sideways(places)
    return np.asarray(np.where(aside >= 0.0, aside + swung.min(axis=1), -aside - swung.max(axis=1)))


def _is_clear_of(places: F64, pose: SE2, normals: F64, offsets: F64, keep: float) -> bool:
    """Whether no place at which people walked lies nearer to the footprint than `keep`."""
    if len(places) == 0:
        return True
    local = pose.inverse().transform(places)
    return bool(((local @ normals.T - offsets).max(axis=1) >= keep).all())
