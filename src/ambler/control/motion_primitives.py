"""The local planner on motion primitives (Zhang, Hu, Chadha and Singh 2020; navigation reference 1.4 to 1.6): a fan of 343 paths in 36 directions, those that
the footprint cannot follow struck out, the group of free ones that leads best followed by pure pursuit.

Differences that experience asked for: the footprint is the true one; the direction wanted is that of the farthest point of the path in sight, and
around what blocks the path; where the robot had to stand is remembered; it says why it stands.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.control.config import RolloutConfig
from ambler.control.dead_ends import DeadEnds
from ambler.control.goal_turn import GoalTurn
from ambler.control.local_goal import LocalGoal, LocalGoals
from ambler.control.local_window import LocalWindow
from ambler.control.passing import passing_discs
from ambler.control.path_follower import LEVEL, PathFollower, approach_limit
from ambler.control.path_tracker import PathTracker
from ambler.control.primitive_choice import Choice, Manner, PrimitiveChooser
from ambler.control.primitives_config import PrimitivesConfig
from ambler.core.errors import InvalidPathError, NoValidControlError
from ambler.core.grid import GridSpec
from ambler.core.movers import NOBODY, Movers
from ambler.core.protocols import BodyVelocity, Lean, LocalState
from ambler.core.robot import DriveKind, RobotModel
from ambler.core.se2 import SE2, wrap_angle

F64 = NDArray[np.float64]

RING = np.stack((np.cos(np.arange(12) * math.pi / 6.0), np.sin(np.arange(12) * math.pi / 6.0)), axis=1)


class MotionPrimitives:
    """A local planner (core.protocols.LocalPlanner) for differential and omnidirectional bases, wheeled or legged. Time is counted in its own periods, so
    that equal inputs give equal commands."""

    def __init__(self, config: PrimitivesConfig, robot: RobotModel) -> None:
        self._config = config
        self._limits = robot.limits
        self._is_omni = robot.drive is DriveKind.OMNI and robot.limits.vy_max > 0.0
        self._window = LocalWindow(robot, config.padding)
        self._chooser = PrimitiveChooser(config, robot, self._window)
        self._follower = PathFollower(config.follower, robot, self._window)
        self._goal_turn = GoalTurn(RolloutConfig(padding=config.padding), robot, self._window)
        self._memory = DeadEnds(config.dead_end_radius, config.dead_end_weight, config.dead_end_memory)
        self._goals = LocalGoals(config, self._window, self._memory)
        self._tracker = PathTracker()
        self._movers = NOBODY
        self._lean = LEVEL
        self._clock = self._blocked_for = self._frozen_for = self._turn_sign = 0.0
        self._is_turning = self._has_arrived = self._is_thawed = False
        self._escapes, self._escape_left = 0, math.inf
        self.state, self.reason = LocalState.IDLE, "there is no path to follow"
        self.trajectory: F64 = np.zeros((0, 3))
        """The way that the last command begins, float64 (N, 3) of (x, y, yaw) in the odom frame."""

    @property
    def path_left(self) -> float:
        """Arc length of the path that is left, metres."""
        return self._tracker.length - self._tracker.along if len(self._tracker.points) else 0.0

    def reset(self) -> None:
        """Forget the path and everything remembered about it."""
        self._tracker = PathTracker()
        self._memory.clear()
        self._follower.reset()
        self._forget()
        self.trajectory = np.zeros((0, 3))
        self.state, self.reason = LocalState.IDLE, "there is no path to follow"

    def set_path(self, path_odom: F64) -> None:
        """Take a new path float64 (N, 3). A path to the same goal keeps what is remembered. Raises InvalidPathError."""
        if not self._tracker.set_path(path_odom):
            self._memory.clear()
            self._forget()

    def set_movers(self, movers: Movers) -> None:
        """Take the movers of now, in the odom frame; they count until the next call."""
        self._movers = movers

    def set_lean(self, lean: Lean) -> None:
        """Take a lean of the body; of those between two commands the fastest change counts."""
        last = self._lean
        rates = (max(abs(lean.roll_rate), abs(last.roll_rate)), max(abs(lean.pitch_rate), abs(last.pitch_rate)))
        self._lean = Lean(lean.roll, lean.pitch, *rates)

    def compute_command(
        self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity
    ) -> BodyVelocity:
        """Return the wanted velocity; raises NoValidControlError when a resting robot is blocked."""
        if len(self._tracker.points) == 0:
            raise InvalidPathError("there is no path to follow")
        start = self._begin(costs, spec, odom_from_base, velocity)
        if self._follower.is_stopped_by_lean:
            return self._stand(LocalState.LEANING, "the body leans too far to drive")
        left = self._tracker.locate(start)
        if self._goal_turn.is_active or self._arrives(start, left):
            return self._face_goal(start)
        return self._approach(start, velocity, left)

    def steer(
        self,
        costs: NDArray[np.uint8],
        spec: GridSpec,
        odom_from_base: SE2,
        velocity: BodyVelocity,
        wanted: BodyVelocity,
    ) -> BodyVelocity:
        """Return the velocity that comes nearest to what a person wants (smart joystick): direction and speed of `wanted`, around what is in the way. Without a speed
        its yaw rate turns the robot in place. Raises NoValidControlError when there is nothing free in that direction."""
        start = self._begin(costs, spec, odom_from_base, velocity)
        if self._follower.is_stopped_by_lean:
            return self._stand(LocalState.LEANING, "the body leans too far to drive")
        speed = math.hypot(wanted.vx, wanted.vy)
        if speed < self._config.follower.speed_min:
            return self._turn_by_hand(start, wanted.wz)
        heading = start.yaw + math.atan2(wanted.vy, wanted.vx)
        far = start.x + 5.0 * math.cos(heading), start.y + 5.0 * math.sin(heading)
        command = self._along_primitive(start, velocity, LocalGoal(*far), speed)
        if command is None:
            self._follower.reset()
            raise self._blocked("nothing is free in the direction that is wanted")
        return command

    # Steps of a cycle

    def _begin(self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity) -> SE2:
        """Take what is new; returns where the base will be when it obeys."""
        self._clock += self._config.follower.period
        self._window.update(costs, spec)
        self._follower.set_lean(self._lean)
        self._lean = Lean(self._lean.roll, self._lean.pitch)
        self.trajectory = np.array([odom_from_base.as_array()])
        lead = np.array([velocity.vx, velocity.vy, velocity.wz]) * self._config.reaction_time
        return odom_from_base @ SE2.exp(lead)

    def _approach(self, start: SE2, velocity: BodyVelocity, left: float) -> BodyVelocity:
        """Drive along the path, around what blocks it, or out of a dead end."""
        self._memory.forget(self._clock)
        self._goals.forget_opened()
        if left < self._escape_left - self._config.escape_progress:
            self._escapes = 0
        goal = self._goals.pick(start, self._tracker, left, self._clock)
        if goal is None:
            goal = self._leave(start, velocity)
        if self._freezes(start, goal):
            return self._stand(LocalState.FROZEN, "the goal was told to lie behind the robot; it waits a moment")
        away = math.hypot(goal.x - start.x, goal.y - start.y)
        speed = self._speed(away if goal.is_end else max(left, away))
        command = None
        if goal.is_end and away < self._config.near_goal:
            command = self._straight(start, velocity, goal, speed)
        if command is None:
            command = self._along_primitive(start, velocity, goal, speed)
        if command is None:
            return self._stuck(start, velocity)
        self._blocked_for = 0.0
        if self._goals.is_leaving:
            self.state, self.reason = LocalState.LEAVING_DEAD_END, "the way ahead is a dead end; another one is tried"
        return command

    def _along_primitive(
        self, start: SE2, velocity: BodyVelocity, goal: LocalGoal, speed: float
    ) -> BodyVelocity | None:
        share = min(1.0, speed / max(self._limits.vx_max, 1e-6))
        is_near = math.hypot(goal.x - start.x, goal.y - start.y) < self._config.near_goal and goal.is_end
        others = self._mover_points(start, max(speed, 0.2))
        choice = self._chooser.choose(start, (goal.x, goal.y), share, others, is_goal_near=is_near)
        return None if choice is None else self._follow(choice, start, velocity, speed)

    def _follow(self, choice: Choice, start: SE2, velocity: BodyVelocity, speed: float) -> BodyVelocity | None:
        c = self._config
        points = start.transform(choice.points)
        headings = np.arctan2(np.gradient(points[:, 1]), np.gradient(points[:, 0]))
        self.trajectory = np.vstack((self.trajectory, np.column_stack((points, headings))[::5]))
        turn = choice.direction if choice.manner is Manner.FORWARD else wrap_angle(choice.direction + math.pi)
        if choice.manner is not Manner.HOLDING:
            self._is_turning = abs(turn) > (c.turn_end if self._is_turning else c.turn_start)
            if self._is_turning:
                command = self._turn(start, turn)
                if command is not None:
                    self.state, self.reason = LocalState.TURNING, "the robot turns towards its way"
                    return command
                self._is_turning = False
        else:
            self._is_turning = False
        if choice.roughness:
            speed *= c.follower.slow_rates[choice.roughness - 1]
        holds, back = choice.manner is Manner.HOLDING, choice.manner is Manner.BACKWARDS
        if holds or (back and not c.is_two_way):
            speed = min(speed, c.aside_speed)
        command = self._follower.follow(points, start, velocity, speed, holds=holds, backwards=back)
        if command is not None:
            self._tell_driving(choice.roughness)
        return command

    def _tell_driving(self, roughness: int) -> None:
        if self._follower.is_slowed_by_lean:
            self.state, self.reason = LocalState.SLOWED, "the body leans or shakes"
        elif roughness:
            self.state, self.reason = LocalState.SLOWED, "the ground is rough"
        else:
            self.state, self.reason = LocalState.DRIVING, ""

    def _straight(self, start: SE2, velocity: BodyVelocity, goal: LocalGoal, speed: float) -> BodyVelocity | None:
        """Drive to a goal that is near and in sight: along all axes, or in a line."""
        if self._is_omni:
            command = self._follower.towards(self._tracker.goal, start, velocity, speed)
        else:
            bearing = wrap_angle(math.atan2(goal.y - start.y, goal.x - start.x) - start.yaw)
            back = self._config.is_two_way and abs(bearing) > 0.5 * math.pi and self._limits.vx_min < 0.0
            turn = wrap_angle(bearing + math.pi) if back else bearing
            self._is_turning = abs(turn) > (self._config.turn_end if self._is_turning else self._config.turn_start)
            if self._is_turning:
                command = self._turn(start, turn)
                if command is not None:
                    self.state, self.reason = LocalState.TURNING, "the robot turns towards its way"
                return command
            path = np.linspace((start.x, start.y), (goal.x, goal.y), 13)
            command = self._follower.follow(path, start, velocity, speed, backwards=back)
        if command is not None:
            self.trajectory = np.vstack((self.trajectory, [[goal.x, goal.y, self._tracker.goal.yaw]]))
            self._tell_driving(0)
        return command

    def _face_goal(self, start: SE2) -> BodyVelocity:
        """Turn to the goal's heading where the robot stands, or by way of a place where there is room."""
        manoeuvre, goal = self._goal_turn, self._tracker.goal
        self.state, self.reason = LocalState.TURNING, "the robot turns to the heading of its goal"
        if manoeuvre.is_active and not manoeuvre.wants_turn:
            slide = manoeuvre.slide(start)
            if slide is not None:
                return slide
            manoeuvre.reset()  # something came into its way
        error = wrap_angle(goal.yaw - start.yaw)
        if abs(error) <= self._config.arrive_yaw:
            if manoeuvre.wants_turn:
                manoeuvre.turned()
            return self._stand(LocalState.GOAL_REACHED, "the goal is reached")
        turn = self._turn(start, error)
        if turn is not None:
            return turn
        if manoeuvre.begin(start, goal):
            return self._follower.stand()
        raise self._blocked("there is no room to turn to the goal's heading")

    def _turn(self, start: SE2, error: float) -> BodyVelocity | None:
        """Turn in place, the shorter way if it is free; None if the robot cannot."""
        if self._turn_sign == 0.0 or abs(error) < 0.5 * math.pi:
            self._turn_sign = math.copysign(1.0, error)
        turns = [error, error - math.copysign(2.0 * math.pi, error)]
        turns.sort(key=lambda turn: turn * self._turn_sign < 0.0)
        for turn in turns:
            if abs(self._window.free_turn(start, turn)) >= abs(turn) - 1e-9:
                self._turn_sign = math.copysign(1.0, turn)
                return self._follower.turn(turn)
        return None

    def _turn_by_hand(self, start: SE2, rate: float) -> BodyVelocity:
        if rate == 0.0:
            return self._stand(LocalState.IDLE, "nobody wants a motion")
        free = self._window.free_turn(start, math.copysign(0.5, rate))
        if abs(free) < 0.1:
            raise self._blocked("there is no room to turn")
        self.state, self.reason = LocalState.TURNING, "the robot turns as it is told"
        command = self._follower.turn(free)
        return BodyVelocity(command.vx, command.vy, max(-abs(rate), min(abs(rate), command.wz)))

    # What stops the robot

    def _leave(self, start: SE2, velocity: BodyVelocity) -> LocalGoal:
        """Return a way out where the path is blocked; raises NoValidControlError while there is none, or the robot may not look for it yet."""
        c = self._config
        if self._goals.is_blocked_by_memory and self._escapes < c.escapes_max:
            if self._goals.has_taken_exit:
                self._memory.visit(start, self._clock)
            goal = self._goals.leave(start, self._tracker.goal)
            if goal is not None:
                return goal
        self._blocked_for += c.follower.period
        if self._blocked_for < c.dead_end_seconds or self._escapes >= c.escapes_max:
            self._follower.reset()
            raise self._blocked("the path is blocked, and there is no way around it in sight")
        return self._way_out(start)

    def _stuck(self, start: SE2, velocity: BodyVelocity) -> BodyVelocity:
        """Brake, and remember a place where nothing is free for a while; raises NoValidControlError."""
        self._blocked_for += self._config.follower.period
        self._goals.reset()
        if self._blocked_for >= self._config.dead_end_seconds and self._escapes < self._config.escapes_max:
            self._way_out(start)
            self._blocked_for = 0.0
        if math.hypot(velocity.vx, velocity.vy) > 0.1:
            return self._stand(LocalState.BLOCKED, "no path is free in the direction of the goal")
        self._follower.reset()
        raise self._blocked("no path is free in the direction of the goal")

    def _way_out(self, start: SE2) -> LocalGoal:
        """Remember this place as a dead end and return the best way out of it; raises NoValidControlError."""
        ahead = self._goals.blocked_at or self._tracker.point_at(self._window.radius)
        self._memory.add(start, ahead, self._clock)
        self._escapes += 1
        self._escape_left = min(self._escape_left, self.path_left)
        goal = self._goals.leave(start, self._tracker.goal)
        if goal is None:
            raise self._blocked("the robot is shut in")
        return goal

    def _blocked(self, text: str) -> NoValidControlError:
        self.state, self.reason = LocalState.BLOCKED, text
        return NoValidControlError(text)

    def _stand(self, state: LocalState, reason: str) -> BodyVelocity:
        self.state, self.reason = state, reason
        return self._follower.stand()

    def _freezes(self, start: SE2, goal: LocalGoal) -> bool:
        """Whether the robot waits because a new goal lies behind it."""
        c = self._config
        if self._is_thawed:
            return False
        bearing = abs(wrap_angle(math.atan2(goal.y - start.y, goal.x - start.x) - start.yaw))
        self._frozen_for += c.follower.period
        self._is_thawed = bearing <= c.freeze_angle or goal.is_detour or self._frozen_for > c.freeze_time
        return not self._is_thawed

    # Small things

    def _forget(self) -> None:
        self._turn_sign = 0.0
        self._is_turning = self._has_arrived = self._is_thawed = False
        self._blocked_for = self._frozen_for = 0.0
        self._escapes = 0
        self._escape_left = math.inf
        self._goal_turn.reset()
        self._goals.reset()
        self._chooser.reset()

    def _speed(self, left: float) -> float:
        """Return how fast the robot may go with `left` metres of its way before it."""
        f, lim = self._config.follower, self._limits
        top = approach_limit(left, lim.ax_brake * f.brake_share, f.reaction_time + f.period)
        return min(lim.vx_max, max(f.speed_min, top))

    def _arrives(self, start: SE2, left: float) -> bool:
        c, goal = self._config, start.inverse() @ self._tracker.goal
        away = math.hypot(goal.x, goal.y)
        if self._has_arrived:
            self._has_arrived = away < 2.0 * c.pass_radius
        elif left < 2.0 * c.pass_radius:
            is_aside = abs(math.atan2(goal.y, goal.x)) > c.turn_start and not self._is_omni
            is_passed = away < c.pass_radius and (is_aside or left < 0.5 * c.arrive_radius)
            self._has_arrived = away < c.arrive_radius or is_passed
        return self._has_arrived

    def _mover_points(self, start: SE2, speed: float) -> F64:
        """Return points (N, 2) in the base frame on the outlines of movers where and when the robot could meet them."""
        c, rows = self._config, passing_discs(self._movers, self._config.reaction_time)
        if len(rows) == 0:
            return np.empty((0, 2))
        parts = []
        for seconds in np.arange(0.0, c.mover_seconds + 1e-9, 0.25):
            centers = rows[:, :2] + seconds * rows[:, 2:4]
            away = np.hypot(centers[:, 0] - start.x, centers[:, 1] - start.y)
            is_met = np.abs(away - self._window.inscribed_radius - speed * seconds) < 0.4 * speed + c.mover_radius
            radius = c.mover_radius + c.mover_growth * seconds
            parts += [(center + radius * RING) for center in centers[is_met]]
        points = start.inverse().transform(np.concatenate(parts)) if parts else np.empty((0, 2))
        return np.asarray(points[np.hypot(points[:, 0], points[:, 1]) > self._window.radius])
