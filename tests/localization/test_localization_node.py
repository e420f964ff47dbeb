"""The node with a hand-made context: it tracks on the bus, keeps silent while lost, and names what is wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan, Message, OccupancyGrid, Odometry, PoseStamped, Status, Transforms
from ambler.core.robot import DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.nodes.localization import LocalizationNode, LocalizationNodeConfig
from ambler.runtime import topics
from ambler.runtime.tasks import Nothing
from tests.localization import rooms

MOUNT = SE3.from_se2(SE2(0.2, 0.05, 0.3))
ROBOT = RobotModel(
    "box",
    DriveKind.DIFFERENTIAL,
    np.array([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]),
    VelocityLimits(),
    (SensorMount("laser", SensorKind.SCAN, MOUNT), SensorMount("imu", SensorKind.IMU, SE3())),
)


class HandMadeContext:
    """Remembers what the node subscribed, served, published and logged."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.services: dict[str, Callable[[Any], Any]] = {}
        self.published: list[tuple[str, Message]] = []
        self.codes: list[str] = []
        self.pending: list[tuple[int, Callable[[], None]]] = []

    def subscribe(self, topic: Any, callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def publish(self, topic: Any, message: Message) -> None:
        self.published.append((topic.name, message))

    def serve(self, service: Any, handler: Callable[[Any], Any]) -> None:
        self.services[service.name] = handler

    def log(self, code: str, text: str, **fields: Any) -> None:
        self.codes.append(code)

    def background(self, work: Callable[[], Any], duration: float, done: Callable[[Any], None]) -> None:
        result = work()  # of what is there now
        self.pending.append((self.now_ns + round(duration * 1e9), lambda: done(result)))

    def settle(self) -> None:
        """Give back what is done by now."""
        due = [done for at_ns, done in self.pending if at_ns <= self.now_ns]
        self.pending = [(at_ns, done) for at_ns, done in self.pending if at_ns > self.now_ns]
        for done in due:
            done()

    def of(self, topic: Any) -> list[Any]:
        return [m for name, m in self.published if name == topic.name]


class Drive:
    """Plays a robot in the office into the node: odometry at 50 Hz, scans at 10 Hz."""

    def __init__(self, context: HandMadeContext, pose: SE2, ahead_ns: int = 0) -> None:
        self.context, self.truth, self.odom = context, pose, SE2(5.0, 1.0, -0.4)
        self.ahead_ns = ahead_ns
        self.rng = np.random.default_rng(0)
        self.room = rooms.office()
        self.step = 0

    def run(self, seconds: float, twist: tuple[float, float, float]) -> None:
        for _ in range(round(seconds * 50)):
            motion = np.array(twist) * 0.02
            self.truth = self.truth @ SE2.exp(motion)
            self.odom = self.odom @ SE2.exp(motion * (1.02 + 0.02 * self.rng.standard_normal(3)))
            self.step += 1
            stamp = self.context.now_ns = self.step * 20_000_000
            self.context.settle()
            if self.step % 5 == 0:
                self.context.callbacks["scan"](self.scan(stamp + self.ahead_ns))  # before the odometry of its instant
            covariance = np.diag([1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 1e-3])
            self.context.callbacks["odometry"](
                Odometry(
                    stamp,
                    "odom",
                    "base",
                    SE3.from_se2(self.odom),
                    (twist[0], twist[1], 0.0),
                    (0.0, 0.0, twist[2]),
                    covariance,
                    covariance.copy(),
                )
            )

    def scan(self, stamp: int) -> LaserScan:
        angles = np.linspace(-math.pi, math.pi, 480, endpoint=False)
        ranges = self.room.cast(self.truth @ MOUNT.to_se2(), angles) + 0.01 * self.rng.standard_normal(480)
        ranges = ranges.astype(np.float32)
        return LaserScan(
            stamp, "laser", -math.pi, 2 * math.pi / 480, 0.0, 0.1, 0.05, 20.0, ranges, np.empty(0, np.float32)
        )


def start(
    config: LocalizationNodeConfig, *, has_map: bool = True, robot: RobotModel = ROBOT
) -> tuple[LocalizationNode, HandMadeContext]:
    node = LocalizationNode(robot, lambda m: GridTracker(m, GridTrackerConfig()), config)
    context = HandMadeContext()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    if has_map:
        cells, spec = rooms.office().occupancy()
        context.now_ns = -1_000_000_000
        context.callbacks["map"](OccupancyGrid(0, "map", spec, cells))
        context.now_ns = 0
        context.settle()
    return node, context


def test_tracks_from_an_initial_pose_and_publishes_both_edges_of_it() -> None:
    pose = SE2(7.0, 4.0, 0.3)
    _, context = start(LocalizationNodeConfig(initial_pose=SE2(7.2, 3.9, 0.2)))
    drive = Drive(context, pose)
    drive.run(3.0, (0.3, 0.0, -0.1))
    poses, edges = context.of(topics.LOCALIZED_POSE), context.of(topics.TRANSFORMS)
    assert len(poses) == len(edges) == 30
    told = poses[-1].pose.to_se2()
    error = rooms.error_of(told, drive.truth)
    assert np.hypot(error[0], error[1]) < 0.005
    assert abs(error[2]) < 0.003
    edge = edges[-1].transforms[0]
    assert isinstance(edges[-1], Transforms)
    assert (edge.parent, edge.child) == ("map", "odom")
    again = edge.parent_from_child.to_se2() @ drive.odom
    np.testing.assert_allclose(again.as_array(), told.as_array(), atol=1e-9)
    sigma = np.sqrt(np.diag(poses[-1].pose_covariance)[[0, 1, 5]])
    assert (sigma < 0.01).all()
    assert poses[-1].linear[0] == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("ahead_ns", [300_000_000, -150_000_000])
def test_a_scanner_whose_stamps_are_off_tells_the_same_pose_once_that_is_known(ahead_ns: int) -> None:
    def told(ahead_ns: int) -> list[tuple[int, tuple[float, ...]]]:
        sensors = tuple(replace(m, clock_offset=ahead_ns * 1e-9) for m in ROBOT.sensors)
        _, context = start(
            LocalizationNodeConfig(initial_pose=SE2(7.2, 3.9, 0.2)), robot=replace(ROBOT, sensors=sensors)
        )
        Drive(context, SE2(7.0, 4.0, 0.3), ahead_ns).run(1.0, (0.3, 0.0, -0.6))
        return [(m.stamp_ns, tuple(m.pose.to_se2().as_array())) for m in context.of(topics.LOCALIZED_POSE)]

    assert len(told(0)) == 10
    assert told(ahead_ns) == told(0)


def test_without_a_pose_it_is_silent_until_it_has_found_itself() -> None:
    _, context = start(LocalizationNodeConfig())
    drive = Drive(context, SE2(7.0, 4.0, 0.3))
    drive.run(0.5, (0.0, 0.0, 0.0))
    assert not context.of(topics.TRANSFORMS)
    codes = [m.code for m in context.of(topics.STATUS)]
    assert codes == ["LOCALIZATION_RELOCALIZING"]
    drive.run(2.5, (0.3, 0.0, 0.0))
    assert [m.code for m in context.of(topics.STATUS)][-1] == "LOCALIZATION_TRACKING"
    told = context.of(topics.LOCALIZED_POSE)[-1].pose.to_se2()
    assert told.distance_to(drive.truth) < 0.01


def test_a_set_pose_is_honoured_at_once_and_relocalize_overrides_it() -> None:
    node, context = start(LocalizationNodeConfig())
    drive = Drive(context, SE2(7.0, 4.0, 0.3))
    drive.run(0.1, (0.0, 0.0, 0.0))
    context.callbacks["set_pose"](PoseStamped(context.now_ns, "map", SE3.from_se2(SE2(7.1, 4.1, 0.35))))
    drive.run(0.2, (0.0, 0.0, 0.0))
    assert context.of(topics.LOCALIZED_POSE)[-1].pose.to_se2().distance_to(drive.truth) < 0.02
    context.services["relocalize"](Nothing())
    count = len(context.of(topics.LOCALIZED_POSE))
    drive.run(0.3, (0.0, 0.0, 0.0))
    assert len(context.of(topics.LOCALIZED_POSE)) == count
    drive.run(2.0, (0.3, 0.0, 0.0))
    assert len(context.of(topics.LOCALIZED_POSE)) > count
    assert node.supervisor is not None


def test_what_is_missing_is_named() -> None:
    _, context = start(LocalizationNodeConfig(), has_map=False)
    with pytest.raises(BadInputError, match="no map"):
        context.services["relocalize"](Nothing())
    context.callbacks["set_pose"](PoseStamped(0, "map", SE3()))
    status = context.of(topics.STATUS)[-1]
    assert isinstance(status, Status)
    assert status.code == "NO_MAP"


def test_what_is_told_in_a_bent_map_is_at_least_as_wide_as_its_bend() -> None:
    told = []
    for bend in ((0.0, 0.0), (0.02, 0.005)):
        _, context = start(LocalizationNodeConfig(initial_pose=SE2(7.0, 4.0, 0.3), map_bend=bend))
        Drive(context, SE2(7.0, 4.0, 0.3)).run(1.0, (0.3, 0.0, 0.0))
        told.append(np.diag(context.of(topics.LOCALIZED_POSE)[-1].pose_covariance)[[0, 1, 5]])
    np.testing.assert_allclose(told[1] - told[0], [4e-4, 4e-4, 2.5e-5], rtol=1e-6)
