"""The odometry node: one message in, odometry and its edge out at the same stamp; only the robot's own IMU counts; faults are logged."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ambler.core.messages import Imu, Message, Odometry
from ambler.core.robot import DriveKind, RobotModel, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.nodes.odometry import OdometryNode
from ambler.runtime import topics

UPSIDE_DOWN = SE3.from_rpy((0.0, 0.0, 0.1), math.pi, 0.0, 0.0)
ROBOT = RobotModel(
    "box",
    DriveKind.DIFFERENTIAL,
    np.array([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]),
    VelocityLimits(),
    (SensorMount("imu", "imu", UPSIDE_DOWN), SensorMount("spare", "imu", SE3())),
)


class Context:
    """Remembers what was subscribed, published and logged."""

    def __init__(self) -> None:
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.published: list[tuple[str, Any]] = []
        self.codes: list[str] = []

    def subscribe(self, topic: Any, callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def publish(self, topic: Any, message: Message) -> None:
        self.published.append((topic.name, message))

    def log(self, code: str, text: str, **fields: Any) -> None:
        self.codes.append(code)


def started() -> Context:
    node, context = OdometryNode(ROBOT), Context()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    return context


def wheels(stamp_ns: int) -> Odometry:
    stated = np.diag([1e-3] * 6)
    return Odometry(stamp_ns, "odom", "base", SE3(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.5), stated, stated.copy())


def turn(context: Context, frame: str, rate: float) -> float:
    """Let the wheels stand while a gyroscope turns for a second; returns the heading that is told."""
    for k in range(50):
        for late in (15, 5):
            context.callbacks["imu"](Imu((20 * k - late) * 1_000_000, frame, (0.0, 0.0, rate), (0.0, 0.0, 9.81)))
        context.callbacks["wheel_odometry"](wheels(20 * k * 1_000_000))
    told = [m for name, m in context.published if name == "odometry"]
    return float(told[-1].pose.to_se2().yaw)


def test_odometry_and_its_edge_have_the_stamp_of_the_wheels() -> None:
    context = started()
    turn(context, "imu", 0.0)
    odometry = [m for name, m in context.published if name == topics.ODOMETRY.name]
    edges = [m.transforms[0] for name, m in context.published if name == topics.TRANSFORMS.name]
    assert [m.stamp_ns for m in odometry] == [e.stamp_ns for e in edges] == [20_000_000 * k for k in range(50)]
    assert {(e.parent, e.child) for e in edges} == {("odom", "base")}
    assert all(e.parent_from_child == m.pose for e, m in zip(edges, odometry, strict=True))


def test_the_first_imu_turns_the_robot_as_it_is_mounted_and_no_other_does() -> None:
    assert turn(started(), "imu", -0.5) > 0.3  # upside down: it turns to the left
    assert abs(turn(started(), "spare", -0.5)) < 0.05


def test_what_is_wrong_is_logged_and_nothing_is_told() -> None:
    context = started()
    turn(context, "imu", 0.0)
    count = len(context.published)
    context.callbacks["wheel_odometry"](wheels(100))
    assert context.codes == ["WHEELS_OUT_OF_ORDER"]
    assert len(context.published) == count
