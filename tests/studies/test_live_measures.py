"""What `ambler bench live` measures: scans followed through the nodes to the commands, and the processor's time."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ambler.core.messages import Message, Odometry, PointCloud, VelocityCommand
from ambler.core.se3 import SE3
from ambler.runtime.topics import CLOUD, TERRAIN_MAP, VELOCITY_COMMAND, VELOCITY_REQUEST, Topic
from ambler.studies.processor_share import ProcessorTimes, plain, processor_times, shares
from ambler.studies.scan_watch import ScanWatch
from tests.hand_made_context import HandMadeContext
from tests.safety.test_gaps import PUCK, Rig

pytestmark = pytest.mark.live

MS = 1_000_000


class Robot:
    """What a watch sees of a live robot, whose nodes do what the test says at the instants that it says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in ("ControllerNode", "GateNode"):
            monkeypatch.setattr(f"ambler.studies.scan_watch.{name}", SimpleNamespace)
        self.now_ns = 0
        self.passed_on: list[Message] = []
        self.controller = SimpleNamespace(scans=CLOUD, seen_ns=None)
        self.gate = SimpleNamespace(gate=SimpleNamespace(seen_ns={"lidar": -1}))
        self.goal = SimpleNamespace(is_active=True)
        self.request: VelocityCommand | None = None
        task = SimpleNamespace(active=self.goal)
        bus = SimpleNamespace(tasks={"follow_path": task})
        contexts = {
            "controller": SimpleNamespace(node=self.controller, bus=bus),
            "gate": SimpleNamespace(node=self.gate, newest=lambda topic: self.request),
        }
        self.context_of = contexts.__getitem__
        self.watch = ScanWatch(self)  # type: ignore[arg-type]

    def send(self, channel: Any, message: Message, writer: Any, number: int) -> None:
        self.passed_on.append(message)

    def publish(self, at_ms: int, topic: Topic[Any], message: Message) -> None:
        self.now_ns = at_ms * MS
        self.send(SimpleNamespace(topic=topic), message, None, 0)

    def scan(self, end_ms: int) -> int:
        """A cloud of 100 ms that arrives 5 ms after its end; returns its stamp."""
        stamp_ns = (end_ms - 100) * MS
        self.publish(end_ms + 5, CLOUD, cloud(stamp_ns, 0.1))
        return stamp_ns

    def ask(self, at_ms: int) -> None:
        command = VelocityCommand(at_ms * MS, 0.1, 0.0, 0.0)
        self.publish(at_ms, VELOCITY_REQUEST, command)
        self.request = command

    def command(self, at_ms: int) -> None:
        self.publish(at_ms, VELOCITY_COMMAND, VelocityCommand(at_ms * MS, 0.1, 0.0, 0.0))


def cloud(stamp_ns: int, seconds: float) -> PointCloud:
    zeros = np.zeros(2, np.float32)
    late = np.array([0.0, seconds], np.float32)
    return PointCloud(stamp_ns, "lidar", np.ones((2, 3), np.float32), zeros, late, np.zeros(2, np.uint16))


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    return Robot(monkeypatch)


def test_a_scan_is_followed_through_gate_and_controller(robot: Robot) -> None:
    for end in (1000, 1100, 1200):
        stamp_ns = robot.scan(end)
        robot.command(end + 8)  # knows nothing of it yet
        robot.gate.gate.seen_ns = {"lidar": stamp_ns}
        robot.command(end + 20)
        robot.ask(end + 21)  # on a costmap without it
        robot.controller.seen_ns = stamp_ns
        robot.command(end + 28)
        robot.ask(end + 30)
        robot.command(end + 40)
    told = robot.watch.results(0, 2_000 * MS)
    assert (told["scans"], told["scans_in_motion"]) == (3, 3)
    assert told["scan_arrival_median_ms"] == pytest.approx(5.0)
    assert told["scan_to_gate_median_ms"] == pytest.approx(20.0)
    assert told["scan_to_command_median_ms"] == pytest.approx(40.0)
    assert told["scan_to_terrain_command_median_ms"] is None
    assert robot.watch.results(1_050 * MS, 1_150 * MS)["scans"] == 1
    assert len(robot.passed_on) == 3 * 7, "everything still goes its way"


def test_a_robot_without_a_motion_is_not_slow(robot: Robot) -> None:
    for end in (1000, 1100):
        robot.controller.seen_ns = robot.scan(end)
        robot.goal.is_active = False
    robot.goal.is_active = True
    robot.ask(3000)
    robot.command(3010)
    told = robot.watch.results(0, 2_000 * MS)
    assert (told["scans"], told["scans_in_motion"]) == (2, 1), "the motion of the first goes on"
    assert told["scan_to_command_median_ms"] == pytest.approx(2010.0)


def test_terrain_counts_from_the_costmap_that_was_drawn_with_it(robot: Robot) -> None:
    """The terrain of the first scan comes after its costmap was drawn: the next scan's costmap holds it."""
    for end in (1000, 1100, 1200):
        stamp_ns = robot.scan(end)
        robot.controller.seen_ns = stamp_ns
        robot.publish(end + 20, TERRAIN_MAP, cloud(end * MS, 0.0))
        robot.ask(end + 30)
        robot.command(end + 40)
    told = robot.watch.results(0, 1_150 * MS)
    assert told["scan_to_command_median_ms"] == pytest.approx(40.0)
    assert told["scan_to_terrain_command_median_ms"] == pytest.approx(140.0)


def test_the_gate_says_what_it_has_seen() -> None:
    rig = Rig(PUCK)
    assert rig.node.gate.seen_ns["puck"] < 0
    rig.tick(0.1)
    assert rig.node.gate.seen_ns == {"puck": rig.context.now_ns}
    rig.tick(0.1, silent=("puck",))
    assert rig.node.gate.seen_ns == {"puck": rig.context.now_ns - 20 * MS}


def test_the_controller_says_what_its_costmap_holds() -> None:
    from ambler.apps.config import RobotConfig
    from ambler.apps.robot import Site, robot_nodes
    from ambler.nodes.controller import ControllerNode
    from ambler.sim.robots import robot_named

    model = robot_named("go2").model
    node = next(n for n in robot_nodes(model, RobotConfig(), Site()) if isinstance(n, ControllerNode))
    context = HandMadeContext()
    context.start(node)
    assert node.scans == CLOUD
    assert node.seen_ns is None
    still, none = (0.0, 0.0, 0.0), np.zeros((6, 6))
    stamp_ns = context.now_ns
    seen = PointCloud(stamp_ns, model.clouds[0].frame, *_points(50))
    context.callbacks["cloud"](seen)
    assert node.seen_ns is None, "nobody knows where the robot was"
    for k in range(12):
        stamp = stamp_ns + 10 * MS * k
        context.callbacks["odometry"](Odometry(stamp, "odom", "base", SE3(), still, still, none, none))
    context.callbacks["cloud"](seen)
    assert node.seen_ns == stamp_ns


def _points(count: int) -> tuple[Any, ...]:
    angles = np.linspace(-3.0, 3.0, count)
    points = np.stack((3.0 * np.cos(angles), 3.0 * np.sin(angles), 0.0 * angles), axis=1).astype(np.float32)
    zeros = np.zeros(count, np.float32)
    return points, zeros, zeros, np.zeros(count, np.uint16)


def test_the_share_of_a_processor_is_what_was_computed_over_the_time() -> None:
    begin = ProcessorTimes(100.0, 7.0, {("gate", 1): 1.0, ("unix:/tmp/ambler-x1/robot.sensors", 2): 0.5})
    ends = {("gate", 1): 1.5, ("unix:/tmp/ambler-x1/robot.sensors", 2): 0.75, ("late_0", 3): 1.0, ("late_1", 4): 0.25}
    told = shares(begin, ProcessorTimes(110.0, 10.0, ends))
    assert told["processor_pct"] == pytest.approx(30.0)
    assert told["processor_seconds"] == pytest.approx(10.0)
    assert told["thread_gate_pct"] == pytest.approx(5.0)
    assert told["thread_robot_sensors_pct"] == pytest.approx(2.5)
    assert told["thread_late_pct"] == pytest.approx(12.5), "workers of one pool together"


def test_names_of_threads_fit_into_names_of_fields() -> None:
    names = ("background-perception_0", "/tmp/ambler-9f/robot.base", "taps")
    assert [plain(name) for name in names] == ["background_perception", "robot_base", "taps"]


def test_a_thread_that_computes_is_told_with_what_it_took() -> None:
    begin, done, measured = processor_times(), threading.Event(), threading.Event()
    took: list[float] = []

    def compute() -> None:
        while time.thread_time() < 0.2:
            sum(range(1000))
        took.append(time.thread_time())
        done.set()
        measured.wait()

    thread = threading.Thread(target=compute, name="burner")
    thread.start()
    done.wait()
    end = processor_times()
    measured.set()
    thread.join()
    told = shares(begin, end)
    assert told["thread_burner_pct"] * told["processor_seconds"] == pytest.approx(100.0 * took[0], rel=0.1)
    assert told["processor_pct"] >= told["thread_burner_pct"]
