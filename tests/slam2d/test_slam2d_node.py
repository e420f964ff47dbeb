"""The node finishes its map on request: jobs one after the other, then the map, then the answer; and it may be asked to stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ambler.core.messages import LaserScan, Odometry
from ambler.core.se3 import SE3
from ambler.nodes.slam2d import Slam2dNode, Slam2dNodeConfig
from ambler.runtime import topics
from ambler.runtime.tasks import FINISH_MAP, Nothing
from ambler.sim.robots import robot_named
from tests.slam2d.drives import run, short_submaps
from tests.slam2d.test_back_end import ring


class HandMadeContext:
    """Keeps the task's handlers, and background jobs until the test runs them."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.tasks: dict[str, tuple[Callable[[Any], None], Callable[[Any], None]]] = {}
        self.jobs: list[tuple[Callable[[], Any], Callable[[Any], None]]] = []
        self.maps = 0

    def subscribe(self, topic: Any, callback: Callable[[Any], None]) -> None: ...

    def serve(self, service: Any, handler: Callable[[Any], Any]) -> None: ...

    def timer(self, period: float, callback: Callable[[], None]) -> None: ...

    def serve_task(self, task: Any, on_goal: Callable[[Any], None], on_cancel: Callable[[Any], None]) -> None:
        self.tasks[task.name] = on_goal, on_cancel

    def background(self, job: Callable[[], Any], duration: float, done: Callable[[Any], None]) -> None:
        self.jobs.append((job, done))

    def publish(self, topic: Any, message: Any) -> None:
        self.maps += topic is topics.MAP

    def run_job(self) -> None:
        job, done = self.jobs.pop()
        done(job())


class Handle:
    """What the node sees of a client."""

    def __init__(self) -> None:
        self.results: list[Any] = []

    def succeed(self, result: Any) -> None:
        self.results.append(result)


@pytest.fixture
def started() -> tuple[Slam2dNode, HandMadeContext]:
    """A node that has driven the ring without any search for loop closures."""
    node, context = Slam2dNode(robot_named("diff").model, Slam2dNodeConfig(slam=short_submaps())), HandMadeContext()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    run(node.slam, ring(), with_odometry=True, with_background=False, rng=np.random.default_rng(3))
    return node, context


def test_finishing_closes_loops_publishes_the_map_and_answers(started: tuple[Slam2dNode, HandMadeContext]) -> None:
    node, context = started
    handle = Handle()
    context.tasks[FINISH_MAP.name][0](handle)
    jobs = 0
    while context.jobs:
        assert len(context.jobs) == 1, "one at a time"
        assert not handle.results
        context.run_job()
        jobs += 1
    assert jobs >= 2
    assert handle.results == [Nothing()]
    assert context.maps == 1
    assert node.slam.loop_closures > 3


def test_a_cancelled_finish_leaves_the_node_ready_for_another(started: tuple[Slam2dNode, HandMadeContext]) -> None:
    _, context = started
    first, second = Handle(), Handle()
    on_goal, on_cancel = context.tasks[FINISH_MAP.name]
    on_goal(first)
    on_cancel(first)
    on_goal(second)  # while the job of the first is under way
    while context.jobs:
        assert len(context.jobs) == 1
        context.run_job()
    assert first.results == []
    assert second.results == [Nothing()]


def test_nothing_is_drawn_into_the_map_while_the_robot_has_no_returns(
    started: tuple[Slam2dNode, HandMadeContext],
) -> None:
    node, context = started
    context.log = lambda *args, **fields: None  # type: ignore[attr-defined]
    said: list[str] = []
    publish = context.publish
    context.publish = lambda topic, message: (  # type: ignore[method-assign]
        said.append(message.code) if topic is topics.STATUS else publish(topic, message)
    )
    handle = Handle()
    context.tasks[FINISH_MAP.name][0](handle)
    while context.jobs:
        context.run_job()
    _, before = node.slam.render_map()
    nodes, last_ns = node.slam.nodes, 10**12
    nothing = np.full(720, np.inf, np.float32)
    for k in range(60):
        stamp = last_ns + k * 100_000_000
        node._on_odometry(odometry(stamp, 0.05 * k))
        node._on_scan(LaserScan(stamp, "laser", -np.pi, 2 * np.pi / 720, 0.0, 0.1, 0.1, 20.0, nothing, nothing[:0]))
    assert node.slam.nodes == nodes
    assert np.array_equal(before, node.slam.render_map()[1])
    assert said == ["SLAM_DEGRADED"]


def odometry(stamp_ns: int, x: float) -> Odometry:
    zero, cov = (0.0, 0.0, 0.0), np.zeros((6, 6))
    return Odometry(stamp_ns, "odom", "base", SE3((x, 0.0, 0.0)), zero, zero, cov, cov)
