"""Omnidirectional pursuit with the behaviour of neo_local_planner (navigation reference 7.1).

Along the path the robot drives like a differential one: it looks along the path, turns, and an omnidirectional base also slides back
onto it. Near the goal it moves along all axes at once. It never leaves its path to get around anything: near obstacles push it
a little aside and slow it down, what lies in its way stops it. Where the original looks at points of a centre line, the
filled footprint is moved along the arc here.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.control.local_window import LocalWindow
from ambler.control.passing import passing_discs
from ambler.control.path_tracker import PathTracker
from ambler.control.pursuit_config import PursuitConfig
from ambler.control.trajectory_rollout import approach_limit
from ambler.core.errors import InvalidPathError, NoValidControlError
from ambler.core.grid import GridSpec
from ambler.core.movers import NOBODY, Movers
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels.arc import free_arc

F64 = NDArray[np.float64]
SHOWN = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)  # seconds of a motion that are shown


class OmniPursuit:
    """A local planner (core.protocols.LocalPlanner) for differential and omnidirectional bases."""

    def __init__(self, config: PursuitConfig, robot: RobotModel) -> None:
        self._config = config
        self._limits = robot.limits
        self._is_omni = robot.drive is DriveKind.OMNI and robot.limits.vy_max > 0.0
        self._window = LocalWindow(robot, config.padding)
        self._outline = _samples_of(robot.footprint, 0.1)
        self._tracker = PathTracker()
        self._turn_sign = 0.0
        self._is_turning = self._is_sliding = False
        self._has_arrived = False
        self._last: tuple[SE2, BodyVelocity] | None = None
        self._movers = NOBODY

    @property
    def trajectory(self) -> F64:
        """The arc of the last command over a second, float64 (N, 3) of (x, y, yaw) in the odom frame; empty before the first."""
        if self._last is None:
            return np.zeros((0, 3))
        odom_from_base, v = self._last
        twist = np.array([v.vx, v.vy, v.wz])
        return np.array([(odom_from_base @ SE2.exp(twist * t)).as_array() for t in SHOWN])

    @property
    def path_left(self) -> float:
        """Arc length of the path that is left, metres."""
        return self._tracker.length - self._tracker.along if len(self._tracker.points) else 0.0

    def reset(self) -> None:
        """Forget the path and everything remembered about it."""
        self._tracker = PathTracker()
        self._is_turning = self._is_sliding = self._has_arrived = False
        self._last = None

    def set_path(self, path_odom: F64) -> None:
        """Take a new path float64 (N, 3); raises InvalidPathError."""
        if not self._tracker.set_path(path_odom):
            self._is_turning = self._is_sliding = self._has_arrived = False

    def set_movers(self, movers: Movers) -> None:
        """Take the movers of now, in the odom frame; they count until the next call."""
        self._movers = movers

    def compute_command(
        self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity
    ) -> BodyVelocity:
        """Return the wanted velocity; raises NoValidControlError when an obstacle stops a resting robot."""
        if len(self._tracker.points) == 0:
            raise InvalidPathError("there is no path to follow")
        self._window.update(costs, spec)
        lead = np.array([velocity.vx, velocity.vy, velocity.wz]) * self._config.reaction_time
        start = odom_from_base @ SE2.exp(lead)
        left = self._tracker.locate(start)
        is_resting = math.hypot(velocity.vx, velocity.vy) < 0.1
        self._last = None
        command = self._checked(self._wanted(start, left, is_resting), start, is_resting)
        self._last = odom_from_base, command
        return command

    def _wanted(self, start: SE2, left: float, is_resting: bool) -> BodyVelocity:
        """The law without obstacles in the way."""
        if self._is_omni:
            goal = start.inverse() @ self._tracker.goal
            if left < self._config.goal_distance and math.hypot(goal.x, goal.y) < 2.0 * self._config.goal_distance:
                return self._to_goal(start, goal)
        elif self._arrives(start, left):
            error = wrap_angle(self._tracker.goal.yaw - start.yaw)
            if abs(error) < self._config.arrive_yaw or not is_resting:
                return BodyVelocity()
            return BodyVelocity(0.0, 0.0, self._turn_rate(start, error))
        return self._along(start, left, is_resting)

    def _along(self, start: SE2, left: float, is_resting: bool) -> BodyVelocity:
        c, lim = self._config, self._limits
        reach = max(0.1, min(c.lookahead + c.lookahead_time * lim.vx_max * 0.5, left))
        x, y = self._tracker.point_at(reach)
        error = 0.0
        if math.hypot(x - start.x, y - start.y) > c.arrive_radius:
            error = wrap_angle(math.atan2(y - start.y, x - start.x) - start.yaw)
        self._is_turning = abs(error) > (c.end_yaw if self._is_turning else c.start_yaw)
        if self._is_turning:
            return self._turn_or_slide(start, error, is_resting)
        self._turn_sign, self._is_sliding = 0.0, False
        aside, push = self._aside(start), self._push(start) - self._give_way(start)
        speed = min(lim.vx_max, self._approach_speed(left), self._clear_speed(start))
        speed = min(speed, c.curve_speed * reach / max(abs(error), 1e-6))
        if self._is_omni:
            vy = min(lim.vy_max, speed) * math.tanh((c.pos_y_gain * aside + push) / max(lim.vy_max, 1e-6))
            wz = c.yaw_gain * error
        else:
            vy = 0.0
            wz = c.yaw_gain * error + c.lateral_gain * aside * speed + c.cost_yaw_gain * push / max(speed, 0.3)
        return BodyVelocity(speed, vy, float(np.clip(wz, -lim.wz_max, lim.wz_max)))

    def _turn_or_slide(self, start: SE2, error: float, is_resting: bool) -> BodyVelocity:
        """Turn in place towards the path; where there is no room for that, an omnidirectional base moves along it without turning until there is."""
        if not is_resting and not self._is_sliding:
            return BodyVelocity()
        try:
            rate = self._turn_rate(start, error)
        except NoValidControlError:
            lim = self._limits
            if not self._is_omni or lim.vx_min >= 0.0:
                raise
            self._is_sliding = True
            most_x = lim.vx_max if math.cos(error) > 0.0 else -lim.vx_min
            shares = ((abs(math.cos(error)), most_x), (abs(math.sin(error)), lim.vy_max))
            speed = min(self._clear_speed(start), *(most / share for share, most in shares if share > 1e-6))
            return BodyVelocity(speed * math.cos(error), speed * math.sin(error), 0.0)
        self._is_sliding = False
        return BodyVelocity(0.0, 0.0, rate if is_resting else 0.0)

    def _to_goal(self, start: SE2, goal: SE2) -> BodyVelocity:
        """Move along all axes to the goal; each slows down so that it can stop there."""
        c, lim = self._config, self._limits
        away = math.hypot(goal.x, goal.y)
        yaw = goal.yaw
        if self._has_arrived:
            self._has_arrived = away < 1.5 * c.xy_tolerance and abs(yaw) < 1.5 * c.yaw_tolerance
        else:
            self._has_arrived = away < 0.6 * c.xy_tolerance and abs(yaw) < 0.6 * c.yaw_tolerance
        if self._has_arrived:
            return BodyVelocity()
        brake = min(lim.ax_brake, lim.ay_brake) * c.brake_share
        speed = min(c.pos_gain * away, approach_limit(away, brake, c.reaction_time + 0.05), self._clear_speed(start))
        speed = max(speed, c.creep) if away > 0.3 * c.xy_tolerance else 0.0
        ux, uy = (goal.x / away, goal.y / away) if away > 1e-9 else (0.0, 0.0)
        most_x = lim.vx_max if ux > 0.0 else -lim.vx_min
        for share, most in ((abs(ux), most_x), (abs(uy), lim.vy_max)):
            speed = min(speed, most / share) if share > 1e-6 else speed
        wz = 0.0
        if abs(yaw) > 0.3 * c.yaw_tolerance:
            wz = self._yaw_speed(yaw)
        return BodyVelocity(speed * ux, speed * uy, wz)

    def _yaw_speed(self, error: float) -> float:
        c, lim = self._config, self._limits
        rate = min(
            c.static_yaw_gain * abs(error), approach_limit(abs(error), lim.az_max * c.brake_share, c.reaction_time)
        )
        return math.copysign(min(lim.wz_max, max(c.creep_yaw, rate)), error)

    def _turn_rate(self, start: SE2, error: float) -> float:
        """Turn in place: the shorter way if it is free, else the other; raises NoValidControlError when neither is."""
        if self._turn_sign == 0.0 or abs(error) < 0.5 * math.pi:
            self._turn_sign = math.copysign(1.0, error)
        turns = [error, error - math.copysign(2.0 * math.pi, error)]
        turns.sort(key=lambda turn: turn * self._turn_sign < 0.0)
        for turn in turns:
            if abs(self._window.free_turn(start, turn)) >= abs(turn) - 1e-9:
                self._turn_sign = math.copysign(1.0, turn)
                limit = approach_limit(
                    abs(turn), self._limits.az_max * self._config.brake_share, self._config.reaction_time
                )
                rate = min(self._limits.wz_max, max(0.1, limit))
                return math.copysign(rate, turn)
        raise NoValidControlError("there is no room to turn")

    def _arrives(self, start: SE2, left: float) -> bool:
        """Whether a differential base has its goal below it, or beside it where it cannot reach it any more."""
        goal = start.inverse() @ self._tracker.goal
        away = math.hypot(goal.x, goal.y)
        if self._has_arrived:
            self._has_arrived = away < 2.0 * self._config.pass_radius
        elif left < 2.0 * self._config.pass_radius:
            is_passed = (
                abs(math.atan2(goal.y, goal.x)) > self._config.start_yaw or left < 0.5 * self._config.arrive_radius
            )
            self._has_arrived = away < 0.5 * self._config.arrive_radius or (
                away < self._config.pass_radius and is_passed
            )
        return self._has_arrived

    def _aside(self, start: SE2) -> float:
        """Return how far to the left of the robot its path runs, metres."""
        x, y = self._tracker.point_at(0.0)
        offset = start.inverse() @ SE2(x, y, 0.0)
        return float(np.clip(offset.y, -0.5, 0.5))

    def _approach_speed(self, left: float) -> float:
        c = self._config
        brake = self._limits.ax_brake * c.brake_share
        return max(0.06, approach_limit(left, brake, c.reaction_time + 0.05))

    def _clearance(self, place: SE2) -> float:
        """Return how far the outline of the footprint is from lethal cells, metres, at most 1."""
        w = self._window
        spec = w.spec
        points = place.transform(self._outline)
        iy = np.clip(((points[:, 1] - spec.origin_y) / spec.resolution).astype(int), 0, spec.height - 1)
        ix = np.clip(((points[:, 0] - spec.origin_x) / spec.resolution).astype(int), 0, spec.width - 1)
        return float(np.clip(w.distance[iy, ix].min() - 0.5 * spec.resolution, 0.0, 1.0))

    def _clear_speed(self, start: SE2) -> float:
        """Near obstacles the robot is slow: here and a little ahead."""
        c = self._config
        room = min(self._clearance(start), self._clearance(start @ SE2(0.3, 0.0, 0.0)))
        share = min(1.0, room / c.near)
        return c.near_speed + share * max(0.0, self._limits.vx_max - c.near_speed)

    def _push(self, start: SE2) -> float:
        """Return the velocity to the left that near obstacles ask for, m/s: the gradient of the clearance, where it is small."""
        left, right = self._clearance(start @ SE2(0.15, 0.05, 0.0)), self._clearance(start @ SE2(0.15, -0.05, 0.0))
        nearness = max(0.0, 1.0 - min(left, right) / self._config.near)
        return self._config.cost_gain * nearness * float(np.clip((left - right) / 0.1, -1.0, 1.0))

    def _give_way(self, start: SE2) -> float:
        """Return the velocity to the right by which the robot passes who comes towards it, m/s: the sooner they meet the more, as far as
        there is room at its right."""
        c, soonest = self._config, math.inf
        for x, y, vx, vy, *_ in passing_discs(self._movers, c.reaction_time):
            place = start.inverse() @ SE2(float(x), float(y), 0.0)
            away = math.hypot(place.x, place.y)
            closing = -(vx * (x - start.x) + vy * (y - start.y)) / max(away, 1e-9)
            if place.x > 0.0 and abs(place.y) < c.give_way_width and closing > 0.0:
                soonest = min(soonest, away / (closing + self._limits.vx_max))
        room = min(1.0, self._clearance(start @ SE2(0.15, -0.15, 0.0)) / c.near)
        return c.give_way_gain * room * max(0.0, 1.0 - soonest / c.give_way_seconds)

    def _checked(self, wanted: BodyVelocity, start: SE2, is_resting: bool) -> BodyVelocity:
        """Slow down on the same arc so that the robot stops before what lies on it."""
        c, lim = self._config, self._limits
        speed = math.hypot(wanted.vx, wanted.vy)
        if speed < 1e-9:
            return wanted
        fastest = speed + abs(wanted.wz) * self._window.radius
        brake = lim.ax_brake * c.brake_share
        horizon = c.reaction_time + speed / brake + c.min_stop / speed + 0.5
        w, twist = self._window, np.array([wanted.vx, wanted.vy, wanted.wz])
        free = free_arc(w.placed(start), twist, horizon, 0.025 / fastest, w.cells, w.outline)
        if free >= horizon:
            return wanted
        limit = approach_limit(free * speed - c.min_stop, brake, c.reaction_time + 0.05)
        scale = min(1.0, limit / speed)
        if scale * speed < 0.02:
            if is_resting:
                raise NoValidControlError("an obstacle lies in the way, and this controller does not leave its path")
            scale = 0.0
        return BodyVelocity(wanted.vx * scale, wanted.vy * scale, wanted.wz * scale)


def _samples_of(polygon: F64, spacing: float) -> F64:
    """Return points (M, 2) along the outline of a polygon (N, 2)."""
    parts = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        count = max(1, math.ceil(float(np.hypot(*(b - a))) / spacing))
        parts.append(a + (b - a) * np.arange(count)[:, None] / count)
    return np.concatenate(parts)
