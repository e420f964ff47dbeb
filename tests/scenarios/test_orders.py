"""Orders from outside to a robot that drives to a goal: it stays within its boundary, goes around what was added, slows down, stops and goes on."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.apps.robot import Parts
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core import messages as m
from ambler.core.se2 import SE2
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.steps import NavigateStep
from ambler.runtime.node import Node, Topics
from ambler.runtime.topics import (
    ADDED_OBSTACLES,
    BOUNDARY,
    GATE_STATUS,
    GOAL_POINT,
    LOCAL_COSTMAP,
    MAP_CLEARING,
    SPEED,
    STOP,
    TRUE_POSE,
    Topic,
)
from ambler.wire.mcap_reader import read_recording

GOAL = SE2(5.0, 0.0, 0.0)
Order = tuple[float, Topic[Any], Callable[[int], m.Message]]


class Orders(Node):
    """Another program that publishes orders at their times (s)."""

    name = "orders"
    latency = 0.001

    def __init__(self, orders: list[Order]) -> None:
        self._orders = orders
        self.outputs: Topics = tuple(dict.fromkeys(topic for _, topic, _ in orders))

    def start(self) -> None:
        for seconds, topic, make in self._orders:
            self.ctx.after(seconds, lambda topic=topic, make=make: self.ctx.publish(topic, make(self.ctx.now_ns)))


class Driven:
    """A drive to the goal in a hall of 10 x 8 m with these orders, and where the robot truly was, (t, x, y) in the map."""

    def __init__(
        self, folder: Path, orders: list[Order], goal: SE2 = GOAL, limit: float = 60.0, robot: str = "diff"
    ) -> None:
        world = folder / "hall.yaml"
        world.write_text(
            "start: {x: 1.5, y: 4.0}\nwalls:\n"
            "  - {from: [0, 0], to: [10, 0]}\n  - {from: [10, 0], to: [10, 8]}\n"
            "  - {from: [10, 8], to: [0, 8]}\n  - {from: [0, 8], to: [0, 0]}\n"
            "boxes:\n  - {center: [4, 0.6], size: [0.8, 0.6, 1.0]}\n  - {center: [7.2, 7.4], size: [0.6, 0.8, 1.0]}\n"
        )
        options = RunOptions(
            (NavigateStep(goal),), str(world), robot, seed=3, physics="kinematic", port=None, time_limit=limit
        )
        self.run = SimulatedRun(options, RunFolder(folder / "run"), parts=Parts(nodes=(Orders(orders),)))
        self.run.run(limit)
        self.run.close()
        frame, rows = TruthFrame(self.run.robot.world_from_map), []
        for recorded in read_recording(self.run.folder.recording, [TRUE_POSE.ros_name]):
            pose = frame.pose(recorded.decode_as(m.Odometry).pose.to_se2())
            rows.append((recorded.log_time_ns * 1e-9, pose.x, pose.y))
        self.track = np.array(rows)

    def speed(self, begin: float, end: float) -> np.ndarray:
        """Speeds over tenths of a second between two times."""
        t = np.arange(begin, end, 0.1)
        x, y = (np.interp(t, self.track[:, 0], self.track[:, k]) for k in (1, 2))
        return np.hypot(np.diff(x), np.diff(y)) / 0.1


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Driven:
    return Driven(tmp_path_factory.mktemp("plain"), [])


def test_without_orders_it_drives_straight_and_fast(undisturbed: Driven) -> None:
    assert undisturbed.run.ended == "succeeded"
    assert np.abs(undisturbed.track[:, 2]).max() < 0.3
    assert undisturbed.speed(3.0, 7.0).max() > 0.7


def test_a_speed_is_kept(tmp_path: Path) -> None:
    driven = Driven(tmp_path, [(3.0, SPEED, lambda t: m.Number(t, 0.25)), (9.0, SPEED, lambda t: m.Number(t, 0.6))])
    assert driven.run.ended == "succeeded"
    assert 0.2 < np.median(driven.speed(4.5, 9.0)) < 0.26
    assert driven.speed(4.5, 9.0).max() < 0.28
    assert driven.speed(9.0, 14.0).max() == pytest.approx(0.6, abs=0.03)


def test_a_stop_holds_and_its_end_lets_go_on(tmp_path: Path) -> None:
    """Longer than anybody's patience: a robot that is told to stand is not stuck."""
    driven = Driven(tmp_path, [(3.5, STOP, lambda t: m.Code(t, 2)), (19.0, STOP, lambda t: m.Code(t, 0))])
    assert driven.run.ended == "succeeded"
    assert driven.speed(5.0, 19.0).max() < 0.01
    assert driven.speed(19.5, 24.0).max() > 0.5
    states = {
        recorded.decode_as(m.GateStatus).state
        for recorded in read_recording(driven.run.folder.recording, [GATE_STATUS.ros_name])
        if 5e9 < recorded.log_time_ns < 18e9
    }
    assert states == {m.GateState.PAUSED}


def test_a_stop_of_the_first_kind_holds_the_way_and_not_the_turning(tmp_path: Path) -> None:
    orders: list[Order] = [(1.05, STOP, lambda t: m.Code(t, 1)), (16.0, STOP, lambda t: m.Code(t, 0))]
    driven = Driven(tmp_path, orders, SE2(0.0, -2.0, 0.0))
    assert driven.run.ended == "succeeded"
    assert "FAILED_TO_MAKE_PROGRESS" not in driven.run.folder.log.read_text(), "it was told to stand"
    assert driven.speed(2.0, 15.5).max() < 0.02
    yaws = [
        (r.log_time_ns * 1e-9, r.decode_as(m.Odometry).pose.to_se2().yaw)
        for r in read_recording(driven.run.folder.recording, [TRUE_POSE.ros_name])
    ]
    turned = [abs(b[1] - a[1]) for a, b in itertools.pairwise(yaws) if 1.5 < a[0] < 15.0]
    assert sum(turned) > 0.5


def test_it_does_not_leave_its_boundary(tmp_path: Path) -> None:
    fence = np.array([[-1.0, -2.0, 0.0], [3.0, -2.0, 0.0], [3.0, 2.0, 0.0], [-1.0, 2.0, 0.0]], np.float32)
    driven = Driven(tmp_path, [(0.5, BOUNDARY, lambda t: m.Polygon(t, "map", fence))], limit=40.0)
    assert driven.run.ended != "succeeded"
    assert driven.track[:, 1].max() < 3.0 - 0.2
    assert np.abs(driven.track[:, 2]).max() < 2.0 - 0.2


def test_an_empty_polygon_takes_the_boundary_away(tmp_path: Path) -> None:
    fence = np.array([[-1.0, -2.0, 0.0], [3.0, -2.0, 0.0], [3.0, 2.0, 0.0], [-1.0, 2.0, 0.0]], np.float32)
    none = np.zeros((0, 3), np.float32)
    orders: list[Order] = [
        (0.3, BOUNDARY, lambda t: m.Polygon(t, "map", fence)),
        (0.6, BOUNDARY, lambda t: m.Polygon(t, "map", none)),
    ]
    assert Driven(tmp_path, orders).run.ended == "succeeded"


def added(stamp_ns: int) -> m.PointCloud:
    y = np.arange(-1.0, 1.0, 0.05, np.float32)
    points = np.stack([np.full_like(y, 2.5), y, np.zeros_like(y)], axis=1)
    zeros = np.zeros(len(y), np.float32)
    return m.PointCloud(stamp_ns, "map", points, zeros, zeros, np.zeros(len(y), np.uint16))


def test_it_goes_around_what_was_added(tmp_path: Path) -> None:
    driven = Driven(tmp_path, [(0.5, ADDED_OBSTACLES, added)])
    assert driven.run.ended == "succeeded"
    beside = driven.track[np.abs(driven.track[:, 1] - 2.5) < 0.1]
    assert np.abs(beside[:, 2]).min() > 1.0 + 0.2


def test_a_point_becomes_a_goal(tmp_path: Path) -> None:
    orders: list[Order] = [(4.0, GOAL_POINT, lambda t: m.PointStamped(t, "map", (1.0, 2.0, 0.0)))]
    driven = Driven(tmp_path, orders, limit=30.0)
    assert driven.run.ended == "preempted"
    assert driven.track[:, 1].max() < GOAL.x - 0.5


def test_clearing_makes_a_robot_with_depth_cameras_see_anew(tmp_path: Path) -> None:
    """Clearing again and again, with nothing believed at one look, leaves no marks to go around; without it there are some."""
    counts = []
    for name, orders in (
        ("seen", []),
        ("cleared", [(0.5 + 0.1 * k, MAP_CLEARING, lambda t: m.Number(t, 9.0)) for k in range(400)]),
    ):
        folder = tmp_path / name
        folder.mkdir()
        driven = Driven(folder, orders, SE2(1.0, 0.0, 0.0), robot="porter+depth")
        assert driven.run.ended == "succeeded"
        costs = [r.decode() for r in read_recording(driven.run.folder.recording, [LOCAL_COSTMAP.ros_name])]
        counts.append(sum(int((c.data >= 99).sum()) for c in costs if isinstance(c, m.OccupancyGrid)))
    assert counts[0] > 100
    assert counts[1] < 0.7 * counts[0]
