"""The docking node on the bus, in lockstep, with a node that plays the robot, its navigator, its gate and its charger."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.core.camera import CameraModel
from ambler.core.messages import (
    BatteryState,
    CameraInfo,
    Image,
    LaserScan,
    Odometry,
    PointCloud,
    PowerSupply,
    Transforms,
    TransformStamped,
    VelocityCommand,
)
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.database import DockDatabase
from ambler.nodes.dock_state import RobotState
from ambler.nodes.docking import DockingNode
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import GoalHandle, GoalTicket, Node, TaskOutcome
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    CAMERA_PICTURES,
    DOCK,
    DOCK_FAILURES,
    NAVIGATE,
    PERMIT_APPROACH,
    REVOKE_APPROACH,
    STOP_CHARGING,
    TEACH_DOCK,
    UNDOCK,
    DockFeedback,
    DockGoal,
    DockReport,
    GateReply,
    NavigateResult,
    Nothing,
    TeachDockGoal,
    UndockGoal,
)
from ambler.runtime.topics import BATTERY, CAMERA_INFO, DOCKING_REQUEST, IMAGE, MERGED_CLOUD, ODOMETRY, SCAN, TRANSFORMS
from ambler.sim.robots import robot_named
from tests.docking.docks import MARKER_DOCK, REFLECTORS

STRIPS = replace(REFLECTORS, map_from_dock=SE2(4.0, 1.0, 0.5))
MAP_FROM_ODOM = SE2(1.0, -2.0, 0.7)
PERIOD = 0.02


class Peers(Node):
    """A robot that goes wherever it is asked to go and sees nothing."""

    name = "peers"
    inputs = (DOCKING_REQUEST,)
    outputs = (ODOMETRY, TRANSFORMS, SCAN, BATTERY, CAMERA_INFO)
    serves = (NAVIGATE, PERMIT_APPROACH, REVOKE_APPROACH, STOP_CHARGING, CAMERA_PICTURES)

    def __init__(self, pose: SE2, supply: PowerSupply = PowerSupply.DISCHARGING) -> None:
        self.pose, self.supply = pose, supply
        self.camera: CameraModel | None = None
        self.is_located = True
        self.drive: GoalHandle[Any, Any, Any] | None = None
        self.command = VelocityCommand(0, 0.0, 0.0, 0.0)
        self.calls_seen: list[str] = []

    def start(self) -> None:
        self.ctx.subscribe(DOCKING_REQUEST, self._on_command)
        self.ctx.serve_task(NAVIGATE, self._on_drive, self._on_cancel)
        for service, reply in (
            (PERMIT_APPROACH, GateReply(True, "")), (REVOKE_APPROACH, Nothing()), (STOP_CHARGING, Nothing()), (CAMERA_PICTURES, Nothing()),
        ):  # fmt: skip
            self.ctx.serve(service, self._answer(service.name, reply))
        self.ctx.timer(PERIOD, self._tick)

    def _answer(self, name: str, reply: Any) -> Callable[[Any], Any]:
        def answer(request: Any) -> Any:
            self.calls_seen.append(name)
            if name == STOP_CHARGING.name:
                self.supply = PowerSupply.NOT_CHARGING
            return reply

        return answer

    def _on_command(self, command: VelocityCommand) -> None:
        self.command = command

    def _on_drive(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self.drive = handle
        self.ctx.after(0.5, lambda: self._arrive(handle))

    def _arrive(self, handle: GoalHandle[Any, Any, Any]) -> None:
        if handle is self.drive and handle.is_active:
            self.pose, self.drive = handle.goal.map_from_goal, None
            handle.succeed(NavigateResult(self.pose, 0.0, 0))

    def _on_cancel(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self.drive = None
        handle.cancelled()

    def _tick(self) -> None:
        now_ns, c = self.ctx.now_ns, self.command
        if now_ns - c.stamp_ns < 300_000_000:
            self.pose = self.pose @ SE2.exp(np.array([c.vx, c.vy, c.wz]) * PERIOD)
        odom = SE3.from_se2(MAP_FROM_ODOM.inverse() @ self.pose)
        zeros = np.zeros((6, 6))
        self.ctx.publish(
            ODOMETRY, Odometry(now_ns, "odom", "base", odom, (c.vx, c.vy, 0.0), (0.0, 0.0, c.wz), zeros, zeros.copy())
        )
        edges = [TransformStamped(now_ns, "odom", "base", odom)]
        if self.is_located:
            edges.append(TransformStamped(now_ns, "map", "odom", SE3.from_se2(MAP_FROM_ODOM)))
        self.ctx.publish(TRANSFORMS, Transforms(now_ns, tuple(edges)))
        nothing = np.full(100, np.inf, np.float32)
        self.ctx.publish(
            SCAN, LaserScan(now_ns, "base", -3.0, 0.06, 0.0, 0.1, 0.05, 30.0, nothing, np.empty(0, np.float32))
        )
        self.ctx.publish(BATTERY, BatteryState(now_ns, "base", 48.0, -2.0, 0.5, self.supply))
        if self.camera is not None:
            self.ctx.publish(CAMERA_INFO, CameraInfo(now_ns, "camera", self.camera))


class Client(Node):
    """Asks for one thing after another, each so many seconds after the one before, and keeps the outcomes."""

    name = "client"
    calls = (DOCK, UNDOCK, TEACH_DOCK)

    def __init__(self, asks: list[tuple[float, Any]]) -> None:
        self.asks = asks
        self.outcomes: list[TaskOutcome[DockReport]] = []
        self.feedback: list[DockFeedback] = []
        self.ticket: GoalTicket | None = None

    def start(self) -> None:
        for seconds, ask in self.asks:
            self.ctx.after(seconds, lambda ask=ask: self._do(ask))

    def _do(self, ask: Any) -> None:
        if ask == "cancel":
            assert self.ticket is not None
            self.ticket.cancel()
        elif isinstance(ask, TeachDockGoal):
            self.ticket = self.ctx.send_goal(TEACH_DOCK, ask, self.outcomes.append)
        elif isinstance(ask, DockGoal):
            self.ticket = self.ctx.send_goal(DOCK, ask, self.outcomes.append, self.feedback.append)
        else:
            self.ticket = self.ctx.send_goal(UNDOCK, ask, self.outcomes.append, self.feedback.append)


def play(
    tmp_path: Path, peers: Peers, asks: list[tuple[float, Any]], seconds: float = 60.0
) -> tuple[Client, DockDatabase, DockingNode]:
    path = tmp_path / "docks.yaml"
    database = DockDatabase(path, {STRIPS.name: STRIPS, MARKER_DOCK.name: MARKER_DOCK})
    client, node = Client(asks), DockingNode(robot_named("amr_omni").model, database)
    executor = LockstepExecutor(Stack([peers, node, client]))
    executor.run(seconds)
    executor.close()
    assert executor.failure is None
    return client, database, node


def codes(client: Client) -> list[str]:
    return [outcome.code for outcome in client.outcomes]


def test_an_unseen_dock_ends_with_its_name_and_a_robot_at_rest(tmp_path: Path) -> None:
    peers = Peers(SE2(1.0, 1.0, 0.0))
    client, _, _ = play(tmp_path, peers, [(0.5, DockGoal("strips"))], 100.0)
    assert codes(client) == ["DOCK_NOT_SEEN"]
    assert "strips" in client.outcomes[0].text
    states = [f.state for f in client.feedback]
    assert states[0] == "staging"
    assert "searching" in states
    assert peers.command.vx == peers.command.vy == peers.command.wz == 0.0
    assert peers.drive is None
    assert REVOKE_APPROACH.name in peers.calls_seen
    assert CAMERA_PICTURES.name not in peers.calls_seen, "reflectors need no pictures"


def test_undocking_stops_the_charge_and_backs_out_by_the_approach_distance(tmp_path: Path) -> None:
    peers = Peers(STRIPS.map_from_dock, PowerSupply.CHARGING)
    client, _, _ = play(tmp_path, peers, [(0.5, UndockGoal("strips"))], 30.0)
    assert codes(client) == ["SUCCEEDED"]
    assert peers.calls_seen.count(STOP_CHARGING.name) == 1
    assert peers.pose.distance_to(STRIPS.map_from_staging) < 0.06
    assert abs(peers.pose.yaw - STRIPS.map_from_dock.yaw) < 0.02


@pytest.mark.parametrize(
    ("goal", "code", "word"),
    [
        (DockGoal("nowhere"), "UNKNOWN_DOCK", "charger, strips"),
        (UndockGoal("nowhere"), "UNKNOWN_DOCK", "charger, strips"),
        (UndockGoal("strips"), "NOT_DOCKED", "strips"),
        (DockGoal("charger"), "NOT_CALIBRATED", "camera"),
    ],
)
def test_what_cannot_be_done_is_refused_with_a_reason(tmp_path: Path, goal: Any, code: str, word: str) -> None:
    peers = Peers(SE2(1.0, 1.0, 0.0))
    client, _, node = play(tmp_path, peers, [(0.5, goal)], 3.0)
    assert codes(client) == [code]
    assert code in DOCK_FAILURES
    assert word in client.outcomes[0].text
    assert not node.mission.is_active
    assert peers.pose == SE2(1.0, 1.0, 0.0)


def test_a_camera_without_a_focal_length_is_refused(tmp_path: Path) -> None:
    peers = Peers(SE2(1.0, 1.0, 0.0))
    peers.camera = CameraModel("camera", 640, 480, 0.0, 0.0, 319.5, 239.5)
    client, _, _ = play(tmp_path, peers, [(0.5, DockGoal("charger"))], 3.0)
    assert codes(client) == ["NOT_CALIBRATED"]
    assert "ambler calibrate camera" in client.outcomes[0].text


def test_pictures_are_asked_for_only_near_the_dock(tmp_path: Path) -> None:
    peers = Peers(MARKER_DOCK.map_from_dock @ SE2(-8.0, 0.0, 0.0))
    peers.camera = CameraModel("camera", 640, 480, 554.0, 554.0, 319.5, 239.5)
    play(tmp_path, peers, [(0.1, DockGoal("charger"))], 0.55)
    assert CAMERA_PICTURES.name not in peers.calls_seen
    peers = Peers(MARKER_DOCK.map_from_dock @ SE2(-8.0, 0.0, 0.0))
    peers.camera = CameraModel("camera", 640, 480, 554.0, 554.0, 319.5, 239.5)
    play(tmp_path, peers, [(0.1, DockGoal("charger"))], 2.7)
    assert 5 <= peers.calls_seen.count(CAMERA_PICTURES.name) <= 10, "a lease of half a second, renewed at half of it"


def test_cancelled_at_any_instant_it_stands(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    for seconds in rng.uniform(0.52, 30.0, 6):
        peers = Peers(SE2(1.0, 1.0, 0.0))
        client, _, node = play(tmp_path, peers, [(0.5, DockGoal("strips")), (seconds, "cancel")], seconds + 1.0)
        assert codes(client) == ["CANCELLED"]
        assert not node.mission.is_active
        assert peers.drive is None
        assert (peers.command.vx, peers.command.vy, peers.command.wz) == (0.0, 0.0, 0.0)


def test_a_newer_task_takes_the_place_of_the_one_under_way(tmp_path: Path) -> None:
    peers = Peers(STRIPS.map_from_dock @ SE2(-0.1, 0.0, 0.0), PowerSupply.NOT_CHARGING)
    asks = [(0.5, DockGoal("strips")), (0.7, UndockGoal("strips"))]
    client, _, _ = play(tmp_path, peers, asks, 30.0)
    assert codes(client) == ["PREEMPTED", "SUCCEEDED"]
    peers = Peers(SE2(1.0, 1.0, 0.0))
    client, _, _ = play(tmp_path, peers, [(0.5, DockGoal("strips")), (0.7, DockGoal("strips")), (2.0, "cancel")], 4.0)
    assert codes(client) == ["PREEMPTED", "CANCELLED"]


class Standing(Peers):
    """Stands in the dock of strips, of which its scanners show returns that are moved by `seen`, as if strips or scanners were."""

    seen = SE2()
    outputs = (*Peers.outputs, MERGED_CLOUD)

    def _tick(self) -> None:
        super()._tick()
        across = np.linspace(-0.02, 0.02, 5)
        points = np.array([[x, y + a] for x, y in STRIPS.reflectors for a in across])
        cloud = np.column_stack([self.seen.transform(points), np.full(len(points), 0.2)]).astype(np.float32)
        bright, times = np.full(len(cloud), 600.0, np.float32), np.zeros(len(cloud), np.float32)
        rings = np.zeros(len(cloud), np.uint16)
        self.ctx.publish(MERGED_CLOUD, PointCloud(self.ctx.now_ns, "base", cloud, bright, times, rings))


def test_a_dock_is_taught_where_the_robot_stands_and_by_what_it_sees_there(tmp_path: Path) -> None:
    stand = SE2(2.5, -1.0, 0.3)
    peers = Standing(stand)
    peers.seen = SE2(0.004, -0.006, math.radians(0.5))
    client, _, _ = play(tmp_path, peers, [(0.5, TeachDockGoal("strips"))], 9.0)
    assert codes(client) == ["SUCCEEDED"]
    saved = DockDatabase.load(tmp_path / "docks.yaml").dock("strips")
    assert saved.map_from_dock.distance_to(stand) < 1e-9
    assert math.isclose(saved.map_from_dock.yaw, stand.yaw)
    left = peers.seen @ saved.offset
    assert math.hypot(left.x, left.y) < 0.002
    assert abs(left.yaw) < math.radians(0.1)


def test_docks_that_cannot_be_written_are_told_and_end_nothing(tmp_path: Path) -> None:
    """A full disk, or one that may only be read, ends a lesson by name, and a docking as if it had been written."""
    (tmp_path / "docks.yaml").mkdir()
    client, database, node = play(tmp_path, Standing(SE2(2.5, -1.0, 0.3)), [(0.5, TeachDockGoal("strips"))], 9.0)
    assert codes(client) == ["DOCK_NOT_SAVED"]
    assert "docks.yaml: cannot be written" in client.outcomes[0].text
    node._dock = database.dock("strips")
    before = database.dock("strips").map_from_dock
    node._refine(before @ SE2(0.01, 0.0, 0.0))
    assert (tmp_path / "docks.yaml").is_dir()


def test_a_dock_is_not_taught_by_a_robot_that_is_lost_sees_nothing_or_moves(tmp_path: Path) -> None:
    lost = Peers(SE2(2.5, -1.0, 0.3))
    lost.is_located = False
    client, _, _ = play(tmp_path, lost, [(0.5, TeachDockGoal("strips"))], 1.0)
    assert codes(client) == ["LOST"]
    assert "does not know where it is" in client.outcomes[0].text
    blind = Peers(SE2(2.5, -1.0, 0.3))
    client, _, _ = play(tmp_path, blind, [(0.5, TeachDockGoal("strips"))], 33.0)
    assert codes(client) == ["DOCK_NOT_SEEN"]
    moving = Peers(SE2(2.5, -1.0, 0.3))
    moving.command = VelocityCommand(700_000_000, 0.1, 0.0, 0.0)
    client, _, _ = play(tmp_path, moving, [(0.5, TeachDockGoal("strips"))], 2.0)
    assert codes(client) == ["NOT_DOCKED"]
    client, _, _ = play(tmp_path, Peers(SE2()), [(0.5, TeachDockGoal("strips")), (1.0, "cancel")], 2.0)
    assert codes(client) == ["CANCELLED"]
    client, _, _ = play(
        tmp_path, Peers(SE2(1.0, 1.0, 0.0)), [(0.5, TeachDockGoal("strips")), (1.0, DockGoal("strips"))], 2.0
    )
    assert codes(client) == ["PREEMPTED"]
    assert not (tmp_path / "docks.yaml").exists(), "nothing was changed"


class Halved(Peers):
    """A camera that sends pictures of half its size for a while."""

    outputs = (*Peers.outputs, IMAGE)

    def _tick(self) -> None:
        super()._tick()
        if self.ctx.now_ns < 1_500_000_000:
            self.ctx.publish(IMAGE, Image(self.ctx.now_ns, "camera", np.zeros((240, 320), np.uint8)))


def test_pictures_that_are_not_as_calibrated_end_a_lesson_and_nothing_later(tmp_path: Path) -> None:
    """The lesson says so; a docking after the camera was put right ends as it ends."""
    peers = Halved(MARKER_DOCK.map_from_dock)
    peers.camera = CameraModel("camera", 640, 480, 554.0, 554.0, 319.5, 239.5)
    asks = [(0.5, TeachDockGoal("charger")), (2.0, DockGoal("charger")), (3.0, "cancel")]
    client, _, _ = play(tmp_path, peers, asks, 4.0)
    assert codes(client) == ["NOT_CALIBRATED", "CANCELLED"]
    assert client.outcomes[0].text == "pictures are 320 x 240, calibrated were 640 x 480"


def test_odometry_that_is_no_number_ends_the_docking(tmp_path: Path) -> None:
    class Broken(Peers):
        def _tick(self) -> None:
            if self.ctx.now_ns > 2_000_000_000:
                self.pose = SE2(math.nan, 0.0, 0.0)
            super()._tick()

    peers = Broken(SE2(1.0, 1.0, 0.0))
    client, _, _ = play(tmp_path, peers, [(0.5, DockGoal("strips"))], 6.0)
    assert codes(client) == ["STALE_INPUT"]
    assert (peers.command.vx, peers.command.vy, peers.command.wz) == (0.0, 0.0, 0.0)


def test_what_a_battery_told_long_ago_is_no_contact() -> None:
    """Contact and charge are unknown before the first word of a battery, and two seconds after its last."""
    state, now_ns = RobotState(), 10_000_000_000
    assert (state.has_contact(now_ns), state.is_charging(now_ns)) == (None, None)
    state.take_battery(BatteryState(now_ns, "base", 53.0, 2.0, 0.9, PowerSupply.CHARGING))
    assert (state.has_contact(now_ns + 1_000_000_000), state.is_charging(now_ns + 1_000_000_000)) == (True, True)
    assert (state.has_contact(now_ns + 3_000_000_000), state.is_charging(now_ns + 3_000_000_000)) == (None, None)
    state.take_battery(BatteryState(now_ns, "base", 53.0, 0.0, 0.9, PowerSupply.NOT_CHARGING))
    assert (state.has_contact(now_ns), state.is_charging(now_ns)) == (True, False)
