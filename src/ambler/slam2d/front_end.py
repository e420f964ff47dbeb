"""Local SLAM: predict, correlate, refine against the older active submap, insert when the robot has moved."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.registration.correlative import Window, correlate
from ambler.registration.gauss_newton import MatchResult, refine
from ambler.registration.planar_scan import PlanarScan, filter_voxels, filter_voxels_adaptively
from ambler.slam2d.config import FrontEndConfig
from ambler.slam2d.submaps import ActiveSubmaps, Submap

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class LocalResult:
    """One scan in the local frame. `match` is None for the first scan and for scans without points; `submaps` took the scan."""

    local_from_base: SE2
    match: MatchResult | None
    scan: PlanarScan
    match_points: F32
    submaps: list[Submap]
    finished: Submap | None


class FrontEnd:
    """Matches and inserts scans; knows nothing of the global frame."""

    def __init__(self, config: FrontEndConfig) -> None:
        self._config = config
        self.active = ActiveSubmaps(config.insertion, config.scans_per_submap)
        self._inserted: tuple[int, SE2] | None = None
        self._usual_score = 0.0

    def update(self, scan: PlanarScan, prediction: SE2, motion: SE2, is_measured: bool) -> LocalResult:
        """Match one scan near the predicted local_from_base; `motion` is the predicted motion since the last scan."""
        config = self._config
        scan = replace(scan, points=filter_voxels(scan.points, config.voxel_size))
        points = filter_voxels_adaptively(scan.points, config.match_max_voxel, config.match_min_points)
        pose, match = prediction, None
        target = self.active.target
        if target is not None and len(points) >= 10:
            match = self._match(target, points, prediction, self._window(motion, is_measured))
            pose = target.local_from_submap @ match.grid_from_base
        submaps: list[Submap] = []
        finished = None
        if len(scan.points) >= 10 and self._has_moved(scan.stamp_ns, pose):
            submaps, finished = self.active.insert(scan, pose)
            self._inserted = (scan.stamp_ns, pose)
        return LocalResult(pose, match, scan, points, submaps, finished)

    def _window(self, motion: SE2, is_measured: bool) -> Window:
        config = self._config
        gain = config.window_gain if is_measured else 1.0
        linear = config.window_linear if is_measured else config.blind_window_linear
        angular = config.window_angular if is_measured else config.blind_window_angular
        return Window(
            min(linear + gain * SE2().distance_to(motion), max(linear, config.window_linear_max)),
            min(angular + gain * abs(motion.yaw), config.window_angular_max),
        )

    def _match(self, target: Submap, points: F32, prediction: SE2, window: Window) -> MatchResult:
        config = self._config
        prior = target.to_submap(prediction)
        start = correlate(target.grid, points, prior, window).grid_from_base
        match = refine(target.grid, points, start, prior, config.refine)
        if match.score < self._usual_score - config.rescue_score_drop:
            wide = Window(config.window_linear_max, config.window_angular_max)
            start = correlate(target.grid, points, prior, wide).grid_from_base
            rescued = refine(target.grid, points, start, prior, config.refine)
            if rescued.score > match.score:
                match = rescued
        self._usual_score += 0.05 * (match.score - self._usual_score)
        return match

    def _has_moved(self, stamp_ns: int, pose: SE2) -> bool:
        config = self._config
        if self._inserted is None:
            return True
        last_ns, last = self._inserted
        return (
            (stamp_ns - last_ns) * 1e-9 > config.motion_time
            or last.distance_to(pose) > config.motion_distance
            or abs(wrap_angle(pose.yaw - last.yaw)) > config.motion_angle
        )
