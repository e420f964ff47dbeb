"""Several stacks on one executor: prefixes keep them apart, and one runs to the same bits whether another one is there or not."""

import time
from typing import Any

import pytest

from ambler.core.errors import StackError
from ambler.core.messages import Imu, Message, VelocityCommand
from ambler.runtime.executor import Executor
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node, WorkKind
from ambler.runtime.stack import Stack
from ambler.runtime.topics import IMU, TELEOP_REQUEST, VELOCITY_REQUEST, Topic
from tests.runtime.toys import Bomb, Client, Filter, Server, Source

EXECUTORS = [LockstepExecutor, LiveExecutor]
Shown = list[tuple[str, int, Any, str]]


def watch(executor: Executor, prefix: str = "") -> Shown:
    seen: Shown = []

    def tap(topic: Topic[Any], m: Message, now_ns: int, writer: str) -> None:
        assert isinstance(m, VelocityCommand)
        seen.append((topic.name, now_ns, (m.stamp_ns, m.vx, m.vy, m.wz), writer))

    executor.tap(tap, prefix)
    return seen


class Worker(Filter):
    """A filter that also works in the background and calls a service, so that every kind of event is there."""

    calls = Client.calls

    def start(self) -> None:
        super().start()
        self.done: list[tuple[int, Any]] = []
        self.ctx.timer(0.03, self._ask)

    def _ask(self) -> None:
        count = len(self.heard)
        self.ctx.call(Client.calls[0], count, self._hear_reply)  # type: ignore[arg-type]
        self.ctx.background(lambda: count + 1, 0.02, self._hear_reply, WorkKind.PERCEPTION)

    def _hear_reply(self, value: Any) -> None:
        self.done.append((self.ctx.now_ns, value))
        self.ctx.publish(VELOCITY_REQUEST, VelocityCommand(self.ctx.now_ns, float(value)))


def robot(prefix: str = "") -> Stack:
    return Stack([Source(), Worker(), Server()], prefix=prefix)


@pytest.mark.parametrize("order", [["a", "b"], ["b", "a"]])
def test_a_stack_runs_to_the_same_bits_with_and_without_another(order: list[str]) -> None:
    alone = LockstepExecutor(robot())
    expected = watch(alone)
    alone.run(1.0)
    pair = LockstepExecutor([robot(prefix) for prefix in order])
    seen = {prefix: watch(pair, prefix) for prefix in order}
    pair.run(1.0)
    assert len(expected) > 60
    assert seen["a"] == seen["b"] == expected


def test_a_feed_by_prefix_replays_each_stack() -> None:
    alone = LockstepExecutor(robot())
    expected = watch(alone)
    alone.run(1.0)
    feed = [
        (TELEOP_REQUEST, VelocityCommand(v[0], v[1]), ns) for name, ns, v, _ in expected if name == "teleop_request"
    ]
    pair = LockstepExecutor([Stack([Worker(), Server()], [TELEOP_REQUEST], p) for p in "ab"])
    seen = [watch(pair, "a"), watch(pair, "b")]
    pair.run(1.0, {"a": feed, "b": feed})
    for shown in seen:
        assert [s[:3] for s in shown] == [e[:3] for e in expected]


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_nothing_of_one_stack_reaches_another(executor_type: type[Executor]) -> None:
    heard = {prefix: Filter() for prefix in ("a", "b")}
    executor = executor_type(  # type: ignore[abstract]
        [Stack([node], [TELEOP_REQUEST], prefix) for prefix, node in heard.items()]
    )
    seen = {prefix: watch(executor, prefix) for prefix in heard}
    executor.start_nodes()
    executor.inject(TELEOP_REQUEST, VelocityCommand(0, 1.0), "a")
    executor.inject(TELEOP_REQUEST, VelocityCommand(0, 2.0), "b")
    executor.run(0.05)
    assert {p: [v for _, v in node.heard] for p, node in heard.items()} == {"a": [1.0], "b": [2.0]}
    told = {p: [v[1] for name, _, v, _ in shown if name == "teleop_request"] for p, shown in seen.items()}
    assert told == {"a": [1.0], "b": [2.0]}
    with pytest.raises(StackError, match=r"no stack has the prefix 'c'; there are \['a', 'b'\]"):
        executor.inject(TELEOP_REQUEST, VelocityCommand(0, 2.0), "c")
    executor.close()


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_services_and_tasks_are_those_of_the_own_stack(executor_type: type[Executor]) -> None:
    servers = {prefix: Server() for prefix in "ab"}
    clients = {"a": Client([(0.01, 2)]), "b": Client([(0.01, 3)])}
    executor = executor_type([Stack([servers[p], clients[p]], prefix=p) for p in "ab"])  # type: ignore[abstract]
    executor.run(0.4)
    assert {p: [o.result for o in c.outcomes] for p, c in clients.items()} == {"a": [2], "b": [3]}
    executor.close()


def test_prefixes_are_different_and_a_failure_names_its_stack() -> None:
    with pytest.raises(StackError, match="different prefixes"):
        LockstepExecutor([Stack([Source()], prefix="a"), Stack([Source()], prefix="a")])
    pair = LockstepExecutor([Stack([Source()], prefix="a"), Stack([Bomb()], prefix="b")])
    with pytest.raises(StackError, match="several stacks"):
        _ = pair.stack
    assert pair.context_of("bomb", "b").name == "b/bomb"
    with pytest.raises(Exception, match="node b/bomb failed: ZeroDivisionError: boom"):
        pair.run(1.0)


class Rear(Node):
    """Publishes on an instance of a topic, at the same instants as the plain topic."""

    name = "rear"
    outputs = (IMU.of("rear"), IMU)

    def start(self) -> None:
        self.ctx.timer(0.01, self._tick)

    def _tick(self) -> None:
        for topic in self.outputs:
            self.ctx.publish(topic, Imu(self.ctx.now_ns, topic.instance, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_instances_of_a_topic_are_streams_of_their_own(executor_type: type[Executor]) -> None:
    class Reader(Node):
        name = "reader"
        inputs = (IMU.of("rear"),)

        def start(self) -> None:
            self.frames: list[str] = []
            self.ctx.subscribe(self.inputs[0], lambda m: self.frames.append(m.frame))

    reader, order = Reader(), list[tuple[int, str]]()
    executor = executor_type(Stack([Rear(), reader]))  # type: ignore[abstract]
    executor.tap(lambda topic, message, now_ns, writer: order.append((now_ns, topic.ros_name)))
    executor.run(0.3)
    executor.close()
    assert len(reader.frames) >= 4
    assert set(reader.frames) == {"rear"}
    if executor_type is LockstepExecutor:
        assert [name for _, name in order[:4]] == ["/imu", "/imu/rear"] * 2, "the table's order, then the instance"


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_quick_work_does_not_wait_for_slow_work_of_another_kind(executor_type: type[Executor]) -> None:
    class Thinker(Node):
        name = "thinker"

        def start(self) -> None:
            self.order: list[str] = []
            self.ctx.background(lambda: time.sleep(0.3), 0.4, lambda _: self.order.append("map"), WorkKind.MAPPING)
            self.ctx.background(lambda: None, 0.05, lambda _: self.order.append("dock"), WorkKind.PERCEPTION)
            self.ctx.background(lambda: None, 0.06, lambda _: self.order.append("wheel"), WorkKind.CONTROL)

    thinker = Thinker()
    executor = executor_type(Stack([thinker]))  # type: ignore[abstract]
    started = time.monotonic()
    executor.run(0.2)
    assert sorted(thinker.order) == ["dock", "wheel"]
    if executor_type is LockstepExecutor:
        assert time.monotonic() - started < 0.29, "the commits at 0.05 and 0.06 s wait for their own work only"
    executor.run(0.4)
    assert thinker.order[-1] == "map"
    executor.close()
