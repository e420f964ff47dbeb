"""Trajectory Rollout (navigation reference 4.3): simulate many wanted velocities with the base's accelerations, discard those
whose filled footprint touches a lethal cell, and take the one that gains most path at least cost.

Differences that experience asked for: the path grid only says which stretch of path is the nearest one around obstacles, the
distance to it is exact; the robot first turns in place when the path leads elsewhere; the speed towards the goal follows from
the deceleration; a trajectory must gain something, so a robot that is blocked says so instead of dithering.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ambler.control.config import RolloutConfig
from ambler.control.goal_turn import GoalTurn
from ambler.control.local_window import LocalWindow
from ambler.control.passing import passing_discs
from ambler.control.path_tracker import PathTracker
from ambler.control.velocity_samples import gliding_samples, velocity_samples
from ambler.core.errors import InvalidPathError, NoValidControlError
from ambler.core.grid import GridSpec
from ambler.core.movers import NOBODY, Movers
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels.path_place import cells_of_path, leads_too_near
from ambler.kernels.rollout import (
    COLUMNS,
    END_X,
    END_Y,
    END_YAW,
    FREE,
    MARKS_MAX,
    Guide,
    best_sample,
    locate_on_path,
    roll_out,
    spread_path,
)

F64 = NDArray[np.float64]

GAIN_MIN = 0.02  # metres that a trajectory must gain to be worth driving
SLOW = 1e-9  # m/s above the slowest sample: slower is not on offer
REFUSALS = 100  # samples about which somebody who refuses them is asked, the best first


class Ways(NamedTuple):
    """Wanted velocities float64 (N, 3), where they lead and the places on their ways, as `roll_out` tells them, and the path along which they are judged."""

    samples: F64
    out: F64
    marks: F64
    guide: Guide


def approach_limit(distance: float, deceleration: float, reaction_time: float) -> float:
    """Return the speed from which one can stop within `distance`, after reacting for `reaction_time`."""
    lost = deceleration * reaction_time
    return math.sqrt(lost * lost + 2.0 * deceleration * max(0.0, distance)) - lost


class TrajectoryRollout:
    """A local planner (core.protocols.LocalPlanner) for differential and omnidirectional bases."""

    def __init__(self, config: RolloutConfig, robot: RobotModel) -> None:
        self._config = config
        self._robot = robot
        self._limits = robot.limits
        self._window = LocalWindow(robot, config.padding)
        self._goal_turn = GoalTurn(config, robot, self._window)
        self._tracker = PathTracker()
        self._turn_target: str = ""
        self._turn_sign = 0.0
        self._has_arrived = False
        self._is_escaping = False
        self._movers = NOBODY
        self._is_refused: Callable[[BodyVelocity], bool] = lambda _: False
        self._top, self._grid = 0.0, np.zeros((0, 3))
        self.trajectory = np.zeros((0, 3))
        """Where the last command leads, float64 (N, 3) of (x, y, yaw) in the odom frame, for people to look at."""

    @property
    def path_left(self) -> float:
        """Arc length of the path that is left, metres."""
        return self._tracker.length - self._tracker.along if len(self._tracker.points) else 0.0

    def reset(self) -> None:
        """Forget the path and everything remembered about it."""
        self._tracker = PathTracker()
        self._has_arrived = False
        self._is_escaping = False
        self._turn_target, self._turn_sign = "", 0.0
        self._goal_turn.reset()
        self.trajectory = np.zeros((0, 3))

    def set_path(self, path_odom: F64) -> None:
        """Take a new path float64 (N, 3). A path to the same goal keeps what has been reached. Raises InvalidPathError."""
        if not self._tracker.set_path(path_odom):
            self._has_arrived = self._is_escaping = False
            self._turn_target, self._turn_sign = "", 0.0
            self._goal_turn.reset()

    def set_movers(self, movers: Movers) -> None:
        """Take the movers of now, in the odom frame; they count until the next call."""
        self._movers = movers

    def set_refusal(self, is_refused: Callable[[BodyVelocity], bool]) -> None:
        """Take who is asked about every velocity before it is wanted; where all are refused, the best is wanted all the same."""
        self._is_refused = is_refused

    def compute_command(
        self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity
    ) -> BodyVelocity:
        """Return the wanted velocity of the base; raises NoValidControlError when every motion worth driving collides."""
        if len(self._tracker.points) == 0:
            raise InvalidPathError("there is no path to follow")
        self._window.update(costs, spec)
        lead = np.array([velocity.vx, velocity.vy, velocity.wz]) * self._config.reaction_time
        start = odom_from_base @ SE2.exp(lead)
        left = self._tracker.locate(start)
        self.trajectory = np.array([odom_from_base.as_array()])
        if self._goal_turn.is_active or self._arrives(start, left):
            return self._face_goal(start, velocity)
        return self._follow(start, velocity, left)

    def _face_goal(self, start: SE2, velocity: BodyVelocity) -> BodyVelocity:
        """Turn to the goal's heading where the robot stands, or by way of a place where there is room."""
        manoeuvre, goal = self._goal_turn, self._tracker.goal
        if manoeuvre.is_active and not manoeuvre.wants_turn:
            slide = manoeuvre.slide(start)
            if slide is not None:
                return slide
            manoeuvre.reset()  # something came into its way
        turn = self._turn_to(start, velocity, goal.yaw, "goal", self._config.arrive_yaw)
        if turn is not None:
            if manoeuvre.wants_turn and abs(wrap_angle(goal.yaw - start.yaw)) <= self._config.arrive_yaw:
                manoeuvre.turned()
            return turn
        if manoeuvre.begin(start, goal):
            return BodyVelocity()
        raise NoValidControlError("there is no room to turn to the goal's heading")

    def _follow(self, start: SE2, velocity: BodyVelocity, left: float) -> BodyVelocity:
        error = self._heading_error(start, left)
        is_turning = self._turn_target == "path"
        if abs(error) > (self._config.turn_end if is_turning else self._turn_start()):
            turn = self._turn_to(start, velocity, start.yaw + error, "path", self._config.turn_end)
            if turn is not None and self._is_refused(turn):
                aside = self._glide(start, velocity, left)
                aside = aside if aside is not None else self._best_command(start, velocity, left)
                turn = turn if aside is None or self._is_refused(aside) else aside
            if turn is not None:
                return turn
        else:
            self._turn_target, self._is_escaping = "", False
        if not self._is_escaping:
            command = self._best_command(start, velocity, left)
            if command is not None:
                self._turn_target = ""
                return command
        if abs(error) > self._config.turn_end:
            command = self._turn_to(start, velocity, start.yaw + error, "path", self._config.turn_end)
            if command is None and not self._is_escaping:  # who draws back goes on drawing back
                command = self._glide(start, velocity, left)
            command = command or self._draw_back(start, error)
            if command is not None:
                return command
        self._is_escaping = False
        raise NoValidControlError("every motion along the path collides, and there is no room to turn")

    def _turn_start(self) -> float:
        """Heading error at which the robot turns in place first, radians."""
        return self._config.turn_start

    def _arrives(self, start: SE2, left: float) -> bool:
        goal = start.inverse() @ self._tracker.goal
        away = math.hypot(goal.x, goal.y)
        if self._has_arrived:
            self._has_arrived = away < 2.0 * self._config.pass_radius
        elif left < 2.0 * self._config.pass_radius:
            is_aside = abs(math.atan2(goal.y, goal.x)) > self._config.turn_start
            is_passed = away < self._config.pass_radius and (is_aside or left < self._config.arrive_radius)
            self._has_arrived = away < self._config.arrive_radius or is_passed
        return self._has_arrived

    def _heading_error(self, start: SE2, left: float) -> float:
        x, y = self._tracker.point_at(min(self._config.look_ahead, left))
        if math.hypot(x - start.x, y - start.y) < self._config.arrive_radius:
            return 0.0
        return wrap_angle(math.atan2(y - start.y, x - start.x) - start.yaw)

    def _turn_to(
        self, start: SE2, velocity: BodyVelocity, yaw: float, target: str, tolerance: float
    ) -> BodyVelocity | None:
        """Turn in place, the shorter way if it is free; None if the robot cannot."""
        error = wrap_angle(yaw - start.yaw)
        if target == "goal" and abs(error) <= tolerance:
            self._turn_target = ""
            return BodyVelocity()
        if self._turn_target != target or abs(error) < math.pi / 2:
            self._turn_sign = math.copysign(1.0, error)
        turns = (error, error - math.copysign(2.0 * math.pi, error))
        turns = turns if turns[0] * self._turn_sign > 0.0 else turns[::-1]
        for turn in turns:
            if abs(self._window.free_turn(start, turn)) >= abs(turn) - 1e-9:
                self._turn_target, self._turn_sign = target, math.copysign(1.0, turn)
                self._is_escaping = False
                if math.hypot(velocity.vx, velocity.vy) > 2.0 * self._config.speed_min:
                    return BodyVelocity()
                limit = approach_limit(
                    abs(turn), self._limits.az_max * self._config.brake_share, self._config.reaction_time
                )
                rate = min(self._limits.wz_max, max(self._config.turn_min, limit))
                return BodyVelocity(0.0, 0.0, math.copysign(rate, turn))
        return None

    def _glide(self, start: SE2, velocity: BodyVelocity, left: float) -> BodyVelocity | None:
        """Follow the path without facing along it, as a base may that moves in all directions: a long body gets out of a dead end as it came
        in. None for other bases, and where no such motion gains anything."""
        if self._robot.drive is not DriveKind.OMNI or self._limits.vy_max <= 0.0:
            return None
        samples = gliding_samples(self._config, self._limits)
        return self._best_of(samples, start, velocity, left, is_gliding=True)

    def _draw_back(self, start: SE2, error: float) -> BodyVelocity | None:
        """Move straight on, back, or sideways, to the nearest place from which the robot can turn by `error`; None if there is none."""
        directions = [(1.0, 0.0)] + ([(-1.0, 0.0)] if self._limits.vx_min < 0.0 else [])
        if self._robot.drive is DriveKind.OMNI and self._limits.vy_max > 0.0:
            directions += [(0.0, 1.0), (0.0, -1.0)]
        best, command = self._config.escape_length + 1e-9, None
        for ux, uy in directions:
            heading = start.yaw + math.atan2(uy, ux)
            free = self._window.free_slide(start, heading, self._config.escape_length)
            for away in np.arange(0.05, free + 1e-9, 0.05):
                if away >= best:
                    break
                place = start @ SE2(ux * float(away), uy * float(away))
                if abs(self._window.free_turn(place, error)) >= abs(error) - 1e-9:
                    best = float(away)
                    limits = {(1.0, 0.0): self._limits.vx_max, (-1.0, 0.0): -self._limits.vx_min}
                    speed = min(self._config.escape_speed, limits.get((ux, uy), self._limits.vy_max))
                    command = BodyVelocity(ux * speed, uy * speed, 0.0)
        self._is_escaping = command is not None
        return command

    def _best_command(self, start: SE2, velocity: BodyVelocity, left: float) -> BodyVelocity | None:
        return self._best_of(self._samples(velocity, left), start, velocity, left)

    def _best_of(
        self, samples: F64, start: SE2, velocity: BodyVelocity, left: float, *, is_gliding: bool = False
    ) -> BodyVelocity | None:
        path = self._path_ahead()
        guide = self._spread(path)
        here = np.empty(3)
        at = self._window.placed(start)
        resolution = self._window.spec.resolution
        locate_on_path(at[0], at[1], guide, resolution, here)
        out, marks = np.empty((len(samples), COLUMNS)), np.empty((len(samples), MARKS_MAX, 3))
        lim = self._limits
        rates = np.array([lim.ax_max, lim.ay_max, lim.az_max, lim.ax_brake, lim.ay_brake, lim.az_max])
        is_end_near = left <= self._config.window
        stop = max(left, resolution) if is_end_near else 1e9
        w = self._window
        v0 = np.array([velocity.vx, velocity.vy, velocity.wz])
        slowest, fastest = self._speeds(samples)
        slow = slowest + SLOW
        for horizon in self._horizons(samples):
            c = self._config
            plan = np.array([horizon, stop, c.step_length, w.radius, c.near_speed, c.speed_per_clearance, slow])
            roll_out(samples, at, v0, rates, plan, w.cells, w.outline, guide, self._movers_ahead(), out, marks)
            ways = Ways(samples, out, marks, guide)
            command = self._choose(ways, here, velocity, fastest * horizon, is_gliding=is_gliding)
            if command is not None:
                return command
        return None

    def _movers_ahead(self) -> F64:
        """Return the movers of the rollout's start, measured from the corner of the grid, rows as `roll_out` takes them."""
        rows = passing_discs(self._movers, self._config.reaction_time)
        rows[:, 0] -= self._window.spec.origin_x
        rows[:, 1] -= self._window.spec.origin_y
        return rows

    def _path_ahead(self) -> F64:
        """Return the stretch of path that is scored, measured from the corner of the grid."""
        path = self._tracker.ahead(self._config.window).copy()
        path[:, 0] -= self._window.spec.origin_x
        path[:, 1] -= self._window.spec.origin_y
        return path

    def _horizons(self, samples: F64) -> tuple[float, ...]:
        """How many seconds the samples are simulated; each further entry is tried when nothing was admissible."""
        return (self._config.horizon,)

    def _choose(
        self, ways: Ways, here: F64, velocity: BodyVelocity, farthest: float, *, is_gliding: bool = False
    ) -> BodyVelocity | None:
        samples, out, path = ways.samples, ways.out, ways.guide.path
        c = self._config
        end_s = float(path[-1, 2])
        weight_path, weight_heading = c.weight_path, c.weight_heading
        if self._is_blocked(path):
            weight_path, weight_heading = c.weight_path_blocked, c.weight_heading_blocked
        weight_sideways = c.weight_sideways
        if is_gliding:
            weight_heading = weight_sideways = 0.0
        ahead = end_s - float(here[1])
        weight_heading *= min(1.0, ahead / (2.0 * c.pass_radius))  # beside its end a path leads nowhere
        before = float((end_s - here[1]) + min(1.0, weight_path) * here[0])
        gain = min(GAIN_MIN, 0.25 * before, 0.5 * farthest)
        weights = np.array(
            [
                *(c.weight_progress, weight_path, weight_heading, c.weight_clearance, c.weight_turn_change),
                *(weight_sideways, c.near, c.weight_movers, c.movers_near),
            ]
        )
        resolution = self._window.spec.resolution
        args = (samples, out, ways.marks, ways.guide, resolution, weights, end_s, before, gain, velocity.wz)
        best = liked = int(best_sample(*args))
        for _ in range(REFUSALS):
            if best < 0 or not self._is_refused(BodyVelocity(*samples[best].tolist())):
                break
            out[best, FREE] = 0.0
            best = int(best_sample(*args))
        else:
            best = -1
        best = best if best >= 0 else liked
        if best < 0:
            return None
        spec = self._window.spec
        end = [
            out[best, END_X] + spec.origin_x,
            out[best, END_Y] + spec.origin_y,
            wrap_angle(float(out[best, END_YAW])),
        ]
        self.trajectory = np.array([self.trajectory[0], end])
        return BodyVelocity(float(samples[best, 0]), float(samples[best, 1]), float(samples[best, 2]))

    def _is_blocked(self, path: F64) -> bool:
        """Whether the robot's centre cannot stay on the path ahead: then it may leave it to get around."""
        w = self._window
        return bool(leads_too_near(path, w.distance, w.spec.resolution, w.inscribed_radius))

    def _spread(self, path: F64) -> Guide:
        spec = self._window.spec
        cells = np.empty((len(path), 2), np.int32)
        cells_of_path(path, spec.resolution, cells)
        steps, label = np.empty(spec.shape, np.int32), np.empty(spec.shape, np.int32)
        queue = np.empty(spec.width * spec.height, np.int32)
        spread_path(cells, self._window.distance, self._window.inscribed_radius, steps, label, queue)
        return Guide(path, steps, label)

    def _samples(self, velocity: BodyVelocity, left: float) -> F64:
        """Wanted velocities (N, 3), the faster the farther the goal; those of the last call again while its top speed holds."""
        top = self._top_speed(left)
        if top != self._top:
            self._top, self._grid = top, velocity_samples(self._config, self._robot, top)
        return self._grid

    def _speeds(self, samples: F64) -> tuple[float, float]:
        """Return the least and the greatest speed of samples, m/s."""
        speed = np.hypot(samples[:, 0], samples[:, 1])
        return float(speed.min()), float(speed.max())

    def _top_speed(self, left: float) -> float:
        """Return how fast the robot may go with `left` metres of path before it."""
        c, lim = self._config, self._limits
        top = approach_limit(left, lim.ax_brake * c.brake_share, c.reaction_time + 0.05)
        return min(lim.vx_max, max(c.speed_min, top))
