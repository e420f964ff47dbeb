"""Docking on the bus: DOCK and UNDOCK in; drives, permissions, pictures and velocities out.

The mission decides, this node carries its commands to the navigator, the gate, the camera and the charger. Velocities are
requests to the gate under a source of their own, which takes over from navigation and falls silent when the mission ends.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field

import numpy as np

from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError, StaleInputError, TransformError
from ambler.core.messages import (
    BatteryState,
    CameraInfo,
    GateState,
    GateStatus,
    Image,
    LaserScan,
    PoseStamped,
    PowerSupply,
    Status,
    Transforms,
    VelocityCommand,
)
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.core.transforms import TransformTree
from ambler.docking.database import DockDatabase
from ambler.docking.detection import DockDetector, DockSighting
from ambler.docking.dock import Dock
from ambler.docking.tracker import TrackerConfig
from ambler.missions.dock import DockMission
from ambler.missions.dock_commands import (
    DockCommand,
    DockConfig,
    DockEnded,
    DockState,
    DockView,
    LookForDock,
    Move,
    NavigateTo,
    PermitApproach,
    RevokeApproach,
    StopCharging,
    StopNavigation,
)
from ambler.nodes.dock_sight import DockSight, Look, detector_of
from ambler.runtime.node import GoalHandle, GoalTicket, Node, TaskOutcome
from ambler.runtime.tasks import (
    CAMERA_PICTURES,
    DOCK,
    NAVIGATE,
    PERMIT_APPROACH,
    REVOKE_APPROACH,
    STOP_CHARGING,
    TEACH_DOCK,
    UNDOCK,
    ApproachRequest,
    DockFeedback,
    DockGoal,
    DockReport,
    NavigateGoal,
    NavigateResult,
    Nothing,
    PicturesRequest,
    TeachDockReply,
    TeachDockRequest,
    UndockGoal,
)
from ambler.runtime.topics import (
    BATTERY,
    CAMERA_INFO,
    DOCK_POSE,
    DOCKING_REQUEST,
    GATE_STATUS,
    IMAGE,
    ODOMETRY,
    SCAN,
    STATUS,
    TRANSFORMS,
)

DockHandle = GoalHandle[DockGoal, DockFeedback, DockReport] | GoalHandle[UndockGoal, DockFeedback, DockReport]

PERIOD = 0.02
DETECTION_TIME = 0.03  # seconds that looking at a picture or scan takes
FEEDBACK_NS = 250_000_000
PERMIT_NS = 100_000_000
LEASE = 0.5  # seconds for which pictures are asked at a time; renewed at half of it
MAP_AGE_NS = 1_500_000_000
FROM_DOCK = 0.3  # metres from a dock's pose at which a robot without contact does not stand in it


@dataclass(frozen=True, slots=True)
class DockingNodeConfig:
    """`sight`: metres to the dock's pose, by the map, from which pictures are taken while the robot still drives to the staging pose.
    `refines`: whether each docking moves the dock's pose in the database a little."""

    mission: DockConfig = field(default_factory=DockConfig)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    sight: float = 2.5
    refines: bool = True


class DockingNode(Node):
    """Docks at the docks of a database, undocks, and teaches docks. One task at a time; a newer one takes its place."""

    name = "docking"
    inputs = (ODOMETRY, TRANSFORMS, SCAN)
    optional_inputs = (IMAGE, CAMERA_INFO, BATTERY, GATE_STATUS)
    outputs = (DOCKING_REQUEST, DOCK_POSE, STATUS)
    serves = (DOCK, UNDOCK, TEACH_DOCK)
    calls = (NAVIGATE, PERMIT_APPROACH, REVOKE_APPROACH, STOP_CHARGING)
    latency = 0.002

    def __init__(self, robot: RobotModel, database: DockDatabase, config: DockingNodeConfig | None = None) -> None:
        self._robot = robot
        self._database = database
        self._config = config if config is not None else DockingNodeConfig()
        if robot.camera is not None:
            self.calls = (*type(self).calls, CAMERA_PICTURES)  # type: ignore[assignment, misc]
        self.mission = DockMission(self._config.mission)
        self._sight = DockSight(robot, self._config.tracker)
        self._tree = TransformTree(history=2.0)
        self._map_ns: int | None = None
        self._camera: CameraModel | None = None
        self._supply: PowerSupply | None = None
        self._is_held = False
        self._dock: Dock | None = None
        self._detector: DockDetector | None = None
        self._handle: DockHandle | None = None
        self._ticket: GoalTicket | None = None
        self._is_looking = False
        self._leased_ns = self._permitted_ns = self._fed_ns = -(1 << 62)
        self._said: tuple[DockState, str] | None = None

    def start(self) -> None:
        """Subscribe, serve, and start the timer."""
        self.ctx.subscribe(ODOMETRY, self._sight.add_odometry)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(IMAGE, self._on_image)
        self.ctx.subscribe(SCAN, self._on_scan)
        self.ctx.subscribe(CAMERA_INFO, self._on_camera)
        self.ctx.subscribe(BATTERY, self._on_battery)
        self.ctx.subscribe(GATE_STATUS, self._on_gate)
        self.ctx.serve_task(DOCK, self._on_dock, self._on_cancel)
        self.ctx.serve_task(UNDOCK, self._on_undock, self._on_cancel)
        self.ctx.serve(TEACH_DOCK, self._on_teach)
        self.ctx.timer(PERIOD, self._tick)

    # Input

    def _on_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)
            if edge.parent == "map":
                self._map_ns = edge.stamp_ns

    def _on_camera(self, info: CameraInfo) -> None:
        self._camera = info.model

    def _on_battery(self, battery: BatteryState) -> None:
        self._supply = battery.supply

    def _on_gate(self, status: GateStatus) -> None:
        self._is_held = status.state is not GateState.ARMED

    def _on_image(self, image: Image) -> None:
        camera = self._camera
        if self._sight.wants_pictures and camera is not None and image.data.shape != (camera.height, camera.width):
            text = f"the camera sends {image.data.shape[1]} x {image.data.shape[0]} pictures, calibrated were {camera.width} x {camera.height}"
            self._do(self.mission.cancel(), "NOT_CALIBRATED", text)
            return
        self._look(self._sight.look_at_picture(image, self._map_prior()))

    def _on_scan(self, scan: LaserScan) -> None:
        self._look(self._sight.look_at_scan(scan, self._map_prior()))

    def _look(self, look: Look | None) -> None:
        if look is None or self._is_looking:
            return
        self._is_looking, series = True, self._sight.series
        self.ctx.background(look, DETECTION_TIME, lambda sighting: self._seen(sighting, series))

    def _seen(self, sighting: DockSighting | None, series: int) -> None:
        self._is_looking = False
        if sighting is None or series != self._sight.series:
            return
        self._sight.take(sighting, self.ctx.now_ns)
        pose = SE3.from_se2(sighting.base_from_dock)
        self.ctx.publish(DOCK_POSE, PoseStamped(sighting.stamp_ns, "base", pose))

    def _map_from_base(self) -> SE2 | None:
        """The pose in the map, None while it is unknown or old."""
        if self._map_ns is None or self.ctx.now_ns - self._map_ns > MAP_AGE_NS:
            return None
        try:
            return self._tree.lookup("map", "base").to_se2()
        except TransformError:
            return None

    def _map_prior(self) -> SE2 | None:
        map_from_base = self._map_from_base()
        if map_from_base is None or self._dock is None:
            return None
        return map_from_base.inverse() @ self._dock.map_from_dock

    # Tasks

    def _on_dock(self, handle: GoalHandle[DockGoal, DockFeedback, DockReport]) -> None:
        self._take_over()
        try:
            dock = self._database.dock(handle.goal.name)
        except BadInputError as error:
            self._refuse(handle, "UNKNOWN_DOCK", str(error))
            return
        try:
            self._detector = detector_of(dock, self._robot, self._camera)
        except BadInputError as error:
            self._refuse(handle, "NOT_CALIBRATED", str(error))
            return
        if not self._is_ready(handle):
            return
        self._handle, self._dock = handle, dock
        self._do(self.mission.begin(dock, self.ctx.now_ns))

    def _on_undock(self, handle: GoalHandle[UndockGoal, DockFeedback, DockReport]) -> None:
        self._take_over()
        try:
            dock = self._database.dock(handle.goal.name)
        except BadInputError as error:
            self._refuse(handle, "UNKNOWN_DOCK", str(error))
            return
        here = self._map_from_base()
        has_contact = self._supply in (PowerSupply.CHARGING, PowerSupply.NOT_CHARGING, PowerSupply.FULL)
        if not has_contact and (here is None or here.distance_to(dock.map_from_dock) > FROM_DOCK):
            self._refuse(handle, "NOT_DOCKED", f"the robot does not stand in dock {dock.name}")
            return
        if not self._is_ready(handle):
            return
        self._handle, self._dock = handle, dock
        self._do(self.mission.begin_undock(dock, self.ctx.now_ns))

    def _on_cancel(self, handle: DockHandle) -> None:
        if self._handle is handle:
            self._do(self.mission.cancel())

    def _take_over(self) -> None:
        """End what is under way because another task begins."""
        if self._handle is not None:
            self._handle.is_preempted = True
            self._do(self.mission.cancel())

    def _is_ready(self, handle: DockHandle) -> bool:
        try:
            self.ctx.newest(ODOMETRY)
            is_ready = self._sight.odom_from_base is not None
        except StaleInputError:
            is_ready = False
        if not is_ready:
            self._refuse(handle, "STALE_INPUT", "there is no fresh odometry")
        return is_ready

    def _refuse(self, handle: DockHandle, code: str, text: str) -> None:
        self._say(code, text)
        handle.fail(code, text)

    def _on_teach(self, request: TeachDockRequest) -> TeachDockReply:
        """Save where the robot stands; a BadInputError, when it does not know where or no such dock is described, is the reply."""
        here = self._map_from_base()
        if here is None:
            raise BadInputError("the robot does not know where it is: a dock cannot be taught")
        taught = self._database.teach(self._database.dock(request.name), here)
        self._say("DOCK_TAUGHT", f"dock {taught.name} is at {here.x:.3f}, {here.y:.3f}, {math.degrees(here.yaw):.2f}°")
        return TeachDockReply(taught.map_from_dock)

    # The mission

    def _tick(self) -> None:
        pose = self._sight.odom_from_base
        if not self.mission.is_active or pose is None:
            return
        now_ns = self.ctx.now_ns
        self._lease_pictures(now_ns)
        supply = self._supply
        view = DockView(
            now_ns,
            pose,
            self._sight.velocity,
            self._map_from_base(),
            self._sight.track(now_ns),
            None if supply is None else supply not in (PowerSupply.DISCHARGING, PowerSupply.UNKNOWN),
            None if supply is None else supply in (PowerSupply.CHARGING, PowerSupply.FULL),
            self._is_held,
            self._is_fresh(),
        )
        self._do(self.mission.update(view))
        self._tell(now_ns)

    def _is_fresh(self) -> bool:
        try:
            return self.ctx.newest(ODOMETRY) is not None and self.ctx.newest(SCAN) is not None
        except StaleInputError:
            return False

    def _lease_pictures(self, now_ns: int) -> None:
        """Ask for pictures while they can show the dock; on the way to it only from near."""
        if not self._sight.wants_pictures or now_ns - self._leased_ns < 0.5 * LEASE * 1e9:
            return
        prior = self._map_prior()
        is_far = prior is None or math.hypot(prior.x, prior.y) > self._config.sight or abs(prior.yaw) > 1.0
        if self.mission.state is DockState.STAGING and is_far:
            return
        self._leased_ns = now_ns
        self.ctx.call(CAMERA_PICTURES, PicturesRequest(LEASE), _ignore)

    def _do(self, commands: list[DockCommand], code: str | None = None, text: str = "") -> None:
        """Carry out commands; `code` and `text` replace those of an end."""
        for command in commands:
            if isinstance(command, Move):
                self._send(command.velocity)
            elif isinstance(command, NavigateTo):
                self._navigate(command)
            elif isinstance(command, StopNavigation):
                ticket, self._ticket = self._ticket, None
                if ticket is not None:
                    ticket.cancel()
            elif isinstance(command, LookForDock):
                if command.is_wanted and self._dock is not None and self._detector is not None:
                    self._sight.begin(self._dock, self._detector)
                else:
                    self._sight.end()
            elif isinstance(command, PermitApproach):
                self._permit(command)
            elif isinstance(command, RevokeApproach):
                self._permitted_ns = -(1 << 62)
                self.ctx.call(REVOKE_APPROACH, Nothing(), _ignore)
            elif isinstance(command, StopCharging):
                self.ctx.call(STOP_CHARGING, Nothing(), _ignore)
            else:
                self._end(command, code or command.code, text or command.text)

    def _send(self, v: BodyVelocity) -> None:
        self.ctx.publish(DOCKING_REQUEST, VelocityCommand(self.ctx.now_ns, v.vx, v.vy, v.wz))

    def _navigate(self, command: NavigateTo) -> None:
        def over(outcome: TaskOutcome[NavigateResult]) -> None:
            self.mission.drive_ended(command.drive, outcome.code, outcome.text)

        goal = NavigateGoal(command.map_from_goal, command.xy_tolerance, command.yaw_tolerance)
        self._ticket = self.ctx.send_goal(NAVIGATE, goal, over)

    def _permit(self, command: PermitApproach) -> None:
        now_ns = self.ctx.now_ns
        if now_ns - self._permitted_ns < PERMIT_NS:
            return
        self._permitted_ns = now_ns
        outline = np.array(command.outline)
        request = ApproachRequest(command.odom_from_dock, outline, command.overrun, command.seconds)
        self.ctx.call(PERMIT_APPROACH, request, _ignore)

    def _end(self, ended: DockEnded, code: str, text: str) -> None:
        handle, self._handle = self._handle, None
        result = ended.result
        report = DockReport(result.attempts, result.seconds, result.docking_seconds, result.base_from_dock)
        self._say(code, text)
        if code == "SUCCEEDED" and self.mission.state is DockState.DOCKED:
            self._refine(result.map_from_base)
        if handle is None:
            return
        if code == "CANCELLED":
            handle.cancelled(report)
        else:
            handle.end(TaskOutcome(code, text, report))

    def _refine(self, map_from_base: SE2 | None) -> None:
        if not self._config.refines or map_from_base is None or self._dock is None:
            return
        try:
            self._database.refine(self._dock.name, map_from_base)
        except BadInputError as error:
            self._say("DOCK_NOT_REFINED", str(error))

    def _tell(self, now_ns: int) -> None:
        mission = self.mission
        if not mission.is_active:
            return
        if self._said != (mission.state, mission.text):
            self._said = (mission.state, mission.text)
            self._say(mission.state.name, mission.text)
            self._fed_ns = now_ns - FEEDBACK_NS
        if self._handle is not None and now_ns - self._fed_ns >= FEEDBACK_NS:
            self._fed_ns = now_ns
            self._handle.feedback(DockFeedback(mission.state.value, mission.text, mission.attempts, mission.distance))

    def _say(self, code: str, text: str) -> None:
        mission = self.mission
        dock = None if self._dock is None else self._dock.name
        fields = {"dock": dock, "attempts": mission.attempts, "distance": mission.distance}
        self.ctx.log(f"DOCKING_{code}", text, **fields)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text, json.dumps(fields)))


def _ignore(reply: object) -> None:
    """What a service says is seen in what happens next: no picture, no permission, no end of the current."""
