"""The gate of a robot with several scanners: sideways motion passes, and each scanner must be there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ambler.core.messages import LaserScan, Odometry, PointCloud, VelocityCommand
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.gate import GateNode
from ambler.runtime.tasks import GateRequest
from ambler.runtime.topics import CLOUD, SCAN, SCANNERS, VELOCITY_COMMAND, Topic
from ambler.sim.robots import robot_named

COVARIANCES = (np.zeros((6, 6)), np.zeros((6, 6)))
FRAMES = ("front_right", "front_left", "rear_left")


class HandMadeContext:
    """Time, and the last of everything published."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000
        self.callbacks: dict[str, Callable[[Any], Any]] = {}
        self.last: dict[str, Any] = {}
        self.codes: list[str] = []
        self.step: Callable[[], None] = lambda: None

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def serve(self, service: Any, callback: Callable[[Any], Any]) -> None:
        self.callbacks[service.name] = callback

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        callback()

    def timer(self, period: float, callback: Callable[[], None]) -> None:
        self.step = callback

    def publish(self, topic: Topic[Any], message: Any) -> None:
        self.last[topic.name] = message

    def log(self, code: str, text: str, **fields: Any) -> None:
        self.codes.append(f"{code} {text}")


def with_clock_offsets(model: RobotModel, offsets: Mapping[str, float]) -> RobotModel:
    sensors = tuple(replace(m, clock_offset=offsets.get(m.frame, 0.0)) for m in model.sensors)
    return replace(model, sensors=sensors)


class Bench:
    """A gate node with a robot that stands among far walls and wants to go sideways."""

    def __init__(self, clock_offsets: Mapping[str, float] | None = None) -> None:
        self.node = GateNode(with_clock_offsets(robot_named("amr_omni").model, clock_offsets or {}))
        self.context = HandMadeContext()
        self.node.ctx = self.context  # type: ignore[assignment]
        self.node.start()
        self.context.callbacks["arm"](GateRequest("test", ""))
        self.y = 0.0
        self.rng = np.random.default_rng(0)

    def run(
        self, seconds: float, frames: tuple[str, ...] = FRAMES, stuck: str = "", ahead_ns: int = 0
    ) -> VelocityCommand:
        """Step for some seconds with scans of these frames; the base moves as commanded."""
        context = self.context
        for k in range(round(seconds / 0.02)):
            context.now_ns += 20_000_000
            pose = SE3((0.0, self.y, 0.0))
            still = (0.0, 0.0, 0.0)
            context.callbacks["odometry"](
                Odometry(context.now_ns, "odom", "base", pose, still, still, np.zeros((6, 6)), np.zeros((6, 6)))
            )
            for frame in frames if k % 4 == 0 else ():
                noise = np.zeros(721) if frame == stuck else 0.01 * self.rng.standard_normal(721)
                ranges = (8.0 + noise).astype(np.float32)
                step = 1.5 * np.pi / 720
                context.callbacks["scanners"](
                    LaserScan(
                        context.now_ns + ahead_ns, frame, -0.75 * np.pi, step, 0.0, 0.08, 0.05, 40.0, ranges, ranges
                    )
                )
            context.callbacks["velocity_request"](VelocityCommand(context.now_ns, 0.0, 0.4, 0.0))
            context.step()
            self.y += 0.02 * context.last["velocity_command"].vy
        command: VelocityCommand = context.last[VELOCITY_COMMAND.name]
        return command


def test_it_reads_the_scanners_themselves_and_lets_sideways_motion_pass() -> None:
    bench = Bench()
    assert SCANNERS in bench.node.inputs
    assert SCAN not in bench.node.inputs
    command = bench.run(2.0)
    assert (command.vx, command.vy, command.wz) == (0.0, pytest.approx(0.4), 0.0)


@pytest.mark.parametrize("missing", FRAMES)
def test_a_scanner_that_never_sent_anything_is_missed(missing: str) -> None:
    bench = Bench()
    command = bench.run(2.0, tuple(f for f in FRAMES if f != missing))
    assert command.vy == 0.0
    assert any(f"STALE_POINTS: no fresh scan or cloud from {missing}" in c for c in bench.context.codes)


def with_a_second_cloud() -> RobotModel:
    spot = robot_named("spot").model
    rear = replace(spot.clouds[0], frame="rear", base_from_sensor=SE3((-0.4, 0.0, 0.7)))
    return replace(spot, sensors=(*spot.sensors, rear))


@pytest.mark.parametrize("missing", ["", "velodyne", "rear"])
def test_every_cloud_is_taken_and_missed(missing: str) -> None:
    node, context = GateNode(with_a_second_cloud()), HandMadeContext()
    assert {CLOUD, CLOUD.of("rear")} <= set(node.inputs)
    node.ctx = context  # type: ignore[assignment]
    node.start()
    context.callbacks["arm"](GateRequest("test", ""))
    still, rng = (0.0, 0.0, 0.0), np.random.default_rng(0)
    topics = {"velodyne": "cloud", "rear": "cloud.rear"}
    for k in range(100):
        context.now_ns += 20_000_000
        context.callbacks["odometry"](Odometry(context.now_ns, "odom", "base", SE3(), still, still, *COVARIANCES))
        for frame, topic in topics.items() if k % 5 == 0 else ():
            if frame != missing:
                angles = rng.uniform(-np.pi, np.pi, 500)
                points = np.column_stack([6.0 * np.cos(angles), 6.0 * np.sin(angles), 0 * angles]).astype(np.float32)
                zeros = np.zeros(500, np.float32)
                context.callbacks[topic](
                    PointCloud(context.now_ns, frame, points, zeros, zeros, np.zeros(500, np.uint16))
                )
        context.callbacks["velocity_request"](VelocityCommand(context.now_ns, 0.2, 0.0, 0.0))
        context.step()
    assert (context.last[VELOCITY_COMMAND.name].vx > 0.0) is not bool(missing)
    assert any(f"no fresh scan or cloud from {missing}" in c for c in context.codes) is bool(missing)


def test_a_scanner_that_falls_silent_stops_the_robot_until_it_is_back() -> None:
    bench = Bench()
    assert bench.run(2.0).vy > 0.3
    assert bench.run(1.2, FRAMES[:2]).vy == 0.0
    assert bench.run(2.0).vy > 0.3


def test_a_scanner_that_repeats_itself_stops_the_robot() -> None:
    bench = Bench()
    assert bench.run(2.0).vy > 0.3
    assert bench.run(1.5, stuck="rear_left").vy == 0.0
    assert any(c.startswith("SCANNER_STUCK rear_left") for c in bench.context.codes)
    assert bench.run(2.0).vy > 0.3


@pytest.mark.parametrize("ahead", [-0.08, 0.08])
def test_a_point_lies_where_the_robot_was_when_its_clock_is_known(ahead: float) -> None:
    """A wall 1.5 m ahead of a robot that drives at it with 1 m/s: the gate's distance is right to a millimetre, and 8 cm off without."""
    model = robot_named("amr_omni").model
    gaps = []
    for offsets in ({"front_left": ahead}, {}):
        node, context = GateNode(with_clock_offsets(model, offsets)), HandMadeContext()
        node.ctx = context  # type: ignore[assignment]
        node.start()
        taken: list[tuple[int, np.ndarray, SE2]] = []
        node.gate.update_points = lambda sensor, stamp, points, pose, taken=taken: taken.append((stamp, points, pose))  # type: ignore[assignment, misc]
        begin_ns, still = context.now_ns, (0.0, 0.0, 0.0)
        for k in range(40):
            stamp_ns = begin_ns + 20_000_000 * k
            pose = SE3((0.02 * k, 0.0, 0.0))
            context.callbacks["odometry"](
                Odometry(stamp_ns, "odom", "base", pose, (1.0, 0.0, 0.0), still, *COVARIANCES)
            )
        mount = next(m for m in model.scanners if m.frame == "front_left").base_from_sensor
        measured_ns = begin_ns + 400_000_000  # the robot was at x = 0.4, the wall is at x = 1.9
        forward = -mount.to_se2().yaw
        distance = np.full(1, 1.5 - mount.translation[0], np.float32)
        stamp_ns = measured_ns + round(ahead * 1e9)
        scan = LaserScan(stamp_ns, "front_left", forward, 0.0, 0.0, 0.08, 0.05, 40.0, distance, distance[:0])
        context.callbacks["scanners"](scan)
        stamp, points, pose = taken[-1]
        assert stamp == (measured_ns if offsets else stamp_ns)
        gaps.append(float(pose.transform(points)[:, 0].mean()) - 1.9)
    assert gaps[0] == pytest.approx(0.0, abs=1e-3)
    assert gaps[1] == pytest.approx(ahead, abs=1e-3)


def test_a_scanner_whose_clock_is_far_ahead_is_not_taken_for_fresh() -> None:
    """Its clock is a second ahead; it fell silent half a second ago, and the gate knows."""
    bench = Bench(clock_offsets=dict.fromkeys(FRAMES, 1.0))
    assert bench.run(2.0, ahead_ns=1_000_000_000).vy > 0.3
    assert bench.run(1.2, FRAMES[:2], ahead_ns=1_000_000_000).vy == 0.0
