"""Latched means latched: who subscribes late hears what was said before, in both executors, once, in its own turn."""

from typing import Any

import pytest

from ambler.core.messages import PointStamped, Transforms, TransformStamped
from ambler.core.se3 import SE3
from ambler.runtime.executor import Executor
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.topics import STATIC_TRANSFORMS, Topic

pytestmark = pytest.mark.live

EXECUTORS = [LockstepExecutor, LiveExecutor]
PLACE = Topic("set_pose", PointStamped, "/place", "latched", 1, has_many_writers=True)


class Announcer(Node):
    """Says everything in `start` already, before anybody listens."""

    outputs = (PLACE,)

    def __init__(self, name: str, *values: float) -> None:
        self.name = name
        self.values = values

    def start(self) -> None:
        for value in self.values:
            self.ctx.publish(PLACE, PointStamped(self.ctx.now_ns, self.name, (value, 0.0, 0.0)))


class Late(Node):
    """Subscribes after `delay` seconds (None: in `start`, which is after that of the announcers)."""

    name = "late"

    def __init__(self, topic: Topic[Any], delay: float | None) -> None:
        self.topic = topic
        self.inputs = (topic,)
        self.delay = delay
        self.heard: list[Any] = []
        self.newest: list[Any] = []
        self.is_in_turn = True

    def start(self) -> None:
        if self.delay is None:
            self._subscribe()
        else:
            self.ctx.after(self.delay, self._subscribe)

    def _subscribe(self) -> None:
        self.ctx.subscribe(self.topic, self._hear)
        self.is_in_turn = not self.heard
        self.ctx.after(0.02, lambda: self.newest.append(self.ctx.newest(self.topic)))

    def _hear(self, message: Any) -> None:
        self.heard.append(message)


@pytest.mark.parametrize("delay", [None, 0.03])
@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_late_subscriber_gets_the_newest_message_of_each_writer(
    executor_type: type[Executor], delay: float | None
) -> None:
    late = Late(PLACE, delay)
    shown: list[str] = []
    executor = executor_type(Stack([Announcer("a", 1.0, 2.0), Announcer("b", 7.0), late]))  # type: ignore[abstract]
    executor.tap(lambda topic, message, now_ns, writer: shown.append(writer))
    executor.run(0.6 if executor_type is LiveExecutor else 0.15)  # a loaded machine takes its time
    executor.close()
    heard = [(m.frame, m.point[0]) for m in late.heard]
    assert heard[-2:] == [("a", 2.0), ("b", 7.0)]
    if delay is not None or executor_type is LiveExecutor:
        assert len(heard) == 2, "what was replaced is not heard any more"
    assert late.newest[0] is late.heard[-1]
    assert late.is_in_turn
    assert sorted(shown) == ["a", "a", "b"], "taps see each delivery once, late ones not again"


class Mounts(Node):
    """Publishes its edges one by one."""

    name = "mounts"
    outputs = (STATIC_TRANSFORMS,)

    def start(self) -> None:
        for child, x in (("lidar", 1.0), ("imu", 2.0), ("lidar", 3.0)):
            edge = TransformStamped(self.ctx.now_ns, "base", child, SE3((x, 0.0, 0.0)))
            self.ctx.publish(STATIC_TRANSFORMS, Transforms(self.ctx.now_ns, (edge,)))


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_latched_transforms_come_merged(executor_type: type[Executor]) -> None:
    late = Late(STATIC_TRANSFORMS, 0.03)
    executor = executor_type(Stack([Mounts(), late]))  # type: ignore[abstract]
    executor.run(0.15)
    executor.close()
    assert [[(e.child, e.parent_from_child.translation[0]) for e in m.transforms] for m in late.heard] == [
        [("lidar", 3.0), ("imu", 2.0)]
    ]
    assert late.newest == late.heard


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_edges_that_wait_in_a_queue_are_merged_and_not_lost(executor_type: type[Executor]) -> None:
    """A subscriber that is busy while three messages arrive knows both edges afterwards."""
    late = Late(STATIC_TRANSFORMS, None)
    executor = executor_type(Stack([late, Mounts()]))  # type: ignore[abstract]
    executor.run(0.1)
    executor.close()
    edges = {e.child: e.parent_from_child.translation[0] for m in late.heard for e in m.transforms}
    assert edges == {"lidar": 3.0, "imu": 2.0}


def test_a_newer_message_is_not_followed_by_the_older_one() -> None:
    """In lockstep: subscribing in the microsecond before the next delivery."""

    class Repeating(Node):
        name = "repeating"
        outputs = (PLACE,)
        latency = 0.01

        def start(self) -> None:
            self.ctx.after(0.0, lambda: self._say(1.0))
            self.ctx.after(0.09, lambda: self._say(2.0))

        def _say(self, value: float) -> None:
            self.ctx.publish(PLACE, PointStamped(self.ctx.now_ns, "", (value, 0.0, 0.0)))

    late = Late(PLACE, 0.1 - 1e-6)
    LockstepExecutor(Stack([Repeating(), late])).run(0.2)
    assert [m.point[0] for m in late.heard] == [2.0]
