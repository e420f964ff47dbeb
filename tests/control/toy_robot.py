"""Toy nodes around the real gate, controller and navigator: a kinematic base with a perfect scanner in a room of segments, a
planner that answers with a straight line, and a person with a script."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ambler.core.errors import PlanningError
from ambler.core.messages import (
    GateStatus,
    LaserScan,
    Odometry,
    Path,
    Transforms,
    TransformStamped,
    VelocityCommand,
)
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, SensorKind, SensorMount
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.runtime.node import Node, TaskOutcome
from ambler.runtime.tasks import (
    ARM,
    CLEAR_GLOBAL_COSTMAP,
    COMPUTE_PATH,
    EMERGENCY_STOP,
    FOLLOW_PATH,
    NAVIGATE,
    PAUSE,
    RECOVER,
    RESET_STOP,
    Nothing,
    PlanReply,
    PlanRequest,
)
from ambler.runtime.topics import GATE_STATUS, GOAL, ODOMETRY, SCAN, STEER_REQUEST, TRANSFORMS, VELOCITY_COMMAND
from tests.control.closed_loop import DIFF, line, step_velocity

ROBOT = RobotModel(
    "toy", DIFF.drive, DIFF.footprint, DIFF.limits, (SensorMount("laser", SensorKind.SCAN, SE3((0.1, 0.0, 0.3))),)
)
MAP_FROM_ODOM = SE2(1.0, -2.0, math.pi / 2)  # the map frame is elsewhere, so that a mix-up cannot go unnoticed
ANGLES = np.linspace(-math.pi, math.pi, 360, endpoint=False)


def room(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    """Four segments (x, y, x, y)."""
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]])


class ToyBase(Node):
    """Obeys the gate's command, and is seen by a perfect scanner; faults are switched by its public fields."""

    name = "base"
    inputs = (VELOCITY_COMMAND,)
    outputs = (ODOMETRY, SCAN, TRANSFORMS)
    latency = 0.002

    def __init__(self, walls: np.ndarray) -> None:
        self.walls = walls
        self.pose, self.velocity, self.command = SE2(), BodyVelocity(), BodyVelocity()
        self.has_scan = self.has_odometry = True
        self.held_beyond = math.inf  # metres along x that it gets, where nothing is to be seen
        self.heard: list[tuple[int, BodyVelocity]] = []

    def start(self) -> None:
        self.ctx.subscribe(VELOCITY_COMMAND, self._obey)
        self.ctx.timer(0.01, self._move)
        self.ctx.timer(0.1, self._scan)

    def _obey(self, message: VelocityCommand) -> None:
        self.command = BodyVelocity(message.vx, message.vy, message.wz)
        self.heard.append((self.ctx.now_ns, self.command))

    def _move(self) -> None:
        v = step_velocity(self.velocity, self.command, ROBOT.limits, 0.01)
        v = self.velocity = BodyVelocity() if self.pose.x >= self.held_beyond and v.vx > 0.0 else v
        self.pose = self.pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * 0.01)
        if self.has_odometry and (self.ctx.now_ns // 10_000_000) % 2 == 0:
            now, pose = self.ctx.now_ns, SE3.from_se2(self.pose)
            zeros = np.zeros((6, 6))
            self.ctx.publish(
                ODOMETRY, Odometry(now, "odom", "base", pose, (v.vx, v.vy, 0.0), (0.0, 0.0, v.wz), zeros, zeros.copy())
            )
            edges = (
                TransformStamped(now, "odom", "base", pose),
                TransformStamped(now, "map", "odom", SE3.from_se2(MAP_FROM_ODOM)),
            )
            self.ctx.publish(TRANSFORMS, Transforms(now, edges))

    def _scan(self) -> None:
        if not self.has_scan:
            return
        origin = self.pose @ SE2(0.1, 0.0, 0.0)
        ranges = np.full(len(ANGLES), np.inf)
        directions = np.stack((np.cos(ANGLES + origin.yaw), np.sin(ANGLES + origin.yaw)), axis=1)
        for x0, y0, x1, y1 in self.walls:
            ex, ey, wx, wy = x1 - x0, y1 - y0, x0 - origin.x, y0 - origin.y
            det = directions[:, 0] * ey - directions[:, 1] * ex
            with np.errstate(divide="ignore", invalid="ignore"):
                along = (wx * ey - wy * ex) / det
                across = (wx * directions[:, 1] - wy * directions[:, 0]) / det
            hit = (np.abs(det) > 1e-12) & (along > 0.0) & (across >= 0.0) & (across <= 1.0)
            ranges[hit] = np.minimum(ranges[hit], along[hit])
        ranges[ranges > 10.0] = np.inf
        step = 2.0 * math.pi / len(ANGLES)
        scan = LaserScan(
            self.ctx.now_ns, "laser", -math.pi, step, 0.0, 0.1, 0.05, 10.0, ranges.astype(np.float32), np.zeros(0, np.float32)
        )  # fmt: skip
        self.ctx.publish(SCAN, scan)


class ToyPlanner(Node):
    """Answers with a straight line from the robot to the goal, or to the `nearest` place to it, or with `failure`."""

    name = "planner"
    inputs = (TRANSFORMS,)
    serves = (COMPUTE_PATH, CLEAR_GLOBAL_COSTMAP)

    def __init__(self, base: ToyBase) -> None:
        self._base = base
        self.failure: PlanningError | None = None
        self.nearest: SE2 | None = None
        self.cleared = 0

    def start(self) -> None:
        self.ctx.serve(COMPUTE_PATH, self._plan)
        self.ctx.serve(CLEAR_GLOBAL_COSTMAP, self._clear)

    def _plan(self, request: PlanRequest) -> PlanReply:
        if self.failure is not None:
            raise self.failure
        end = request.map_from_goal if self.nearest is None else self.nearest
        return PlanReply(straight_path(self._base.pose, end), 1.0, end.distance_to(request.map_from_goal))

    def _clear(self, request: Nothing) -> Nothing:
        self.cleared += 1
        return Nothing()


def straight_path(odom_from_base: SE2, map_from_goal: SE2) -> Path:
    """A straight path in the map frame."""
    start = MAP_FROM_ODOM @ odom_from_base
    return Path(0, "map", line((start.x, start.y), (map_from_goal.x, map_from_goal.y), yaw=map_from_goal.yaw))


class Person(Node):
    """Does what its script says: (seconds, what). It arms the gate at 0.3 s unless told otherwise."""

    name = "person"
    optional_inputs = (GATE_STATUS,)
    calls = (ARM, PAUSE, EMERGENCY_STOP, RESET_STOP, FOLLOW_PATH, RECOVER, NAVIGATE)
    outputs = (GOAL, STEER_REQUEST)

    def __init__(self, script: list[tuple[float, Callable[[Person], None]]]) -> None:
        self._script = script
        self.outcomes: list[TaskOutcome[Any]] = []
        self.replies: list[Any] = []
        self.states: list[GateStatus] = []
        self.ticket: Any = None

    def start(self) -> None:
        self.ctx.subscribe(GATE_STATUS, self.states.append)
        for seconds, act in self._script:
            self.ctx.after(seconds, lambda act=act: act(self))  # type: ignore[misc]

    def send(self, task: Any, goal: Any) -> None:
        """Start a task."""
        self.ticket = self.ctx.send_goal(task, goal, self.outcomes.append)

    def ask(self, service: Any, request: Any) -> None:
        """Call a service."""
        self.ctx.call(service, request, self.replies.append)
