"""The nodes of a simulated robot's devices, in a context made by hand: what they publish, when, and that they obey commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambler.apps.simulated_robot import lone_robot_nodes
from ambler.core import messages as m
from ambler.core.devices import DeviceHealth, DeviceState
from ambler.core.errors import BadInputError
from ambler.core.robot import SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.nodes.devices.joystick import JoystickNode
from ambler.nodes.devices.node import HEALTH_PERIOD
from ambler.nodes.devices.sensors import ImuNode
from ambler.nodes.devices.table import device_names, device_nodes, topics_of, topics_of_kind
from ambler.runtime import topics
from ambler.runtime.node import Node
from ambler.runtime.tasks import CAMERA_PICTURES, PicturesRequest
from ambler.sim.robot_devices import robot_devices
from ambler.sim.robots import robot_named
from ambler.sim.sensors import MEMS_IMU
from ambler.sim.sim_robot import SimRobot
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.sim.world_file import load_world
from tests.hand_made_context import HandMadeContext

LAB = load_world("lab_empty")
MS = 1_000_000


def started(robot: SimRobot, world: str = "lab_empty") -> tuple[HandMadeContext, list[Node]]:
    context, nodes = HandMadeContext(), lone_robot_nodes(load_world(world), robot, SimulationConfig())
    for node in nodes:
        context.start(node)
    return context, nodes


def test_what_is_there_before_anything_moves() -> None:
    context, _ = started(robot_named("diff"))
    (mounts,), (grid,) = context.messages(topics.STATIC_TRANSFORMS), context.messages(topics.TRUE_MAP)
    assert {(t.parent, t.child) for t in mounts.transforms} == {("base", "laser"), ("base", "imu")}
    (outline,) = context.messages(topics.ROBOT_DESCRIPTION)
    assert '<robot name="diff">' in outline.text
    assert grid.frame == "world"
    assert grid.data[grid.spec.cell_of(LAB.start.x, LAB.start.y)] == 0
    (start,) = context.messages(topics.TRUE_START)
    assert (start.frame, start.pose.to_se2()) == ("world", LAB.start)


def test_everything_is_published_in_time_and_on_declared_topics() -> None:
    context, nodes = started(robot_named("diff"))
    context.run(1.0)
    assert {t.name for _, t, _ in context.published} <= {t.name for n in nodes for t in n.outputs}
    assert {n.name for n in nodes} - {"truth"} <= device_names(robot_named("diff").model)
    for topic in (topics.WHEEL_ODOMETRY, topics.TRUE_POSE):
        told = [(now, message) for now, t, message in context.published if t == topic]
        assert len(told) == 51
        assert {now - message.stamp_ns for now, message in told[1:]} == {0}
    assert len(context.messages(topics.IMU)) == 100
    scans = [(now, s) for now, t, s in context.published if t is topics.SCAN]
    assert len(scans) == 9
    assert {now - s.stamp_ns for now, s in scans} == {105 * MS}
    assert all(now >= message.stamp_ns for now, _, message in context.published)


def test_scanners_and_transducers_send_exactly_their_latency_after_the_measurement() -> None:
    context, nodes = started(robot_named("amr_omni+ultrasonic"))
    context.run(1.0)
    scans = [(now, s) for now, t, s in context.published if t is topics.SCANNERS]
    assert {s.frame for _, s in scans} == {"front_right", "front_left", "rear_left"}
    assert {now - s.stamp_ns for now, s in scans} == {35 * MS}, "30 ms for 270 degrees, 5 ms on the way"
    echoes = [now - e.stamp_ns for now, t, e in context.published if t is topics.RANGES]
    assert set(echoes) == {20 * MS}
    assert len(echoes) >= 12 * 11
    lidars = [n.name for n in nodes if n.name.startswith("lidar_")]
    assert lidars == ["lidar_front_right", "lidar_front_left", "lidar_rear_left"]


def test_the_robot_obeys_the_command_topic() -> None:
    context, _ = started(robot_named("spot"))
    for _ in range(20):
        context.callbacks["velocity_command"](m.VelocityCommand(context.now_ns, 0.4, 0.2, 0.0))
        context.run(0.1)
    truth = (LAB.start.inverse() @ context.messages(topics.TRUE_POSE)[-1].pose.to_se2()).as_array()
    odometry = context.messages(topics.WHEEL_ODOMETRY)[-1].pose.translation
    assert 0.6 < truth[0] < 0.85
    assert 0.3 < truth[1] < 0.45
    np.testing.assert_allclose(odometry[:2], truth[:2], atol=0.08)
    assert context.messages(topics.CLOUD)
    assert not context.messages(topics.SCAN)
    assert not context.messages(topics.CONTACT)


def test_pictures_come_while_somebody_wants_them() -> None:
    context, _ = started(robot_named("amr_omni"), "dock_room")
    context.run(0.5)
    assert not context.messages(topics.IMAGE)
    (info,) = context.messages(topics.CAMERA_INFO)
    assert (info.frame, info.model.width) == ("camera", 640)
    begin = context.now_ns
    context.services[CAMERA_PICTURES.name](PicturesRequest(0.4))
    context.run(1.0)
    taken = [(now, i.stamp_ns) for now, t, i in context.published if t is topics.IMAGE]
    assert len(taken) == 5, "12.5 Hz for 0.4 s"
    assert max(now for now, _ in taken) <= begin + 450 * MS
    assert {now - stamp for now, stamp in taken} == {40 * MS + 2_500_000}, "40 ms after half an exposure"


def with_more(robot: SimRobot) -> SimRobot:
    """Two more of each kind that may come several times."""
    kinds = {"rear_imu": SensorKind.IMU, "rear_camera": SensorKind.CAMERA}
    mounts = tuple(SensorMount(frame, kind, SE3((-0.4, 0.0, 0.3))) for frame, kind in kinds.items())
    return replace(
        robot,
        model=replace(robot.model, sensors=robot.model.sensors + mounts),
        imus={**robot.imus, "rear_imu": MEMS_IMU},
        cameras={**robot.cameras, "rear_camera": robot.cameras["camera"]},
    )


def test_several_sensors_of_a_kind_have_topics_of_their_own() -> None:
    robot = with_more(robot_named("amr_omni"))
    context, nodes = started(robot)
    context.run(0.5)
    main, rear = context.messages(topics.IMU), context.messages(topics.IMU.of("rear_imu"))
    assert (len(main), len(rear)) == (100, 50), "each at its own rate"
    assert {i.frame for i in main} == {"imu"}
    assert {i.frame for i in rear} == {"rear_imu"}
    assert len(context.messages(topics.IMAGE.of("rear_camera"))) > 4, "nobody can ask a further camera"
    assert not context.messages(topics.IMAGE)
    assert {"imu_imu", "imu_rear_imu", "camera_rear_camera"} <= {n.name for n in nodes}
    assert topics_of_kind(robot.model, SensorKind.IMU) == (topics.IMU, topics.IMU.of("rear_imu"))
    assert topics_of_kind(robot.model, SensorKind.SCAN) == (topics.SCANNERS,)
    assert topics_of(robot_named("diff").model, robot_named("diff").model.scanners[0]) == (topics.SCAN,)


def test_a_device_at_a_frame_that_the_robot_does_not_mount_is_refused() -> None:
    world = World(LAB, [BodySpec("a", with_more(robot_named("amr_omni")))], SimulationConfig())
    with pytest.raises(BadInputError, match="rear_imu"):
        device_nodes(robot_named("amr_omni").model, robot_devices(world, "a"))


class SickImu:
    """An IMU whose health the test decides."""

    name, frame, poll_period = "imu", "imu", 0.01

    def __init__(self) -> None:
        self.now = DeviceHealth(DeviceState.OPEN)
        self.is_closed = False

    def open(self) -> None:
        self.is_closed = False

    def close(self) -> None:
        self.is_closed = True

    def health(self) -> DeviceHealth:
        return self.now

    def read(self, now_ns: int) -> list[m.Imu]:
        return []


def test_changes_of_a_devices_health_are_told_once() -> None:
    device, context = SickImu(), HandMadeContext()
    node = ImuNode(device, topics.IMU)
    context.start(node)
    context.run(1.0)
    assert context.messages(topics.STATUS) == []
    device.now = DeviceHealth(DeviceState.OPEN, clock_jumps=1, clock_offset=0.5)
    context.run(2 * HEALTH_PERIOD)
    device.now = replace(device.now, state=DeviceState.FAILED, text="the line broke")
    context.run(4 * HEALTH_PERIOD)
    device.now = replace(device.now, state=DeviceState.OPEN, text="")
    context.run(4 * HEALTH_PERIOD)
    told = [(s.node, s.code) for s in context.messages(topics.STATUS)]
    codes = ["DEVICE_CLOCK_JUMPED", "DEVICE_FAILED", "DEVICE_RECOVERED"]
    assert told == [("imu_imu", code) for code in codes]
    assert [code for code, _ in context.logged] == codes
    assert context.messages(topics.STATUS)[1].text == "the line broke"
    node.stop()
    assert device.is_closed


class HeldJoystick(SickImu):
    """A joystick whose states the test writes."""

    name = "joystick"

    def __init__(self) -> None:
        super().__init__()
        self.states: list[m.JoystickState] = []

    def read(self, now_ns: int) -> list[m.JoystickState]:  # type: ignore[override]
        states, self.states = self.states, []
        return states


def held(
    stamp_ns: int, forward: float, turn: float, *, dead_man: bool, steer: bool = False, left: float = 0.0
) -> m.JoystickState:
    buttons = np.zeros(6, np.uint8)
    buttons[4], buttons[5] = dead_man, steer
    return m.JoystickState(stamp_ns, "joystick", np.array([left, forward, 0.0, turn], np.float32), buttons)


def test_a_joystick_drives_only_while_its_dead_man_button_is_held() -> None:
    device, context = HeldJoystick(), HandMadeContext()
    context.start(JoystickNode(device, VelocityLimits(vx_max=0.8, vx_min=-0.4, wz_max=1.0)))
    device.states = [held(1, 1.0, 0.0, dead_man=False)]
    context.run(0.1)
    assert context.messages(topics.TELEOP_REQUEST) == []
    device.states = [held(2, 1.0, -0.5, dead_man=True), held(3, -1.0, 0.05, dead_man=True)]
    context.run(0.1)
    device.states = [held(4, 1.0, 0.0, dead_man=False), held(5, 1.0, 0.0, dead_man=False)]
    context.run(0.1)
    wanted = [(r.stamp_ns, r.vx, r.vy, r.wz) for r in context.messages(topics.TELEOP_REQUEST)]
    assert wanted == [(2, 0.4, 0.0, -0.25), (3, -0.2, 0.0, 0.0), (4, 0.0, 0.0, 0.0)]
    assert len(context.messages(topics.JOYSTICK)) == 5
    assert context.messages(topics.STEER_REQUEST) == []


def test_a_joystick_steers_while_the_other_button_is_held_and_driving_by_hand_comes_first() -> None:
    """A base without sideways motion is steered to the left all the same: the local planner turns it."""
    device, context = HeldJoystick(), HandMadeContext()
    context.start(JoystickNode(device, VelocityLimits(vx_max=0.8, vx_min=-0.4, wz_max=1.0)))
    device.states = [held(1, 0.5, 0.0, dead_man=False, steer=True, left=0.5)]
    device.states += [held(2, 0.5, 0.0, dead_man=True, steer=True), held(3, 0.5, 0.0, dead_man=False)]
    context.run(0.1)
    steered = [(r.stamp_ns, r.vx, r.vy, r.wz) for r in context.messages(topics.STEER_REQUEST)]
    driven = [(r.stamp_ns, r.vx, r.vy, r.wz) for r in context.messages(topics.TELEOP_REQUEST)]
    assert steered == [(1, 0.2, 0.2, 0.0), (2, 0.0, 0.0, 0.0)]
    assert driven == [(2, 0.2, 0.0, 0.0), (3, 0.0, 0.0, 0.0)]
