"""What both executors share: contexts, subscriptions, services, tasks, and what happens when a node fails.

An executor decides only *when* a callback runs. A call-back of one node never overlaps another of the same node.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self, TypeVar

from ambler.core.errors import AmblerError, StackError, StaleInputError
from ambler.core.messages import Message
from ambler.runtime.log import RunLog
from ambler.runtime.node import GoalHandle, Node, Service, Task, TaskOutcome
from ambler.runtime.stack import Stack
from ambler.runtime.topics import Topic, all_topics

T = TypeVar("T")

Tap = Callable[[Topic[Any], Message, int, str], None]
"""Sees every delivered message once: topic, message, delivery time in ns, name of the writer."""

EXTERNAL = "outside"


class NodeFailedError(AmblerError):
    """A node raised; the robot was stopped."""

    code = "NODE_FAILED"


@dataclass(slots=True)
class Subscription:
    """One node's interest in one topic."""

    context: NodeContext
    callback: Callable[[Any], None]


@dataclass(slots=True)
class TaskServer:
    """One node's offer of a task, and the goal that it works on."""

    context: NodeContext
    on_goal: Callable[[Any], None]
    on_cancel: Callable[[Any], None]
    active: GoalHandle[Any, Any, Any] | None = None


class NodeContext:
    """A node's only way to the world; see `runtime.node.Context`."""

    def __init__(self, executor: Executor, node: Node, index: int) -> None:
        self.executor = executor
        self.node = node
        self.index = index
        self.latency_ns = max(1000, round(node.latency * 1e9))
        self.is_failed = False
        self.timers = 0
        self._newest: dict[str, Message] = {}
        self._published: dict[str, int] = {}

    @property
    def now_ns(self) -> int:
        return self.executor.now_ns

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self._check(topic, (*self.node.inputs, *self.node.optional_inputs), "reads")
        self.executor.subscriptions[topic.name].append(Subscription(self, callback))

    def publish(self, topic: Topic[Any], message: Message) -> None:
        self._check(topic, self.node.outputs, "writes")
        if type(message) is not topic.type:
            raise StackError(f"{self.node.name} put a {type(message).__name__} on {topic.name!r}")
        number = self._published[topic.name] = self._published.get(topic.name, 0) + 1
        self.executor.send(topic, message, self, number)

    def receive(self, topic: Topic[Any], message: Message) -> None:
        """Remember the newest message of a topic (called by the executor before the callbacks)."""
        self._newest[topic.name] = message

    def newest(self, topic: Topic[Any]) -> Any:
        message: Any = self._newest.get(topic.name)
        if message is not None and topic.max_age is not None:
            age = (self.now_ns - message.stamp_ns) * 1e-9
            if age > topic.max_age:
                raise StaleInputError(f"{topic.name} is {age:.2f} s old, allowed are {topic.max_age} s")
        return message

    def timer(self, period: float, callback: Callable[[], None], *, phase: float = 0.0) -> None:
        self.timers += 1
        self.executor.add_timer(self, round(period * 1e9), round(phase * 1e9), callback, self.timers)

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        self.executor.post(self, round(delay * 1e9), callback)

    def background(self, work: Callable[[], T], duration: float, done: Callable[[T], None]) -> None:
        self.executor.run_in_background(self, work, round(duration * 1e9), done)

    def serve(self, service: Service[Any, Any], handler: Callable[[Any], Any]) -> None:
        self._check_offer(service, self.node.serves, "serves")
        self.executor.services[service.name] = (self, handler)

    def call(self, service: Service[Any, Any], request: Any, done: Callable[[Any], None]) -> None:
        self._check_offer(service, self.node.calls, "calls")
        server, handler = self.executor.services[service.name]

        def answer() -> None:
            reply: Any
            try:
                reply = handler(request)
            except AmblerError as error:
                reply = error
            self.executor.post(self, server.latency_ns, lambda: done(reply))

        self.executor.post(server, self.latency_ns, answer)

    def serve_task(
        self, task: Task[Any, Any, Any], on_goal: Callable[[Any], None], on_cancel: Callable[[Any], None]
    ) -> None:
        self._check_offer(task, self.node.serves, "serves")
        self.executor.tasks[task.name] = TaskServer(self, on_goal, on_cancel)

    def send_goal(
        self,
        task: Task[Any, Any, Any],
        goal: Any,
        on_done: Callable[[TaskOutcome[Any]], None],
        on_feedback: Callable[[Any], None] | None = None,
    ) -> GoalTicketOfContext:
        self._check_offer(task, self.node.calls, "calls")
        server = self.executor.tasks[task.name]
        post = self.executor.post

        def send_feedback(feedback: Any) -> None:
            if on_feedback is not None:
                post(self, server.context.latency_ns, lambda: on_feedback(feedback))

        def send_outcome(outcome: TaskOutcome[Any]) -> None:
            if server.active is handle:
                server.active = None
            post(self, server.context.latency_ns, lambda: on_done(outcome))

        handle: GoalHandle[Any, Any, Any] = GoalHandle(goal, send_feedback, send_outcome)
        post(server.context, self.latency_ns, lambda: _start_goal(server, handle))
        return GoalTicketOfContext(self, server, handle)

    def log(self, code: str, text: str, **fields: Any) -> None:
        self.executor.log.write(self.now_ns, self.node.name, code, text, **fields)

    def _check(self, topic: Topic[Any], declared: tuple[Topic[Any], ...], verb: str) -> None:
        if topic not in declared:
            raise StackError(f"{self.node.name} {verb} {topic.name!r} without declaring it")

    def _check_offer(self, offer: Any, declared: tuple[Any, ...], verb: str) -> None:
        if offer not in declared:
            raise StackError(f"{self.node.name} {verb} {offer.name!r} without declaring it")


def _start_goal(server: TaskServer, handle: GoalHandle[Any, Any, Any]) -> None:
    running = server.active
    if running is not None and running.is_active:
        running.is_preempted = True
        server.on_cancel(running)
        running.cancelled()
    server.active = handle
    server.on_goal(handle)


class GoalTicketOfContext:
    """The client's side of one goal; see `runtime.node.GoalTicket`."""

    def __init__(self, client: NodeContext, server: TaskServer, handle: GoalHandle[Any, Any, Any]) -> None:
        self._client = client
        self._server = server
        self._handle = handle

    def cancel(self) -> None:
        def cancel_on_server() -> None:
            if self._handle.is_active:
                self._server.on_cancel(self._handle)
                self._handle.cancelled()

        self._client.executor.post(self._server.context, self._client.latency_ns, cancel_on_server)


class Executor(abc.ABC):
    """Runs a stack. `on_failure` is called once with the reason when a node raises: it must stop the robot."""

    def __init__(
        self, stack: Stack, log: RunLog | None = None, on_failure: Callable[[str], None] | None = None
    ) -> None:
        self.stack = stack
        self.log = log if log is not None else RunLog()
        self.subscriptions: dict[str, list[Subscription]] = {topic.name: [] for topic in all_topics()}
        self.services: dict[str, tuple[NodeContext, Callable[[Any], Any]]] = {}
        self.tasks: dict[str, TaskServer] = {}
        self.contexts = [NodeContext(self, node, i) for i, node in enumerate(stack.nodes)]
        self.failure: NodeFailedError | None = None
        self._taps: list[Tap] = []
        self._on_failure = on_failure
        self._is_started = False
        for node, context in zip(stack.nodes, self.contexts, strict=True):
            node.ctx = context

    @property
    @abc.abstractmethod
    def now_ns(self) -> int:
        """Time, nanoseconds."""

    @abc.abstractmethod
    def send(self, topic: Topic[Any], message: Message, writer: NodeContext, number: int) -> None:
        """Deliver a message to every subscriber; `number` counts the writer's messages on this topic."""

    @abc.abstractmethod
    def post(self, context: NodeContext, delay_ns: int, callback: Callable[[], None]) -> None:
        """Run a callback in a node's turn."""

    @abc.abstractmethod
    def add_timer(
        self, context: NodeContext, period_ns: int, phase_ns: int, callback: Callable[[], None], number: int
    ) -> None:
        """Run a callback periodically."""

    @abc.abstractmethod
    def run_in_background(
        self, context: NodeContext, work: Callable[[], T], duration_ns: int, done: Callable[[T], None]
    ) -> None:
        """Run work off the node's time and give its value back in the node's turn."""

    @abc.abstractmethod
    def inject(self, topic: Topic[Any], message: Message) -> None:
        """Put a message from outside on an external topic; may be called from any thread."""

    @abc.abstractmethod
    def stop(self) -> None:
        """End `run` after the current callback; may be called from any thread."""

    @abc.abstractmethod
    def run(self, duration: float | None = None) -> None:
        """Run until `duration` seconds are over or `stop` is called; may be called again. Raises NodeFailedError."""

    def tap(self, callback: Tap) -> Callable[[], None]:
        """Show every delivered message to `callback`: a recorder, a live view. Returns what ends it."""
        self._taps.append(callback)
        return lambda: self._taps.remove(callback)

    def show(self, topic: Topic[Any], message: Message, now_ns: int, writer: str) -> None:
        """Show a message to the taps."""
        for tap in tuple(self._taps):
            tap(topic, message, now_ns, writer)

    @abc.abstractmethod
    def close(self) -> None:
        """Stop every node and release threads."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start_nodes(self) -> None:
        """Start every node once, in the order of the stack."""
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

    def _fail(self, context: NodeContext, error: Exception) -> None:
        context.is_failed = True
        reason = f"node {context.node.name} failed: {type(error).__name__}: {error}"
        self.log.write(self.now_ns, context.node.name, "NODE_FAILED", reason)
        if self.failure is None:
            self.failure = NodeFailedError(reason)
            self.failure.__cause__ = error
        if self._on_failure is not None:
            self._on_failure(reason)
        self.after_failure()

    @abc.abstractmethod
    def after_failure(self) -> None:
        """Let the robot come to rest for a moment, then end `run`."""
