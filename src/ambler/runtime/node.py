"""What a node is. It owns no thread and no time: it subscribes in `start`, has timers, calls one algorithm.

A node declares its inputs and outputs as class attributes, so that a stack can be checked before it runs. The executor
hands it a `Context`, the only way to the world.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from ambler.core.errors import AmblerError
from ambler.core.messages import Message
from ambler.core.requests import TaskOutcome
from ambler.runtime.topics import Topic
from ambler.wire import ros_services

__all__ = [
    "PREEMPTED",
    "Context",
    "GoalHandle",
    "GoalTicket",
    "Node",
    "Offers",
    "Service",
    "Task",
    "TaskOutcome",
    "Topics",
    "WorkKind",
]

PREEMPTED = "PREEMPTED"  # a task that ended because somebody else took what it needs

M = TypeVar("M", bound=Message)
T = TypeVar("T")
Q = TypeVar("Q")
R = TypeVar("R")
G = TypeVar("G")
F = TypeVar("F")


@dataclass(frozen=True, slots=True)
class Service(Generic[Q, R]):
    """A request with one reply; `ros_type` defines both on the wire. `is_outside` says that pages, bridges and other machines may
    offer it to their users; what it is not is for the robot's own nodes and application."""

    name: str
    request: type[Q]
    reply: type[R]
    ros_name: str = ""
    ros_type: str = ""
    is_outside: bool = False

    def encode_request(self, request: Q) -> bytes:
        """Return the request as CDR; raises BadInputError for values that do not fit."""
        return ros_services.encode_request(self.ros_type, request)

    def decode_request(self, data: bytes) -> Q:
        """Read a request; raises BadInputError."""
        return ros_services.decode_request(self.ros_type, self.request, data)

    def encode_reply(self, reply: R | AmblerError) -> bytes:
        """Return the reply, or the error that the server answered with, as CDR."""
        return ros_services.encode_reply(self.ros_type, self.reply, reply)

    def decode_reply(self, data: bytes) -> R:
        """Read a reply; raises the error that the server answered with, or BadInputError."""
        return ros_services.decode_reply(self.ros_type, self.reply, data)


@dataclass(frozen=True, slots=True)
class Task(Generic[G, F, R]):
    """A long-running goal with feedback and a result; cancellable and preemptible, with named failures. `ros_type` defines its parts
    on the wire, `is_outside` is as for services."""

    name: str
    goal: type[G]
    feedback: type[F]
    result: type[R]
    failures: tuple[str, ...]
    ros_name: str = ""
    ros_type: str = ""
    is_outside: bool = False

    def encode_goal(self, goal: G) -> bytes:
        """Return the goal as CDR; raises BadInputError for values that do not fit."""
        return ros_services.encode_goal(self.ros_type, goal)

    def decode_goal(self, data: bytes) -> G:
        """Read a goal; raises BadInputError."""
        return ros_services.decode_goal(self.ros_type, self.goal, data)

    def encode_feedback(self, feedback: F) -> bytes:
        """Return feedback as CDR."""
        return ros_services.encode_feedback(self.ros_type, feedback)

    def decode_feedback(self, data: bytes) -> F:
        """Read feedback; raises BadInputError."""
        return ros_services.decode_feedback(self.ros_type, self.feedback, data)

    def encode_outcome(self, outcome: TaskOutcome[R]) -> bytes:
        """Return how the task ended as CDR."""
        return ros_services.encode_outcome(self.ros_type, self.result, outcome)

    def decode_outcome(self, data: bytes) -> TaskOutcome[R]:
        """Read how the task ended; raises BadInputError."""
        return ros_services.decode_outcome(self.ros_type, self.result, data)


class WorkKind(enum.Enum):
    """Classes of background work. Each has a thread of its own, so that none of one class waits for work of another."""

    CONTROL = "control"
    PERCEPTION = "perception"
    MAPPING = "mapping"


Topics = tuple[Topic[Any], ...]
Offers = tuple[Service[Any, Any] | Task[Any, Any, Any], ...]


class GoalHandle(Generic[G, F, R]):
    """The server's side of one goal. After `succeed`, `fail` or `cancelled` every further call is ignored."""

    def __init__(
        self, goal: G, send_feedback: Callable[[F], None], send_outcome: Callable[[TaskOutcome[R]], None]
    ) -> None:
        self.goal = goal
        self.is_active = True
        self.is_preempted = False
        self._send_feedback = send_feedback
        self._send_outcome = send_outcome

    def feedback(self, feedback: F) -> None:
        """Tell the client how far the goal is."""
        if self.is_active:
            self._send_feedback(feedback)

    def succeed(self, result: R, text: str = "") -> None:
        """End the goal successfully; `text` says what is worth knowing about it."""
        self.end(TaskOutcome("SUCCEEDED", text, result))

    def fail(self, code: str, text: str, result: R | None = None) -> None:
        """End the goal with one of the task's named failures and one sentence that says why."""
        self.end(TaskOutcome(code, text, result))

    def cancelled(self, result: R | None = None) -> None:
        """End the goal because its client cancelled it, or because a newer goal took its place."""
        if self.is_preempted:
            self.end(TaskOutcome(PREEMPTED, "a newer goal took its place", result))
        else:
            self.end(TaskOutcome("CANCELLED", "cancelled on request", result))

    def end(self, outcome: TaskOutcome[R]) -> None:
        """End the goal with any outcome."""
        if self.is_active:
            self.is_active = False
            self._send_outcome(outcome)


class GoalTicket(Protocol):
    """The client's side of one goal."""

    def cancel(self) -> None: ...


class Context(Protocol):
    """What the executor offers to a node. Every callback of one node runs alone: a node needs no lock."""

    @property
    def now_ns(self) -> int:
        """The executor's time, nanoseconds."""
        ...

    def subscribe(self, topic: Topic[M], callback: Callable[[M], None]) -> None:
        """Call back for each message, in order; with a `latest` topic only the newest waiting one."""
        ...

    def publish(self, topic: Topic[M], message: M) -> None:
        """Publish now; subscribers get it after the node's declared latency."""
        ...

    def newest(self, topic: Topic[M]) -> M | None:
        """Return the newest message delivered to this node, or None; raises StaleInputError when it is older than the topic allows."""
        ...

    def timer(self, period: float, callback: Callable[[], None], *, phase: float = 0.0) -> None:
        """Call back every `period` seconds, the first time `phase` seconds after the start plus one period."""
        ...

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        """Call back once, `delay` seconds from now."""
        ...

    def background(
        self,
        work: Callable[[], T],
        duration: float,
        done: Callable[[T], None],
        kind: WorkKind = WorkKind.MAPPING,
    ) -> None:
        """Run pure `work` off the node's time, after earlier work of the same kind; `done` gets its value `duration` simulated
        seconds later (live: when it is ready)."""
        ...

    def serve(self, service: Service[Q, R], handler: Callable[[Q], R]) -> None:
        """Answer a service. An AmblerError raised by the handler reaches the caller as a failed reply."""
        ...

    def call(self, service: Service[Q, R], request: Q, done: Callable[[R | Exception], None]) -> None:
        """Ask a service; `done` gets the reply, or the AmblerError that the handler raised."""
        ...

    def serve_task(
        self,
        task: Task[G, F, R],
        on_goal: Callable[[GoalHandle[G, F, R]], None],
        on_cancel: Callable[[GoalHandle[G, F, R]], None],
    ) -> None:
        """Offer a task. A new goal first cancels the running one, whose client sees PREEMPTED."""
        ...

    def send_goal(
        self,
        task: Task[G, F, R],
        goal: G,
        on_done: Callable[[TaskOutcome[R]], None],
        on_feedback: Callable[[F], None] | None = None,
    ) -> GoalTicket:
        """Start a task."""
        ...

    def log(self, code: str, text: str, **fields: Any) -> None:
        """Write one line of the structured log."""
        ...


class Node:
    """Base class. Subclasses set the declarations, for the class or for one instance, and override `start`; `stop` is called once at
    the end. `kept_inputs` are those whose messages it only keeps until something else asks for them: live, it is not woken for each.
    `commands` says that a wheel waits for it: live, its thread goes before those of the others where that is permitted."""

    name: str = ""
    inputs: Topics = ()
    optional_inputs: Topics = ()
    kept_inputs: Topics = ()
    outputs: Topics = ()
    serves: Offers = ()
    calls: Offers = ()
    latency: float = 0.001
    commands: bool = False
    ctx: Context

    def start(self) -> None:
        """Subscribe, set timers, serve; `self.ctx` is ready."""

    def stop(self) -> None:
        """Close files and sockets."""
