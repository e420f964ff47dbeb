"""What a gate must not take for granted: that its scanners see all around, that each of them speaks, that their clocks go right."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import LaserScan, Odometry, PointCloud, Range, VelocityCommand
from ambler.core.robot import RobotModel, SensorMount
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.gate import GateNode
from ambler.runtime.tasks import GateRequest
from tests.safety.invariants import BOX
from tests.safety.test_many_scanners import HandMadeContext

HALF = np.radians(np.arange(-90.0, 90.1, 0.5))
AHEAD = tuple(
    SensorMount(name, "scan", SE3((0.35, y, 0.3)), azimuth=(-0.5 * math.pi, 0.5 * math.pi))
    for name, y in (("left", 0.15), ("right", -0.15))
)
BEHIND = SensorMount("rear", "scan", SE3.from_se2(SE2(-0.35, 0.0, math.pi)), azimuth=(-0.5 * math.pi, 0.5 * math.pi))
PUCK = SensorMount("puck", "cloud", SE3((0.0, 0.0, 0.5)), 0.1)
SONAR = SensorMount("sonar", "range", SE3((0.4, 0.0, 0.3)))
POLE = np.array([[0.9, 0.004 * k] for k in range(-15, 16)])  # in the odom frame, ahead of the robot at its start


class Rig:
    """A gate whose robot is put where the test wants it, with scanners that see a pole and nothing else up to 9 m."""

    def __init__(self, *sensors: SensorMount, ahead: float = 0.0) -> None:
        self.model: RobotModel = replace(BOX, sensors=tuple(replace(m, clock_offset=ahead) for m in sensors))
        self.node = GateNode(self.model)
        self.ahead_ns = round(ahead * 1e9)
        self.context = HandMadeContext()
        self.node.ctx = self.context  # type: ignore[assignment]
        self.node.start()
        self.context.callbacks["arm"](GateRequest("test", ""))
        self.pose, self.pole = SE2(), POLE

    def tick(self, vx: float, silent: tuple[str, ...] = ()) -> VelocityCommand:
        self.context.now_ns += 20_000_000
        now_ns, still = self.context.now_ns, (0.0, 0.0, 0.0)
        pose = SE3.from_se2(self.pose)
        covariance = np.zeros((6, 6))
        odometry = Odometry(now_ns, "odom", "base", pose, still, still, covariance, covariance)
        self.context.callbacks["odometry"](odometry)
        for mount in self.model.sensors:
            if mount.frame not in silent:
                self.speak(mount, now_ns + self.ahead_ns)
        self.context.callbacks["velocity_request"](VelocityCommand(now_ns, vx, 0.0, 0.0))
        self.context.step()
        command: VelocityCommand = self.context.last["velocity_command"]
        return command

    def speak(self, mount: SensorMount, stamp_ns: int) -> None:
        if mount.kind == "scan":
            self.context.callbacks["scanners" if len(self.model.scanners) > 1 else "scan"](self.scan(mount, stamp_ns))
        elif mount.kind == "cloud":
            points = np.array([[6.0, 0.0, 0.0], [6.0, 0.1, 0.001 * (stamp_ns % 977)]], np.float32)
            zeros = np.zeros(2, np.float32)
            self.context.callbacks["cloud"](
                PointCloud(stamp_ns, mount.frame, points, zeros, zeros, np.zeros(2, np.uint16))
            )
        else:
            self.context.callbacks["ranges"](Range(stamp_ns, mount.frame, 0.5, 0.1, 4.0, math.inf))

    def scan(self, mount: SensorMount, stamp_ns: int) -> LaserScan:
        sensor_from_odom = mount.base_from_sensor.to_se2().inverse() @ self.pose.inverse()
        ranges = np.full(len(HALF), 9.0, np.float32) + np.float32(0.001) * (stamp_ns // 20_000_000 % 7)
        for x, y in sensor_from_odom.transform(self.pole):
            index = round((math.atan2(y, x) - HALF[0]) / math.radians(0.5))
            if 0 <= index < len(HALF):
                ranges[index] = math.hypot(x, y)
        return LaserScan(
            stamp_ns, mount.frame, float(HALF[0]), math.radians(0.5), 0.0, 0.08, 0.05, 40.0, ranges, ranges[:0]
        )

    def turn_away(self) -> None:
        """Turn by half a circle: the pole is behind the robot now, 50 cm from its rear edge."""
        for yaw in np.linspace(0.0, math.pi, 60):
            self.pose = SE2(0.0, 0.0, float(yaw))
            self.tick(0.0)

    def backwards(self, seconds: float) -> VelocityCommand:
        """Drive back, obeying the gate."""
        for _ in range(round(seconds / 0.02)):
            command = self.tick(-0.3)
            self.pose = self.pose @ SE2(0.02 * command.vx, 0.0, 0.0)
        return command


@pytest.mark.parametrize("sensors", [AHEAD[:1], AHEAD], ids=["one", "two"])
def test_what_no_scanner_looks_at_any_more_still_stops_the_robot(sensors: tuple[SensorMount, ...]) -> None:
    rig = Rig(*sensors)
    rig.turn_away()
    command = rig.backwards(4.0)
    assert command.vx > -0.02
    assert 0.35 < rig.pose.x < 0.9 - 0.4 - 0.02, "it drove back and stopped before the pole"


def test_what_another_scanner_looks_at_is_left_to_that_one() -> None:
    """The pole is taken away while only the rear scanner looks there: nothing is remembered against what it sees."""
    rig = Rig(*AHEAD, BEHIND)
    rig.turn_away()
    rig.pole = np.add(POLE, [0.0, 50.0])
    assert rig.backwards(4.0).vx == pytest.approx(-0.3)
    assert rig.pose.x > 0.9


@pytest.mark.parametrize("missing", ["left", "puck"])
def test_a_scanner_of_any_kind_that_never_spoke_is_missed(missing: str) -> None:
    rig = Rig(AHEAD[0], PUCK)
    for _ in range(60):
        command = rig.tick(-0.2, silent=(missing,))
    assert command.vx == 0.0
    assert any(f"STALE_POINTS: no fresh scan or cloud from {missing}" in code for code in rig.context.codes)
    for _ in range(120):
        command = rig.tick(-0.2)
    assert command.vx == pytest.approx(-0.2)


@pytest.mark.parametrize("ahead", [1.0, -1.0])
@pytest.mark.parametrize("sensors", [(AHEAD[0],), (PUCK,), (AHEAD[0], SONAR)], ids=["scan", "cloud", "range"])
def test_a_known_error_of_a_clock_is_taken_out_of_every_kind_of_message(
    sensors: tuple[SensorMount, ...], ahead: float
) -> None:
    rig = Rig(*sensors, ahead=ahead)
    for _ in range(100):
        command = rig.tick(-0.2)
    assert command.vx == pytest.approx(-0.2), "a second off, and yet neither stale nor from the future"
    rig.ahead_ns = 0
    for _ in range(100):
        command = rig.tick(-0.2)
    assert command.vx == 0.0
