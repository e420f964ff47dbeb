"""Tracks the pose by matching every scan to the map's surfaces and fusing the match with odometry (after neo_localization2).

Unlike its model it matches against the near face of walls, so thin and filled walls give the same pose; several starts are
tried only while the pose is uncertain; directions that the scan does not determine stay with odometry and their variance grows.
The state is (x, y, yaw) and the depth of the real surfaces behind the mapped ones, which every scan of opposite walls refines.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.core.units import Radians
from ambler.localization.errors import NoPoseError
from ambler.localization.localizer import INITIAL_COVARIANCE, Estimate, Mode, Observation
from ambler.localization.matcher import MatcherConfig, MatchResult, ScanMatcher, fuse
from ambler.localization.motion import OdometryNoise, predict, require_valid
from ambler.localization.surface_map import SurfaceMap

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

PUSH_SPEED = 1.5  # m/s at which somebody who walks into the robot moves it while its wheels tell nothing
PUSH_TURN = 1.5  # rad/s
WIDEST = 25.0  # m²: a pose as uncertain as this is not made more uncertain by scans that it does not believe


@dataclass(frozen=True, slots=True)
class GridTrackerConfig:
    """`min_score`, `min_points`: below them the scan is not used; below `sure_score` more starts are tried, spread by at most
    `lattice_most` (m). `gate`: largest surprise that is believed at once. `depth_sigma`: spread of the surface depth before anything was seen, in cells. `novelty_*`: way and turn after which the map's errors count as new."""

    matcher: MatcherConfig = field(default_factory=MatcherConfig)
    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    min_score: float = 0.3
    min_points: int = 20
    gate: float = 12.0
    sure_score: float = 0.5
    lattice_most: float = 0.5
    depth_sigma: float = 0.3
    novelty_way: float = 0.7
    novelty_turn: Radians = 0.5


class GridTracker:
    """A `Localizer` by scan matching."""

    def __init__(self, surface_map: SurfaceMap, config: GridTrackerConfig) -> None:
        self.config = config
        self._matcher = ScanMatcher(surface_map, config.matcher)
        self._cell = surface_map.spec.resolution
        self._covariance = np.zeros((4, 4))
        self._depth = 0.0
        self._odom_from_base = SE2()
        self._novelty = 1.0
        self._is_locked = False
        self._matched_ns = 0
        self._estimate: Estimate | None = None

    @property
    def estimate(self) -> Estimate | None:
        """The last estimate, or None before the first pose."""
        return self._estimate

    @property
    def depth(self) -> tuple[float, float]:
        """How far the real surfaces lie behind the mapped ones, and its standard deviation, metres."""
        return self._depth, math.sqrt(self._covariance[3, 3])

    def set_pose(
        self, stamp_ns: int, odom_from_base: SE2, map_from_base: SE2, covariance: F64 = INITIAL_COVARIANCE
    ) -> None:
        """Start again from a pose; raises InvalidPoseError."""
        require_valid(map_from_base, covariance)
        if self._estimate is None:
            self._covariance[3, 3] = (self.config.depth_sigma * self._cell) ** 2
        depth_variance = self._covariance[3, 3]
        self._covariance = np.zeros((4, 4))
        self._covariance[:3, :3] = covariance
        self._covariance[3, 3] = depth_variance
        self._odom_from_base = odom_from_base
        self._novelty = 1.0
        self._is_locked = False
        self._matched_ns = stamp_ns
        self._estimate = Estimate(stamp_ns, map_from_base, covariance.copy(), 0.0, Mode.ODOMETRY, 0.0, False)

    def request_update(self) -> None:
        """Nothing to do: every observation is used, also while the robot stands."""

    def update(self, observation: Observation) -> Estimate:
        """Predict by odometry, match, fuse."""
        if self._estimate is None:
            raise NoPoseError("give the grid tracker a pose first: set_pose, or a relocalization")
        config = self.config
        motion = self._odom_from_base.inverse() @ observation.odom_from_base
        predicted = self._predict(self._estimate.map_from_base, motion)
        self._odom_from_base = observation.odom_from_base
        points = self._matcher.thin(observation.points_base)
        result = None
        if len(points) >= config.min_points:
            result = self._match(points, predicted)
        self._estimate = self._fuse(observation.stamp_ns, predicted, result, points)
        return self._estimate

    def _predict(self, pose: SE2, motion: SE2) -> SE2:
        config = self.config
        moved, covariance = predict(pose, self._covariance[:3, :3], motion, config.odometry)
        turn = np.eye(3)
        turn[0, 2], turn[1, 2] = pose.y - moved.y, moved.x - pose.x
        self._covariance[:3, :3] = covariance
        self._covariance[:3, 3] = turn @ self._covariance[:3, 3]
        self._covariance[3, :3] = self._covariance[:3, 3]
        way = math.hypot(motion.x, motion.y)
        self._covariance[3, 3] += (5e-4) ** 2 * way
        gained = way / config.novelty_way + abs(motion.yaw) / config.novelty_turn
        self._novelty = min(1.0, self._novelty + gained)
        return moved

    def _match(self, points: F32, predicted: SE2) -> MatchResult:
        """Match from the prediction; from a lattice of starts while the pose is new or when the single start fails."""
        config = self.config
        center = np.array([predicted.x, predicted.y, predicted.yaw, self._depth])
        depth_variance = self._covariance[3, 3]
        if self._is_locked:
            result = self._matcher.match(points, center[None], depth_variance)
            if result.score >= config.sure_score:
                return result
        return self._matcher.match(points, self._lattice(center), depth_variance)

    def _lattice(self, center: F64) -> F64:
        """Starts over the spread of the pose: along both axes of the ellipse 0 and +-1.2 sigma, yaw 0, +-1.2 and +-2.4 sigma."""
        values, vectors = np.linalg.eigh(self._covariance[:2, :2])
        steps = 1.2 * np.minimum(np.sqrt(np.maximum(values, 0.0)), self.config.lattice_most)
        turn = 1.2 * min(math.sqrt(self._covariance[2, 2]), 0.3)
        starts = []
        for a, b, c in itertools.product((0, -1, 1), (0, -1, 1), (0, -1, 1, -2, 2)):
            offset = a * steps[0] * vectors[:, 0] + b * steps[1] * vectors[:, 1]
            starts.append(center + np.array([offset[0], offset[1], c * turn, 0.0]))
        return np.array(starts)

    def _fuse(self, stamp_ns: int, predicted: SE2, result: MatchResult | None, points: F32) -> Estimate:
        config = self.config
        if result is None or result.score < config.min_score or result.determined == 0:
            score = 0.0 if result is None else result.score
            return self._carried(stamp_ns, predicted, score, 0.0)
        prior = np.array([predicted.x, predicted.y, predicted.yaw, self._depth])
        fusion, away = fuse(prior, self._covariance, result), _difference(result.state, prior)
        if fusion.surprise > config.gate and self._is_push(stamp_ns, prior, result, points):
            fusion = fuse(prior, self._covariance + np.outer(away, away), result)
        if fusion.surprise > config.gate:
            self._doubt()
            self._is_locked = False
            spread = 0.5 * np.outer(away[:3], away[:3])
            return self._carried(stamp_ns, predicted, result.score, fusion.surprise, spread)
        self._covariance = fusion.covariance
        self._depth = float(fusion.state[3])
        self._matcher.learn(self._novelty)
        self._novelty = 0.0
        self._is_locked = True
        self._matched_ns = stamp_ns
        mode = Mode(result.determined)
        return Estimate(stamp_ns, fusion.map_from_base, fusion.published, result.score, mode, fusion.surprise, True)

    def _is_push(self, stamp_ns: int, prior: F64, result: MatchResult, points: F32) -> bool:
        """Say whether odometry missed a motion: a match that surprises explains clearly more than the prediction, and lies no farther from it than
        somebody who walks into the robot can have moved it since the last match. Wheels that are pushed or slip tell nothing of it."""
        seconds = 1e-9 * (stamp_ns - self._matched_ns)
        away = _difference(result.state, prior)
        if math.hypot(away[0], away[1]) > PUSH_SPEED * seconds or abs(away[2]) > PUSH_TURN * seconds:
            return False
        return self._matcher.explains_more(result, prior, points)

    def _doubt(self) -> None:
        """Widen pose and depth after a match that was not believed. The depth, too: in a made map it is another one where a wall was drawn by
        another visit, and a pose alone, however wide, cannot explain a match of which the depth is what surprises."""
        grown = np.full(4, math.sqrt(3.0) if np.trace(self._covariance[:2, :2]) < WIDEST else 1.0)
        widest = self.config.depth_sigma * self._cell
        grown[3] = min(math.sqrt(3.0), max(1.0, widest / math.sqrt(self._covariance[3, 3])))
        self._covariance *= np.outer(grown, grown)

    def _carried(
        self, stamp_ns: int, predicted: SE2, score: float, surprise: float, spread: F64 | None = None
    ) -> Estimate:
        """Tell the prediction; `spread` float64 (3, 3) is added while it may as well be where a refused match says."""
        covariance = self._covariance[:3, :3] + (np.zeros((3, 3)) if spread is None else spread)
        return Estimate(stamp_ns, predicted, covariance, score, Mode.ODOMETRY, surprise, False)


def _difference(state: F64, prior: F64) -> F64:
    away = state - prior
    away[2] = wrap_angle(float(away[2]))
    return away
