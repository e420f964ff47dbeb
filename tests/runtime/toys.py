"""Toy nodes for the tests of the runtime."""

from dataclasses import dataclass
from typing import Any

from ambler.core.errors import StaleInputError
from ambler.core.messages import PointStamped, VelocityCommand
from ambler.runtime.node import GoalHandle, Node, Service, Task, TaskOutcome
from ambler.runtime.topics import ODOMETRY, TELEOP_REQUEST, VELOCITY_REQUEST, Topic

COUNT = Topic("goal", PointStamped, "/count", depth=3)
DOUBLE: Service[int, int] = Service("double", int, int)


@dataclass(frozen=True, slots=True)
class Steps:
    count: int


WALK: Task[Steps, int, int] = Task("walk", Steps, int, int, ("TIRED",))


class Source(Node):
    """Sends a teleoperation request every 50 ms, with a number in vx."""

    name = "source"
    outputs = (TELEOP_REQUEST,)
    latency = 0.004

    def start(self) -> None:
        self.sent = 0
        self.ctx.timer(0.05, self._tick)

    def _tick(self) -> None:
        self.sent += 1
        self.ctx.publish(TELEOP_REQUEST, VelocityCommand(self.ctx.now_ns, float(self.sent)))


class Filter(Node):
    """Publishes the running mean of what it hears, every 100 ms."""

    name = "filter"
    inputs = (TELEOP_REQUEST,)
    outputs = (VELOCITY_REQUEST,)
    latency = 0.01

    def start(self) -> None:
        self.heard: list[tuple[int, float]] = []
        self.stale = 0
        self.ctx.subscribe(TELEOP_REQUEST, self._hear)
        self.ctx.timer(0.1, self._tick)

    def _hear(self, message: VelocityCommand) -> None:
        self.heard.append((self.ctx.now_ns, message.vx))

    def _tick(self) -> None:
        try:
            newest = self.ctx.newest(TELEOP_REQUEST)
        except StaleInputError:
            self.stale += 1
            return
        if newest is not None:
            mean = sum(v for _, v in self.heard) / len(self.heard)
            self.ctx.publish(VELOCITY_REQUEST, VelocityCommand(newest.stamp_ns, mean, 1.0 / 3.0, mean * 0.1))


class Server(Node):
    """Doubles numbers and walks steps of 10 ms."""

    name = "server"
    serves = (DOUBLE, WALK)

    def start(self) -> None:
        self.cancelled: list[Steps] = []
        self.ctx.serve(DOUBLE, lambda n: 2 * n)
        self.ctx.serve_task(WALK, self._on_goal, lambda handle: self.cancelled.append(handle.goal))

    def _on_goal(self, handle: GoalHandle[Steps, int, int]) -> None:
        self._step(handle, 0)

    def _step(self, handle: GoalHandle[Steps, int, int], done: int) -> None:
        if not handle.is_active:
            return
        if done == 7:
            handle.fail("TIRED", "seven steps are enough")
        elif done == handle.goal.count:
            handle.succeed(done)
        else:
            handle.feedback(done)
            self.ctx.after(0.02, lambda: self._step(handle, done + 1))


class Client(Node):
    """Runs a list of (delay, step count or 'cancel') and remembers every outcome."""

    name = "client"
    calls = (DOUBLE, WALK)

    def __init__(self, script: list[tuple[float, Any]]) -> None:
        self.script = script
        self.replies: list[Any] = []
        self.outcomes: list[TaskOutcome[int]] = []
        self.feedback: list[int] = []

    def start(self) -> None:
        self.ctx.after(0.001, lambda: self.ctx.call(DOUBLE, 21, self.replies.append))
        for delay, action in self.script:
            self.ctx.after(delay, lambda a=action: self._act(a))  # type: ignore[misc]

    def _act(self, action: Any) -> None:
        if action == "cancel":
            self.ticket.cancel()
        else:
            self.ticket = self.ctx.send_goal(WALK, Steps(action), self.outcomes.append, self.feedback.append)


class Bomb(Node):
    """Raises at its third tick."""

    name = "bomb"

    def start(self) -> None:
        self.ticks = 0
        self.ctx.timer(0.01, self._tick)

    def _tick(self) -> None:
        self.ticks += 1
        if self.ticks == 3:
            raise ZeroDivisionError("boom")


class OdometryReader(Node):
    name = "reader"
    inputs = (ODOMETRY,)
