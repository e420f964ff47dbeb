"""What both executors share: stacks, contexts, the outside door, who watches, and what happens when a node fails.

An executor decides only *when* a callback runs. A call-back of one node never overlaps another of the same node.
"""

from __future__ import annotations

import abc
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Self, TypeVar

from ambler.core.errors import AmblerError, StackError
from ambler.core.messages import Message, OutsideCall
from ambler.runtime.bus import Bus, Channel, Subscription, Tap
from ambler.runtime.context import NodeContext
from ambler.runtime.conveyor import describe
from ambler.runtime.door import OUTSIDE, OutsideDoor, OutsideTicket, RunEndedError
from ambler.runtime.log import RunLog
from ambler.runtime.node import Service, Task, WorkKind
from ambler.runtime.stack import Stack
from ambler.runtime.topics import Topic
from ambler.runtime.troubles import Troubles

F = TypeVar("F")
G = TypeVar("G")
Q = TypeVar("Q")
R = TypeVar("R")
T = TypeVar("T")

EXTERNAL = OUTSIDE


class NodeFailedError(AmblerError):
    """A node raised; the robot was stopped."""

    code = "NODE_FAILED"


class Executor(abc.ABC):
    """Runs one stack, or several with different prefixes. `on_failure` is called first of all when a node raises: it must stop the
    robots. What goes wrong beside the run (taps, listeners, recorders, the log) is counted in `troubles` and never stops anything.

    Raises StackError when two stacks have the same prefix.
    """

    begin_background: Callable[[], None] | None = None
    """Called first in every thread of background work."""

    def __init__(
        self,
        stacks: Stack | Sequence[Stack],
        log: RunLog | None = None,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        self.stacks = (stacks,) if isinstance(stacks, Stack) else tuple(stacks)
        self.log = log if log is not None else RunLog()
        self.troubles = Troubles(lambda code, text: self.log_line("executor", code, text))
        self.failure: NodeFailedError | None = None
        self._buses = {stack.prefix: Bus(stack, index) for index, stack in enumerate(self.stacks)}
        if len(self._buses) < len(self.stacks) or not self.stacks:
            raise StackError(f"an executor runs stacks of different prefixes, not {[s.prefix for s in self.stacks]}")
        self._doors = {prefix: OutsideDoor(self, bus) for prefix, bus in self._buses.items()}
        self.contexts = [
            NodeContext(self, bus, node, index)
            for bus in self._buses.values()
            for index, node in enumerate(bus.stack.nodes)
        ]
        self._pools: dict[tuple[str, WorkKind], ThreadPoolExecutor] = {}
        self._on_failure = on_failure
        self._failing = threading.Lock()
        self._is_started = False
        for context in self.contexts:
            context.node.ctx = context

    @property
    def stack(self) -> Stack:
        """The only stack; raises StackError when there are several."""
        if len(self.stacks) > 1:
            raise StackError("this executor runs several stacks; name one by its prefix")
        return self.stacks[0]

    @property
    @abc.abstractmethod
    def now_ns(self) -> int:
        """Time, nanoseconds."""

    @abc.abstractmethod
    def subscribe(self, channel: Channel, subscription: Subscription) -> None:
        """Add a subscription; what a latched topic holds already comes in the subscriber's own turn."""

    @abc.abstractmethod
    def send(self, channel: Channel, message: Message, writer: NodeContext, number: int) -> None:
        """Deliver a message to every subscriber; `number` counts the writer's messages on this topic."""

    @abc.abstractmethod
    def post(self, context: NodeContext, delay_ns: int, callback: Callable[[], None]) -> None:
        """Run a callback in a node's turn; may be called from any thread."""

    @abc.abstractmethod
    def post_outside(self, door: OutsideDoor, callback: Callable[[], None]) -> None:
        """Run a callback in the turn of a stack's door; may be called from any thread."""

    @abc.abstractmethod
    def show_outside(self, bus: Bus, call: OutsideCall) -> None:
        """Show an outside call to the taps, in the turn of the door."""

    @abc.abstractmethod
    def add_timer(
        self, context: NodeContext, period_ns: int, phase_ns: int, callback: Callable[[], None], number: int
    ) -> None:
        """Run a callback periodically."""

    @abc.abstractmethod
    def run_in_background(
        self, context: NodeContext, work: Callable[[], T], duration_ns: int, done: Callable[[T], None], kind: WorkKind
    ) -> None:
        """Run work off the node's time and give its value back in the node's turn."""

    @abc.abstractmethod
    def inject(self, topic: Topic[Any], message: Message, prefix: str = "") -> None:
        """Put a message from outside on an external topic of a stack; may be called from any thread."""

    @abc.abstractmethod
    def stop(self) -> None:
        """End `run` after the current callback; may be called from any thread."""

    @abc.abstractmethod
    def run(self, duration: float | None = None) -> None:
        """Run until `duration` seconds are over or `stop` is called; may be called again. Raises NodeFailedError."""

    @abc.abstractmethod
    def after_failure(self) -> None:
        """Let the robots come to rest for a moment, then end `run`."""

    def call(self, service: Service[Q, R], request: Q, prefix: str = "") -> Future[R]:
        """Call a service from outside, from any thread. The future gives the reply, or raises the AmblerError of the server, or why
        the run ended before: RunEndedError, NodeFailedError. Its callbacks run on the door's turn and must be short.

        Raises StackError when no node serves it, BadInputError when the request cannot be encoded.
        """
        return self._door(prefix).call(service, request)

    def send_goal(
        self, task: Task[G, F, R], goal: G, on_feedback: Callable[[F], None] | None = None, prefix: str = ""
    ) -> OutsideTicket[F, R]:
        """Start a task from outside, from any thread; raises as `call`. What `on_feedback` raises is counted in `troubles`."""
        return self._door(prefix).send_goal(task, goal, on_feedback)

    def tap(self, callback: Tap, prefix: str = "") -> Callable[[], None]:
        """Show every delivered message of a stack to `callback`: a recorder, a live view. Returns what ends it."""
        bus = self._bus(prefix)
        bus.taps = (*bus.taps, callback)

        def end() -> None:
            bus.taps = tuple(tap for tap in bus.taps if tap is not callback)

        return end

    def show(self, bus: Bus, topic: Topic[Any], message: Message, now_ns: int, writer: str) -> None:
        """Show a message to the taps. One that raises is counted and shown no more."""
        for tap in bus.taps:
            if not self.troubles.attempt("TAP_FAILED", lambda tap=tap: tap(topic, message, now_ns, writer)):  # type: ignore[misc]
                bus.taps = tuple(other for other in bus.taps if other is not tap)

    def context_of(self, node: str, prefix: str = "") -> NodeContext:
        """Return the context of a node by its name; raises KeyError."""
        for context in self.contexts:
            if context.node.name == node and context.bus.prefix == prefix:
                return context
        raise KeyError(f"no stack {prefix!r} with a node {node!r}")

    def log_line(self, node: str, code: str, text: str, **fields: Any) -> None:
        """Write one line of the log; whatever is wrong with the log is counted in `troubles` of both and goes no further."""
        try:
            self.log.write(self.now_ns, node, code, text, **fields)
        except Exception as error:  # noqa: BLE001  (a log of whatever kind must not reach a node's turn, nor a stop)
            self.troubles.note("LOG_FAILED", describe(error))

    def close(self) -> None:
        """Stop every node, answer whoever still waits outside, and release threads."""
        self.stop_nodes()
        self._end_calls(RunEndedError("the executor was closed"), for_good=True)
        for pool in self._pools.values():
            pool.shutdown(wait=True, cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start_nodes(self) -> None:
        """Start every node once, in the order of the stacks."""
        if self._is_started:
            return
        self._is_started = True
        for context in self.contexts:
            self.guarded(context, context.node.start)
        if self.failure is not None:
            raise self.failure

    def stop_nodes(self) -> None:
        """Stop every node once, in reverse order."""
        if not self._is_started:
            return
        self._is_started = False
        for context in reversed(self.contexts):
            self.guarded(context, context.node.stop)

    def guarded(self, context: NodeContext, callback: Callable[[], None]) -> None:
        """Run a callback in a node's turn. The border where any fault of a node becomes NODE_FAILED and stops the robot."""
        if context.is_failed:
            return
        try:
            callback()
        except Exception as error:  # noqa: BLE001  (the one place where every fault of a node ends)
            self._fail(context, error)

    def pool(self, context: NodeContext, kind: WorkKind) -> ThreadPoolExecutor:
        """Return the one thread of a stack for background work of a kind."""
        key = context.bus.prefix, kind
        pool = self._pools.get(key)
        if pool is None:
            pool = ThreadPoolExecutor(1, f"background-{kind.value}", initializer=self.begin_background)
            pool = self._pools.setdefault(key, pool)
        return pool

    def end_run(self, *, is_over: bool) -> None:
        """Tell those who wait outside that a run is over (it failed, was stopped, or nothing is left to do), and raise its failure."""
        if self.failure is not None:
            self._end_calls(self.failure, for_good=True)
            raise self.failure
        if is_over:
            self._end_calls(RunEndedError("the run was stopped"), for_good=False)

    def _fail(self, context: NodeContext, error: Exception) -> None:
        """Stop first, then tell."""
        context.is_failed = True
        reason = f"node {context.name} failed: {describe(error)}"
        with self._failing:
            if self.failure is None:
                self.failure = NodeFailedError(reason)
                self.failure.__cause__ = error
        on_failure = self._on_failure
        if on_failure is not None:
            self.troubles.attempt("STOP_FAILED", lambda: on_failure(reason))
        self.after_failure()
        self.log_line(context.name, "NODE_FAILED", reason)

    def _end_calls(self, reason: AmblerError, *, for_good: bool) -> None:
        for door in self._doors.values():
            door.end(reason, for_good=for_good)

    def _bus(self, prefix: str) -> Bus:
        try:
            return self._buses[prefix]
        except KeyError:
            raise StackError(f"no stack has the prefix {prefix!r}; there are {sorted(self._buses)}") from None

    def _door(self, prefix: str) -> OutsideDoor:
        self._bus(prefix)
        return self._doors[prefix]
