"""Does what a person with a joystick would do who walks behind a simulated robot: stands still a moment, drives it along a route, stops.

The person sees where the robot truly is; no algorithm does. What is asked for goes through the velocity gate like every other request.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ambler.control.route_pursuit import RoutePursuit, RoutePursuitConfig
from ambler.core.messages import GateState, GateStatus, Odometry, Path, Status, VelocityCommand
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.nodes.steps import ProgramEnd
from ambler.runtime.node import Node, Offers
from ambler.runtime.tasks import ARM, END_PROGRAM, SIT, STAND, EndProgramRequest, GateReply, GateRequest, Nothing
from ambler.runtime.topics import GATE_STATUS, PATH, STATUS, TRUE_POSE, VELOCITY_REQUEST

PERIOD = 0.05
HALTED = 0.7  # seconds after the end of the route until a walker sits down
MOVED = 0.05  # metres that count as getting on


@dataclass(frozen=True, slots=True)
class RouteDriverConfig:
    """`rest`: seconds of standing still before and after (what a LiDAR-inertial odometry levels itself with); `patience`: seconds without
    getting on after which the driver gives up."""

    rest: float = 3.0
    patience: float = 20.0
    pursuit: RoutePursuitConfig = field(default_factory=RoutePursuitConfig)


class RouteDriverNode(Node):
    """Drives along `points` (x, y) of the frame `world` at `speed` m/s and calls `on_finished` with what came of it: SUCCEEDED,
    LEFT_THE_ROUTE, BLOCKED, or why it was ended from outside."""

    name = "driver"
    inputs = (TRUE_POSE,)
    optional_inputs = (GATE_STATUS,)
    outputs = (VELOCITY_REQUEST, PATH, STATUS)
    serves: Offers = (END_PROGRAM,)
    latency = 0.001

    def __init__(
        self,
        points: tuple[tuple[float, float], ...],
        speed: float,
        robot: RobotModel,
        world_from_odom: SE2,
        on_finished: Callable[[ProgramEnd], None],
        on_progress: Callable[[int, str], None] | None = None,
        config: RouteDriverConfig | None = None,
        *,
        has_legs: bool = False,
    ) -> None:
        """Of a robot that `has_legs` the driver has it stand up before and sit down after the drive."""
        self._has_legs = has_legs
        self.calls: Offers = (ARM, STAND, SIT) if has_legs else (ARM,)
        self._config = config if config is not None else RouteDriverConfig()
        self._pursuit = RoutePursuit(points, speed, robot.limits, self._config.pursuit)
        self._points = np.array(points)
        self._world_from_odom = world_from_odom
        self._on_finished, self._on_progress = on_finished, on_progress
        self._pose: SE2 | None = None
        self._height = 0.0
        self._gate = ""
        self._best_left, self._best_ns = float("inf"), 0
        self._is_driving = self._is_over = False

    def start(self) -> None:
        self.ctx.subscribe(TRUE_POSE, self._on_pose)
        self.ctx.subscribe(GATE_STATUS, self._on_gate)
        self.ctx.serve(END_PROGRAM, self._on_end_program)
        self.ctx.after(self._config.rest, self._arm)
        self.ctx.timer(PERIOD, self._step)

    def _on_pose(self, truth: Odometry) -> None:
        self._pose, self._height = truth.pose.to_se2(), truth.pose.translation[2]

    def _on_gate(self, status: GateStatus) -> None:
        self._gate = status.reason if status.state is not GateState.ARMED else ""

    def _arm(self) -> None:
        if not self._is_over:
            if self._has_legs:
                self.ctx.call(STAND, Nothing(), lambda _: None)
            self.ctx.call(ARM, GateRequest(self.name, "a drive begins"), self._armed)

    def _armed(self, reply: GateReply | Exception) -> None:
        if isinstance(reply, Exception) or not reply.is_done:
            text = str(reply) if isinstance(reply, Exception) else reply.text
            self._say("NOT_ARMED", f"the gate refused to arm: {text}")
            self.ctx.after(1.0, self._arm)
            return
        self._is_driving, self._best_ns = True, self.ctx.now_ns
        odom_from_world = self._world_from_odom.inverse()
        path = np.column_stack([odom_from_world.transform(self._points), np.zeros(len(self._points))])
        self.ctx.publish(PATH, Path(self.ctx.now_ns, "odom", path))
        self._say("DRIVE_BEGINS", f"{self._pursuit.left:.0f} m to drive")

    def _step(self) -> None:
        if not self._is_driving or self._pose is None:
            return
        now_ns, pursuit = self.ctx.now_ns, self._pursuit
        velocity = pursuit.compute_command(self._pose)
        self.ctx.publish(VELOCITY_REQUEST, VelocityCommand(now_ns, velocity.vx, velocity.vy, velocity.wz))
        if pursuit.left < self._best_left - MOVED or velocity.vx == 0.0:
            self._best_left, self._best_ns = pursuit.left, now_ns
        if pursuit.is_done:
            self._rest()
        elif pursuit.is_lost:
            self._finish(
                "LEFT_THE_ROUTE", f"{pursuit.left:.1f} m before the end the robot was too far beside the route"
            )
        elif now_ns - self._best_ns > self._config.patience * 1e9:
            self._finish(
                "BLOCKED", f"{pursuit.left:.1f} m before the end the robot did not get on: {self._gate or 'it is held'}"
            )
        elif self._on_progress is not None:
            held = f"  gate: {self._gate}" if self._gate else ""
            self._on_progress(now_ns, f"{pursuit.left:6.1f} m to go  height {self._height:5.2f} m{held}")

    def _rest(self) -> None:
        """Stand still a moment, or sit down, so that the recording ends at rest."""
        self._is_driving = False
        if self._has_legs:
            self.ctx.after(HALTED, lambda: self.ctx.call(SIT, Nothing(), lambda _: None))
        self.ctx.after(self._config.rest, lambda: self._finish("SUCCEEDED", ""))

    def _on_end_program(self, request: EndProgramRequest) -> Nothing:
        self._finish(request.code, request.text)
        return Nothing()

    def _finish(self, code: str, text: str) -> None:
        if self._is_over:
            return
        self._is_over, self._is_driving = True, False
        self._say(code, text or "the route is driven")
        self._on_finished(ProgramEnd(code, text, ()))

    def _say(self, code: str, text: str) -> None:
        self.ctx.log(code, text)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text))
