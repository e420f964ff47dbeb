"""The explorer: looks at the map about once a second and carries out what the exploration mission commands."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

from ambler.core.errors import TransformError
from ambler.core.messages import (
    CostGrid,
    Frontiers,
    GateState,
    GateStatus,
    GroundLevels,
    Number,
    OccupancyGrid,
    PointCloud,
    PointStamped,
    PoseStamped,
    Status,
    Transforms,
)
from ambler.core.se3 import SE3
from ambler.core.transforms import TransformTree
from ambler.exploration.strategies import Strategy
from ambler.exploration.survey import FrontierSurvey
from ambler.missions.drive_to import DriveTo
from ambler.missions.explore import ExploreMission
from ambler.missions.explore_commands import (
    ChangeLevel,
    ClearCosts,
    Command,
    DoubtTerrain,
    Ended,
    ExploreConfig,
    ExploreState,
    ExploreView,
    HoldStation,
    StopDriving,
    TurnAround,
)
from ambler.missions.navigate import NavigationState
from ambler.nodes.navigator import NavigatorNode
from ambler.runtime.node import PREEMPTED, GoalHandle, GoalTicket, Node, Service, Task, TaskOutcome
from ambler.runtime.tasks import (
    CHOOSE_LEVEL,
    CLEAR_GLOBAL_COSTMAP,
    CLICKED_GOAL_OVER,
    EXPLORE,
    NAVIGATE,
    RECOVER,
    SCAN_STATION,
    ExploreFeedback,
    ExploreGoal,
    ExploreResult,
    LevelRequest,
    NavigateGoal,
    Nothing,
    RecoverGoal,
    RecoveryKind,
    ScanStationGoal,
)
from ambler.runtime.topics import (
    FRONTIERS,
    GATE_STATUS,
    GLOBAL_COSTMAP,
    GOAL,
    GOAL_POINT,
    GROUND_LEVELS,
    MAP,
    MOVERS,
    STATUS,
    TERRAIN_CLEARING,
    TRANSFORMS,
    WAY_POINT,
    Topic,
)

Handle = GoalHandle[ExploreGoal, ExploreFeedback, ExploreResult]


class ExplorerNode(Node):
    """Serves EXPLORE by driving with NAVIGATE; between goals it is silent."""

    name: str = "explorer"
    inputs: tuple[Topic[Any], ...] = (MAP, GLOBAL_COSTMAP, TRANSFORMS)
    optional_inputs: tuple[Topic[Any], ...] = (
        *(STATUS, GATE_STATUS, GROUND_LEVELS, MOVERS),
        *(GOAL, GOAL_POINT, WAY_POINT),
    )
    kept_inputs: tuple[Topic[Any], ...] = (TRANSFORMS,)
    outputs: tuple[Topic[Any], ...] = (FRONTIERS, TERRAIN_CLEARING, STATUS)
    serves: tuple[Service[Any, Any] | Task[Any, Any, Any], ...] = (EXPLORE,)
    calls: tuple[Service[Any, Any] | Task[Any, Any, Any], ...] = (NAVIGATE, RECOVER, CLEAR_GLOBAL_COSTMAP)
    latency: float = 0.05

    def __init__(
        self,
        config: ExploreConfig,
        survey: FrontierSurvey,
        strategy: Strategy,
        period: float = 1.0,
        *,
        has_levels: bool = False,
    ) -> None:
        if has_levels:
            self.calls = (*self.calls, CHOOSE_LEVEL)
        if config.stations.spacing > 0.0:
            self.calls = (*self.calls, SCAN_STATION)
        self._mission = ExploreMission(config, survey, strategy)
        self._period = period
        self._tree = TransformTree()
        self._map: OccupancyGrid | None = None
        self._costs: CostGrid | None = None
        self._handle: Handle | None = None
        self._ticket: GoalTicket | None = None
        self._drive: DriveTo | TurnAround | None = None
        self._is_yielding = self._gives_way = self._is_told_to_wait = False
        self._levels: GroundLevels | None = None
        self._told = ""

    def start(self) -> None:
        """Subscribe, serve EXPLORE and look around once per period."""
        self.ctx.subscribe(MAP, self._on_map)
        self.ctx.subscribe(GLOBAL_COSTMAP, self._on_costs)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(GROUND_LEVELS, self._on_levels)
        self.ctx.subscribe(STATUS, self._on_status)
        self.ctx.subscribe(GATE_STATUS, self._on_gate)
        self.ctx.subscribe(MOVERS, self._on_movers)
        self.ctx.subscribe(GOAL, self._on_click)
        for clicked in (GOAL_POINT, WAY_POINT):
            self.ctx.subscribe(clicked, self._on_click)
        self.ctx.serve_task(EXPLORE, self._on_goal, self._on_cancel)
        self.ctx.timer(self._period, self._update)

    def _on_map(self, message: OccupancyGrid) -> None:
        self._map = message

    def _on_levels(self, message: GroundLevels) -> None:
        """Another level: what was known of the last one is not of it."""
        if self._levels is not None and message.active != self._levels.active:
            self._map = self._costs = None
        self._levels = message

    def _on_costs(self, message: CostGrid) -> None:
        if self._levels is None or message.stamp_ns >= self._levels.stamp_ns:  # else of another level
            self._costs = message

    def _on_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)

    def _on_status(self, message: Status) -> None:
        """Hear from SLAM whether the map is in doubt, and from the navigator whether it lets somebody by: nothing is decided meanwhile. When a person's own goal is over, go on with the drive that it displaced, unless another program
        drives by now."""
        if message.code in ("SLAM_GOOD", "SLAM_DEGRADED", "SLAM_LOST"):
            self._mission.doubt("" if message.code == "SLAM_GOOD" else message.text, self.ctx.now_ns)
        if message.node.rpartition("/")[2] == NavigatorNode.name and message.code in NavigationState.__members__:
            self._gives_way = message.code == NavigationState.GIVING_WAY.value
            self._pause()
        if self._is_yielding and message.code == CLICKED_GOAL_OVER:
            self._is_yielding = False
            self._mission.resume(self.ctx.now_ns)
            if message.text.startswith(PREEMPTED):
                self._mission.take_over()
                self._update()
            elif self._mission.is_active and self._drive is not None:
                self._carry_out([self._drive])

    def _on_movers(self, movers: PointCloud) -> None:
        self._mission.meet(self.ctx.now_ns, is_here=len(movers.points) > 0)

    def _on_click(self, goal: PoseStamped | PointStamped) -> None:
        """A person's own goal: the robot is his until it is over. It displaces a drive; a station is broken off."""
        if not self._mission.is_active or goal.frame != "map" or self._is_yielding:
            return
        self._is_yielding = True
        self.ctx.log("YIELDING", "a person drives; exploration goes on afterwards")
        if self._mission.state is ExploreState.SCANNING:
            self._carry_out([StopDriving()])

    def _on_gate(self, gate: GateStatus) -> None:
        self._mission.hold(gate.reason if gate.state is GateState.FAULT else "", self.ctx.now_ns)
        self._is_told_to_wait = gate.state in (GateState.PAUSED, GateState.EMERGENCY_STOP)
        self._pause()

    def _pause(self) -> None:
        self._mission.pause(self.ctx.now_ns, is_paused=self._is_told_to_wait or self._gives_way)

    def _on_goal(self, handle: Handle) -> None:
        self._handle = handle
        self._is_yielding = self._gives_way = False
        self._mission.begin(handle.goal, self.ctx.now_ns)
        self._pause()
        self._update()

    def _on_cancel(self, handle: Handle) -> None:
        if handle is self._handle:
            self._carry_out(self._mission.cancel())
            self._tell()

    def _pose(self) -> SE3 | None:
        try:
            return self._tree.lookup("map", "base")
        except TransformError:
            return None

    def _view(self) -> ExploreView | None:
        pose = self._pose()
        if self._map is None or self._costs is None or pose is None:
            return None
        up = pose.rotate((0.0, 0.0, 1.0))[2]
        tilt = math.acos(max(-1.0, min(1.0, up)))
        view = ExploreView(self.ctx.now_ns, self._map, self._costs, pose.to_se2(), tilt=tilt)
        if self._levels is None:
            return view
        return replace(view, level=self._levels.active, passages=self._levels.passages)

    def _update(self) -> None:
        mission = self._mission
        if not mission.is_active or self._is_yielding:
            return
        commands = mission.update(self._view(), self.ctx.now_ns)
        if self._map is not None and mission.survey is not None:
            self.ctx.publish(FRONTIERS, Frontiers(self._map.stamp_ns, self._map.frame, mission.frontiers()))
        if self._handle is not None:
            self._handle.feedback(mission.feedback)
        self._tell()
        self._carry_out(commands)

    def _tell(self) -> None:
        """Publish and log the mission's state when it changed."""
        mission = self._mission
        said = f"{mission.state.name} {mission.text}"
        if said == self._told:
            return
        self._told = said
        feedback = mission.feedback
        fields = {
            "frontiers_open": feedback.frontiers_open,
            "goals_reached": feedback.goals_reached,
            "known_area_m2": round(feedback.known_area, 2),
        }
        status = Status(self.ctx.now_ns, self.name, mission.state.name, mission.text, json.dumps(fields))
        self.ctx.publish(STATUS, status)
        self.ctx.log(mission.state.name, mission.text, **fields)

    def _carry_out(self, commands: list[Command]) -> None:
        for command in commands:
            if isinstance(command, DriveTo | TurnAround):
                self._drive = command
            match command:
                case DriveTo():
                    goal = NavigateGoal(command.map_from_goal, command.xy_tolerance, command.yaw_tolerance)
                    self._ticket = self.ctx.send_goal(NAVIGATE, goal, self._reporter(command.drive))
                case TurnAround():
                    turn = RecoverGoal(RecoveryKind.ROTATE, command.angle)
                    self._ticket = self.ctx.send_goal(RECOVER, turn, self._reporter(command.drive))
                case HoldStation():
                    self._drive = None
                    scan = ScanStationGoal(command.seconds, command.level)
                    self._ticket = self.ctx.send_goal(SCAN_STATION, scan, self._reporter(command.drive))
                case StopDriving():
                    if self._ticket is not None:
                        self._ticket.cancel()
                        self._ticket = None
                case ChangeLevel():
                    self.ctx.call(CHOOSE_LEVEL, LevelRequest(command.level), self._on_chosen)
                case ClearCosts():
                    self.ctx.call(CLEAR_GLOBAL_COSTMAP, Nothing(), self._on_cleared)
                case DoubtTerrain():
                    self.ctx.publish(TERRAIN_CLEARING, Number(self.ctx.now_ns, command.radius))
                case Ended():
                    self._end(command)

    def _reporter(self, drive: int) -> Any:
        def report(outcome: TaskOutcome[Any]) -> None:
            is_last = self._drive is not None and self._drive.drive == drive
            if outcome.code == PREEMPTED and is_last:
                if self._is_yielding:
                    return  # to a person, whose goal displaced it: it is driven again afterwards
                if isinstance(self._drive, DriveTo):
                    self._mission.take_over()
            if is_last:
                self._drive = None
            if self._mission.drive_ended(drive, outcome.code, outcome.text):
                self._update()

        return report

    def _on_cleared(self, reply: Nothing | Exception) -> None:
        if isinstance(reply, Exception):
            self.ctx.log("CLEAR_FAILED", str(reply))

    def _on_chosen(self, reply: Nothing | Exception) -> None:
        if isinstance(reply, Exception):
            self.ctx.log("LEVEL_REFUSED", str(reply))

    def _end(self, ended: Ended) -> None:
        handle, self._handle = self._handle, None
        if handle is None:
            return
        if ended.code == "SUCCEEDED":
            handle.succeed(ended.result, ended.text)
        elif ended.code == "CANCELLED":
            handle.cancelled(ended.result)
        else:
            handle.fail(ended.code, ended.text, ended.result)
