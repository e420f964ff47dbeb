"""The node finishes its map on request: jobs one after the other, then the map, then the answer; and it may be asked to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.messages import LaserScan, Odometry, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.slam2d import Slam2dNode, Slam2dNodeConfig
from ambler.runtime import topics
from ambler.runtime.tasks import FINISH_MAP, Nothing
from ambler.sim.robots import robot_named
from tests.registration.room import WALLS, box_at, ranges_at
from tests.slam2d.drives import oval, run, short_submaps
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


@pytest.mark.parametrize("returns", [0, 15])
def test_nothing_is_drawn_into_the_map_while_the_robot_has_hardly_any_returns(
    started: tuple[Slam2dNode, HandMadeContext], returns: int
) -> None:
    node, context = started
    said = codes_said(context)
    handle = Handle()
    context.tasks[FINISH_MAP.name][0](handle)
    while context.jobs:
        context.run_job()
    _, before = node.slam.render_map()
    nodes, last_ns = node.slam.nodes, 10**12
    ranges = np.full(720, np.inf, np.float32)
    ranges[: 9 * returns : 9] = 1.5
    for k in range(60):
        stamp = last_ns + k * 100_000_000
        node._on_odometry(odometry(stamp, SE2(0.05 * k)))
        node._on_scan(laser_scan(stamp, ranges + np.float32(0.001 * k)))
    assert node.slam.nodes == nodes
    assert np.array_equal(before, node.slam.render_map()[1])
    assert said == ["SLAM_DEGRADED"]


CELL = np.array(box_at(0.0, 0.0, 1.6, 0.4))


def test_what_a_robot_sees_after_it_was_carried_away_is_not_drawn_over_its_map() -> None:
    """It maps a room, is carried into a narrow cell and drives on there; its odometry knows of the driving only. Back in the room it maps on."""
    robot = robot_named("diff").model
    node, context = Slam2dNode(robot, Slam2dNodeConfig()), HandMadeContext()
    node.ctx = context  # type: ignore[assignment]
    said = codes_said(context)
    node.start()
    base_from_laser = robot.sensor("laser").base_from_sensor.to_se2()
    angles = -np.pi + 2 * np.pi / 720 * np.arange(720)
    stamp = 0

    def step(odom: SE2, place: SE2, walls: NDArray[np.float64]) -> None:
        nonlocal stamp
        stamp += 100_000_000
        node._on_odometry(odometry(stamp, odom))
        node._on_scan(laser_scan(stamp, ranges_at(place @ base_from_laser, angles, walls).astype(np.float32)))

    poses = oval(0.5)
    for pose in poses:
        step(pose, pose, WALLS)
    node._publish_map()
    nodes, (spec, before) = node.slam.nodes, node.slam.render_map()
    assert nodes > 10
    assert (before > 50).any()
    for _ in range(5):
        step(poses[-1], SE2(), CELL)
    for k in range(30):
        step(poses[-1] @ SE2(0.02 * k), SE2(0.015 * k - 0.2), CELL)
    assert node.slam.nodes == nodes
    after_spec, after = node.slam.render_map()
    assert after_spec == spec
    assert np.array_equal(after, before)
    assert said == ["SLAM_DEGRADED"]


@pytest.mark.parametrize("ahead", [0.2, -0.1])
def test_a_scanner_whose_stamps_are_off_makes_the_same_map_once_that_is_known(ahead: float) -> None:
    """The only scanner of a robot, whose scans nobody merges."""

    def mapped(clock_offset: float) -> NDArray[np.int8]:
        robot = robot_named("diff").model
        robot = replace(robot, sensors=tuple(replace(m, clock_offset=clock_offset) for m in robot.sensors))
        node = Slam2dNode(robot, Slam2dNodeConfig())
        node.ctx = HandMadeContext()  # type: ignore[assignment]
        node.start()
        base_from_laser = robot.sensor("laser").base_from_sensor.to_se2()
        angles = -np.pi + 2 * np.pi / 720 * np.arange(720)
        for k, pose in enumerate(oval(0.5)[:60]):
            stamp = (k + 10) * 100_000_000
            node._on_odometry(odometry(stamp, pose))
            ranges = ranges_at(pose @ base_from_laser, angles, WALLS).astype(np.float32)
            node._on_scan(laser_scan(stamp + round(clock_offset * 1e9), ranges))
        return node.slam.render_map()[1]

    assert np.array_equal(mapped(ahead), mapped(0.0))


PERSON = np.array([[0.2, -0.1]])
DRIFT = SE2(0.4, -0.3, 0.2)


@pytest.mark.parametrize("seen", [True, False])
def test_whoever_walks_leaves_no_trace_in_the_map(*, seen: bool) -> None:
    """A person has stopped before a robot that drives around him; its odometry began elsewhere than its map."""
    robot = robot_named("diff").model
    node, context = Slam2dNode(robot, Slam2dNodeConfig()), HandMadeContext()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    base_from_laser = robot.sensor("laser").base_from_sensor.to_se2()
    angles = -np.pi + 2 * np.pi / 720 * np.arange(720)
    around = np.linspace(0.0, 2.0 * np.pi, 17)
    outline = PERSON + 0.25 * np.column_stack((np.cos(around), np.sin(around)))
    walls = np.concatenate((WALLS, np.hstack((outline[:-1], outline[1:]))))
    for k, pose in enumerate(oval(0.5)[:60]):
        stamp = (k + 1) * 100_000_000
        node._on_odometry(odometry(stamp, DRIFT @ pose))
        if seen:
            places = np.array([[*DRIFT.transform(PERSON)[0], 0.0]], np.float32)
            none = np.zeros(1, np.float32)
            node._on_movers(PointCloud(stamp - 100_000_000, "odom", places, none, none, np.zeros(1, np.uint16)))
        node._on_scan(laser_scan(stamp, ranges_at(pose @ base_from_laser, angles, walls).astype(np.float32)))
    spec, occupancy = node.slam.render_map()
    y, x = np.nonzero(occupancy > 50)
    world_from_map = oval(0.5)[0] @ node.slam.map_from_node(0).inverse()
    gaps = np.hypot(*(world_from_map.transform(np.column_stack(spec.center_of(y, x))) - PERSON).T)
    assert (gaps < 0.4).any() != seen
    assert (gaps > 0.5).sum() > 200, "the walls are there"


def codes_said(context: HandMadeContext) -> list[str]:
    """Return the list into which the codes of STATUS will go."""
    said: list[str] = []
    context.log = lambda *args, **fields: None  # type: ignore[attr-defined]
    publish = context.publish
    context.publish = lambda topic, message: (  # type: ignore[method-assign]
        said.append(message.code) if topic is topics.STATUS else publish(topic, message)
    )
    return said


def laser_scan(stamp_ns: int, ranges: NDArray[np.float32]) -> LaserScan:
    return LaserScan(stamp_ns, "laser", -np.pi, 2 * np.pi / 720, 0.0, 0.1, 0.1, 20.0, ranges, ranges[:0])


def odometry(stamp_ns: int, pose: SE2) -> Odometry:
    zero, cov = (0.0, 0.0, 0.0), np.zeros((6, 6))
    return Odometry(stamp_ns, "odom", "base", SE3.from_se2(pose), zero, zero, cov, cov)
