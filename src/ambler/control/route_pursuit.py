"""Pure pursuit of a prescribed route (Coulter 1992): the arc through a point of the route a little ahead, in the plane, whatever the
ground below does.

Progress along the route only grows, so that a route may cross itself, or run back over itself on another level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RoutePursuitConfig:
    """Numbers of the pursuit, SI.

    lookahead, lookahead_time   the point ahead lies so many metres plus seconds at the wanted speed along the route
    spacing            metres between two points of the route at which progress is measured
    search             metres of the route ahead of the progress so far among which the nearest point is looked for
    turn_angle         beyond this angle (rad) to the point ahead the base turns in place
    turn_gain          yaw rate per radian while it does
    braking            deceleration (m/s²) with which it comes to the end
    tolerance          distance (m) to the last point at which the route is done
    lost_distance      distance (m) from the route at which nobody follows it any more
    """

    lookahead: float = 0.5
    lookahead_time: float = 0.5
    spacing: float = 0.05
    search: float = 2.0
    turn_angle: float = 0.8
    turn_gain: float = 1.5
    braking: float = 0.4
    tolerance: float = 0.15
    lost_distance: float = 2.0


class RoutePursuit:
    """Follows waypoints (x, y) of one frame at `speed` m/s."""

    def __init__(
        self,
        points: Sequence[tuple[float, float]],
        speed: float,
        limits: VelocityLimits,
        config: RoutePursuitConfig | None = None,
    ) -> None:
        self._config = config if config is not None else RoutePursuitConfig()
        self._limits = limits
        self._speed = min(speed, limits.vx_max)
        self._route = _evenly_spaced(np.array(points, np.float64), self._config.spacing)
        self._at = 0
        self._off = 0.0
        self._is_turning = False

    @property
    def left(self) -> float:
        """Metres of the route that are left."""
        return (len(self._route) - 1 - self._at) * self._config.spacing

    @property
    def is_done(self) -> bool:
        """Whether the end is reached."""
        return self.left <= self._config.tolerance

    @property
    def is_lost(self) -> bool:
        """Whether the base is too far from the route to follow it."""
        return self._off > self._config.lost_distance

    def compute_command(self, pose: SE2) -> BodyVelocity:
        """Return the velocity for a base at a pose in the route's frame."""
        config, limits = self._config, self._limits
        self._locate(pose)
        if self.is_done or self.is_lost:
            return BodyVelocity()
        ahead = config.lookahead + config.lookahead_time * self._speed
        target = self._route[min(self._at + round(ahead / config.spacing), len(self._route) - 1)]
        x, y = pose.inverse().transform(target[None, :])[0].tolist()
        angle, distance = math.atan2(y, x), math.hypot(x, y)
        self._is_turning = abs(angle) > (0.3 * config.turn_angle if self._is_turning else config.turn_angle)
        if self._is_turning:
            rate = min(config.turn_gain * abs(angle), limits.wz_max)
            return BodyVelocity(0.0, 0.0, math.copysign(rate, angle))
        curvature = 2.0 * math.sin(angle) / max(distance, config.tolerance)
        speed = min(self._speed, math.sqrt(2.0 * config.braking * self.left))
        if abs(curvature) * speed > 0.8 * limits.wz_max:
            speed = 0.8 * limits.wz_max / abs(curvature)
        return BodyVelocity(speed * math.cos(angle), 0.0, speed * curvature)

    def _locate(self, pose: SE2) -> None:
        part = self._route[self._at : self._at + round(self._config.search / self._config.spacing) + 1]
        off = np.hypot(part[:, 0] - pose.x, part[:, 1] - pose.y)
        nearest = int(np.argmin(off))
        self._at, self._off = self._at + nearest, float(off[nearest])


def _evenly_spaced(points: F64, spacing: float) -> F64:
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    count = max(2, round(float(along[-1]) / spacing) + 1)
    at = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(at, along, points[:, k]) for k in range(2)])
