"""The outside door: answers from foreign threads, in both executors; what came in is recorded and can be repeated to the bit."""

import threading
import time
from concurrent.futures import Future, wait
from contextlib import suppress
from typing import Any

import pytest

from ambler.core.errors import AmblerError, BadInputError, NoValidPathError, StackError
from ambler.core.messages import Message, OutsideCall, OutsideKind, VelocityCommand
from ambler.core.requests import DockFeedback, DockGoal, DockReport, GateReply, GateRequest, Nothing, TaskOutcome
from ambler.core.se2 import SE2
from ambler.runtime.door import RunEndedError
from ambler.runtime.executor import Executor, NodeFailedError
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import GoalHandle, Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import ARM, CLEAR_LOCAL_COSTMAP, DOCK, NAVIGATE, PAUSE, NavigateGoal
from ambler.runtime.topics import OUTSIDE_CALLS, VELOCITY_REQUEST, Topic
from ambler.wire.ros_messages import encode
from tests.runtime.toys import DOUBLE, Bomb, Server, Source

pytestmark = pytest.mark.live

EXECUTORS = [LockstepExecutor, LiveExecutor]
Handle = GoalHandle[DockGoal, DockFeedback, DockReport]


class Robot(Node):
    """Arms and counts, docks in `len(name)` steps of 10 ms, and says on the bus what it was told."""

    name = "robot"
    serves = (ARM, PAUSE, CLEAR_LOCAL_COSTMAP, DOCK)
    outputs = (VELOCITY_REQUEST,)

    def start(self) -> None:
        self.asked: list[str] = []
        self.ctx.serve(ARM, self._arm)
        self.ctx.serve(PAUSE, self._refuse)
        self.ctx.serve(CLEAR_LOCAL_COSTMAP, lambda _: Nothing())
        self.ctx.serve_task(DOCK, self._dock, lambda handle: self._note(f"cancel {handle.goal.name}"))

    def _note(self, what: str) -> None:
        self.asked.append(what)
        self.ctx.publish(VELOCITY_REQUEST, VelocityCommand(self.ctx.now_ns, float(len(self.asked)), float(len(what))))

    def _arm(self, request: GateRequest) -> GateReply:
        self._note(f"arm {request.source}")
        return GateReply(True, request.reason)

    def _refuse(self, request: GateRequest) -> GateReply:
        raise NoValidPathError(f"not for {request.source}")

    def _dock(self, handle: Handle) -> None:
        self._note(f"dock {handle.goal.name}")
        self._step(handle, 0)

    def _step(self, handle: Handle, done: int) -> None:
        if not handle.is_active:
            return
        if handle.goal.name == "wall":
            handle.fail("DOCK_NOT_SEEN", "a wall is no dock")
        elif done == len(handle.goal.name):
            handle.succeed(DockReport(1, 0.5, 0.25, None))
        else:
            handle.feedback(DockFeedback("APPROACH", "", done, None))
            self.ctx.after(0.01, lambda: self._step(handle, done + 1))


def run_aside(executor: Executor, duration: float = 20.0) -> threading.Thread:
    """Run on a thread of its own, as an application beside a server does."""

    def run() -> None:
        with suppress(NodeFailedError):
            executor.run(duration)

    thread = threading.Thread(target=run)
    thread.start()
    return thread


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_calls_are_answered_with_replies_and_named_errors(executor_type: type[Executor]) -> None:
    with executor_type(Stack([Robot()])) as executor:  # type: ignore[abstract]
        armed = executor.call(ARM, GateRequest("page", "please"))
        paused = executor.call(PAUSE, GateRequest("page"))
        cleared = executor.call(CLEAR_LOCAL_COSTMAP, Nothing())
        executor.run(0.1)
        assert armed.result(0) == GateReply(True, "please")
        with pytest.raises(NoValidPathError, match="not for page"):
            paused.result(0)
        assert cleared.result(0) == Nothing()


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_goals_give_feedback_and_end_by_name(executor_type: type[Executor]) -> None:
    heard: list[int] = []
    with executor_type(Stack([Robot()])) as executor:  # type: ignore[abstract]
        good = executor.send_goal(DOCK, DockGoal("abc"), lambda f: heard.append(f.attempts))
        executor.run(0.2)
        assert good.outcome.result(0) == TaskOutcome("SUCCEEDED", "", DockReport(1, 0.5, 0.25, None))
        assert heard == [0, 1, 2]
        assert good.feedback == DockFeedback("APPROACH", "", 2, None)
        bad = executor.send_goal(DOCK, DockGoal("wall"))
        executor.run(0.1)
        assert bad.outcome.result(0).code == "DOCK_NOT_SEEN"
        first, second = executor.send_goal(DOCK, DockGoal("x" * 99)), executor.send_goal(DOCK, DockGoal("y" * 99))
        executor.run(0.1)
        assert first.outcome.result(0).code == "PREEMPTED"
        second.cancel()
        executor.run(0.1)
        assert second.outcome.result(0).code == "CANCELLED"


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_thousand_calls_and_goals_from_four_threads_are_all_answered(executor_type: type[Executor]) -> None:
    robot = Robot()
    executor = executor_type(Stack([robot, Source()]))  # type: ignore[abstract]
    runner = run_aside(executor, 1e5 if executor_type is LockstepExecutor else 60.0)
    answers: dict[int, list[Future[Any]]] = {}

    def ask(who: int) -> None:
        mine = answers[who] = []
        for k in range(250):
            if k % 5:
                mine.append(executor.call(ARM, GateRequest(f"{who}", f"{k}")))
            else:
                mine.append(executor.send_goal(DOCK, DockGoal(f"{who}.{k}")).outcome)
            if k % 50 == 49:
                wait(mine, timeout=30.0)

    threads = [threading.Thread(target=ask, args=(who,)) for who in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for who, mine in answers.items():
        for k, future in enumerate(mine):
            if k % 5:
                assert future.result(30.0) == GateReply(True, f"{k}")
            else:
                assert future.result(30.0).code in ("SUCCEEDED", "PREEMPTED")
        assert [a for a in robot.asked if a == f"arm {who}"] == [f"arm {who}"] * 200, "none was lost or done twice"
    executor.stop()
    runner.join()
    executor.close()


def play(stack: Stack, feed: Any = (), calls: bool = True) -> list[tuple[str, int, bytes, str]]:
    """Run for a second; calls come before the start, and one when each goal's first feedback is heard."""
    shown: list[tuple[str, int, bytes, str]] = []
    executor = LockstepExecutor(stack)

    def tap(topic: Topic[Any], message: Message, now_ns: int, writer: str) -> None:
        shown.append((topic.name, now_ns, encode(message), writer))

    executor.tap(tap)
    if calls:
        goal = executor.send_goal(DOCK, DockGoal("x" * 50), lambda f: f.attempts == 7 and goal.cancel())
        executor.call(ARM, GateRequest("a")).add_done_callback(
            lambda _: executor.send_goal(DOCK, DockGoal("wall")).outcome and executor.call(PAUSE, GateRequest("b"))
        )
        executor.run(0.5)
        executor.call(ARM, GateRequest("late"))
        executor.send_goal(DOCK, DockGoal("ab"))
        executor.run(0.5)
    else:
        executor.run(1.0, feed)
    executor.close()
    return shown


def test_outside_calls_are_recorded_and_a_replay_repeats_them_to_the_bit() -> None:
    from ambler.wire.ros_messages import decode

    original = play(Stack([Robot(), Source()]))
    assert play(Stack([Robot(), Source()])) == original
    calls = [(OUTSIDE_CALLS, decode(OutsideCall, raw), ns) for name, ns, raw, _ in original if name == "outside_calls"]
    assert [(c.kind, c.name, c.number) for _, c, _ in calls] == [
        (OutsideKind.GOAL, "dock", 1),
        (OutsideKind.CALL, "arm", 2),
        (OutsideKind.GOAL, "dock", 3),
        (OutsideKind.CALL, "pause", 4),
        (OutsideKind.CALL, "arm", 5),
        (OutsideKind.GOAL, "dock", 6),
    ]
    assert play(Stack([Robot(), Source()]), calls, calls=False) == original
    assert play(Stack([Robot(), Source()]), calls[:-1], calls=False) != original, "the last goal matters"


def test_a_recorded_cancel_is_repeated() -> None:
    def run(feed: Any) -> tuple[list[str], list[Any]]:
        robot, shown = Robot(), list[Any]()
        executor = LockstepExecutor(Stack([robot]))
        executor.tap(lambda topic, m, now_ns, writer: shown.append((topic, m, now_ns)))
        if feed is None:
            ticket = executor.send_goal(DOCK, DockGoal("x" * 50))
            executor.run(0.1)
            ticket.cancel()
            executor.run(0.4)
            assert ticket.outcome.result(0).code == "CANCELLED"
            ticket.cancel()  # of no avail, and not recorded
        executor.run(0.4 if feed is None else 0.9, feed or ())
        executor.close()
        return robot.asked, shown

    asked, shown = run(None)
    assert asked == ["dock " + "x" * 50, "cancel " + "x" * 50]
    calls = [event for event in shown if event[0] is OUTSIDE_CALLS]
    assert [(m.kind, m.number, ns) for _, m, ns in calls] == [
        (OutsideKind.GOAL, 1, 1000),
        (OutsideKind.CANCEL, 1, 100_001_000),
    ]
    again, repeated = run(calls)
    assert again == asked
    assert [ns for _, _, ns in repeated] == [ns for _, _, ns in shown]


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_calls_from_outside_keep_their_order(executor_type: type[Executor]) -> None:
    robot = Robot()
    with executor_type(Stack([robot])) as executor:  # type: ignore[abstract]
        for who in "abcdefgh":
            executor.call(ARM, GateRequest(who))
        executor.run(0.1)
        assert robot.asked == [f"arm {who}" for who in "abcdefgh"]


def test_in_lockstep_the_door_comes_before_inside_calls_of_the_same_instant() -> None:
    order: list[tuple[str, int]] = []

    class Both(Robot):
        def start(self) -> None:
            super().start()
            self.ctx.after(0.01, self._act)

        def _act(self) -> None:
            self.ctx.after(0.0, lambda: order.append(("inside", self.ctx.now_ns)))
            executor.call(ARM, GateRequest("page"))

    executor = LockstepExecutor(Stack([Both()]))
    executor.tap(lambda topic, m, now_ns, writer: order.append((topic.name, now_ns)))
    executor.run(0.1)
    executor.close()
    assert order[:2] == [("outside_calls", 10_001_000), ("inside", 10_001_000)]


def test_what_was_answered_with_the_end_of_a_run_is_not_done_in_the_next() -> None:
    asked: list[Future[GateReply]] = []

    class Leaving(Robot):
        def start(self) -> None:
            super().start()
            self.ctx.after(0.01, self._act)

        def _act(self) -> None:
            asked.append(executor.call(ARM, GateRequest("page")))
            executor.stop()

    robot = Leaving()
    executor = LockstepExecutor(Stack([robot]))
    executor.run(0.1)
    assert isinstance(asked[0].exception(0), RunEndedError)
    executor.run(0.1)
    executor.close()
    assert robot.asked == []


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_failed_run_answers_everybody_with_its_failure(executor_type: type[Executor]) -> None:
    with executor_type(Stack([Robot(), Bomb()])) as executor:  # type: ignore[abstract]
        ticket = executor.send_goal(DOCK, DockGoal("x" * 999))
        with pytest.raises(NodeFailedError):
            executor.run(10.0)
        with pytest.raises(NodeFailedError, match="bomb failed"):
            ticket.outcome.result(0)
        with pytest.raises(NodeFailedError, match="bomb failed"):
            executor.call(ARM, GateRequest("late")).result(0)
        ticket.cancel()


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_server_that_raises_by_accident_fails_the_node_and_answers(executor_type: type[Executor]) -> None:
    class Broken(Robot):
        def _arm(self, request: GateRequest) -> GateReply:
            raise ZeroDivisionError("oops")

    with executor_type(Stack([Broken()])) as executor:  # type: ignore[abstract]
        future = executor.call(ARM, GateRequest("page"))
        with pytest.raises(NodeFailedError):
            executor.run(10.0)
        with pytest.raises(NodeFailedError, match="oops"):
            future.result(0)


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_stopped_run_answers_everybody_and_calls_goals_off(executor_type: type[Executor]) -> None:
    robot = Robot()
    executor = executor_type(Stack([robot, Source()]))  # type: ignore[abstract]
    ticket = executor.send_goal(DOCK, DockGoal("x" * 999), lambda f: executor.stop() if f.attempts == 3 else None)
    executor.run(1000.0)
    with pytest.raises(RunEndedError, match="stopped"):
        ticket.outcome.result(0)
    executor.run(0.1)
    assert robot.asked[-1] == "cancel " + "x" * 999, "nobody waits for it, so nobody drives on for it"
    assert executor.call(ARM, GateRequest("again")).done() is False
    executor.close()


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_closing_answers_those_who_still_wait_and_those_who_come_later(executor_type: type[Executor]) -> None:
    executor = executor_type(Stack([Robot()]))  # type: ignore[abstract]
    never = executor.call(ARM, GateRequest("page"))
    waiting: list[Any] = []
    thread = threading.Thread(target=lambda: waiting.append(never.exception(30.0)))
    thread.start()
    executor.close()
    thread.join()
    assert isinstance(waiting[0], RunEndedError)
    assert isinstance(executor.call(ARM, GateRequest("page")).exception(0), RunEndedError)


def test_what_cannot_be_asked_is_refused_at_the_door() -> None:
    executor = LockstepExecutor(Stack([Robot(), Server()]))
    with pytest.raises(StackError, match="nobody serves 'navigate'"):
        executor.send_goal(NAVIGATE, NavigateGoal(SE2()))
    with pytest.raises(StackError, match="'double' is not in the table"):
        executor.call(DOUBLE, 3)
    with pytest.raises(StackError, match="no stack has the prefix 'x'"):
        executor.call(ARM, GateRequest("page"), prefix="x")
    with pytest.raises(BadInputError, match="do not fit"):
        executor.call(ARM, GateRequest(7))  # type: ignore[arg-type]
    future = executor.call(ARM, GateRequest("page"))
    assert not future.cancel(), "an answer always comes"


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_listener_outside_that_raises_harms_nobody(executor_type: type[Executor]) -> None:
    with executor_type(Stack([Robot()])) as executor:  # type: ignore[abstract]
        ticket = executor.send_goal(DOCK, DockGoal("abc"), lambda f: 1 // 0)
        executor.run(0.2)
        assert ticket.outcome.result(0).is_success
        assert executor.troubles.counts == {"OUTSIDE_LISTENER_FAILED": 3}
        assert "ZeroDivisionError" in executor.troubles.texts["OUTSIDE_LISTENER_FAILED"]


def test_posting_from_foreign_threads_is_safe_and_publishing_is_refused() -> None:
    """Posts from two threads, while the heap of events is in use."""

    class Quick(Source):
        name = "quick"

        def start(self) -> None:
            super().start()
            self.posts = 0
            self.ctx.timer(0.0001, lambda: None)

    quick = Quick()
    executor = LockstepExecutor(Stack([quick]))
    runner = run_aside(executor, 1e5)
    context = executor.context_of("quick")

    def count() -> None:
        quick.posts += 1

    while executor.now_ns == 0:
        time.sleep(0)

    def post() -> None:
        for _ in range(2000):
            executor.post(context, 0, count)

    threads = [threading.Thread(target=post) for _ in range(2)]
    for thread in threads:
        thread.start()
    with pytest.raises(StackError, match="quick publishes from a thread that is not the run's"):
        quick.ctx.publish(quick.outputs[0], VelocityCommand(0))
    for thread in threads:
        thread.join()
    done = threading.Event()
    executor.post(context, 0, done.set)
    assert done.wait(30.0)
    executor.stop()
    runner.join()
    executor.close()
    assert quick.posts == 4000
    assert executor.failure is None


def test_the_stack_says_what_may_be_offered_outside() -> None:
    stack = Stack([Robot(), Server()])
    assert [offer.name for offer in stack.served] == ["arm", "pause", "clear_local_costmap", "dock", "double", "walk"]
    assert [offer.name for offer in stack.outside_offers] == ["arm", "pause", "clear_local_costmap", "dock"]
    assert isinstance(RunEndedError("x"), AmblerError)
