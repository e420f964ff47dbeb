"""A local planner of one's own: it drives towards a point on its path, a carrot, and stops before what lies in its way.

Nothing in `src` knows this file. `ControllerNode` takes any `LocalPlanner`; the tests drive this one through the suite of all others.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import InvalidPathError, NoValidControlError
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2, wrap_angle

F64 = NDArray[np.float64]
CARROT = 0.35  # metres ahead on the path
TURN_START, TURN_END = 0.5, 0.1  # radians: turn in place from the one on, until the other
ARRIVED, PASSED, HEADED = 0.03, 0.11, 0.025  # metres, metres, radians
REACTION = 0.1  # seconds until a command has its effect
KEPT = 0.08  # metres that stay free before an obstacle


class CarrotPlanner:
    """A `LocalPlanner` that uses a base as if it were differential."""

    def __init__(self, robot: RobotModel) -> None:
        self._limits = robot.limits
        self._outline = _spaced(robot.footprint, 0.04)
        self._path = np.zeros((0, 3))
        self._is_turning = self._has_arrived = False
        self.trajectory = np.zeros((0, 3))

    def set_path(self, path_odom: F64) -> None:
        """Take a new path float64 (N, 3); raises InvalidPathError."""
        if (
            path_odom.ndim != 2
            or path_odom.shape[1:] != (3,)
            or len(path_odom) == 0
            or not np.isfinite(path_odom).all()
        ):
            raise InvalidPathError("a path must be finite, (N, 3), and not empty")
        if len(self._path) == 0 or not np.allclose(self._path[-1], path_odom[-1]):
            self._is_turning = self._has_arrived = False
        self._path = np.array(path_odom, np.float64)

    def compute_command(
        self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity
    ) -> BodyVelocity:
        """Return the next command; raises NoValidControlError when a resting robot has something in its way."""
        if len(self._path) == 0:
            raise InvalidPathError("there is no path to follow")
        self.trajectory = np.zeros((0, 3))
        start = odom_from_base @ SE2.exp(np.array([velocity.vx, velocity.vy, velocity.wz]) * REACTION)
        is_resting = math.hypot(velocity.vx, velocity.vy) < 0.05
        wanted = self._wanted(start, is_resting)
        free = self._free_seconds(costs, spec, start, wanted)
        command = self._slowed(wanted, free, is_resting)
        twist = np.array([command.vx, command.vy, command.wz])
        self.trajectory = np.array([(odom_from_base @ SE2.exp(twist * t)).as_array() for t in np.linspace(0.0, 1.0, 6)])
        return command

    def _wanted(self, start: SE2, is_resting: bool) -> BodyVelocity:
        away = np.hypot(self._path[:, 0] - start.x, self._path[:, 1] - start.y)
        nearest = int(np.argmin(away))
        ahead = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(self._path[nearest:, :2], axis=0).T))))
        left = float(max(ahead[-1], away[-1])) if nearest == len(self._path) - 1 else float(ahead[-1])
        goal = start.inverse() @ SE2.from_array(self._path[-1])
        is_beside = goal.x < 0.02 and away[-1] < PASSED
        self._has_arrived = away[-1] < (2.0 * PASSED if self._has_arrived else ARRIVED) or (left < PASSED and is_beside)
        if self._has_arrived:
            return self._turn(goal.yaw if abs(goal.yaw) > HEADED else 0.0, is_resting)
        at = int(np.searchsorted(ahead, min(CARROT, ahead[-1])))
        x, y = self._path[min(nearest + at, len(self._path) - 1), :2]
        error = wrap_angle(math.atan2(y - start.y, x - start.x) - start.yaw)
        self._is_turning = abs(error) > (TURN_END if self._is_turning else TURN_START)
        if self._is_turning:
            return self._turn(error, is_resting)
        speed = min(self._limits.vx_max, self._braking(left, self._limits.ax_brake)) * max(0.15, math.cos(2.0 * error))
        wz = float(np.clip(2.0 * error, -self._limits.wz_max, self._limits.wz_max))
        return BodyVelocity(max(0.05, speed), 0.0, wz)

    def _turn(self, error: float, is_resting: bool) -> BodyVelocity:
        if not is_resting or error == 0.0:
            return BodyVelocity()
        rate = min(self._limits.wz_max, max(0.1, self._braking(abs(error), self._limits.az_max)))
        return BodyVelocity(0.0, 0.0, math.copysign(rate, error))

    def _braking(self, distance: float, deceleration: float) -> float:
        """The speed from which half of the deceleration still stops within a distance, reaction included."""
        a = 0.5 * deceleration
        lag = a * (REACTION + 0.05)
        return max(0.0, math.sqrt(lag * lag + 2.0 * a * max(0.0, distance)) - lag)

    def _free_seconds(self, costs: NDArray[np.uint8], spec: GridSpec, start: SE2, v: BodyVelocity) -> float:
        """How long the outline may be moved along an arc before it covers more lethal cells than now, at most 2.5 s."""
        fastest = math.hypot(v.vx, v.vy) + abs(v.wz) * float(np.hypot(*self._outline.T).max())
        if fastest == 0.0:
            return 2.5
        twist, before = np.array([v.vx, v.vy, v.wz]), _covered(costs, spec, start.transform(self._outline))
        for t in np.arange(0.0, 2.5, 0.04 / fastest):
            if _covered(costs, spec, (start @ SE2.exp(twist * t)).transform(self._outline)) > before:
                return float(t)
        return 2.5

    def _slowed(self, v: BodyVelocity, free: float, is_resting: bool) -> BodyVelocity:
        speed = math.hypot(v.vx, v.vy)
        if free >= 2.5:
            return v
        if speed == 0.0:
            if free * abs(v.wz) < 0.15:
                raise NoValidControlError("there is no room to turn")
            return v
        scale = min(1.0, self._braking(free * speed - KEPT, self._limits.ax_brake) / speed)
        if scale * speed < 0.03:
            if is_resting:
                raise NoValidControlError("something lies in the way, and a carrot does not lead around it")
            scale = 0.0
        return BodyVelocity(v.vx * scale, 0.0, v.wz * scale)


def _spaced(polygon: F64, step: float) -> F64:
    ends = zip(polygon, np.roll(polygon, -1, axis=0), strict=True)
    return np.concatenate([a + (b - a) * np.arange(0.0, 1.0, step / math.dist(a, b))[:, None] for a, b in ends])


def _covered(costs: NDArray[np.uint8], spec: GridSpec, points: F64) -> int:
    cells = spec.cells_of(points)
    is_in = ((cells >= 0) & (cells < spec.shape)).all(axis=1)
    return int(np.count_nonzero(costs[cells[is_in, 0], cells[is_in, 1]] == COST_LETHAL))
