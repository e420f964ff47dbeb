"""Both executors keep the contract of `runtime.node.Context`."""

import gc
from typing import Any

import pytest

from ambler.core.errors import StackError
from ambler.core.messages import VelocityCommand
from ambler.runtime.executor import Executor, NodeFailedError
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.topics import TELEOP_REQUEST, VELOCITY_REQUEST
from tests.runtime.toys import Bomb, Client, Filter, OdometryReader, Server, Source

pytestmark = pytest.mark.live

EXECUTORS = [LockstepExecutor, LiveExecutor]


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_messages_arrive_in_order_and_none_is_lost(executor_type: type[Executor]) -> None:
    source, heard = Source(), Filter()
    executor_type(Stack([source, heard])).run(0.52)
    values = [v for _, v in heard.heard]
    assert values == [float(i + 1) for i in range(len(values))]
    assert len(values) >= 8


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_what_was_there_before_a_run_is_not_searched_for_garbage_during_it(executor_type: type[Executor]) -> None:
    before, during = gc.get_freeze_count(), []

    class Looking(Source):
        def _tick(self) -> None:
            during.append(gc.get_freeze_count())

    executor_type(Stack([Looking()])).run(0.2)
    with pytest.raises(NodeFailedError):
        executor_type(Stack([Source(), Bomb()])).run(0.2)
    assert min(during) > before + 10_000
    assert gc.get_freeze_count() == before


def test_lockstep_delivers_after_the_declared_latency() -> None:
    source, heard = Source(), Filter()
    LockstepExecutor(Stack([source, heard])).run(0.3)
    assert [t for t, _ in heard.heard] == [54_000_000 + 50_000_000 * i for i in range(5)]


def test_a_fault_can_raise_the_latency() -> None:
    source, heard = Source(), Filter()
    LockstepExecutor(Stack([source, heard]), extra_latency={"source": 0.1}).run(0.3)
    assert [t for t, _ in heard.heard] == [154_000_000, 204_000_000, 254_000_000]


def test_stale_input_is_a_named_failure() -> None:
    class Short(Source):
        def _tick(self) -> None:
            if self.sent < 2:
                super()._tick()

    heard = Filter()
    LockstepExecutor(Stack([Short(), heard])).run(1.0)
    assert heard.stale == 5  # the last message is of 0.1 s, 0.4 s are allowed: stale from 0.6 s on


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_service_and_task_succeed_with_feedback(executor_type: type[Executor]) -> None:
    client = Client([(0.05, 3)])
    executor_type(Stack([Server(), client])).run(0.4)
    assert client.replies == [42]
    assert [(o.code, o.result) for o in client.outcomes] == [("SUCCEEDED", 3)]
    assert client.feedback == [0, 1, 2]


@pytest.mark.parametrize("executor_type", EXECUTORS)
@pytest.mark.parametrize(
    ("script", "codes"),
    [
        ([(0.02, 100)], ["TIRED"]),
        ([(0.02, 100), (0.08, "cancel")], ["CANCELLED"]),
        ([(0.02, 100), (0.08, 2)], ["PREEMPTED", "SUCCEEDED"]),
        ([(0.02, 1), (0.2, "cancel")], ["SUCCEEDED"]),
    ],
)
def test_tasks_end_by_name(executor_type: type[Executor], script: list[tuple[float, Any]], codes: list[str]) -> None:
    client = Client(script)
    executor_type(Stack([Server(), client])).run(0.5)
    assert [o.code for o in client.outcomes] == codes


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_failing_node_stops_the_robot_and_ends_the_run(executor_type: type[Executor]) -> None:
    reasons: list[str] = []
    log = RunLog()
    records: list[dict[str, Any]] = []
    log.listen(records.append)
    source = Source()
    executor = executor_type(Stack([source, Filter(), Bomb()]), log=log, on_failure=reasons.append)  # type: ignore[abstract]
    with pytest.raises(NodeFailedError, match="bomb failed: ZeroDivisionError: boom"):
        executor.run(10.0)
    assert len(reasons) == 1
    assert [r["code"] for r in records if r["node"] == "bomb"] == ["NODE_FAILED"]
    assert 5 < source.sent < 40, "the other nodes go on for a moment, so that the robot can brake"


def test_background_work_commits_at_its_declared_time() -> None:
    class Worker(Node):
        name = "worker"

        def start(self) -> None:
            self.done: list[tuple[int, int]] = []
            self.ctx.after(
                0.1, lambda: self.ctx.background(lambda: 6 * 7, 0.25, lambda v: self.done.append((self.ctx.now_ns, v)))
            )

    worker = Worker()
    LockstepExecutor(Stack([worker])).run(1.0)
    assert worker.done == [(350_000_000, 42)]


def test_a_full_queue_drops_the_oldest_and_counts() -> None:
    class Slow(Node):
        name = "slow"
        inputs = (VELOCITY_REQUEST, TELEOP_REQUEST)
        outputs = ()

        def start(self) -> None:
            self.heard: list[float] = []
            self.ctx.subscribe(TELEOP_REQUEST, lambda m: self.heard.append(m.vx))

    slow = Slow()
    executor = LiveExecutor(Stack([slow], external=[VELOCITY_REQUEST, TELEOP_REQUEST]))
    executor.start_nodes()
    for i in range(5):
        executor.inject(TELEOP_REQUEST, VelocityCommand(0, float(i)))
    task = executor._mailboxes[executor.contexts[0]].take(lambda: 0)
    assert task is not None
    task()
    assert slow.heard == [4.0], "a `latest` topic keeps the newest only"


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([Filter()], "input 'teleop_request' of filter has no writer"),
        ([Source(), Source()], "two nodes are called 'source'"),
        ([OdometryReader()], "input 'odometry' of reader has no writer"),
        ([Client([])], "client calls 'double', which nobody serves"),
    ],
)
def test_a_wrong_stack_is_refused(nodes: list[Node], message: str) -> None:
    with pytest.raises(StackError, match=message):
        Stack(nodes)


def test_two_writers_of_one_topic_are_refused() -> None:
    class Second(Source):
        name = "second"

    with pytest.raises(StackError, match="'teleop_request' has 2 writers: source, second"):
        Stack([Source(), Second()])


def test_publishing_what_was_not_declared_fails() -> None:
    class Liar(Source):
        outputs = ()

    with pytest.raises(NodeFailedError, match="without declaring"):
        LockstepExecutor(Stack([Liar()])).run(1.0)


def test_injected_messages_are_delivered_and_shown() -> None:
    heard = Filter()
    executor = LockstepExecutor(Stack([heard], external=[TELEOP_REQUEST]))
    seen: list[tuple[str, str]] = []
    executor.tap(lambda topic, message, now_ns, writer: seen.append((topic.name, writer)))
    executor.inject(TELEOP_REQUEST, VelocityCommand(0, 5.0))
    executor.run(0.15)
    assert [v for _, v in heard.heard] == [5.0]
    assert seen == [("teleop_request", "outside"), ("velocity_request", "filter")]


def test_two_lockstep_runs_are_equal_and_a_feed_replays_them() -> None:
    def record(executor: LockstepExecutor) -> list[tuple[str, int, Any]]:
        out: list[tuple[str, int, Any]] = []
        executor.tap(lambda topic, m, now_ns, writer: out.append((topic.name, now_ns, (m.stamp_ns, m.vx, m.vy, m.wz))))
        return out

    runs = []
    for _ in range(2):
        executor = LockstepExecutor(Stack([Source(), Filter()]))
        runs.append(record(executor))
        executor.run(2.0)
    assert runs[0] == runs[1]
    replay = LockstepExecutor(Stack([Filter()], external=[TELEOP_REQUEST]))
    again = record(replay)
    feed = [
        (TELEOP_REQUEST, VelocityCommand(values[0], values[1]), now_ns)
        for name, now_ns, values in runs[0]
        if name == "teleop_request"
    ]
    replay.run(2.0, feed)
    assert again == runs[0]
