"""From detections to one pose of the dock: a Kalman filter on a standing thing, seen from a base that odometry carries.

The state is `odom_from_dock`. It stands still, except that odometry drifts: its covariance grows with the way driven. A detection farther
off than the gate allows is an outlier; when several outliers agree with one another, the filter was wrong and starts again
there. What was not seen for a while, or over some way, is told no more, and the next sighting that is elsewhere takes its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.covariance import adjoint, difference
from ambler.docking.detection import DockDetection

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TrackerConfig:
    """`gate`: chi-squared (3 degrees of freedom) of the largest accepted surprise. `floor`: standard deviations (m, rad) that no single
    detection is better than: errors repeat from picture to picture. `drift`: of odometry, per metre (m, rad) and per radian
    (m, rad), as of wheels alone; beside a gyroscope `gyro_share` of its turning is left (0.2 % of the turning, 0.05° per slow metre). `max_age`, `max_travel`: seconds and metres after which an unseen dock is unknown. `restart`: so many outliers in
    a row that agree begin anew. `first`: so many detections before anything is told."""

    gate: float = 16.3
    floor: tuple[float, float] = (0.001, math.radians(0.1))
    drift_per_metre: tuple[float, float] = (0.01, math.radians(0.5))
    drift_per_radian: tuple[float, float] = (0.005, math.radians(0.5))
    gyro_share: float = 0.2
    max_age: float = 5.0
    max_travel: float = 0.5
    restart: int = 4
    first: int = 2
    max_latency: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class DockTrack:
    """Where the dock is: `base_from_dock` now with covariance (3, 3), seconds and metres since it was last seen, and how many
    detections are in it."""

    base_from_dock: SE2
    covariance: F64
    age: float
    travel: float
    sightings: int


class DockTracker:
    """Filters the detections of one dock, from a base whose odometry hears a gyroscope or not."""

    def __init__(self, config: TrackerConfig | None = None, *, has_gyroscope: bool = False) -> None:
        self.config = config if config is not None else TrackerConfig()
        self._yaw_share = self.config.gyro_share if has_gyroscope else 1.0
        self.reset()

    def reset(self) -> None:
        """Forget the dock."""
        self._odom_from_dock: SE2 | None = None
        self._covariance = np.zeros((3, 3))
        self._stamp_ns = 0
        self._last_base: SE2 | None = None
        self._travel = 0.0
        self._count = 0
        self._outliers: list[SE2] = []
        self.rejected = 0
        """How many detections were refused so far."""

    def update(self, detection: DockDetection, odom_from_base: SE2, now_ns: int) -> bool:
        """Take a detection and the base's pose at its stamp; returns whether it was used. Stale and impossible ones are dropped."""
        age = (now_ns - detection.stamp_ns) * 1e-9
        values = np.concatenate((detection.base_from_dock.as_array(), detection.covariance.reshape(-1)))
        is_old = self._odom_from_dock is not None and detection.stamp_ns <= self._stamp_ns
        if not 0.0 <= age <= self.config.max_latency or is_old or not np.isfinite(values).all():
            self.rejected += 1
            return False
        self._drift(odom_from_base)
        seen = odom_from_base @ detection.base_from_dock
        place, turn = self.config.floor
        noise = detection.covariance + np.diag([place, place, turn]) ** 2
        if self._odom_from_dock is None:
            self._begin(seen, noise, detection.stamp_ns)
            return True
        d = difference(self._odom_from_dock, seen)
        spread = self._covariance + noise
        if float(d @ np.linalg.solve(spread, d)) > self.config.gate:
            return self._doubt(seen, noise, detection.stamp_ns)
        gain = self._covariance @ np.linalg.inv(spread)
        step = gain @ d
        self._odom_from_dock = self._odom_from_dock @ SE2(float(step[0]), float(step[1]), float(step[2]))
        rest = np.eye(3) - gain
        self._covariance = rest @ self._covariance @ rest.T + gain @ noise @ gain.T
        self._stamp_ns, self._travel, self._outliers = detection.stamp_ns, 0.0, []
        self._count += 1
        return True

    def move(self, odom_from_base: SE2) -> None:
        """Take the newest pose of the base; call it at the rate of odometry or of the controller."""
        self._drift(odom_from_base)

    def track(self, now_ns: int, odom_from_base: SE2) -> DockTrack | None:
        """Return where the dock is in the base frame; None when it was never seen often enough, or not for too long."""
        if self._odom_from_dock is None or self._count < self.config.first:
            return None
        self._drift(odom_from_base)
        age = (now_ns - self._stamp_ns) * 1e-9
        if self._is_forgotten(age):
            return None
        pose = odom_from_base.inverse() @ self._odom_from_dock
        return DockTrack(pose, self._covariance.copy(), age, self._travel, self._count)

    def expected(self, odom_from_base: SE2) -> SE2 | None:
        """Return `base_from_dock` as a prior for detectors, however old; None when the dock was never seen."""
        return None if self._odom_from_dock is None else odom_from_base.inverse() @ self._odom_from_dock

    def _begin(self, odom_from_dock: SE2, covariance: F64, stamp_ns: int) -> None:
        self._odom_from_dock, self._covariance, self._stamp_ns = odom_from_dock, covariance, stamp_ns
        self._travel, self._count, self._outliers = 0.0, 1, []

    def _is_forgotten(self, age: float) -> bool:
        return age > self.config.max_age or self._travel > self.config.max_travel

    def _doubt(self, seen: SE2, noise: F64, stamp_ns: int) -> bool:
        self.rejected += 1
        agree = [o for o in self._outliers if o.distance_to(seen) < 0.05 and abs(wrap_angle(o.yaw - seen.yaw)) < 0.1]
        self._outliers = [*agree, seen]
        is_forgotten = self._is_forgotten((stamp_ns - self._stamp_ns) * 1e-9)
        if len(self._outliers) < self.config.restart and not is_forgotten:
            return False
        self._begin(seen, noise, stamp_ns)
        return True

    def _drift(self, odom_from_base: SE2) -> None:
        """Grow the covariance by the way since the last call; the dock turns about the base, so its distance is a lever."""
        last, self._last_base = self._last_base, odom_from_base
        if last is None or self._odom_from_dock is None:
            return
        way, turn = last.distance_to(odom_from_base), abs(wrap_angle(odom_from_base.yaw - last.yaw))
        self._travel += way
        c = self.config
        place = c.drift_per_metre[0] * way + c.drift_per_radian[0] * turn
        angle = self._yaw_share * (c.drift_per_metre[1] * way + c.drift_per_radian[1] * turn)
        # A random walk whose spread after a metre is the drift of one metre.
        unit = max(1e-9, way + turn)
        lever = adjoint((odom_from_base.inverse() @ self._odom_from_dock).inverse())
        growth = np.diag([place, place, angle]) ** 2 / unit
        self._covariance = self._covariance + lever @ growth @ lever.T
