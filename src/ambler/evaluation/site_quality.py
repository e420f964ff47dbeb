"""How much of a site with three dimensions a robot has mapped, from its recording and its levels of ground, against the truth of the simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE
from ambler.core.messages import Odometry, PointCloud, PoseStamped, Transforms
from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import SpatialError, spatial_error, truth_at
from ambler.evaluation.station_quality import StationQuality
from ambler.runtime.topics import REGISTERED_VIEW, SLAM_POSE, TRANSFORMS, TRUE_POSE
from ambler.sim.reachable_ground import ReachableGround
from ambler.wire.ground_files import GroundLevel
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

F64 = NDArray[np.float64]
SAME_LEVEL = 0.7  # metres between a height in the map and the true one that are of one level
NEAR = 0.4  # metres from a true surface within which a point of the map shows it
BESIDE = 0.25  # metres from true ground within which ground of the map is no mistake: two cells and what a map bends
GAP = 0.2  # seconds between true poses


@dataclass(frozen=True, slots=True, eq=False)
class SiteRecord:
    """What a run tells of itself: poses of the base in the map, true ones in the world, and points (N, 3) of its clouds in the map."""

    stamps_ns: NDArray[np.int64]
    poses: Sequence[SE3]
    true_ns: NDArray[np.int64]
    true_poses: Sequence[SE3]
    points: F64


@dataclass(frozen=True, slots=True, eq=False)
class SiteQuality:
    """Shares: of the ground that the robot can reach that its map holds as ground; of the ground in the map that is none; of the visible surface that its
    clouds show. `error` is that of its trajectory, `height_range` (m) of what it climbed; `missed` (N, 3) places and `unseen` (N, 3) points of the truth that the map lacks. `known_tour` (m): the round of somebody who knows the site; `stations`: None where none were wanted."""

    ground_coverage: float
    false_ground: float
    surface_coverage: float
    levels: int
    reachable_m2: float
    surface_points: int
    error: SpatialError
    height_range: float
    missed: F64
    unseen: F64
    known_tour: float | None = None
    stations: StationQuality | None = None


def read_site(recording: Path, cell: float = 0.2) -> SiteRecord:
    """Read a run; its clouds are thinned to one point in each cube of `cell` metres. Raises BadInputError when the recording cannot be read."""
    stamps: list[int] = []
    poses: list[SE3] = []
    true_ns: list[int] = []
    true_poses: list[SE3] = []
    map_from_odom: SE3 | None = None
    seen: set[bytes] = set()
    kept: list[F64] = []
    wanted = (TRUE_POSE, SLAM_POSE, REGISTERED_VIEW, TRANSFORMS)
    types = {topic.ros_name: topic.type for topic in wanted}
    for recorded in read_recording(recording, list(types)):
        message = decode(types[recorded.topic], recorded.data)
        if isinstance(message, Odometry):
            true_ns.append(message.stamp_ns)
            true_poses.append(message.pose)
        elif isinstance(message, PoseStamped):
            stamps.append(message.stamp_ns)
            poses.append(message.pose)
        elif isinstance(message, Transforms):
            edges = [e for e in message.transforms if (e.parent, e.child) == ("map", "odom")]
            map_from_odom = edges[0].parent_from_child if edges else map_from_odom
        elif isinstance(message, PointCloud) and map_from_odom is not None:
            placed = np.asarray(map_from_odom.transform(message.points.astype(np.float64)))
            keys = np.floor(placed / cell).astype(np.int32)
            names = [key.tobytes() for key in keys]
            fresh = [k for k, name in enumerate(names) if name not in seen]
            seen.update(names)
            kept.append(placed[fresh])
    points = np.concatenate(kept) if kept else np.zeros((0, 3))
    return SiteRecord(np.array(stamps, np.int64), poses, np.array(true_ns, np.int64), true_poses, points)


def judge_site(record: SiteRecord, levels: Sequence[GroundLevel], ground: ReachableGround, surface: F64) -> SiteQuality:
    """Compare with the truth, after the best rigid motion of the trajectory. `surface` (N, 3) in the world. Raises BadInputError when no pose has a truth."""
    error = spatial_error(record.stamps_ns, record.poses, record.true_ns, record.true_poses, max_gap=GAP)
    world_from_map = aligned(record)
    places = ground.places()
    is_covered = _is_ground(world_from_map.inverse().transform(places), levels)
    shown = np.asarray(world_from_map.transform(record.points))
    is_seen: NDArray[np.bool_] = np.zeros(len(surface), np.bool_)
    if len(shown):
        is_seen = np.asarray(cKDTree(shown).query(surface, distance_upper_bound=NEAR)[0] <= NEAR)
    return SiteQuality(
        ground_coverage=_share(is_covered),
        false_ground=_false_ground(levels, ground, world_from_map),
        surface_coverage=_share(is_seen),
        levels=len(levels),
        reachable_m2=len(places) * ground.spec.resolution**2,
        surface_points=len(surface),
        error=error,
        height_range=float(np.ptp([pose.translation[2] for pose in record.true_poses])),
        missed=places[~is_covered],
        unseen=surface[~is_seen],
    )


def _share(is_true: NDArray[np.bool_]) -> float:
    return float(np.mean(is_true)) if len(is_true) else 0.0


def aligned(record: SiteRecord) -> SE3:
    """Return world_from_map, the first true pose upright where the map begins, moved and turned about the vertical as fits the whole way best."""
    pairs: list[tuple[SE3, SE3]] = [
        (pose, true)
        for stamp, pose in zip(record.stamps_ns.tolist(), record.poses, strict=True)
        if (true := truth_at(stamp, record.true_ns, record.true_poses, GAP)) is not None
    ]
    if not pairs:
        raise BadInputError("no pose of the map has a true pose at its time")
    told = np.array([pose.translation for pose, _ in pairs])
    known = np.array([pose.translation for _, pose in pairs])
    begun = pairs[0][1].to_se2() @ pairs[0][0].to_se2().inverse()
    start = SE3.from_rpy((begun.x, begun.y, float(np.mean(known[:, 2] - told[:, 2]))), 0.0, 0.0, begun.yaw)
    moved = np.asarray(start.transform(told))
    a, b = moved[:, :2] - moved[:, :2].mean(axis=0), known[:, :2] - known[:, :2].mean(axis=0)
    turn = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    turned = SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, turn)
    shift = known[:, :2].mean(axis=0) - np.asarray(turned.transform(moved))[:, :2].mean(axis=0)
    return SE3((float(shift[0]), float(shift[1]), 0.0)) @ turned @ start


def _is_ground(places: F64, levels: Sequence[GroundLevel]) -> NDArray[np.bool_]:
    """Say which places (N, 3) in the map are ground of one of its levels."""
    out = np.zeros(len(places), np.bool_)
    for spec, occupancy, heights in levels:
        cells = spec.cells_of(places[:, :2])
        inside = ((cells >= 0) & (cells < spec.shape)).all(axis=1)
        iy, ix = cells[inside].T
        same = np.abs(heights[iy, ix] - places[inside, 2]) <= SAME_LEVEL
        out[inside] |= (occupancy[iy, ix] == OCC_FREE) & same
    return out


def _false_ground(levels: Sequence[GroundLevel], ground: ReachableGround, world_from_map: SE3) -> float:
    """Return the share of the map's ground without true ground at its height nearby."""
    reach = round(BESIDE / ground.spec.resolution)
    disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= reach
    wrong = total = 0
    for spec, occupancy, heights in levels:
        iy, ix = np.nonzero((occupancy == OCC_FREE) & np.isfinite(heights))
        xy = spec.centers_of(np.column_stack((iy, ix)))
        points: F64 = np.column_stack((xy, heights[iy, ix].astype(np.float64)))
        points = np.asarray(world_from_map.transform(points), np.float64)
        cells = ground.spec.cells_of(points[:, :2])
        inside = ((cells >= 0) & (cells < ground.spec.shape)).all(axis=1)
        wanted = np.full(ground.spec.shape, np.nan)
        wanted[cells[inside, 0], cells[inside, 1]] = points[inside, 2]
        with np.errstate(invalid="ignore"):
            is_true = (np.abs(ground.heights - wanted) <= SAME_LEVEL).any(axis=0)
        near = ndimage.binary_dilation(is_true, disc)
        total += len(points)
        wrong += len(points) - int(np.count_nonzero(near[cells[inside, 0], cells[inside, 1]]))
    return wrong / total if total else 0.0
