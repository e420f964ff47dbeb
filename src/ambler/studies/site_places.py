"""Places in a saved site: where a robot is switched on anew, and way-points that it can get to on the ground of its map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.known_ground import KnownGround, KnownLevel
from ambler.sim.reachable_ground import ReachableGround
from ambler.sim.solids import WorldSpec

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
SAME_HEIGHT = 0.7  # metres between the height of a true place and that of the map
PUT = 0.3  # metres between the height of a true place and that at which the simulator puts a robot there: it knows the lowest level only
FAR_SHARE = 0.5  # of the way from the old start to the farthest place: so far away at least is the new start
APART = 4.0  # metres between way-points at least, while there is room


def free_pieces(ground: KnownGround, radius: float) -> list[I32]:
    """Return for each level a number for every place (cell [iy, ix]) with nothing but ground within `radius` metres; places have one number where a robot gets from
    one to the other, through passages too. 0: there is no room."""
    labels: list[I32] = []
    count = 0
    for level in ground.levels:
        own, pieces = ndimage.label(_roomy(level, radius))
        labels.append(np.where(own > 0, own + count, 0).astype(np.int32))
        count += pieces
    ends = [_ends(ground, labels, row) for row in ground.passages]
    pairs = np.array([pair for pair in ends if 0 not in pair], np.int64).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count + 1, count + 1))
    joined = connected_components(graph, directed=False)[1].astype(np.int32)
    return [np.where(own > 0, joined[own] + 1, 0).astype(np.int32) for own in labels]


def draw_start(
    ground: KnownGround,
    pieces: list[I32],
    truth: ReachableGround,
    world: WorldSpec,
    world_from_map: SE3,
    rng: np.random.Generator,
) -> tuple[SE2, int]:
    """Return where a robot is switched on, in the frame of the map, and the number of the piece of ground there: a true place on which it can stand, on the largest piece of the map, far from where the
    map began. Raises BadInputError where there is none."""
    places = truth.places()
    in_map = np.asarray(world_from_map.inverse().transform(places))
    numbers = np.array([_piece_at(ground, pieces, place) for place in in_map.tolist()])
    if not numbers.any():
        raise BadInputError("the saved map has no ground on which a robot can stand")
    kept = numbers == np.argmax(np.bincount(numbers[numbers > 0]))
    away = np.hypot(in_map[:, 0], in_map[:, 1])
    chosen = np.flatnonzero(kept & (away >= FAR_SHARE * away[kept].max()))
    for k in chosen[rng.permutation(len(chosen))].tolist():
        if abs(float(world.ground_at(places[k : k + 1, :2])[0]) - places[k, 2]) < PUT:
            yaw = float(rng.uniform(-math.pi, math.pi))
            return SE2(float(in_map[k, 0]), float(in_map[k, 1]), yaw), int(numbers[k])
    raise BadInputError("no place of the saved map is one at which the simulator can begin")


def draw_way_points(
    ground: KnownGround, pieces: list[I32], piece: int, count: int, rng: np.random.Generator
) -> list[tuple[SE2, int]]:
    """Return poses in the map with their levels, drawn from one piece of its ground, `APART` metres from each other while there is room."""
    spots: list[tuple[int, float, float]] = []
    for k, (level, own) in enumerate(zip(ground.levels, pieces, strict=True)):
        xy = level.spec.centers_of(np.argwhere(own == piece))
        spots += [(k, x, y) for x, y in xy.tolist()]
    if not spots:
        raise BadInputError("there is no room for a way-point in the saved map")
    chosen: list[tuple[SE2, int]] = []
    apart = APART
    while len(chosen) < count:
        for _ in range(200):
            k, x, y = spots[int(rng.integers(len(spots)))]
            if all(k != other or math.hypot(x - p.x, y - p.y) >= apart for p, other in chosen):
                chosen.append((SE2(x, y, float(rng.uniform(-math.pi, math.pi))), k))
                break
        else:
            apart *= 0.5
    return chosen


def _roomy(level: KnownLevel, radius: float) -> NDArray[np.bool_]:
    """Say for each cell whether all within a radius is ground whose height is known."""
    free = np.pad((level.occupancy == OCC_FREE) & np.isfinite(level.heights), 1)
    return np.asarray(ndimage.distance_transform_edt(free)[1:-1, 1:-1] * level.spec.resolution > radius)


def _piece_at(ground: KnownGround, pieces: list[I32], place: list[float]) -> int:
    """Return the number of the piece on which a place (x, y, z) of the map lies, 0: none."""
    for level, own in zip(ground.levels, pieces, strict=True):
        height = level.height_at(place[0], place[1])
        if height is not None and abs(height - place[2]) < SAME_HEIGHT:
            number = int(own[level.spec.cell_of(place[0], place[1])])
            if number:
                return number
    return 0


def _ends(ground: KnownGround, labels: list[I32], row: F64) -> tuple[int, int]:
    """Return the numbers of the pieces that a passage joins: those nearest to it, within two metres; 0: none."""
    out = []
    for k in row[:2].astype(int).tolist():
        cells = np.argwhere(labels[k] > 0)
        far = np.hypot(*(ground.levels[k].spec.centers_of(cells) - row[2:4]).T)
        near = int(np.argmin(far)) if len(far) else -1
        out.append(int(labels[k][tuple(cells[near])]) if near >= 0 and far[near] <= 2.0 else 0)
    return out[0], out[1]
