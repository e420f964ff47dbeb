"""Does what a person would do with a robot in a known map: arms it, waits until it knows where it is, sends it to goals in turn.

It exists only where nobody is at hand: in simulation and on the command line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ambler.core.messages import Odometry, Status
from ambler.core.se2 import SE2
from ambler.runtime.node import Node, Offers, TaskOutcome
from ambler.runtime.tasks import (
    ARM,
    NAVIGATE,
    RECOVER,
    GateReply,
    GateRequest,
    NavigateGoal,
    NavigateResult,
    Nothing,
    RecoverGoal,
    RecoveryKind,
)
from ambler.runtime.topics import LOCALIZED_POSE, STATUS

SETTLE_TIME = 1.0
FRESH_NS = 500_000_000


@dataclass(frozen=True, slots=True)
class Journey:
    """How a list of goals ended: one outcome per goal that was begun; `is_localized` is False when the robot never knew its pose."""

    outcomes: tuple[TaskOutcome[NavigateResult], ...]
    is_localized: bool

    @property
    def is_success(self) -> bool:
        return self.is_localized and all(outcome.is_success for outcome in self.outcomes)


@dataclass(frozen=True, slots=True)
class PilotConfig:
    """`goals` in the map frame with their tolerances. `may_turn`: the robot may turn in place, by `turn` radians each time, until it
    knows where it is; without that permission it stands. After `patience` seconds without a pose the journey ends."""

    goals: tuple[SE2, ...] = ()
    xy_tolerance: float = 0.15
    yaw_tolerance: float = 0.2
    may_turn: bool = False
    turn: float = 0.8
    patience: float = 60.0


class PilotNode(Node):
    """Drives to every goal and calls `on_finished` with the journey; a goal that fails does not end it."""

    name = "pilot"
    inputs = (LOCALIZED_POSE,)
    outputs = (STATUS,)
    calls: Offers = (ARM, NAVIGATE, RECOVER)
    latency = 0.001

    def __init__(self, config: PilotConfig, on_finished: Callable[[Journey], None]) -> None:
        self._config = config
        self._on_finished = on_finished
        self._goals = config.goals
        self._outcomes: list[TaskOutcome[NavigateResult]] = []
        self._pose_ns: int | None = None

    def start(self) -> None:
        """Begin after the sensors have settled."""
        self.ctx.subscribe(LOCALIZED_POSE, self._on_pose)
        self.ctx.after(SETTLE_TIME, self._arm)

    @property
    def is_localized(self) -> bool:
        """Whether the localization has told a pose a moment ago."""
        return self._pose_ns is not None and self.ctx.now_ns - self._pose_ns < FRESH_NS

    def _on_pose(self, pose: Odometry) -> None:
        self._pose_ns = pose.stamp_ns

    def _arm(self) -> None:
        self.ctx.call(ARM, GateRequest(self.name, "a journey begins"), self._armed)

    def _armed(self, reply: GateReply | Exception) -> None:
        if isinstance(reply, Exception) or not reply.is_done:
            text = str(reply) if isinstance(reply, Exception) else reply.text
            self._say("NOT_ARMED", f"the gate refused to arm: {text}")
            self.ctx.after(SETTLE_TIME, self._arm)
            return
        self._wait_for_pose()

    def _wait_for_pose(self) -> None:
        """Go on once the pose is known; meanwhile turn, if that is permitted, so that localization sees another view."""
        if self.is_localized:
            self._next_goal()
        elif self.ctx.now_ns > self._config.patience * 1e9:
            self._say("NOT_LOCALIZED", "the robot does not know where it is")
            self._on_finished(Journey((), False))
        elif self._config.may_turn:
            goal = RecoverGoal(RecoveryKind.ROTATE, self._config.turn)
            self.ctx.send_goal(RECOVER, goal, self._turned)
        else:
            self.ctx.after(0.5, self._wait_for_pose)

    def _turned(self, outcome: TaskOutcome[Nothing]) -> None:
        self.ctx.after(0.5, self._wait_for_pose)

    def _next_goal(self) -> None:
        if len(self._outcomes) == len(self._goals):
            self._on_finished(Journey(tuple(self._outcomes), True))
            return
        goal = self._goals[len(self._outcomes)]
        self._say("DRIVING", f"to goal {len(self._outcomes) + 1} of {len(self._goals)}")
        config = self._config
        self.ctx.send_goal(NAVIGATE, NavigateGoal(goal, config.xy_tolerance, config.yaw_tolerance), self._arrived)

    def _arrived(self, outcome: TaskOutcome[NavigateResult]) -> None:
        self._outcomes.append(outcome)
        self._say(outcome.code, outcome.text or f"goal {len(self._outcomes)} is reached")
        self._next_goal()

    def _say(self, code: str, text: str) -> None:
        self.ctx.log(code, text)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text))
