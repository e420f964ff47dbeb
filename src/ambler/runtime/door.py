"""The outside door of a stack: services and tasks for whoever is no node of it. Pages, bridges, scripts and the application use it.

What comes in is encoded in the caller's thread, waits for the door's turn, is shown to the taps as an OutsideCall, is decoded
again, and then takes the way of every inside call. So a recording holds exactly what the server got, and a replay that feeds the
recorded OUTSIDE_CALLS repeats it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ambler.core.errors import AmblerError, StackError
from ambler.core.messages import OutsideCall, OutsideKind
from ambler.runtime.context import GoalTicketOfContext, NodeContext
from ambler.runtime.node import Node, Offers, Service, Task, TaskOutcome
from ambler.runtime.tasks import service_named, task_named

if TYPE_CHECKING:
    from ambler.runtime.bus import Bus
    from ambler.runtime.executor import Executor

F = TypeVar("F")
Q = TypeVar("Q")
R = TypeVar("R")

OUTSIDE = "outside"


class RunEndedError(AmblerError):
    """The run ended before an outside call was answered."""

    code = "RUN_ENDED"


class _Caller(Node):
    """Stands in the stack for everybody outside."""

    name = OUTSIDE
    latency = 1e-6

    def __init__(self, calls: Offers) -> None:
        self.calls = calls


@dataclass(slots=True, eq=False)
class _Wish:
    """What somebody outside wants, and where the answer goes."""

    kind: OutsideKind
    name: str
    data: bytes
    answer: Future[Any]
    on_feedback: Callable[[Any], None] | None = None
    number: int = 0


class OutsideTicket(Generic[F, R]):
    """One goal sent from outside. `outcome` resolves with the TaskOutcome, however the task ended, or raises why the run ended
    before; `feedback` is the newest (None: none yet). Safe from any thread."""

    def __init__(self, door: OutsideDoor, wish: _Wish) -> None:
        self.outcome: Future[TaskOutcome[R]] = wish.answer
        self.feedback: F | None = None
        self._door = door
        self._wish = wish

    def cancel(self) -> None:
        """Ask the server to end the goal; its outcome will say CANCELLED, or how it ended before."""
        self._door.cancel(self._wish)


class OutsideDoor:
    """Lets calls of one stack in, from any thread. What is not answered when the run ends gets an error, so that nobody hangs."""

    def __init__(self, executor: Executor, bus: Bus) -> None:
        self.context = NodeContext(executor, bus, _Caller(bus.stack.served), len(bus.stack.nodes))
        self._executor = executor
        self._bus = bus
        self._lock = threading.Lock()
        self._pending: set[_Wish] = set()
        self._tickets: dict[int, GoalTicketOfContext] = {}
        self._count = 0
        self._end: AmblerError | None = None

    def call(self, service: Service[Q, R], request: Q) -> Future[R]:
        """Call a service; the future gives the reply or raises the AmblerError that the server answered with.

        Raises StackError when nobody serves it, BadInputError when the request cannot be encoded.
        """
        self._check(service, service_named)
        return self._enter(_Wish(OutsideKind.CALL, service.name, service.encode_request(request), Future()))

    def send_goal(
        self, task: Task[Q, F, R], goal: Q, on_feedback: Callable[[F], None] | None = None
    ) -> OutsideTicket[F, R]:
        """Start a task; raises as `call`."""
        self._check(task, task_named)
        wish = _Wish(OutsideKind.GOAL, task.name, task.encode_goal(goal), Future())
        ticket: OutsideTicket[F, R] = OutsideTicket(self, wish)

        def hear(feedback: F) -> None:
            ticket.feedback = feedback
            if on_feedback is not None:
                self._executor.troubles.attempt("OUTSIDE_LISTENER_FAILED", lambda: on_feedback(feedback))

        wish.on_feedback = hear
        self._enter(wish)
        return ticket

    def cancel(self, goal: _Wish) -> None:
        """Cancel a goal that came through this door."""
        if not goal.answer.done():
            self._executor.post_outside(self, lambda: self._cancel(goal))

    def repeat(self, call: OutsideCall) -> None:
        """Do in the door's turn what a recording holds; whoever waits for the answer is not there any more."""
        self._count = max(self._count, call.number)
        self._executor.show_outside(self._bus, call)
        known = self._bus.tasks if call.kind is OutsideKind.GOAL else self._bus.services
        if call.kind is OutsideKind.CANCEL:
            self._withdraw(call.number)
        elif call.name in known:
            self._act(call, _Wish(call.kind, call.name, call.data, Future()))

    def end(self, reason: AmblerError, *, for_good: bool) -> None:
        """Answer whoever still waits with an error, and call their goals off; `for_good` refuses whatever comes later as well."""
        with self._lock:
            waiting, self._pending = sorted(self._pending, key=lambda wish: wish.number), set()
            if for_good:
                self._end = reason
        for wish in waiting:
            if wish.kind is OutsideKind.GOAL and wish.number and not for_good:
                self._executor.post_outside(self, lambda number=wish.number: self._record_cancel(number))  # type: ignore[misc]
            wish.answer.set_exception(reason)

    def _check(self, offer: Any, find: Callable[[str], Any]) -> None:
        if offer not in self.context.node.calls:
            raise StackError(f"nobody serves {offer.name!r}")
        try:
            find(offer.name)
        except KeyError:
            raise StackError(f"{offer.name!r} is not in the table of services and tasks") from None

    def _enter(self, wish: _Wish) -> Future[Any]:
        wish.answer.set_running_or_notify_cancel()  # whoever waits cannot take it back; goals have `cancel`
        with self._lock:
            end = self._end
            if end is None:
                self._pending.add(wish)
        if end is not None:
            wish.answer.set_exception(end)
        else:
            self._executor.post_outside(self, lambda: self._admit(wish))
        return wish.answer

    def _admit(self, wish: _Wish) -> None:
        """Number, show and do a wish, in the door's turn."""
        if wish not in self._pending:  # the run ended before its turn came
            return
        self._count += 1
        wish.number = self._count
        call = OutsideCall(self._executor.now_ns, wish.kind, wish.name, wish.number, wish.data)
        self._executor.show_outside(self._bus, call)
        try:
            self._act(call, wish)
        except (StackError, KeyError) as error:
            self._settle(wish, StackError(f"{wish.name!r} is not served: {error}"))

    def _act(self, call: OutsideCall, wish: _Wish) -> None:
        if call.kind is OutsideKind.CALL:
            service = service_named(call.name)
            self.context.call(service, service.decode_request(call.data), lambda reply: self._settle(wish, reply))
            return
        task = task_named(call.name)

        def over(outcome: TaskOutcome[Any]) -> None:
            self._tickets.pop(call.number, None)
            self._settle(wish, outcome)

        goal = task.decode_goal(call.data)
        self._tickets[call.number] = self.context.send_goal(task, goal, over, wish.on_feedback)

    def _cancel(self, goal: _Wish) -> None:
        if goal.number in self._tickets:
            self._record_cancel(goal.number)

    def _record_cancel(self, number: int) -> None:
        call = OutsideCall(self._executor.now_ns, OutsideKind.CANCEL, "", number)
        self._executor.show_outside(self._bus, call)
        self._withdraw(number)

    def _withdraw(self, number: int) -> None:
        ticket = self._tickets.get(number)
        if ticket is not None:
            ticket.cancel()

    def _settle(self, wish: _Wish, value: Any) -> None:
        with self._lock:
            if wish not in self._pending:
                return
            self._pending.discard(wish)
        if isinstance(value, Exception):
            wish.answer.set_exception(value)
        else:
            wish.answer.set_result(value)
