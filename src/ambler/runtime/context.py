"""A node's only way to the world, the same in both executors; see `runtime.node.Context`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from ambler.core.errors import AmblerError, StackError, StaleInputError
from ambler.core.messages import Message
from ambler.runtime.bus import Bus, Subscription, TaskServer
from ambler.runtime.node import GoalHandle, Node, Service, Task, TaskOutcome, WorkKind
from ambler.runtime.topics import Topic

if TYPE_CHECKING:
    from ambler.runtime.executor import Executor

T = TypeVar("T")


class NodeContext:
    """What the executor offers to one node. `index` is the node's place in its stack, `name` is unique in the executor."""

    def __init__(self, executor: Executor, bus: Bus, node: Node, index: int) -> None:
        self.executor = executor
        self.bus = bus
        self.node = node
        self.index = index
        self.name = f"{bus.prefix}/{node.name}" if bus.prefix else node.name
        self.latency_ns = max(1000, round(node.latency * 1e9))
        self.is_failed = False
        self.timers = 0
        self._newest: dict[str, Message] = {}
        self._published: dict[str, int] = {}

    @property
    def now_ns(self) -> int:
        return self.executor.now_ns

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        _check(self.node, topic, (*self.node.inputs, *self.node.optional_inputs), "reads")
        subscription = Subscription(self, callback, can_wait=topic in self.node.kept_inputs)
        self.executor.subscribe(self.bus.channel(topic), subscription)

    def publish(self, topic: Topic[Any], message: Message) -> None:
        _check(self.node, topic, self.node.outputs, "writes")
        if type(message) is not topic.type:
            raise StackError(f"{self.node.name} put a {type(message).__name__} on {topic.name!r}")
        number = self._published[topic.name] = self._published.get(topic.name, 0) + 1
        self.executor.send(self.bus.channel(topic), message, self, number)

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
        if period <= 0.0:
            raise StackError(f"node {self.name}: a timer's period must be positive, not {period} s")
        self.timers += 1
        self.executor.add_timer(self, round(period * 1e9), round(phase * 1e9), callback, self.timers)

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        self.executor.post(self, round(delay * 1e9), callback)

    def background(
        self,
        work: Callable[[], T],
        duration: float,
        done: Callable[[T], None],
        kind: WorkKind = WorkKind.MAPPING,
    ) -> None:
        self.executor.run_in_background(self, work, round(duration * 1e9), done, kind)

    def serve(self, service: Service[Any, Any], handler: Callable[[Any], Any]) -> None:
        _check(self.node, service, self.node.serves, "serves")
        self.bus.services[service.name] = (self, handler)

    def call(self, service: Service[Any, Any], request: Any, done: Callable[[Any], None]) -> None:
        _check(self.node, service, self.node.calls, "calls")
        server, handler = self.bus.services[service.name]

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
        _check(self.node, task, self.node.serves, "serves")
        self.bus.tasks[task.name] = TaskServer(self, on_goal, on_cancel)

    def send_goal(
        self,
        task: Task[Any, Any, Any],
        goal: Any,
        on_done: Callable[[TaskOutcome[Any]], None],
        on_feedback: Callable[[Any], None] | None = None,
    ) -> GoalTicketOfContext:
        _check(self.node, task, self.node.calls, "calls")
        server = self.bus.tasks[task.name]
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
        self.executor.log_line(self.name, code, text, **fields)


def _check(node: Node, wanted: Any, declared: tuple[Any, ...], verb: str) -> None:
    if wanted not in declared:
        raise StackError(f"{node.name} {verb} {wanted.name!r} without declaring it")


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
