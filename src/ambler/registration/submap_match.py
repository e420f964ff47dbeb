"""Lays one submap on another with small_gicp (generalized ICP: Segal, Haehnel and Thrun 2009), and says how well it lies and which directions are weak.

Information is that of point-to-plane residuals of unit noise at the end, (6, 6), translation first, perturbed on the right of target_from_source.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import small_gicp
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
KEPT = 12  # clouds that are kept ready, 8 MB each
NEIGHBORS = 12  # points that make a normal: a patch of three to four cells
PASSES = (
    1.0,
    0.25,
    0.1,
)  # shares of the reach within which points are paired, one pass after the other: wide pairs lead from afar, but pull sideways by centimetres
JUDGED = 0.25  # share of the reach within which a point has a partner at the end
STILL = (2e-4, 2e-5)  # m and rad of a step that ends a pass; small_gicp's own angle, 0.1 degrees, is 5 cm at 30 m
LEAST = 1e-3  # m; robust deviations below which all pairs count
SAMPLE = 1500  # points that tell how much overlaps
COARSER = 2.0  # times the cell, of the points of the first pass: a quarter as many
FEW_LEAST = 2000  # of them; with less all lead
DOUBT = 0.8  # of the overlap that is asked at the end: less, after the first pass, never becomes enough
OUTLIER = 3.0  # robust standard deviations of a residual beyond which a pair says nothing of directions


class SubmapCloud(Protocol):
    """Points of a submap, one per `cell`. A thousand of them are kept for a long way, so what a match needs besides, thirty times as much, is made when it is wanted."""

    @property
    def points(self) -> F32:
        """float32 (M, 3)."""
        ...

    @property
    def cell(self) -> float:
        """Metres."""
        ...

    def __hash__(self) -> int:
        """Tell it from others: what was made ready for a match is kept under it."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ThinCloud:
    """A submap's cloud in memory."""

    points: F32
    cell: float


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """`points` float64 (M, 3) with unit `normals` (M, 3), ready to be matched; `few` are fewer, which lead the first pass."""

    points: F64
    normals: F64
    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree
    few: small_gicp.PointCloud


@dataclass(frozen=True, slots=True, eq=False)
class CloudMatch:
    """`target_from_source` float64 (4, 4); `overlap`: share of the source's points that have one of the target nearer than a quarter of the reach;
    `residual_m`: how far these lie from the target's planes (1.48 of the median); `pairs` of them count in `information`."""

    target_from_source: F64
    information: F64
    overlap: float
    residual_m: float
    pairs: int
    converged: bool


def thin_cloud(points: NDArray[np.floating], cell: float) -> ThinCloud:
    """Thin points (N, 3) out to one per cell, their mean."""
    thin = small_gicp.voxelgrid_sampling(np.ascontiguousarray(points, np.float64), cell)
    return ThinCloud(np.ascontiguousarray(thin.points()[:, :3], np.float32), cell)


@functools.lru_cache(maxsize=KEPT)
def _prepared(submap: SubmapCloud) -> _Prepared:
    """Return what a match needs of a cloud. The last ones are kept: a new submap is tried with several, the next one with nearly the same."""
    points = submap.points.astype(np.float64)
    cloud = small_gicp.PointCloud(points)
    tree = small_gicp.KdTree(cloud)
    small_gicp.estimate_normals_covariances(cloud, tree, NEIGHBORS)
    few, _ = small_gicp.preprocess_points(
        points, downsampling_resolution=COARSER * submap.cell, num_neighbors=NEIGHBORS
    )
    if few.size() < FEW_LEAST:
        few = cloud
    return _Prepared(points, np.ascontiguousarray(cloud.normals()[:, :3]), cloud, tree, few)


def match_clouds(
    target_cloud: SubmapCloud, source_cloud: SubmapCloud, guess: F64, reach: float, overlap_least: float = 0.0
) -> CloudMatch | None:
    """Match from a guess of target_from_source (4, 4); points within `reach` metres are paired first, nearer ones then.

    None: a sample of the source shows that less than `overlap_least` will overlap, before the guess is refined or after a pass of few points.
    """
    target, source = _prepared(target_cloud), _prepared(source_cloud)
    pose, converged = guess, False
    sample = source.points[:: max(1, len(source.points) // SAMPLE)]
    if _overlap(target, sample, pose, reach) < overlap_least:
        return None
    for share in PASSES:
        moving = source.cloud if share < 1.0 else source.few
        result = small_gicp.align(
            *(target.cloud, moving, target.tree, pose),
            max_correspondence_distance=share * reach,
            max_iterations=60,
            translation_epsilon=STILL[0],
            rotation_epsilon=STILL[1],
        )
        # From the optimum itself no step leads on, and small_gicp calls that not converged.
        stays = converged and bool(np.abs(np.asarray(result.T_target_source) - pose).max() < STILL[1])
        pose, converged = np.asarray(result.T_target_source), bool(result.converged) or stays
        if _overlap(target, sample, pose, JUDGED * reach) < DOUBT * overlap_least:
            return None
    placed = source.points @ pose[:3, :3].T + pose[:3, 3]
    nearest, squares = target.tree.batch_nearest_neighbor_search(placed)
    is_near = np.asarray(squares) < (JUDGED * reach) ** 2
    if is_near.sum() < 6:
        return CloudMatch(pose, np.zeros((6, 6)), float(is_near.mean()), np.inf, 0, False)
    index = np.asarray(nearest, np.int64)[is_near]
    normals = target.normals[index]
    off = np.einsum("ij,ij->i", normals, placed[is_near] - target.points[index])
    sigma = 1.4826 * float(np.median(np.abs(off)))
    counts = np.abs(off) <= OUTLIER * max(sigma, LEAST)
    local = normals[counts] @ pose[:3, :3]
    rows = np.concatenate([local, np.cross(source.points[is_near][counts], local)], axis=1)
    return CloudMatch(pose, rows.T @ rows, float(is_near.mean()), sigma, int(counts.sum()), converged)


def _overlap(target: _Prepared, points: F64, pose: F64, within: float) -> float:
    """Return the share of the points (N, 3) that have one of the target within some metres."""
    _, squares = target.tree.batch_nearest_neighbor_search(points @ pose[:3, :3].T + pose[:3, 3])
    return float(np.mean(np.asarray(squares) < within**2))
