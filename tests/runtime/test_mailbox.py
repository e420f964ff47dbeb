"""What waits for a node of the live executor: its order, and what wakes the node."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from ambler.apps.config import RobotConfig
from ambler.apps.robot import Site, robot_nodes
from ambler.core.messages import Text
from ambler.runtime.bus import Subscription
from ambler.runtime.mailbox import Mailbox
from ambler.runtime.topics import Topic
from ambler.sim.robots import robot_named

NEWS = Topic("news", Text, "/news", depth=100)


class CountingCondition(threading.Condition):
    """Counts how often somebody was to be woken."""

    def __init__(self) -> None:
        super().__init__()
        self.calls = 0

    def notify(self, n: int = 1) -> None:
        self.calls += 1
        super().notify(n)


class Box:
    """A mailbox, what was taken out of it, and two subscriptions: to what is worth waking for, and to what is only kept."""

    def __init__(self) -> None:
        self.taken: list[str] = []
        self.box = Mailbox()
        self.condition = self.box._condition = CountingCondition()
        context: Any = SimpleNamespace(receive=lambda topic, message: None)
        self.urgent = Subscription(context, lambda text: self.taken.append(text.text))
        self.kept = Subscription(context, lambda text: self.taken.append(text.text), can_wait=True)

    def put(self, subscription: Subscription, text: str) -> None:
        self.box.put_message(subscription, NEWS, Text(0, text), 0)

    def put_timer(self, due_ns: int, text: str) -> None:
        self.box.put_timer(due_ns, lambda: self.taken.append(text))

    def take(self, count: int, now_ns: int = 100) -> list[str]:
        for _ in range(count):
            task = self.box.take(lambda: now_ns)
            assert task is not None
            task()
        return self.taken


def test_what_is_only_kept_wakes_the_node_for_every_tenth() -> None:
    box = Box()
    for k in range(9):
        box.put(box.kept, str(k))
    assert box.condition.calls == 0
    box.put(box.kept, "9")
    assert box.condition.calls == 1
    assert box.take(10) == [str(k) for k in range(10)]
    for _ in range(9):
        box.put(box.kept, "more")
    assert box.condition.calls == 1
    box.put(box.urgent, "now")
    assert box.condition.calls == 2


def test_whatever_wakes_the_node_finds_taken_in_what_came_before() -> None:
    box = Box()
    box.put(box.kept, "odometry")
    box.put_timer(50, "step")
    assert box.take(2) == ["odometry", "step"]
    box.put(box.kept, "older")
    box.put(box.urgent, "cloud")
    box.put(box.kept, "newer")
    assert box.take(3)[2:] == ["older", "cloud", "newer"]


def test_what_is_due_still_goes_before_what_wakes() -> None:
    box = Box()
    box.put(box.urgent, "cloud")
    box.put(box.kept, "odometry")
    box.put_timer(50, "step")
    assert box.take(3) == ["step", "cloud", "odometry"]


def test_a_timer_that_is_always_late_leaves_every_other_turn_to_the_queue() -> None:
    """One slow driver must not make its node deaf, least of all to a stop."""
    box = Box()
    for k in range(3):
        box.put(box.urgent, f"message {k}")
    box.box.put_call(lambda: box.taken.append("stop"))

    def late() -> None:
        box.taken.append("beat")
        box.box.put_timer(50, late)

    box.box.put_timer(50, late)
    wanted = ["beat", "message 0", "beat", "message 1", "beat", "message 2", "beat", "stop", "beat", "beat"]
    assert box.take(10) == wanted


@pytest.mark.parametrize("robot", ["go2", "diff", "spot", "amr_omni"])
def test_nodes_keep_only_what_they_read(robot: str) -> None:
    nodes = robot_nodes(robot_named(robot).model, RobotConfig(), Site())
    assert any(node.kept_inputs for node in nodes)
    for node in nodes:
        assert set(node.kept_inputs) <= {*node.inputs, *node.optional_inputs}, node.name
