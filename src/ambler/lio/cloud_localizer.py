"""Localization in a saved cloud: the place is looked for, then followed. Odometry runs on; at a low rate what was seen lately is registered to
the map and corrects map_from_odom by a Kalman filter on SE(3), so that what the map does not determine stays with the odometry.

The map never changes, so the error does not grow with time. No threads: whoever calls decides what waits for a search.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.lio.cloud_map import CloudMap
from ambler.lio.cloud_match import CloudMatch, apart, between, judge, register, turned
from ambler.lio.cloud_relocalizer import CloudRelocalizer, CloudState
from ambler.lio.config import CloudLocalizerConfig, CloudTrackerConfig
from ambler.lio.sight import LaidScan, Sight

F64 = NDArray[np.float64]
START_SIGMAS = np.array([0.02, 0.02, 0.02, 0.1, 0.1, 0.1])  # rad and m: what a registration is off by at first


@dataclass(frozen=True, slots=True, eq=False)
class CloudPose:
    """Where the IMU is in the map at a scan's end; None for both until it was found. `match` is the registration or search of this scan, if there was one.
    `covariance` float64 (6, 6) is that of translation and rotation about the axes of the odometry's frame, None where the pose is."""

    stamp_ns: int
    state: CloudState
    map_from_imu: SE3 | None
    map_from_odom: SE3 | None
    match: CloudMatch | None = None
    covariance: F64 | None = None


class CloudLocalizer:
    """Give it every result of the odometry. `guess` is map_from_imu at the first one."""

    def __init__(
        self, cloud_map: CloudMap, config: CloudLocalizerConfig | None = None, guess: SE3 | None = None
    ) -> None:
        self.map = cloud_map
        self.config = config or CloudLocalizerConfig()
        self._relocalizer = self._looking(guess)
        self._tracker: CloudTracker | None = None
        self._was_found = False

    def update(self, result: LaidScan) -> CloudPose:
        """Look for the place, or follow it; lost, it is looked for in the whole map again."""
        if self._tracker is None:
            search = self._relocalizer.update(result)
            match = search.matches[0] if search.matches else None
            if search.state is not CloudState.FOUND or match is None:
                state = CloudState.LOST if self._was_found and search.state is CloudState.GATHERING else search.state
                return CloudPose(result.stamp_ns, state, None, None, match)
            self._was_found = True
            map_from_odom = match.map_from_local @ search.odom_from_local.inverse()
            self._tracker = CloudTracker(self.map, self.config, map_from_odom, result)
            return self._told(result, CloudState.FOUND, self._tracker, match)
        match = self._tracker.update(result)
        if self._tracker.is_lost:
            self._tracker = None
            self._relocalizer = self._looking(None)
            return CloudPose(result.stamp_ns, CloudState.LOST, None, None, match)
        return self._told(result, CloudState.TRACKING, self._tracker, match)

    def _told(self, result: LaidScan, state: CloudState, tracker: CloudTracker, match: CloudMatch | None) -> CloudPose:
        shown = tracker.map_from_odom
        return CloudPose(result.stamp_ns, state, shown @ result.map_from_imu, shown, match, tracker.covariance)

    @property
    def is_tracking(self) -> bool:
        """Whether the place is known: then a scan takes milliseconds, while a search takes seconds."""
        return self._tracker is not None

    def search_again(self, guess: SE3 | None) -> None:
        """Forget the place and look for it anew; `guess` is map_from_imu at the next scan."""
        self._tracker = None
        self._relocalizer = self._looking(guess)

    def _looking(self, guess: SE3 | None) -> CloudRelocalizer:
        return CloudRelocalizer(self.map, self.config.relocalizer, self.config.match, guess)


class CloudTracker:
    """Follows map_from_odom. The state is the pose of `local` (see `Sight`) in the map with a covariance of rotation and translation on the right."""

    def __init__(self, cloud_map: CloudMap, config: CloudLocalizerConfig, map_from_odom: SE3, result: LaidScan) -> None:
        self._map, self._match = cloud_map, config.match
        self.config: CloudTrackerConfig = config.tracker
        self._sight = Sight(config.match, self.config.scans)
        self._estimate = self.map_from_odom = map_from_odom
        self._covariance = np.diag(START_SIGMAS**2)
        self._at, self._last_ns = np.array(result.map_from_imu.translation), result.stamp_ns
        self._next_ns = result.stamp_ns + round(self.config.period * 1e9)
        self._misses = 0

    @property
    def is_lost(self) -> bool:
        """Whether too many registrations in a row have failed."""
        return self._misses >= self.config.misses_most

    @property
    def covariance(self) -> F64:
        """Covariance (6, 6) of translation and rotation about the axes of the odometry's frame."""
        order = [3, 4, 5, 0, 1, 2]
        return self._covariance[np.ix_(order, order)]

    def update(self, result: LaidScan) -> CloudMatch | None:
        """Carry the estimate on, register where it is time to, and let what is told follow; returns the registration."""
        self._sight.add(result)
        self._carry(result)
        match = None
        if result.stamp_ns >= self._next_ns and len(self._sight) >= min(self.config.scans, 5):
            self._next_ns = result.stamp_ns + round(self.config.period * 1e9)
            match = self._correct()
        self._follow(result)
        return match

    def _carry(self, result: LaidScan) -> None:
        """Let the covariance grow by what the odometry may have drifted; `local` moves with the IMU, and so do its errors."""
        c, here = self.config, np.array(result.map_from_imu.translation)
        step, seconds = here - self._at, 1e-9 * (result.stamp_ns - self._last_ns)
        self._dt = max(seconds, 0.0)
        lever = np.eye(6)
        x, y, z = step
        lever[3:, :3] = -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        way = float(np.linalg.norm(step))
        turn = c.turn**2 * way + c.idle_turn**2 * self._dt
        walk = c.walk**2 * way + c.idle_walk**2 * self._dt
        self._covariance = lever @ self._covariance @ lever.T + np.diag([turn] * 3 + [walk] * 3)
        self._at, self._last_ns = here, result.stamp_ns

    def _correct(self) -> CloudMatch:
        """Register and update; what does not fit changes nothing."""
        c = self.config
        local = self._sight.gathered(c.scans)
        predicted = self._estimate @ local.odom_from_local
        pose = register(self._map, local, predicted, self._match)
        match = judge(self._map, local, pose, self._match)
        off, turn = apart(predicted, pose)
        if match.quality < c.accept or off > c.jump or turn > c.jump_turn:
            self._misses += 1
            return match
        self._misses = 0
        information = match.information / c.noise**2
        innovation = between(predicted, pose)
        self._covariance = np.linalg.inv(np.linalg.inv(self._covariance) + information)
        self._covariance = 0.5 * (self._covariance + self._covariance.T)
        corrected = turned(predicted, self._covariance @ (information @ innovation))
        self._estimate = corrected @ local.odom_from_local.inverse()
        return match

    def _follow(self, result: LaidScan) -> None:
        """Move what is told towards the estimate, where the sensor is: far from the odometry's origin a small turn is a long way."""
        place = SE3(result.map_from_imu.translation)
        share = 1.0 - math.exp(-self._dt / self.config.smooth)
        shown = (self.map_from_odom @ place).interpolate(self._estimate @ place, share)
        self.map_from_odom = shown @ place.inverse()
