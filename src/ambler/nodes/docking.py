"""Docking on the bus: DOCK and UNDOCK in; drives, permissions, pictures and velocities out.

The mission decides, a task client takes its commands to the other nodes. Velocities are requests to the gate under a source of their
own, which takes over from navigation and falls silent when the mission ends.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace

from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.messages import Image, LaserScan, PointCloud, PoseStamped, Status
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.database import DockDatabase
from ambler.docking.detection import DockDetection, DockDetector
from ambler.docking.dock import Dock
from ambler.docking.lesson import LessonConfig
from ambler.docking.tracker import TrackerConfig
from ambler.missions.dock import DockMission
from ambler.missions.dock_commands import DockConfig, DockEnded, DockState, DockView, LookForDock
from ambler.nodes.dock_sight import DockSight, Look, detector_of
from ambler.nodes.dock_state import RobotState
from ambler.nodes.dock_task_client import DockTaskClient
from ambler.nodes.dock_teacher import DockTeacher, TeachHandle
from ambler.runtime.node import GoalHandle, Node, Offers, TaskOutcome, WorkKind
from ambler.runtime.tasks import (
    CAMERA_PICTURES,
    DOCK,
    NAVIGATE,
    PERMIT_APPROACH,
    REVOKE_APPROACH,
    STOP_CHARGING,
    TEACH_DOCK,
    UNDOCK,
    DockFeedback,
    DockGoal,
    DockReport,
    UndockGoal,
)
from ambler.runtime.topics import (
    BATTERY,
    CAMERA_INFO,
    DOCK_POSE,
    DOCKING_REQUEST,
    GATE_STATUS,
    IMAGE,
    MERGED_CLOUD,
    ODOMETRY,
    SCAN,
    STATUS,
    TRANSFORMS,
)

DockHandle = GoalHandle[DockGoal, DockFeedback, DockReport] | GoalHandle[UndockGoal, DockFeedback, DockReport]

PERIOD = 0.02
DETECTION_TIME = 0.03  # seconds that looking at a picture or scan takes
FEEDBACK_NS = 250_000_000
FROM_DOCK = 0.3  # metres from a dock's pose at which a robot without contact does not stand in it


@dataclass(frozen=True, slots=True)
class DockingNodeConfig:
    """`sight`: metres to the dock's pose, by the map, from which the dock is looked for while the robot still drives to the staging pose.
    `refines`: whether each docking moves the dock's pose in the database a little. `edge_shift_px`: how far farther out the edges of markers are
    than seen (`ambler calibrate range`)."""

    mission: DockConfig = field(default_factory=DockConfig)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    sight: float = 2.5
    refines: bool = True
    lesson: LessonConfig = field(default_factory=LessonConfig)
    edge_shift_px: float = 0.0


class DockingNode(Node):
    """Docks at the docks of a database, undocks, and teaches docks. One task at a time; a newer one takes its place."""

    name = "docking"
    inputs = (ODOMETRY, TRANSFORMS, SCAN)
    optional_inputs = (IMAGE, CAMERA_INFO, BATTERY, GATE_STATUS, MERGED_CLOUD)
    outputs = (DOCKING_REQUEST, DOCK_POSE, STATUS)
    serves = (DOCK, UNDOCK, TEACH_DOCK)
    calls: Offers = (NAVIGATE, PERMIT_APPROACH, REVOKE_APPROACH, STOP_CHARGING)
    latency = 0.002
    commands = True

    def __init__(self, robot: RobotModel, database: DockDatabase, config: DockingNodeConfig | None = None) -> None:
        self._robot = robot
        self._database = database
        self._config = config if config is not None else DockingNodeConfig()
        if robot.camera is not None:
            self.calls = (*type(self).calls, CAMERA_PICTURES)
        self.mission = DockMission(self._config.mission)
        self._sight = DockSight(robot, self._config.tracker)
        self._state = RobotState()
        self._dock: Dock | None = None
        self._detector: DockDetector | None = None
        self._handle: DockHandle | None = None
        self._is_looking = False
        self._fed_ns = 0
        self._said: tuple[DockState, str] | None = None
        self._misfit: str | None = None
        self._teacher = DockTeacher(database, self._config.lesson)

    def start(self) -> None:
        """Subscribe, serve, and start the timer."""
        self._client = DockTaskClient(self.ctx, self.mission.drive_ended, self._switch_sight, self._end)
        self.ctx.subscribe(ODOMETRY, self._sight.add_odometry)
        self.ctx.subscribe(TRANSFORMS, self._state.take_transforms)
        self.ctx.subscribe(IMAGE, self._on_image)
        self.ctx.subscribe(SCAN, self._on_scan)
        self.ctx.subscribe(MERGED_CLOUD, self._on_cloud)
        self.ctx.subscribe(CAMERA_INFO, self._state.take_camera)
        self.ctx.subscribe(BATTERY, self._state.take_battery)
        self.ctx.subscribe(GATE_STATUS, self._state.take_gate)
        self.ctx.serve_task(DOCK, self._on_dock, self._on_cancel)
        self.ctx.serve_task(UNDOCK, self._on_undock, self._on_cancel)
        self.ctx.serve_task(TEACH_DOCK, self._on_teach, self._on_cancel)
        self.ctx.timer(PERIOD, self._tick)

    # Seeing

    def _on_image(self, image: Image) -> None:
        camera = self._state.camera
        if self._sight.wants_pictures and camera is not None and image.data.shape != (camera.height, camera.width):
            height, width = image.data.shape
            self._refuse_pictures(f"pictures are {width} x {height}, calibrated were {camera.width} x {camera.height}")
            return
        self._look(self._sight.look_at_picture(image, self._base_from_dock()))

    def _refuse_pictures(self, text: str) -> None:
        """End whatever looks at pictures that the calibration does not fit."""
        taught = self._teacher.stop()
        if taught is not None:
            self._sight.end()
            self._refuse(taught, "NOT_CALIBRATED", text)
            return
        self._misfit = text
        self._client.do(self.mission.cancel())

    def _on_scan(self, scan: LaserScan) -> None:
        """Take the scan of a single scanner; several are looked at as their merged cloud."""
        if len(self._robot.scanners) <= 1 and self._may_see():
            self._look(self._sight.look_at_scan(scan, self._base_from_dock()))

    def _on_cloud(self, cloud: PointCloud) -> None:
        if self._may_see():
            self._look(self._sight.look_at_cloud(cloud, self._base_from_dock()))

    def _look(self, look: Look | None) -> None:
        """Look in the background, one at a time; what comes meanwhile is not looked at."""
        if look is None or self._is_looking:
            return
        self._is_looking, series = True, self._sight.series
        self.ctx.background(look, DETECTION_TIME, lambda detection: self._seen(detection, series), WorkKind.PERCEPTION)

    def _seen(self, detection: DockDetection | None, series: int) -> None:
        self._is_looking = False
        if detection is None or series != self._sight.series:
            return
        self._teacher.see(detection)
        self._sight.take(detection, self.ctx.now_ns)
        pose = SE3.from_se2(detection.base_from_dock)
        self.ctx.publish(DOCK_POSE, PoseStamped(detection.stamp_ns, "base", pose))

    def _base_from_dock(self) -> SE2 | None:
        """Where the dock is by the map; while it is taught, where the robot stands."""
        if self._teacher.handle is not None:
            return SE2()
        map_from_base = self._state.map_from_base(self.ctx.now_ns)
        if map_from_base is None or self._dock is None:
            return None
        return map_from_base.inverse() @ self._dock.map_from_dock

    def _switch_sight(self, command: LookForDock) -> None:
        if command.is_wanted and self._dock is not None and self._detector is not None:
            self._sight.begin(self._dock, self._detector)
        else:
            self._sight.end()

    # Tasks

    def _on_dock(self, handle: GoalHandle[DockGoal, DockFeedback, DockReport]) -> None:
        dock = self._dock_for(handle, handle.goal.name)
        if dock is None:
            return
        try:
            self._detector = self._detector_of(dock)
        except BadInputError as error:
            self._refuse(handle, "NOT_CALIBRATED", str(error))
            return
        self._handle, self._dock = handle, dock
        self._client.do(self.mission.begin(dock, self.ctx.now_ns))

    def _on_undock(self, handle: GoalHandle[UndockGoal, DockFeedback, DockReport]) -> None:
        dock = self._dock_for(handle, handle.goal.name)
        if dock is None:
            return
        here = self._state.map_from_base(self.ctx.now_ns)
        if not self._state.has_contact(self.ctx.now_ns) and (
            here is None or here.distance_to(dock.map_from_dock) > FROM_DOCK
        ):
            self._refuse(handle, "NOT_DOCKED", f"the robot does not stand in dock {dock.name}")
            return
        self._handle, self._dock = handle, dock
        self._client.do(self.mission.begin_undock(dock, self.ctx.now_ns))

    def _dock_for(self, handle: DockHandle | TeachHandle, name: str) -> Dock | None:
        """End what is under way, and return the dock of a new goal; None when the goal is refused."""
        if self._teacher.handle is not None:
            self._teacher.handle.is_preempted = True
            self._end_lesson()
        if self._handle is not None:
            self._handle.is_preempted = True
            self._client.do(self.mission.cancel())
        self._misfit = None
        try:
            dock = self._database.dock(name)
        except BadInputError as error:
            self._refuse(handle, "UNKNOWN_DOCK", str(error))
            return None
        if not self._is_fresh():
            self._refuse(handle, "STALE_INPUT", "there is no fresh odometry or scan")
            return None
        return dock

    def _refuse(self, handle: DockHandle | TeachHandle, code: str, text: str) -> None:
        self._say(code, text)
        handle.fail(code, text)

    def _on_cancel(self, handle: DockHandle | TeachHandle) -> None:
        if self._teacher.handle is handle:
            self._end_lesson()
        elif self._handle is handle:
            self._client.do(self.mission.cancel())

    def _on_teach(self, handle: TeachHandle) -> None:
        """Look at the dock for a while from where the robot stands in it."""
        dock = self._dock_for(handle, handle.goal.name)
        if dock is None:
            return
        here = self._state.map_from_base(self.ctx.now_ns)
        if here is None:
            self._refuse(handle, "LOST", "the robot does not know where it is: a dock cannot be taught")
            return
        self._dock = plain = replace(dock, offset=SE2())
        try:
            detector = self._detector_of(plain)
        except BadInputError as error:
            self._refuse(handle, "NOT_CALIBRATED", str(error))
            return
        self._teacher.begin(handle, plain, here, self.ctx.now_ns)
        self._sight.begin(plain, detector)
        self._say("TEACHING", f"the robot stands in {dock.name} and looks at it")

    def _teach(self) -> None:
        """Go on with a lesson until it is over."""
        if self._sight.wants_pictures:
            self._client.lease_pictures()
        handle = self._teacher.handle
        outcome = self._teacher.update(self._sight.velocity, self.ctx.now_ns)
        if outcome is not None and handle is not None:
            self._sight.end()
            self._say("DOCK_TAUGHT" if outcome.code == "SUCCEEDED" else outcome.code, outcome.text)
            handle.end(outcome)

    def _end_lesson(self) -> None:
        """End a lesson that nobody wants any more."""
        handle = self._teacher.stop()
        if handle is not None:
            self._sight.end()
            handle.cancelled()

    def _detector_of(self, dock: Dock) -> DockDetector:
        return detector_of(dock, self._robot, self._state.camera, self._config.edge_shift_px)

    # The mission

    def _tick(self) -> None:
        pose = self._sight.odom_from_base
        if self._teacher.handle is not None:
            self._teach()
        if not self.mission.is_active or pose is None:
            return
        now_ns, state = self.ctx.now_ns, self._state
        if self._sight.wants_pictures and self._may_see():
            self._client.lease_pictures()
        view = DockView(
            now_ns,
            pose,
            self._sight.velocity,
            state.map_from_base(now_ns),
            self._sight.track(now_ns),
            state.has_contact(now_ns),
            state.is_charging(now_ns),
            state.is_held,
            self._is_fresh(),
        )
        self._client.do(self.mission.update(view))
        self._tell(now_ns)

    def _is_fresh(self) -> bool:
        try:
            is_known = self.ctx.newest(ODOMETRY) is not None and self.ctx.newest(SCAN) is not None
        except StaleInputError:
            return False
        return is_known and self._sight.is_fresh(self.ctx.now_ns)

    def _may_see(self) -> bool:
        """Say whether pictures or scans can show the dock; on the way to it only from near."""
        if self.mission.state is not DockState.STAGING:
            return True
        dock = self._base_from_dock()
        return dock is not None and math.hypot(dock.x, dock.y) < self._config.sight and abs(dock.yaw) < 1.0

    def _end(self, ended: DockEnded) -> None:
        handle, self._handle = self._handle, None
        code, text, result = ended.code, ended.text, ended.result
        if self._misfit is not None:
            code, text, self._misfit = "NOT_CALIBRATED", self._misfit, None
        report = DockReport(result.attempts, result.seconds, result.docking_seconds, result.base_from_dock)
        self._say(code, text)
        if self.mission.state is DockState.DOCKED:
            self._refine(result.map_from_base)
        if handle is not None and code == "CANCELLED":
            handle.cancelled(report)
        elif handle is not None:
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
        is_news = self._said != (mission.state, mission.text)
        if is_news:
            self._said = (mission.state, mission.text)
            self._say(mission.state.name, mission.text)
        if self._handle is not None and (is_news or now_ns - self._fed_ns >= FEEDBACK_NS):
            self._fed_ns = now_ns
            feedback = DockFeedback(mission.state.value, mission.text, mission.attempts, mission.distance)
            self._handle.feedback(feedback)

    def _say(self, code: str, text: str) -> None:
        mission = self.mission
        dock = None if self._dock is None else self._dock.name
        fields = {"dock": dock, "attempts": mission.attempts, "distance": mission.distance}
        self.ctx.log(f"DOCKING_{code}", text, **fields)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text, json.dumps(fields)))
