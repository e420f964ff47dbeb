"""The node around the simulation, in a context made by hand: what it publishes, when, and that it obeys commands."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.nodes.simulator import SimulatorNode
from ambler.runtime import topics
from ambler.runtime.topics import Topic
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation
from ambler.sim.world import load_world


class HandMadeContext:
    """Time, timers and a list of everything published, with the time of publishing."""

    def __init__(self) -> None:
        self.now_ns = 5_000_000_000
        self.published: list[tuple[int, Topic[Any], Any]] = []
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def publish(self, topic: Topic[Any], message: Any) -> None:
        self.published.append((self.now_ns, topic, message))

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (self.now_ns + round(delay * 1e9), self._count, callback))

    def timer(self, period: float, callback: Callable[[], None], *, phase: float = 0.0) -> None:
        def fire() -> None:
            self.after(period, fire)
            callback()

        self.after(period + phase, fire)

    def run(self, seconds: float) -> None:
        end = self.now_ns + round(seconds * 1e9)
        while self._due and self._due[0][0] <= end:
            self.now_ns, _, callback = heapq.heappop(self._due)
            callback()
        self.now_ns = end

    def messages(self, topic: Topic[Any]) -> list[Any]:
        return [message for _, t, message in self.published if t is topic]


def started(robot: str) -> HandMadeContext:
    node = SimulatorNode(Simulation(load_world("lab_empty"), robot_named(robot)))
    context = HandMadeContext()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    return context


def test_what_is_there_before_anything_moves() -> None:
    context = started("diff")
    (mounts,), (grid,) = context.messages(topics.STATIC_TRANSFORMS), context.messages(topics.TRUE_MAP)
    assert {(t.parent, t.child) for t in mounts.transforms} == {("base", "laser"), ("base", "imu")}
    assert grid.frame == "map"
    assert grid.data[grid.spec.cell_of(0.0, 0.0)] == 0


def test_everything_is_published_in_time_and_on_declared_topics() -> None:
    context = started("diff")
    context.run(1.0)
    assert {t.name for _, t, _ in context.published} <= {t.name for t in SimulatorNode.outputs}
    assert len(context.messages(topics.WHEEL_ODOMETRY)) == 51
    assert len(context.messages(topics.IMU)) == 100
    scans = [(now, s) for now, t, s in context.published if t is topics.SCAN]
    assert len(scans) == 9
    assert {now - s.stamp_ns for now, s in scans} == {105_000_000}
    assert all(now >= message.stamp_ns for now, _, message in context.published)


def test_the_robot_obeys_the_command_topic() -> None:
    context = started("spot")
    for _ in range(20):
        context.callbacks["velocity_command"](m.VelocityCommand(context.now_ns, 0.4, 0.2, 0.0))
        context.run(0.1)
    truth = context.messages(topics.TRUE_POSE)[-1].pose.translation
    odometry = context.messages(topics.WHEEL_ODOMETRY)[-1].pose.translation
    assert 0.6 < truth[0] < 0.85
    assert 0.3 < truth[1] < 0.45
    np.testing.assert_allclose(odometry[:2], truth[:2], atol=0.08)
    assert context.messages(topics.CLOUD)
    assert not context.messages(topics.SCAN)
    assert not context.messages(topics.CONTACT)
