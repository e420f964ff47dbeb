"""The navigator on the bus: NAVIGATE in; plans, paths and recoveries out. A click on `/goal_pose` starts a drive as well."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ambler.core.errors import TransformError
from ambler.core.messages import (
    CostGrid,
    GateState,
    GateStatus,
    GroundLevels,
    Path,
    PointCloud,
    PointStamped,
    PoseStamped,
    Status,
    Transforms,
)
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.transforms import TransformTree
from ambler.missions.blocked_ways import BlockedWays
from ambler.missions.company import Company
from ambler.missions.giving_way import GivingWay
from ambler.missions.navigate import TICK_PERIOD, Cancel, Navigation, NavigationConfig, NavigationState
from ambler.missions.recovery import RecoveryAction, RecoverySequence, RecoveryStep
from ambler.runtime.node import PREEMPTED, GoalHandle, Node, Offers, TaskOutcome, Topics, WorkKind
from ambler.runtime.tasks import (
    CHOOSE_LEVEL,
    CLEAR_GLOBAL_COSTMAP,
    CLEAR_LOCAL_COSTMAP,
    CLICKED_GOAL_OVER,
    COMPUTE_PATH,
    FOLLOW_PATH,
    NAVIGATE,
    RECOVER,
    FollowPathGoal,
    LevelRequest,
    NavigateFeedback,
    NavigateGoal,
    NavigateResult,
    Nothing,
    PlanReply,
    PlanRequest,
    RecoverGoal,
    RecoveryKind,
)
from ambler.runtime.topics import (
    BLOCKED,
    GATE_STATUS,
    GLOBAL_COSTMAP,
    GOAL,
    GOAL_POINT,
    GROUND_LEVELS,
    MOVERS,
    PATH,
    STATUS,
    TRANSFORMS,
    WAY_POINT,
)

NavigateHandle = GoalHandle[NavigateGoal, NavigateFeedback, NavigateResult]

FEEDBACK_PERIOD = 0.25
SEARCH_TIME = 0.05  # seconds that the search for a place to stand aside takes
KINDS = {RecoveryAction.ROTATE: RecoveryKind.ROTATE, RecoveryAction.BACK_UP: RecoveryKind.BACK_UP}


class NavigatorNode(Node):
    """Runs one `Navigation` at a time; a new goal preempts the old one. `has_levels`: the map is one of ground, whose levels can be chosen; a goal that somebody
    clicks then lies on the level that the map shows. Only a node that knows its `robot` stands aside for people."""

    name = "navigator"
    inputs = (TRANSFORMS,)
    kept_inputs: Topics = (TRANSFORMS, MOVERS)
    optional_inputs = (GOAL, GOAL_POINT, WAY_POINT, GLOBAL_COSTMAP, GROUND_LEVELS, MOVERS, GATE_STATUS)
    outputs = (PATH, STATUS, BLOCKED)
    serves = (NAVIGATE,)
    calls: Offers = (COMPUTE_PATH, FOLLOW_PATH, RECOVER, CLEAR_GLOBAL_COSTMAP, CLEAR_LOCAL_COSTMAP, NAVIGATE)
    latency = 0.002

    def __init__(
        self, config: NavigationConfig | None = None, robot: RobotModel | None = None, *, has_levels: bool = False
    ) -> None:
        if has_levels:
            self.calls = (*type(self).calls, CHOOSE_LEVEL)
        self._has_levels = has_levels
        self._config = config if config is not None else NavigationConfig()
        self._tree = TransformTree()
        self._costmap: CostGrid | None = None
        self._drive: _Drive | None = None
        self._last: Navigation | None = None
        self._clicks = 0
        self._levels: GroundLevels | None = None
        self._company = Company(self._config.company_time, 0)
        self._giving_way = None if robot is None else GivingWay(self._config.giving_way, robot)
        self._blocked = {0: BlockedWays(self._config.blocked)}  # by level
        self._marked = 0

    def start(self) -> None:
        """Subscribe, serve, and start the timers."""
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(GLOBAL_COSTMAP, self._on_costmap)
        self.ctx.subscribe(GROUND_LEVELS, self._on_levels)
        self.ctx.subscribe(MOVERS, self._on_movers)
        self.ctx.subscribe(GATE_STATUS, self._on_gate)
        self.ctx.subscribe(GOAL, self._on_click)
        for topic in (GOAL_POINT, WAY_POINT):
            self.ctx.subscribe(topic, self._on_point)
        self.ctx.serve_task(NAVIGATE, self._on_goal, self._on_cancel)
        self.ctx.timer(TICK_PERIOD, self._tick)
        self.ctx.timer(FEEDBACK_PERIOD, self._feedback)

    @property
    def newest_costmap(self) -> CostGrid | None:
        """The newest global costmap, if any."""
        return self._costmap

    @property
    def newest_levels(self) -> GroundLevels | None:
        """The levels of the map of ground; None on a planar map."""
        return self._levels

    @property
    def _level(self) -> int:
        return 0 if self._levels is None else self._levels.active

    def map_from_base(self) -> SE2 | None:
        """Return the pose of the robot, or None while it is unknown."""
        try:
            return self._tree.lookup("map", "base").to_se2()
        except TransformError:
            return None

    def say(self, code: str, text: str, recoveries: int = 0) -> None:
        """Tell people and the log."""
        fields = json.dumps({"recoveries": recoveries})
        self.ctx.log(f"NAVIGATION_{code}", text, recoveries=recoveries)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text, fields))

    def mark_blocked(self, path: Path, *, is_held: bool) -> bool:
        """Count a path that could not be followed, which is marked at once where something holds the robot; say whether it is marked now, and planned around."""
        base, ways, now_ns = self.map_from_base(), self._blocked[self._level], self.ctx.now_ns
        if base is None:
            return False
        mark = ways.hold if is_held else ways.fail
        if not mark(path, base, now_ns, self._costmap, is_in_company=self._company.is_about(now_ns)):
            return False
        why = "something that no sensor shows" if is_held else "a way that could not be followed three times"
        self.ctx.log("WAY_BLOCKED", f"{why} is planned around")
        self._tell_blocked()
        return True

    def _tell_blocked(self) -> None:
        """Publish the places that are marked, when that has changed."""
        points = self._blocked[self._level].points(self.ctx.now_ns)
        if len(points) == 0 and self._marked == 0:
            return
        self._marked = len(points)
        poses = np.zeros((len(points), 3))
        poses[:, :2] = points
        self.ctx.publish(BLOCKED, Path(self.ctx.now_ns, "map", poses))

    def _on_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)

    def _on_costmap(self, costmap: CostGrid) -> None:
        self._costmap = costmap
        if self._drive is not None:
            self._drive.navigation.see_costs()

    def _on_levels(self, levels: GroundLevels) -> None:
        before, self._levels = self._level, levels
        if levels.active == before:
            return
        self._costmap = None  # of the level before
        if self._giving_way is not None:
            self._giving_way.forget()
        self._blocked.setdefault(levels.active, BlockedWays(self._config.blocked))
        self._tell_blocked()
        if self._drive is not None:
            self._drive.navigation.change_level()

    def _on_movers(self, movers: PointCloud) -> None:
        self._company.meet(self.ctx.now_ns, is_here=len(movers.points) > 0)
        base = self.map_from_base()
        if self._giving_way is not None and base is not None:
            with suppress(TransformError):
                places = self._tree.lookup("map", movers.frame).to_se2().transform(movers.points[:, :2].astype(float))
                self._giving_way.meet(self.ctx.now_ns, places, base)

    def _on_gate(self, gate: GateStatus) -> None:
        if self._giving_way is not None and gate.state not in (GateState.ARMED, GateState.PROTECTIVE_STOP):
            self._giving_way.rest()

    @property
    def is_in_company(self) -> bool:
        """Whether people are about, or were lately."""
        return self._company.is_about(self.ctx.now_ns)

    def enter(self, state: NavigationState) -> None:
        """Take in which state the drive is now."""
        if self._giving_way is not None and state is not NavigationState.GIVING_WAY:
            self._giving_way.end(self.ctx.now_ns)

    def is_held_up(self, path: Path | None) -> bool:
        """Whether somebody right before the robot, on its path, has not let it get on for some time."""
        base = self.map_from_base()
        if self._giving_way is None or base is None:
            return False
        return self._giving_way.is_held_up(self.ctx.now_ns, base, None if path is None else path.poses)

    def find_refuge(self, path: Path | None, done: Callable[[SE2 | None], None]) -> None:
        """Seek where to stand aside for him; `done` gets None where there is no such place."""
        giving_way, base, costs = self._giving_way, self.map_from_base(), self._costmap
        search = None
        if giving_way is not None and base is not None and costs is not None:
            search = giving_way.seek(self.ctx.now_ns, base, None if path is None else path.poses, costs)
        if giving_way is None or base is None or search is None:
            self.ctx.after(0.0, lambda: done(None))
            return

        def found(refuge: SE2 | None) -> None:
            if refuge is not None:
                giving_way.go_to(self.ctx.now_ns, base, refuge)
            done(refuge)

        self.ctx.background(search, SEARCH_TIME, found, WorkKind.PERCEPTION)

    def is_let_by(self) -> bool:
        """Whether whom the robot stands aside for is past, or has gone elsewhere."""
        return self._giving_way is None or self._giving_way.is_over(self.ctx.now_ns)

    def choose_level(self, level: int) -> None:
        """Have a level taken for the one that the robot is on, as soon as what it sees fits it."""
        if self._has_levels:
            self.ctx.call(CHOOSE_LEVEL, LevelRequest(level), self._on_chosen)

    def _on_chosen(self, reply: Nothing | Exception) -> None:
        if isinstance(reply, Exception):
            self.ctx.log("LEVEL_REFUSED", str(reply))

    def _on_click(self, goal: PoseStamped) -> None:
        self._drive_there(goal.frame, NavigateGoal(goal.pose.to_se2()))

    def _on_point(self, point: PointStamped) -> None:
        """Drive to a point; with what heading the robot stands there is all the same."""
        goal = SE2(point.point[0], point.point[1], 0.0)
        self._drive_there(point.frame, NavigateGoal(goal, yaw_tolerance=math.pi))

    def _drive_there(self, frame: str, goal: NavigateGoal) -> None:
        if frame != "map":
            self.say("GOAL_REFUSED", f"a goal must be told in the frame map, not in {frame!r}")
            return

        self._clicks += 1
        number = self._clicks

        def over(outcome: TaskOutcome[NavigateResult]) -> None:
            if outcome.code != PREEMPTED or number == self._clicks:  # else the person's next goal displaced it
                self.say(CLICKED_GOAL_OVER, f"{outcome.code}: {outcome.text}" if outcome.text else outcome.code)

        level = None if self._levels is None else self._levels.active
        self.ctx.send_goal(NAVIGATE, replace(goal, level=level), over)

    def _on_goal(self, handle: NavigateHandle) -> None:
        left = None if self._last is None else self._last.recoveries_left()
        self._drive = _Drive(self, handle, self._config, left)
        self._last = self._drive.navigation
        self._drive.navigation.start()

    def _on_cancel(self, handle: NavigateHandle) -> None:
        if self._drive is not None and self._drive.handle is handle:
            drive, self._drive = self._drive, None
            drive.navigation.cancel()

    def _tick(self) -> None:
        if self._marked and len(self._blocked[self._level].points(self.ctx.now_ns)) != self._marked:
            self._tell_blocked()
        if self._giving_way is not None:
            self._giving_way.take_idle(self.ctx.now_ns, is_idle=self._drive is None)
        if self._drive is not None:
            self._drive.navigation.tick()

    def _feedback(self) -> None:
        if self._drive is None:
            return
        n = self._drive.navigation
        if n.is_over:
            self._drive = None
        else:
            self._drive.handle.feedback(NavigateFeedback(n.state.value, n.distance_remaining, n.recoveries))


class _Drive:
    """Carries the requests of one `Navigation` (missions.navigate.Driver) to the other nodes."""

    def __init__(
        self, node: NavigatorNode, handle: NavigateHandle, config: NavigationConfig, left: RecoverySequence | None
    ) -> None:
        self._node = node
        self._ctx = node.ctx
        self.handle = handle
        self.navigation = Navigation(config, self, handle.goal, left)

    def plan(self, map_from_goal: SE2, done: Callable[[PlanReply | Exception], None]) -> None:
        self._ctx.call(COMPUTE_PATH, PlanRequest(map_from_goal), done)

    def follow(
        self, path: Path, goal: NavigateGoal, done: Callable[[str, str], None], left: Callable[[float], None]
    ) -> Cancel:
        ticket = self._ctx.send_goal(
            FOLLOW_PATH,
            FollowPathGoal(path, goal.xy_tolerance, goal.yaw_tolerance),
            lambda outcome: done(outcome.code, outcome.text),
            lambda feedback: left(feedback.distance_remaining),
        )
        return ticket.cancel

    def replace_path(self, path: Path) -> None:
        self._ctx.publish(PATH, path)

    def recover(self, step: RecoveryStep, done: Callable[[str, str], None]) -> Cancel:
        goal = RecoverGoal(KINDS[step.action], step.amount)
        return self._ctx.send_goal(RECOVER, goal, lambda outcome: done(outcome.code, outcome.text)).cancel

    def clear_costmaps(self, done: Callable[[], None]) -> None:
        def clear_global(reply: Nothing | Exception) -> None:
            self._ctx.call(CLEAR_GLOBAL_COSTMAP, Nothing(), lambda reply: done())

        self._ctx.call(CLEAR_LOCAL_COSTMAP, Nothing(), clear_global)

    def costmap(self) -> CostGrid | None:
        return self._node.newest_costmap

    def map_from_base(self) -> SE2 | None:
        return self._node.map_from_base()

    def levels(self) -> GroundLevels | None:
        return self._node.newest_levels

    def choose_level(self, level: int) -> None:
        self._node.choose_level(level)

    def mark_blocked(self, path: Path, *, is_held: bool) -> bool:
        return self._node.mark_blocked(path, is_held=is_held)

    def is_in_company(self) -> bool:
        return self._node.is_in_company

    def is_held_up(self, path: Path | None) -> bool:
        return self._node.is_held_up(path)

    def find_refuge(self, path: Path | None, done: Callable[[SE2 | None], None]) -> None:
        self._node.find_refuge(path, done)

    def is_let_by(self) -> bool:
        return self._node.is_let_by()

    def report(self, state: str, text: str) -> None:
        self._node.enter(NavigationState(state))
        self._node.say(state, text, self.navigation.recoveries)

    def finish(self, code: str, text: str) -> None:
        n = self.navigation
        result = NavigateResult(self._node.map_from_base(), n.goal_distance, n.recoveries)
        if code == "SUCCEEDED":
            self.handle.succeed(result)
        else:
            self.handle.fail(code, text, result)
