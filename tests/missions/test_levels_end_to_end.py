"""Goals on two decks above each other through the real map of ground, planner and navigator, in lockstep, with either planner. Ground and base are toys: a deck, a ramp beside it
behind a wall, and a deck above, seen without noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from ambler.core.messages import Odometry, Path, PointCloud, Transforms, TransformStamped
from ambler.core.protocols import GlobalPlanner
from ambler.core.robot import DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.inflation import InflationConfig
from ambler.nodes.ground_mapper import GroundMapperNode
from ambler.nodes.navigator import NavigatorNode
from ambler.nodes.planner import GlobalPlannerNode
from ambler.perception.terrain import Ground
from ambler.perception.terrain_config import TerrainConfig
from ambler.planning.grid_planner import GridPlanner, PlannerConfig
from ambler.planning.visibility_planner import VisibilityConfig, VisibilityPlanner
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import GoalHandle, Node, TaskOutcome
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    CLEAR_LOCAL_COSTMAP,
    FOLLOW_PATH,
    NAVIGATE,
    RECOVER,
    SAVE_GRAPH,
    FollowPathFeedback,
    NavigateGoal,
    Nothing,
    SaveMapRequest,
)
from ambler.runtime.topics import ODOMETRY, PATH, STATUS, TERRAIN_MAP, TRANSFORMS, Topic
from ambler.wire.graph_files import load_graph

FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
LIDAR = SensorMount("lidar", SensorKind.CLOUD, SE3((0.0, 0.0, 0.6)), elevation=(-1.5, 1.5))
ROBOT = RobotModel("toy", DriveKind.OMNI, FOOTPRINT, VelocityLimits(), (LIDAR,))
DECK, FOOT, RAMP, TOP, UPPER = range(5)
ROOMS = {  # x0, x1, y0, y1, height, rise along x
    DECK: (0.0, 20.0, 0.0, 8.0, 0.0, 0.0),
    FOOT: (0.0, 4.0, 8.0, 13.0, 0.0, 0.0),
    RAMP: (4.0, 16.0, 9.0, 13.0, 0.0, 0.25),
    TOP: (16.0, 20.0, 8.0, 13.0, 3.0, 0.0),
    UPPER: (0.0, 20.0, 0.0, 8.0, 3.0, 0.0),
}
BESIDE = {DECK: (FOOT,), FOOT: (DECK, RAMP), RAMP: (FOOT, TOP), TOP: (RAMP, UPPER), UPPER: (TOP,)}
SEEN, CELL, SPEED, STEP = 7.0, 0.2, 2.0, 0.05


def height(room: int, x: Any, y: Any) -> Any:
    x0, _, _, _, z, rise = ROOMS[room]
    return z + rise * (x - x0)


def holds(room: int, x: Any, y: Any) -> Any:
    x0, x1, y0, y1, _, _ = ROOMS[room]
    return (x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1)


class Climber(Node):
    """A base that goes along its newest path, on the sheet of ground that continues the one where it is, and tells the terrain of its room and of those beside it."""

    name = "climber"
    inputs = (PATH,)
    outputs = (ODOMETRY, TRANSFORMS, TERRAIN_MAP)
    serves = (FOLLOW_PATH, RECOVER, CLEAR_LOCAL_COSTMAP)

    def __init__(self) -> None:
        self.pose, self.room = SE2(2.0, 4.0, 0.0), DECK
        self.falls = 0
        self._path = np.zeros((0, 3))
        self._handle: GoalHandle[Any, Any, Any] | None = None

    def start(self) -> None:
        self.ctx.subscribe(PATH, self._take)
        self.ctx.serve_task(FOLLOW_PATH, self._follow, self._stop)
        self.ctx.serve_task(RECOVER, self._recover, self._stop)
        self.ctx.serve(CLEAR_LOCAL_COSTMAP, lambda request: request)
        self.ctx.timer(STEP, self._move)
        self.ctx.timer(0.2, self._look)

    @property
    def place(self) -> SE3:
        z = float(height(self.room, self.pose.x, self.pose.y))
        flat = SE3.from_se2(self.pose)
        return SE3((self.pose.x, self.pose.y, z), flat.rotation)

    def _take(self, path: Path) -> None:
        away = np.hypot(path.poses[:, 0] - self.pose.x, path.poses[:, 1] - self.pose.y)
        self._path = path.poses[int(np.argmin(away)) :]

    def _follow(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self._handle = handle
        self._take(handle.goal.path)

    def _recover(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self.ctx.after(2.0, lambda: handle.succeed(Nothing()))

    def _stop(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self._handle, self._path = None, np.zeros((0, 3))

    def _move(self) -> None:
        if self._handle is not None:
            steps = max(1, round(SPEED * STEP / 0.05))
            if len(self._path):
                self.pose = SE2(*self._path[min(steps, len(self._path) - 1)].tolist())
                self._path = self._path[steps:]
            if not holds(self.room, self.pose.x, self.pose.y):
                onto = [r for r in BESIDE[self.room] if holds(r, self.pose.x, self.pose.y)]
                self.falls += not onto
                self.room = onto[0] if onto else self.room
            self._handle.feedback(FollowPathFeedback(0.05 * len(self._path)))
            if len(self._path) == 0:
                handle, self._handle = self._handle, None
                handle.succeed(Nothing())
        now = self.ctx.now_ns
        zeros = np.zeros((6, 6))
        self.ctx.publish(ODOMETRY, Odometry(now, "odom", "base", self.place, (0.0,) * 3, (0.0,) * 3, zeros, zeros))
        edges = (TransformStamped(now, "odom", "base", self.place), TransformStamped(now, "map", "odom", SE3()))
        self.ctx.publish(TRANSFORMS, Transforms(now, edges))

    def _look(self) -> None:
        """Ground of the rooms that can be seen, and walls around them; nothing of what lies above or below."""
        n = round(SEEN / CELL)
        around = (np.arange(-n, n) + 0.5) * CELL
        cx, cy = (round(v / CELL) * CELL for v in (self.pose.x, self.pose.y))
        x, y = (a.ravel() for a in np.meshgrid(cx + around, cy + around))
        z, is_ground = np.full(len(x), np.nan), np.zeros(len(x), np.bool_)
        for room in (*BESIDE[self.room], self.room):
            inside = holds(room, x, y)
            z, is_ground = np.where(inside, height(room, x, y), z), is_ground | inside
        wall = ndimage.binary_dilation(is_ground.reshape(2 * n, 2 * n), np.ones((3, 3))).ravel() & ~is_ground
        for room in {far for near in BESIDE[self.room] for far in BESIDE[near]}:
            wall &= ~holds(room, x, y)  # it goes on there, out of sight
        z = np.where(np.isnan(z), self.place.translation[2], z)
        is_seen = (is_ground | wall) & (np.hypot(x - self.pose.x, y - self.pose.y) < SEEN)
        x, y, z, wall = x[is_seen], y[is_seen], z[is_seen], wall[is_seen]
        points = np.stack((x, y, z), axis=1).astype(np.float32)
        kinds = np.where(wall, int(Ground.OBSTACLE), int(Ground.GROUND)).astype(np.uint16)
        above = np.where(wall, 1.0, 0.0).astype(np.float32)
        self.ctx.publish(
            TERRAIN_MAP, PointCloud(self.ctx.now_ns, "odom", points, above, np.zeros(len(x), np.float32), kinds)
        )


class Guest(Node):
    """Sends the robot to goals in turn, and has the graph saved at the end."""

    name = "guest"
    calls = (NAVIGATE,)

    def __init__(self, goals: list[NavigateGoal], climber: Climber, stem: FilePath | None) -> None:
        self._goals, self._climber, self._stem = goals, climber, stem
        if stem is not None:
            self.calls = (NAVIGATE, SAVE_GRAPH)
        self.ends: list[tuple[str, int, SE2]] = []
        self.is_done = False

    def start(self) -> None:
        self.ctx.after(2.0, self._next)

    def _next(self) -> None:
        if len(self.ends) < len(self._goals):
            self.ctx.send_goal(NAVIGATE, self._goals[len(self.ends)], self._over)
        elif self._stem is not None:
            self.ctx.call(SAVE_GRAPH, SaveMapRequest(str(self._stem)), self._saved)
        else:
            self.is_done = True

    def _saved(self, reply: Any) -> None:
        assert isinstance(reply, Nothing), reply
        self.is_done = True

    def _over(self, outcome: TaskOutcome[Any]) -> None:
        self.ends.append((outcome.code, self._climber.room, self._climber.pose))
        self._next()


def make_grid() -> GlobalPlanner:
    return GridPlanner(PlannerConfig(is_unknown_allowed=True))


def make_graph() -> GlobalPlanner:
    return VisibilityPlanner(VisibilityConfig(is_unknown_allowed=True))


def goal(x: float, y: float, level: int | None = None) -> NavigateGoal:
    return NavigateGoal(SE2(x, y), yaw_tolerance=3.2, level=level)


GOALS = [goal(17.0, 4.0), goal(2.0, 10.0), goal(18.0, 10.0), goal(10.0, 4.0, 1), goal(10.0, 4.0, 0), goal(3.0, 2.0, 1)]


@pytest.mark.parametrize("make", [make_grid, make_graph], ids=["grid", "visibility_graph"])
def test_goals_on_two_decks_are_driven_to_over_the_ramp_between_them(
    make: Callable[[], GlobalPlanner], tmp_path: FilePath
) -> None:
    climber, planner = Climber(), make()
    is_graph = isinstance(planner, VisibilityPlanner)
    costmap = GlobalCostmap(GlobalCostmapConfig(inflation=InflationConfig(inscribed_radius=0.3)), ROBOT)
    mapper = GroundMapperNode(ROBOT, TerrainConfig())
    guest = Guest(GOALS, climber, tmp_path / "map" if is_graph else None)
    nodes = [climber, mapper, GlobalPlannerNode(costmap, planner), NavigatorNode(has_levels=True), guest]
    executor = LockstepExecutor(Stack(nodes))
    told: list[str] = []

    def hear(topic: Topic[Any], message: Any, now_ns: int, writer: str) -> None:
        if topic is STATUS and writer == "planner":
            told.append(message.code)
        if guest.is_done:
            executor.stop()

    executor.tap(hear)
    executor.run(200.0)
    assert [code for code, _, _ in guest.ends] == ["SUCCEEDED"] * len(GOALS)
    assert [room for _, room, _ in guest.ends] == [DECK, FOOT, TOP, UPPER, DECK, UPPER]
    for wanted, (_, _, pose) in zip(GOALS, guest.ends, strict=True):
        assert pose.distance_to(wanted.map_from_goal) < 0.2
    assert climber.falls == 0
    assert len(mapper.map.levels) == 2
    if is_graph:
        assert set(told) == {"PLANNING", "FREE_PATH", "ATTEMPTING"}
        kept = VisibilityPlanner(VisibilityConfig(is_unknown_allowed=True), load_graph(tmp_path / "map.vgraph"))
        assert isinstance(planner, VisibilityPlanner)
        for level in (0, 1):
            kept.enter_level(level)
            planner.enter_level(level)
            before, after = planner.view(0, "map"), kept.view(0, "map")
            assert len(before.nodes) > 4
            np.testing.assert_array_equal(after.nodes, before.nodes)
            np.testing.assert_array_equal(after.edges, before.edges)
