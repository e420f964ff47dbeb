"""The path follower: pure pursuit on a short path, for differential, omnidirectional and legged bases (navigation reference 1.6).

The base turns towards the point ahead while it drives, or holds its heading and slides. It slows down towards the end of its way, where clearance is
small, on rough ground and on a lean; it stops before what lies on its arc, and on a lean from which it could fall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.control.local_window import LocalWindow
from ambler.core.protocols import BodyVelocity, Lean
from ambler.core.robot import DriveKind, RobotModel
from ambler.core.se2 import SE2, wrap_angle
from ambler.core.units import Radians
from ambler.kernels.arc import free_arc
from ambler.kernels.rollout import clearance_at

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FollowerConfig:
    """Numbers of the follower, SI.

    period             between two commands
    lookahead, lookahead_time   the point ahead lies so many metres plus seconds at the present speed along the path
    yaw_gain           yaw rate per radian to the point ahead
    curve_speed        m/s at which one radian to the point ahead may be turned while driving
    speed_min          slowest motion worth commanding
    brake_share        share of the deceleration limits used on purpose
    reaction_time      that the stop zone counts on
    min_stop           metres kept from what stops the robot
    near_speed, speed_per_clearance   speed (m/s) at no clearance, and how much more per metre of it
    slow_rates         shares of the speed on rough, and on very rough ground
    slow_lean, stop_lean   roll or pitch (rad) from which on the robot is slow, and stands: steps and ramps stay below 20°, and a base of half a metre that
                       carries its mass low falls beyond 40°
    lean_rate          roll or pitch rate (rad/s) that slows the robot down for `slow_time`: what shakes it so is worse than it looked
    slow_time, stop_time   seconds for which that holds, and for which it stands after a lean
    off_time           seconds by which the base may lag behind what was asked for, before the ramp begins anew at what it does
    """

    period: float = 0.05
    lookahead: float = 0.35
    lookahead_time: float = 0.25
    yaw_gain: float = 2.5
    curve_speed: float = 0.45
    speed_min: float = 0.06
    brake_share: float = 0.6
    reaction_time: float = 0.1
    min_stop: float = 0.03
    near_speed: float = 0.3
    speed_per_clearance: float = 3.5
    slow_rates: tuple[float, float] = (0.5, 0.25)
    slow_lean: Radians = math.radians(20.0)
    stop_lean: Radians = math.radians(30.0)
    lean_rate: Radians = math.radians(120.0)
    slow_time: float = 2.0
    stop_time: float = 5.0
    off_time: float = 0.2


LEVEL = Lean()


def approach_limit(distance: float, deceleration: float, reaction_time: float) -> float:
    """Return the speed from which one can stop within `distance`, after reacting for `reaction_time`."""
    lost = deceleration * reaction_time
    return math.sqrt(lost * lost + 2.0 * deceleration * max(0.0, distance)) - lost


class PathFollower:
    """Follows points of the odom frame; `window` says what is free."""

    def __init__(self, config: FollowerConfig, robot: RobotModel, window: LocalWindow) -> None:
        self._config = config
        self._limits = robot.limits
        self._is_omni = robot.drive is DriveKind.OMNI and robot.limits.vy_max > 0.0
        self._window = window
        self._asked = BodyVelocity()
        self._slow_left = self._stop_left = 0.0
        self._slow_share = 1.0
        self.is_stopped_by_lean = False

    def reset(self) -> None:
        """Forget what was asked for last; what a lean stopped stays stopped."""
        self._asked = BodyVelocity()

    def set_lean(self, lean: Lean) -> None:
        """Take the lean of now, once per period."""
        c = self._config
        most = max(abs(lean.roll), abs(lean.pitch))
        if max(abs(lean.roll_rate), abs(lean.pitch_rate)) > c.lean_rate:
            self._slow_left = c.slow_time
        if most > c.stop_lean:
            self._stop_left = c.stop_time
        self._slow_share = 1.0
        if self._slow_left > 0.0:
            self._slow_share = c.slow_rates[1]
        elif most > c.slow_lean:
            self._slow_share = c.slow_rates[0]
        self.is_stopped_by_lean = self._stop_left > 0.0
        self._slow_left, self._stop_left = self._slow_left - c.period, self._stop_left - c.period

    @property
    def is_slowed_by_lean(self) -> bool:
        """Whether a lean slows the robot down."""
        return self._slow_share < 1.0

    def stand(self) -> BodyVelocity:
        """Return the command that brings the base to rest as it likes to."""
        return self._ramped(BodyVelocity())

    def turn(self, turn: float) -> BodyVelocity:
        """Turn in place by `turn` radians, which somebody has found free; a moving base comes to rest first."""
        c, lim = self._config, self._limits
        if math.hypot(self._asked.vx, self._asked.vy) > c.speed_min:
            return self.stand()
        limit = approach_limit(abs(turn), lim.az_max * c.brake_share, c.reaction_time)
        rate = min(lim.wz_max, max(0.15, limit)) * self._slow_share
        return self._ramped(BodyVelocity(0.0, 0.0, math.copysign(rate, turn)))

    def follow(
        self,
        path: F64,
        start: SE2,
        velocity: BodyVelocity,
        speed: float,
        *,
        holds: bool = False,
        backwards: bool = False,
    ) -> BodyVelocity | None:
        """Follow points (N, 2), the first where the base stands, no faster than `speed`; None when what lies ahead stops a resting base. It `holds` its heading,
        drives `backwards`, or looks along the path."""
        c, lim = self._config, self._limits
        self._catch_up(velocity)
        x, y, reach = self._ahead(path, start, math.hypot(velocity.vx, velocity.vy))
        bearing = wrap_angle(math.atan2(y - start.y, x - start.x) - start.yaw)
        speed = min(speed, self._clear_speed(start, bearing)) * self._slow_share
        if holds:
            wanted = self._sliding(bearing, speed)
        else:
            error = wrap_angle(bearing + math.pi) if backwards else bearing
            speed = min(speed, -lim.vx_min if backwards else lim.vx_max, c.curve_speed * reach / max(abs(error), 1e-6))
            speed = max(speed, c.speed_min)
            wz = min(lim.wz_max, max(-lim.wz_max, c.yaw_gain * error))
            wanted = BodyVelocity(-speed if backwards else speed, 0.0, wz)
        checked = self._checked(wanted, start, velocity)
        return None if checked is None else self._ramped(checked)

    def towards(self, goal: SE2, start: SE2, velocity: BodyVelocity, speed: float) -> BodyVelocity | None:
        """Move an omnidirectional base along all its axes to a pose that is in sight; None when what lies ahead stops a resting base."""
        c, lim = self._config, self._limits
        self._catch_up(velocity)
        offset = start.inverse() @ goal
        away = math.hypot(offset.x, offset.y)
        speed = min(speed, self._clear_speed(start, math.atan2(offset.y, offset.x))) * self._slow_share
        slide = self._sliding(math.atan2(offset.y, offset.x), speed)
        seconds = max(away / max(math.hypot(slide.vx, slide.vy), c.speed_min), 0.5)
        wz = min(0.5 * lim.wz_max, max(-0.5 * lim.wz_max, offset.yaw / seconds))
        checked = self._checked(BodyVelocity(slide.vx, slide.vy, wz), start, velocity)
        if checked is None:  # perhaps it is the turning that is in the way
            checked = self._checked(slide, start, velocity)
        return None if checked is None else self._ramped(checked)

    def _sliding(self, bearing: float, speed: float) -> BodyVelocity:
        lim, c, s = self._limits, math.cos(bearing), math.sin(bearing)
        most_x, most_y = lim.vx_max if c > 0.0 else -lim.vx_min, lim.vy_max
        for share, most in ((abs(c), most_x), (abs(s), most_y)):
            speed = min(speed, most / share) if share > 1e-6 else speed
        return BodyVelocity(speed * c, max(-most_y, min(most_y, speed * s)), 0.0)

    def _ahead(self, path: F64, start: SE2, moving: float) -> tuple[float, float, float]:
        """Return the point ahead on the path, and how far it is."""
        reach = self._config.lookahead + self._config.lookahead_time * moving
        away = np.hypot(path[:, 0] - start.x, path[:, 1] - start.y)
        first = int(np.argmin(away))
        beyond = np.flatnonzero(away[first:] >= reach)
        k = first + int(beyond[0]) if len(beyond) else len(path) - 1
        return float(path[k, 0]), float(path[k, 1]), max(0.1, float(away[k]))

    def _clear_speed(self, start: SE2, bearing: float) -> float:
        """Near obstacles the robot is slow: here and a little ahead."""
        w, c = self._window, self._config
        room = np.inf
        for ahead in (0.0, 0.3):
            gx, gy, yaw = w.placed(start @ SE2(ahead * math.cos(bearing), ahead * math.sin(bearing), 0.0))
            gap = clearance_at(gx, gy, math.cos(yaw), math.sin(yaw), w.outline.circles, w.distance, w.spec.resolution)
            room = min(room, float(gap))
        return c.near_speed + c.speed_per_clearance * max(0.0, room)

    def _checked(self, wanted: BodyVelocity, start: SE2, velocity: BodyVelocity) -> BodyVelocity | None:
        """Slow down on the same arc so that the robot stops before what lies on it."""
        c, lim, w = self._config, self._limits, self._window
        speed = math.hypot(wanted.vx, wanted.vy)
        if speed < 1e-9:
            return wanted
        fastest = speed + abs(wanted.wz) * w.radius
        brake = lim.ax_brake * c.brake_share
        horizon = c.reaction_time + speed / brake + c.min_stop / speed + 0.4
        twist = np.array([wanted.vx, wanted.vy, wanted.wz])
        free = free_arc(w.placed(start), twist, horizon, 0.025 / fastest, w.cells, w.outline)
        if free >= horizon:
            return wanted
        limit = approach_limit(free * speed - c.min_stop, brake, c.reaction_time + c.period)
        scale = min(1.0, limit / speed)
        if scale * speed < 0.02:
            if math.hypot(velocity.vx, velocity.vy) < 0.1:
                return None
            scale = 0.0
        return BodyVelocity(wanted.vx * scale, wanted.vy * scale, wanted.wz * scale)

    def _catch_up(self, velocity: BodyVelocity) -> None:
        """A base that was held (by the gate, by people) does not begin again at the speed that was asked for before."""
        lim, late, a = self._limits, self._config.off_time, self._asked
        self._asked = BodyVelocity(
            _within(a.vx, velocity.vx, lim.ax_max * late),
            _within(a.vy, velocity.vy, lim.ay_max * late),
            _within(a.wz, velocity.wz, lim.az_max * late),
        )

    def _ramped(self, wanted: BodyVelocity) -> BodyVelocity:
        """Return what the base's accelerations make of a wanted velocity within a period."""
        lim, dt, a = self._limits, self._config.period, self._asked
        self._asked = BodyVelocity(
            _ramp(a.vx, wanted.vx, lim.ax_max * dt, lim.ax_brake * dt),
            _ramp(a.vy, wanted.vy, lim.ay_max * dt, lim.ay_brake * dt),
            _ramp(a.wz, wanted.wz, lim.az_max * dt, lim.az_max * dt),
        )
        return self._asked


def _within(value: float, middle: float, reach: float) -> float:
    return min(max(value, middle - reach), middle + reach)


def _ramp(value: float, target: float, up: float, down: float) -> float:
    """Move a velocity towards another by `up` at most, by `down` while it falls; what is left of a period after a standstill is `up`'s."""
    if value * target < 0.0:
        if abs(value) >= down:
            return value - math.copysign(down, value)
        return math.copysign(min(abs(target), up * (1.0 - abs(value) / down)), target)
    step = down if abs(target) < abs(value) else up
    return value + math.copysign(min(step, abs(target - value)), target - value)
