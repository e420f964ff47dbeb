"""What the sensor saw lately, as one cloud: the points of the last scans laid together by the odometry, with the way each surface faces.

The frame `local` has the odometry's axes (z up) and its origin in the IMU at the newest scan.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import small_gicp
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.kernels.cloud_search import WALL
from ambler.lio.cloud_map import kinds_of
from ambler.lio.config import CloudMatchConfig, VoxelMapConfig
from ambler.lio.voxel_map import VoxelMap

F64 = NDArray[np.float64]
VOXELS = 1 << 15


class LaidScan(Protocol):
    """What localization looks at: a scan's points (M, 3) in the frame of the sensor, and where that is in a level frame that stands still; a LioResult is one."""

    @property
    def stamp_ns(self) -> int: ...

    @property
    def map_from_imu(self) -> SE3: ...

    @property
    def points_imu(self) -> F64: ...


@dataclass(frozen=True, slots=True, eq=False)
class SeenScan:
    """A scan that somebody else has registered."""

    stamp_ns: int
    map_from_imu: SE3
    points_imu: F64


@dataclass(frozen=True, slots=True, eq=False)
class LocalCloud:
    """`points` float64 (N, 3) in `local`, at most `points_most`, one per fine cell, each seen from `origins` (N, 3); `kinds` uint8 (N,) and `normals` (N, 3) of the surfaces they lie on.
    `coarse` and `fine` are the same points prepared for registration."""

    stamp_ns: int
    odom_from_local: SE3
    points: F64
    origins: F64
    kinds: NDArray[np.uint8]
    normals: F64
    coarse: small_gicp.PointCloud
    fine: small_gicp.PointCloud

    def walls(self) -> F64:
        """Return the points on walls, (M, 3)."""
        return np.asarray(self.points[self.kinds == WALL])


class Sight:
    """Keeps the points of at most `most` scans."""

    def __init__(self, config: CloudMatchConfig, most: int) -> None:
        self.config = config
        self._scans: deque[tuple[int, F64, F64]] = deque(maxlen=most)

    def __len__(self) -> int:
        return len(self._scans)

    def add(self, result: LaidScan) -> None:
        """Add a scan where the odometry places it."""
        points = result.points_imu
        near = np.einsum("ij,ij->i", points, points) < self.config.range_most**2
        pose = result.map_from_imu
        self._scans.append((result.stamp_ns, pose.transform(points[near]), np.array(pose.translation)))

    def clear(self) -> None:
        """Forget all."""
        self._scans.clear()

    def gathered(self, scans: int) -> LocalCloud:
        """Lay the newest scans together."""
        c, own = self.config, list(self._scans)[-scans:]
        here = own[-1][2]
        points = np.concatenate([p for _, p, _ in own]) - here
        origins = np.concatenate([np.broadcast_to(o - here, p.shape) for _, p, o in own])
        # The newest first, so that they are the ones that remain in their cells.
        points, origins = points[::-1], origins[::-1]
        surfaces = VoxelMap(VoxelMapConfig(voxels_most=VOXELS, radius=1e6))
        surfaces.insert(np.ascontiguousarray(points))
        cells = np.floor(points / c.fine_cell).astype(np.int64)
        _, first = np.unique(cells, axis=0, return_index=True)
        first = np.sort(first)[:: math.ceil(len(first) / c.points_most)]
        points, origins = np.ascontiguousarray(points[first]), np.ascontiguousarray(origins[first])
        planes, is_plane = surfaces.fit_planes(points)
        x, y, z = here.tolist()
        return LocalCloud(
            own[-1][0],
            SE3((x, y, z)),
            points,
            origins,
            kinds_of(planes, is_plane),
            planes[:, :3],
            _prepared(points, c.coarse_cell),
            _prepared(points, c.fine_cell),
        )


def _prepared(points: F64, cell: float) -> small_gicp.PointCloud:
    cloud, _ = small_gicp.preprocess_points(points, cell, 10)
    return cloud
