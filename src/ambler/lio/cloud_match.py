"""Registration of what the sensor sees to a saved cloud: coarse to fine (GICP of small_gicp), then judged by what it explains.

A pose explains a point that lies on a surface of the map which faces as the point's own does; it contradicts the map where a ray has passed
through a surface of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import small_gicp
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.kernels.cloud_search import FLAT, WALL
from ambler.lio.cloud_map import CloudMap
from ambler.lio.config import CloudMatchConfig
from ambler.lio.sight import LocalCloud
from ambler.lio.state import log, to_se3

F64 = NDArray[np.float64]
WALLS_LEAST = 15  # points on walls below which a place cannot be told from others
RAYS = 400
LENIENT = 0.75  # of a wall that is explained, that a wall which is not there any more says against a place
AS_MANY = 0.9  # of the walls that another place explains


@dataclass(frozen=True, slots=True, eq=False)
class CloudMatch:
    """A pose and what speaks for it: shares of the points on walls and on flats that are explained, of the rays that are blocked; RMS distance of the explained walls
    from their planes, m (of flats it says less: a thin deck has two sides, and a plane through both lies between); `information` float64 (6, 6) of unit noise about rotation and translation (both in `local`, on the right); `tightness`: the least residual
    of the places that explain as many walls over its own, 1 when it stands alone."""

    map_from_local: SE3
    walls: float
    flats: float
    blocked: float
    residual_m: float
    information: F64
    tightness: float = 1.0

    @property
    def quality(self) -> float:
        """The share of the walls that is explained, minus twice that of the rays which should not have come through; less where it lies beside the walls rather than on them."""
        return (self.walls - 2.0 * self.blocked) * self.tightness

    @property
    def lenient_quality(self) -> float:
        """The same where much has been taken away since the map was made: there rays go through what stood at the right place, and a contradiction says less than what is explained."""
        return (self.walls - LENIENT * self.blocked) * self.tightness


def compared(matches: Sequence[CloudMatch]) -> tuple[CloudMatch, ...]:
    """Return the places of one sight with their tightness, the best first: where things were moved rays go through what is gone at the right place, too, but there the walls that
    are left fit to centimetres."""
    most = max((match.walls for match in matches), default=0.0)
    least = min((match.residual_m for match in matches if match.walls >= AS_MANY * most), default=0.0)
    own = [replace(match, tightness=min(1.0, least / max(match.residual_m, 1e-6))) for match in matches]
    return tuple(sorted(own, key=lambda match: -match.quality))


def register_coarsely(cloud_map: CloudMap, local: LocalCloud, start: SE3, config: CloudMatchConfig) -> SE3:
    """Return map_from_local from a start within the coarse reach, to within the fine one."""
    return _aligned(cloud_map, local.coarse, start, config.coarse_reach, config.coarse_rounds)


def register(cloud_map: CloudMap, local: LocalCloud, start: SE3, config: CloudMatchConfig) -> SE3:
    """Return map_from_local, refined from a start within the fine reach."""
    return _aligned(cloud_map, local.fine, start, config.fine_reach, config.fine_rounds)


def _aligned(cloud_map: CloudMap, source: small_gicp.PointCloud, start: SE3, reach: float, rounds: int) -> SE3:
    result = small_gicp.align(
        cloud_map.target,
        source,
        cloud_map.tree,
        start.matrix(),
        registration_type="GICP",
        max_correspondence_distance=reach,
        max_iterations=rounds,
    )
    matrix = np.asarray(result.T_target_source)
    return to_se3(matrix[:3, 3].copy(), matrix[:3, :3])


def judge(cloud_map: CloudMap, local: LocalCloud, map_from_local: SE3, config: CloudMatchConfig) -> CloudMatch:
    """Say what a pose explains."""
    matrix = map_from_local.matrix()
    placed = np.ascontiguousarray(local.points @ matrix[:3, :3].T + matrix[:3, 3])
    planes, is_plane = cloud_map.surfaces.fit_planes(placed)
    normals_local = planes[:, :3] @ matrix[:3, :3]
    off = np.einsum("ij,ij->i", planes[:, :3], placed) + planes[:, 3]
    faces = np.abs(np.einsum("ij,ij->i", normals_local, local.normals)) > config.facing
    explained = is_plane & faces & (np.abs(off) < config.near) & (local.kinds > 0)
    is_wall, is_flat = local.kinds == WALL, local.kinds == FLAT
    on_walls = off[explained & is_wall]
    rows = np.concatenate([np.cross(local.points, normals_local), normals_local], axis=1)[explained]
    rays = np.flatnonzero(is_wall)
    rays = rays[:: max(1, len(rays) // RAYS)]
    origins = local.origins[rays] @ matrix[:3, :3].T + matrix[:3, 3]
    return CloudMatch(
        map_from_local,
        _share(explained, is_wall) if np.count_nonzero(is_wall) >= WALLS_LEAST else 0.0,
        _share(explained, is_flat),
        cloud_map.blocked(origins, placed[rays]) / max(len(rays), 1),
        float(np.sqrt(np.mean(on_walls**2))) if len(on_walls) else math.inf,
        rows.T @ rows,
    )


def tilt_of(map_from_local: SE3) -> float:
    """Return the angle between the two verticals, rad."""
    return math.acos(min(1.0, float(map_from_local.matrix()[2, 2])))


def apart(a: SE3, b: SE3) -> tuple[float, float]:
    """Return how far two poses lie from each other, metres and radians."""
    between = a.inverse() @ b
    return math.dist(a.translation, b.translation), float(np.linalg.norm(log(between.matrix()[:3, :3])))


def turned(pose: SE3, delta: F64) -> SE3:
    """Return a pose perturbed on the right by rotation and translation, float64 (6,)."""
    angle = float(np.linalg.norm(delta[:3]))
    half = 0.5 * angle
    scale = math.sin(half) / angle if angle > 1e-12 else 0.5
    x, y, z = (scale * delta[:3]).tolist()
    tx, ty, tz = delta[3:].tolist()
    return pose @ SE3((tx, ty, tz), (math.cos(half), x, y, z))


def between(a: SE3, b: SE3) -> F64:
    """Return the perturbation float64 (6,) on the right that takes one pose to another."""
    step = a.inverse() @ b
    return np.concatenate([log(step.matrix()[:3, :3]), step.translation])


def _share(explained: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
    count = int(np.count_nonzero(among))
    return float(np.count_nonzero(explained & among)) / count if count else 0.0
