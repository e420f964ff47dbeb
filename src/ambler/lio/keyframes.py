"""Stretches of the way as submaps: each a bounded cloud in the frame of the LiDAR in its middle, as the odometry laid it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.lio.cloud_file import CloudFile, KeptPoints
from ambler.lio.config import DriftConfig, LioConfig
from ambler.lio.drift import Drift
from ambler.lio.health import LioResult
from ambler.lio.state import log
from ambler.registration.submap_match import SubmapCloud, ThinCloud, thin_cloud

F64 = NDArray[np.float64]
THINNED = 40  # scans after which the points so far are thinned out, so that memory stays bounded
GROWTH = 1.25
STEP = 0.02  # m between two poses that may become the middle


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """`odom_from_keyframe` float64 (4, 4) is the LiDAR's pose at the scan in its middle, as the odometry had it, at `stamp_ns`, after `way` metres. `cloud` lies in
    the keyframe; `up` (3,) is the direction against gravity there, good to `up_sigma` rad, None: unknown. `covariance` (6, 6) is that of
    the drift that is reckoned with on as long a way, perturbed on the right of its end. `is_at_rest`: the scanner had not moved yet."""

    stamp_ns: int
    way: float
    odom_from_keyframe: F64
    cloud: SubmapCloud
    up: F64 | None
    covariance: F64
    up_sigma: float = 0.0
    is_at_rest: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _FiledCloud:
    """A submap's cloud on the disk."""

    kept: KeptPoints
    cell: float

    @property
    def points(self) -> NDArray[np.float32]:
        return self.kept.read()


class KeyframeBuilder:
    """Takes the odometry's results one by one and gives a keyframe whenever a stretch is complete."""

    def __init__(self, config: LioConfig) -> None:
        self._loops = config.loops
        self._way = 0.0
        self._last: F64 | None = None
        self._stands = True  # at the very beginning, before the first step
        self._begin: F64 | None = None
        self._track: list[tuple[int, float, F64]] = []  # stamp, way and pose along the stretch
        self._parts: list[NDArray[np.float32]] = []
        self._may_drift = _allowed(config)
        self._drift = Drift(self._may_drift)
        self._up, self._ups, self._up_sigma = np.zeros(3), 0, 0.0
        self._file = CloudFile()

    def add(self, result: LioResult) -> Keyframe | None:
        """Take a scan's result; returns the stretch that it ended, which does not hold it."""
        pose = result.map_from_lidar.matrix()
        out = None
        if self._stands and not result.health.is_at_rest:
            out = self.finish(self._last)
            self._stands = False
        if self._last is not None:
            self._way += float(np.linalg.norm(pose[:3, 3] - self._last[:3, 3]))
            if self._begin is not None and not self._stands and self._is_complete(pose):
                out = self.finish(pose)
        if self._begin is None:
            self._begin = pose
        elif self._last is not None:
            self._drift.move(pose[:3, 3] - self._last[:3, 3], result.health.frozen_translation)
        if not self._track or self._way - self._track[-1][1] > STEP:
            self._track.append((result.stamp_ns, self._way, pose))
        self._last = pose
        self._add(result, pose)
        return out

    def finish(self, end: F64 | None = None) -> Keyframe | None:
        """Return what there is of the running stretch, which ends at a pose (4, 4); None: there is nothing."""
        if self._begin is None or not self._parts:
            return None
        end = self._begin if end is None else end
        halfway = 0.5 * (self._track[0][1] + self._track[-1][1])
        stamp_ns, way, pose = min(self._track, key=lambda at: abs(at[1] - halfway))
        middle_from_begin = np.linalg.inv(pose) @ self._begin
        up = None if self._ups == 0 else middle_from_begin[:3, :3] @ self._up / np.linalg.norm(self._up)
        thin = self._cloud(middle_from_begin)
        cloud = _FiledCloud(self._file.put(thin.points), thin.cell)
        frame = Keyframe(stamp_ns, way, pose, cloud, up, self._covariance(end), self._up_sigma, self._stands)
        self._restart()
        return frame

    def _restart(self) -> None:
        self._begin, self._parts, self._track = None, [], []
        self._drift = Drift(self._may_drift)
        self._up, self._ups = np.zeros(3), 0

    def _is_complete(self, pose: F64) -> bool:
        assert self._begin is not None
        turn = float(np.linalg.norm(log(self._begin[:3, :3].T @ pose[:3, :3])))
        return self._way - self._track[0][1] >= self._loops.keyframe_m or turn >= self._loops.keyframe_rad

    def _add(self, result: LioResult, pose: F64) -> None:
        assert self._begin is not None
        keyframe_from_odom = np.linalg.inv(self._begin)
        points = result.imu_from_lidar.inverse().transform(result.points_imu)
        near = points[np.einsum("ij,ij->i", points, points) < self._loops.range_most**2]
        # Who stands is where he was: the rings of a scanner at rest leave gaps, and its attitude sways by half a milliradian, which 200 m on is a decimetre.
        relative = np.eye(4) if self._stands else keyframe_from_odom @ pose
        self._parts.append((near @ relative[:3, :3].T + relative[:3, 3]).astype(np.float32))
        if result.up_imu is not None:
            self._up += relative[:3, :3] @ np.array(result.imu_from_lidar.inverse().rotate(_tuple(result.up_imu)))
            self._ups += 1
            self._up_sigma = result.up_sigma  # a bias is common to all scans of a stretch: no smaller for many
        if len(self._parts) >= THINNED:
            self._parts = [self._cloud(np.eye(4)).points]

    def _cloud(self, frame_from_begin: F64) -> ThinCloud:
        points, cell = (
            np.concatenate(self._parts) @ frame_from_begin[:3, :3].T + frame_from_begin[:3, 3],
            self._loops.cell,
        )
        cloud = thin_cloud(points, cell)
        while len(cloud.points) > self._loops.points_most:
            cell *= GROWTH
            cloud = thin_cloud(points, cell)
        return cloud

    def _covariance(self, end: F64) -> F64:
        """Return the drift's covariance (6, 6) along the stretch, in the axes of its end."""
        covariance = self._drift.covariance(end[:3, :3])
        turned = np.eye(6)
        turned[:3, :3] = end[:3, :3].T
        covariance = turned @ covariance @ turned.T
        least = np.repeat(np.square(self._loops.odometry_least), 3)
        return np.asarray(covariance + np.diag(least))


def _allowed(config: LioConfig) -> DriftConfig:
    drift, loops = config.drift, config.loops
    walk, coasted = loops.drift_factor, loops.coasting_factor
    return replace(
        drift, position=walk * drift.position, rotation=walk * drift.rotation, coasting=coasted * drift.coasting
    )


def _tuple(v: F64) -> tuple[float, float, float]:
    x, y, z = v.tolist()
    return (x, y, z)
