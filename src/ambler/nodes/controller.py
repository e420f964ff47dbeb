"""Local control on the bus: keeps the local costmap, follows paths, lets a person steer, and frees the robot on request.

One motion at a time: a path or a recovery; while a person steers, a path waits and a recovery ends. Every end of a motion, whatever its reason, sends
a zero velocity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from ambler.control.checkers import GoalChecker, ProgressChecker, StallChecker
from ambler.control.held_motions import HeldMotions
from ambler.control.local_window import LocalWindow
from ambler.control.recovery_motion import BackUp, MakeRoom, RecoveryMotion, TurnInPlace
from ambler.control.unseen_ground import UnseenGround, UnseenGroundConfig
from ambler.control.way_back import WayBack
from ambler.control.yielding import YieldConfig, Yielding
from ambler.core.errors import AmblerError, ControlError, InvalidPathError, StaleInputError, TransformError
from ambler.core.messages import (
    Code,
    CostGrid,
    GateState,
    GateStatus,
    LaserScan,
    Message,
    Number,
    Odometry,
    Path,
    PointCloud,
    Polygon,
    Status,
    Transforms,
    VelocityCommand,
)
from ambler.core.protocols import (
    BodyVelocity,
    LeanAware,
    LocalPlanner,
    LocalState,
    MoverAware,
    Steers,
    TakesNo,
    TellsState,
)
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.costmap.local_costmap import LocalCostmap
from ambler.nodes.layer_inputs import UNPLACED, LayerInput, usual_inputs
from ambler.nodes.local_modes import LeanMeter, StateTeller, Steering
from ambler.nodes.local_view import LocalView
from ambler.perception.glass import SpecularConfig
from ambler.perception.mover_track import MoverConfig
from ambler.perception.planar import PlanarConfig
from ambler.runtime.node import PREEMPTED, GoalHandle, Node, Topics
from ambler.runtime.tasks import (
    CLEAR_LOCAL_COSTMAP,
    FOLLOW_PATH,
    RECOVER,
    FollowPathFeedback,
    FollowPathGoal,
    Nothing,
    RecoverGoal,
    RecoveryKind,
)
from ambler.runtime.topics import (
    CLOUD,
    CLOUD_CLEARING,
    FOOTPRINT,
    GATE_STATUS,
    LOCAL_COSTMAP,
    LOCAL_PATH,
    MAP,
    MAP_CLEARING,
    MERGED_CLOUD,
    MERGED_FREE,
    MOVERS,
    ODOMETRY,
    PATH,
    SCAN,
    SCANNERS,
    SPEED,
    STATUS,
    STEER_REQUEST,
    STOP,
    TERRAIN_MAP,
    TRANSFORMS,
    VELOCITY_REQUEST,
    Topic,
)

FollowHandle = GoalHandle[FollowPathGoal, FollowPathFeedback, Nothing]
RecoverHandle = GoalHandle[RecoverGoal, Nothing, Nothing]

PERIOD = 0.05
NEARLY_NS = 40_000_000  # after one that began a cycle, a scan begins the next
APART = 0.025  # seconds between a cycle and one that a scan begins, at least; a scan that just missed one would miss all others
GRACE = 0.005  # for which a cycle waits when no scan has begun the one before: it may come any moment
RECOVERY_PADDING = 0.02
VIEW_PERIOD = 0.5
PATIENCE_NS = 1_500_000_000
PROTECTIVE_PATIENCE_NS = 3_000_000_000
RECOVERY_PATIENCE_NS = 2_500_000_000
HELD = (GateState.PAUSED, GateState.EMERGENCY_STOP, GateState.FAULT)


class ControllerNode(Node):
    """Follows paths with any LocalPlanner and recovers, both on the local costmap.

    `layer_inputs` feed layers of one's own; those of `usual_inputs` are fed anyway. Of orders from outside it obeys SPEED (m/s, the fastest that it
    drives from now on), MAP_CLEARING and CLOUD_CLEARING (m, the radius within which the costmap forgets), and has patience while STOP holds.
    """

    name = "controller"
    inputs: Topics = (SCAN, ODOMETRY, TRANSFORMS)
    optional_inputs: Topics = (PATH, GATE_STATUS, STEER_REQUEST)
    kept_inputs: Topics = (ODOMETRY, TRANSFORMS)
    outputs = (VELOCITY_REQUEST, LOCAL_COSTMAP, LOCAL_PATH, FOOTPRINT, MOVERS, STATUS)
    serves = (FOLLOW_PATH, RECOVER, CLEAR_LOCAL_COSTMAP)
    latency = 0.01
    commands = True

    def __init__(
        self,
        robot: RobotModel,
        planner: LocalPlanner,
        costmap: LocalCostmap,
        planar: PlanarConfig | None = None,
        layer_inputs: Sequence[LayerInput[Any]] = (),
        movers: MoverConfig | None = None,
        yielding: YieldConfig | None = None,
        specular: SpecularConfig | None = None,
        unseen: UnseenGroundConfig | None = None,
    ) -> None:
        self._unseen = None if unseen is None else UnseenGround(unseen)
        self._robot = robot
        self._planner = planner
        # Asked once: whether an object follows a Protocol takes longer than taking in a message.
        self._lean_aware = planner if isinstance(planner, LeanAware) else None
        self._mover_aware = planner if isinstance(planner, MoverAware) else None
        self._telling = planner if isinstance(planner, TellsState) else None
        self._view = LocalView(robot, costmap, planar, movers, specular)
        self._yield_config = yielding if yielding is not None else YieldConfig()
        self._yielding = Yielding(self._yield_config, robot)
        if isinstance(planner, TakesNo):
            planner.set_refusal(lambda v: self._held_motions.refuses(v) or self._yielding.refuses(v))
        self._held_motions, self._wanted = HeldMotions(), BodyVelocity()
        self._yields_since_ns: int | None = None
        self._window = LocalWindow(robot, RECOVERY_PADDING)
        self._layer_inputs = (*usual_inputs(costmap.layers, needs_echoes=bool(robot.rangers)), *layer_inputs)
        needed = tuple(wanted.topic for wanted in self._layer_inputs if wanted.is_required)
        self._fresh: Topics = (*self._view.topics, *needed)
        self.inputs = (*self._fresh, ODOMETRY, TRANSFORMS)
        optional = tuple(wanted.topic for wanted in self._layer_inputs if not wanted.is_required)
        self.optional_inputs = (
            *(PATH, GATE_STATUS, STEER_REQUEST, SPEED, STOP, MAP_CLEARING, CLOUD_CLEARING),
            *((SCANNERS,) if self._view.uses_merged else ()),
            *(() if unseen is None else (MAP,)),
            *optional,
        )
        self._follow: FollowHandle | None = None
        self._path: Path | None = None
        self._recover: RecoverHandle | None = None
        self._recover_since_ns = 0
        self._motion: RecoveryMotion | None = None
        self._way_back = WayBack()
        self._goal_checker = GoalChecker(0.15, 0.2)
        self._progress, self._stall, self._sent = (
            ProgressChecker(),
            StallChecker(self._robot.limits.ax_max),
            BodyVelocity(),
        )
        self._trouble_since_ns: int | None = None
        self._protective_since_ns: int | None = None
        self._is_held = False
        self._gate: GateStatus | None = None
        self._steering, self._teller, self._lean = Steering(), StateTeller(), LeanMeter()
        self._speed_most = math.inf
        self._stop_order = 0
        self._cycles, self._begun_ns, self._scan_began_ns = 0, 0, 0
        self._is_alone = True

    @property
    def scans(self) -> Topic[Any]:
        """The topic whose messages the costmap is drawn with."""
        return self._view.topics[-1]

    @property
    def seen_ns(self) -> int | None:
        """The stamp of the newest of them that the costmap holds, None before the first."""
        return self._view.stamp_ns

    def start(self) -> None:
        """Subscribe, serve, and start the cycle and the timer of what is shown."""
        if self._view.uses_merged:
            self.ctx.subscribe(SCANNERS, self._view.add_panes)
            self.ctx.subscribe(MERGED_FREE, self._on_free)
            self.ctx.subscribe(MERGED_CLOUD, self._on_merged)
        elif self._view.uses_cloud:
            self.ctx.subscribe(CLOUD, self._on_cloud)
        else:
            self.ctx.subscribe(SCAN, self._on_scan)
        if self._unseen is not None:
            self.ctx.subscribe(MAP, self._unseen.set_map)
        self.ctx.subscribe(SPEED, self._on_speed)
        self.ctx.subscribe(STOP, self._on_stop_order)
        for clearing in (MAP_CLEARING, CLOUD_CLEARING):
            self.ctx.subscribe(clearing, self._on_clearing)
        for wanted in self._layer_inputs:
            take = self._on_terrain if wanted.topic is TERRAIN_MAP else self._on_layer_input
            self.ctx.subscribe(wanted.topic, partial(take, wanted))
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(PATH, self._on_path)
        self.ctx.subscribe(GATE_STATUS, self._on_gate_status)
        self.ctx.subscribe(STEER_REQUEST, self._steering.take)
        self.ctx.serve_task(FOLLOW_PATH, self._on_follow, self._on_follow_cancelled)
        self.ctx.serve_task(RECOVER, self._on_recover, self._on_recover_cancelled)
        self.ctx.serve(CLEAR_LOCAL_COSTMAP, self._on_clear)
        self._begin_after(PERIOD)
        self.ctx.timer(VIEW_PERIOD, self._show)

    # Input

    def _on_scan(self, scan: LaserScan) -> None:
        self._view.add_scan(scan)
        self._tell_movers()
        self._begin_with_scan()

    def _on_free(self, free: PointCloud) -> None:
        self._view.add_free(free)

    def _on_merged(self, cloud: PointCloud) -> None:
        self._view.add_merged(cloud)
        self._tell_movers()
        self._begin_with_scan()

    def _on_cloud(self, cloud: PointCloud) -> None:
        self._view.add_cloud(cloud)
        self._tell_movers()
        self._begin_with_scan()

    def _on_layer_input(self, wanted: LayerInput[Any], message: Message) -> None:
        with suppress(*UNPLACED):
            wanted.feed(message, self._view)

    def _on_terrain(self, wanted: LayerInput[Any], terrain: PointCloud) -> None:
        self._view.add_terrain(terrain)
        self._on_layer_input(wanted, terrain)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._view.add_odometry(odometry)
        if self._lean_aware is not None:
            self._lean_aware.set_lean(self._lean.read(odometry))
            if self._lean.is_blind:
                self.ctx.log("LEAN_NOT_MEASURED", "the odometry is planar: the limits of inclination cannot act")

    def _on_transforms(self, transforms: Transforms) -> None:
        self._view.add_transforms(transforms)

    def _on_path(self, path: Path) -> None:
        if self._follow is not None and len(path.poses) > 0:
            self._path = path

    def _on_gate_status(self, status: GateStatus) -> None:
        self._gate = status
        self._is_held = status.state in HELD
        if status.state is not GateState.PROTECTIVE_STOP:
            self._protective_since_ns = None
        elif self._protective_since_ns is None:
            self._protective_since_ns = self.ctx.now_ns

    def _on_speed(self, speed: Number) -> None:
        if speed.value >= 0.0:
            self._speed_most = speed.value

    def _on_stop_order(self, order: Code) -> None:
        self._stop_order = order.value

    def _on_clearing(self, radius: Number) -> None:
        with suppress(TransformError):
            at, _ = self._view.now(self.ctx.now_ns)
            if radius.value > 0.0:
                self._view.costmap.clear_within(at.x, at.y, radius.value)

    def _on_clear(self, request: Nothing) -> Nothing:
        self._view.costmap.clear()
        return Nothing()

    def _tell_movers(self) -> None:
        """Tell where whoever moves is, in the odom frame, until nobody is there any more; intensities are speeds in m/s."""
        movers = self._view.tracked
        if len(movers) == 0 and self._is_alone:
            return
        self._is_alone = len(movers) == 0
        points = np.zeros((len(movers), 3), np.float32)
        points[:, :2] = movers.states[:, :2]
        speeds = np.hypot(movers.states[:, 2], movers.states[:, 3]).astype(np.float32)
        zeros, rings = np.zeros(len(movers), np.float32), np.zeros(len(movers), np.uint16)
        self.ctx.publish(MOVERS, PointCloud(movers.stamp_ns, "odom", points, speeds, zeros, rings))

    # Goals

    def _on_follow(self, handle: FollowHandle) -> None:
        self._end_recover(PREEMPTED, "a path is to be followed")
        self._follow, self._path = handle, handle.goal.path
        self._goal_checker = GoalChecker(handle.goal.xy_tolerance, handle.goal.yaw_tolerance)
        self._progress, self._stall = ProgressChecker(), StallChecker(self._robot.limits.ax_max)
        self._trouble_since_ns = self._protective_since_ns = None

    def _on_follow_cancelled(self, handle: FollowHandle) -> None:
        if self._follow is handle:
            self._follow, self._path = None, None
            self._send(BodyVelocity())

    def _on_recover(self, handle: RecoverHandle) -> None:
        self._end_follow(PREEMPTED, "a recovery begins")
        self._recover_since_ns = self.ctx.now_ns
        kind, amount = handle.goal.kind, handle.goal.amount
        self._recover = handle
        if kind is RecoveryKind.ROTATE:
            self._motion = TurnInPlace(self._robot, amount, RECOVERY_PADDING)
        elif kind is RecoveryKind.BACK_UP:
            self._motion = BackUp(self._robot, amount, RECOVERY_PADDING, self._way_back)
        else:
            self._motion = MakeRoom(self._robot, amount, RECOVERY_PADDING, self._seen_slide)
        self._trouble_since_ns = None

    def _on_recover_cancelled(self, handle: RecoverHandle) -> None:
        if self._recover is handle:
            self._recover = None
            self._send(BodyVelocity())

    def _end_follow(self, code: str, text: str) -> None:
        if self._follow is None:
            return
        handle, self._follow, self._path = self._follow, None, None
        self._send(BodyVelocity())
        self.ctx.log(f"FOLLOW_PATH_{code}", text)
        if code == "SUCCEEDED":
            handle.succeed(Nothing())
        else:
            handle.fail(code, text)

    def _end_recover(self, code: str, text: str) -> None:
        if self._recover is None:
            return
        handle, self._recover = self._recover, None
        self._send(BodyVelocity())
        self.ctx.log(f"RECOVER_{code}", text)
        if code == "SUCCEEDED":
            handle.succeed(Nothing())
        else:
            handle.fail(code, text)

    # Control

    def _begin_with_scan(self) -> None:
        """Begin a cycle with what a scan has just shown: waiting for the next one would age it by half a cycle. Of scans that come fast, not each."""
        now_ns = self.ctx.now_ns
        if now_ns - self._scan_began_ns < NEARLY_NS:
            return
        self._scan_began_ns = now_ns
        wait = APART - (now_ns - self._begun_ns) * 1e-9
        if wait > 0.0:
            self._begin_after(wait)
        else:
            self._begin(PERIOD)

    def _begin_after(self, seconds: float) -> None:
        self._cycles += 1
        self.ctx.after(seconds, partial(self._begin_again, self._cycles))

    def _begin_again(self, cycles: int) -> None:
        if cycles == self._cycles:  # no scan has begun one since
            self._begin(PERIOD + GRACE)

    def _begin(self, until_next: float) -> None:
        self._begun_ns = self.ctx.now_ns
        self._begin_after(until_next)
        self._cycle()

    def _cycle(self) -> None:
        steered = self._steering.wanted(self.ctx.now_ns)
        if self._steering.has_ended(steered):
            self._send(BodyVelocity())
            self._progress, self._trouble_since_ns = ProgressChecker(), None
        if steered is not None:
            self._end_recover(PREEMPTED, "a person steers")
        is_idle = steered is None and self._follow is None and self._recover is None
        if not is_idle:
            self._control(steered)
        self._tell_state(is_idle=is_idle)

    def _control(self, steered: BodyVelocity | None) -> None:
        try:
            self.ctx.newest(ODOMETRY)
            self._check_sight()
            odom_from_base, velocity = self._view.now(self.ctx.now_ns)
            if not (self._recover is not None and isinstance(self._motion, BackUp)):
                self._way_back.add(odom_from_base)
            is_held = self._protective_since_ns is not None
            self._held_motions.update(self.ctx.now_ns * 1e-9, odom_from_base, self._wanted, is_held=is_held)
            self._wanted = BodyVelocity()  # until `_drive` is asked for something
            movers = self._view.movers(self.ctx.now_ns)
            self._yielding.set_movers(movers, odom_from_base, velocity)
            if self._mover_aware is not None:
                self._mover_aware.set_movers(movers)
            if steered is not None:
                self._steer_step(odom_from_base, velocity, steered)
            elif self._recover is not None:
                self._recover_step(odom_from_base)
            else:
                self._follow_step(odom_from_base, velocity)
            self._trouble_since_ns = None
        except (StaleInputError, TransformError, ControlError) as error:
            if steered is not None:  # the person sees it, and steers elsewhere
                self._send(BodyVelocity())
                self._tell_refused(error)
            else:
                self._wait_in_trouble(error)

    def _steer_step(self, odom_from_base: SE2, velocity: BodyVelocity, wanted: BodyVelocity) -> None:
        if not isinstance(self._planner, Steers):  # never where a person points without looking
            text = f"{type(self._planner).__name__} cannot be steered; `controller: primitives` can"
            raise ControlError(text)
        costmap = self._view.costmap
        self._drive(self._planner.steer(costmap.costs, costmap.spec, odom_from_base, velocity, wanted))

    def _tell_refused(self, error: AmblerError) -> None:
        news = self._teller.news(self.ctx.now_ns, LocalState.BLOCKED, str(error), self._gate)
        if news is not None:
            self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, *news))

    def _tell_state(self, *, is_idle: bool) -> None:
        """Tell people what a planner that knows it does, and why the robot stands."""
        if self._telling is None:
            return
        state, reason = self._telling.state, self._telling.reason
        if is_idle and state is not LocalState.GOAL_REACHED:
            state, reason = LocalState.IDLE, "there is nothing to do"
        news = self._teller.news(self.ctx.now_ns, state, reason, self._gate)
        if news is not None:
            self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, *news))

    def _check_sight(self) -> None:
        for topic in self._fresh:
            self.ctx.newest(topic)

    def _follow_step(self, odom_from_base: SE2, velocity: BodyVelocity) -> None:
        assert self._follow is not None
        assert self._path is not None
        path_odom = self._view.to_odom(self._path)
        self._planner.set_path(path_odom)
        left = _length_left(path_odom, odom_from_base)
        self._follow.feedback(FollowPathFeedback(left))
        if self._goal_checker.update(odom_from_base, SE2.from_array(path_odom[-1]), velocity, left):
            self._end_follow("SUCCEEDED", "the end of the path is reached")
            return
        if self._goal_checker.may_stop:
            self._send(BodyVelocity())
            return
        if self._is_held or self._stop_order != 0 or self._speed_most == 0.0 or self._is_yielding():
            self._progress, self._stall = ProgressChecker(), StallChecker(self._robot.limits.ax_max)
        elif not self._progress.update(self.ctx.now_ns, odom_from_base):
            self._end_follow("FAILED_TO_MAKE_PROGRESS", "the robot hardly moved for 10 s")
            return
        elif not self._obeys(velocity):
            text = "told to move, it stands: something holds it that no sensor shows"
            self._end_follow("HELD", text)
            return
        since_ns = self._protective_since_ns
        if since_ns is not None and self.ctx.now_ns - since_ns > PROTECTIVE_PATIENCE_NS:
            self._end_follow("NO_VALID_CONTROL", "the gate has held the robot before an obstacle for 3 s")
            return
        most = math.inf if self._unseen is None else self._unseen.speed_most(self._path.poses, left)
        costmap = self._view.costmap
        self._drive(self._planner.compute_command(costmap.costs, costmap.spec, odom_from_base, velocity), most)

    def _recover_step(self, odom_from_base: SE2) -> None:
        assert self._motion is not None
        since_ns = self._protective_since_ns
        if since_ns is not None and self.ctx.now_ns - max(since_ns, self._recover_since_ns) > RECOVERY_PATIENCE_NS:
            if not (isinstance(self._motion, TurnInPlace) and self._motion.turn_back()):
                self._end_recover("COLLISION_AHEAD", "the gate holds this motion")
                return
            self._recover_since_ns = self.ctx.now_ns
        costmap = self._view.costmap
        try:
            command = self._motion.compute_command(self.ctx.now_ns, costmap.costs, costmap.spec, odom_from_base)
        except ControlError as error:
            self._end_recover(error.code, str(error))
            return
        if command is None:
            self._end_recover("SUCCEEDED", "done")
        else:
            self._drive(command)

    def _drive(self, wanted: BodyVelocity, most: float = math.inf) -> None:
        """Send as much of a velocity, at most so fast (m/s), as starts no contact with anybody who moves or may set out; a robot that has to stand gets out of his way
        if it can, and else creeps."""
        self._wanted = wanted
        allowed = _slowed(wanted, min(self._speed_most, most))
        passed = self._yielding.limited(allowed)
        if not self._yielding.is_waiting(passed):
            self._yields_since_ns = None
        elif self._yields_since_ns is None:
            self._yields_since_ns = self.ctx.now_ns
        if passed == BodyVelocity() and not self._yielding.is_alone:
            passed = self._yielding.evasion(self._seen_slide)
            if passed == BodyVelocity():
                passed = self._yielding.creeping(allowed)
        self._send(passed)

    def _seen_slide(self, heading: float, length: float) -> float:
        """Return how far the robot may slide along a heading of the odom frame through what it has seen to be free, at most `length` m."""
        odom_from_base, _ = self._view.now(self.ctx.now_ns)
        self._window.update(self._view.costmap.costs, self._view.costmap.spec)
        free = self._window.free_slide(odom_from_base, heading, length)
        x, y = odom_from_base.x + free * math.cos(heading), odom_from_base.y + free * math.sin(heading)
        there = SE2(x, y, odom_from_base.yaw).transform(self._robot.footprint)
        return free if self._view.has_seen(there) else 0.0

    def _is_yielding(self) -> bool:
        """Whether the robot waits for people, and has not done so for too long."""
        since_ns = self._yields_since_ns
        return since_ns is not None and self.ctx.now_ns - since_ns < self._yield_config.patience * 1e9

    def _wait_in_trouble(self, error: AmblerError) -> None:
        """Stand still; end the motion when the trouble lasts, or at once when waiting cannot help. While the gate holds the
        robot, only missing input counts as trouble."""
        self._send(BodyVelocity())
        is_excused = self._is_held and isinstance(error, ControlError)
        if self._trouble_since_ns is None or is_excused:
            self._trouble_since_ns = self.ctx.now_ns
        is_hopeless = isinstance(error, InvalidPathError)
        if is_hopeless or self.ctx.now_ns - self._trouble_since_ns > PATIENCE_NS:
            self._end_follow(error.code, str(error))
            self._end_recover("STALE_INPUT", str(error))

    def _obeys(self, velocity: BodyVelocity) -> bool:
        """Whether the base moves as it is told, where the gate passes on what it is asked for as it is."""
        is_let_through = self._gate is not None and self._gate.state is GateState.ARMED and not self._gate.reason
        return self._stall.update(self.ctx.now_ns, self._sent if is_let_through else BodyVelocity(), velocity)

    def _send(self, v: BodyVelocity) -> None:
        self._sent = v
        self.ctx.publish(VELOCITY_REQUEST, VelocityCommand(self.ctx.now_ns, v.vx, v.vy, v.wz))

    # View

    def _show(self) -> None:
        costmap, stamp_ns = self._view.costmap, self._view.stamp_ns
        if stamp_ns is None:
            return
        self.ctx.publish(LOCAL_COSTMAP, CostGrid(stamp_ns, "odom", costmap.spec, costmap.costs))
        odom_from_base, _ = self._view.now(self.ctx.now_ns)
        corners = np.zeros((len(self._robot.footprint), 3), np.float32)
        corners[:, :2] = odom_from_base.transform(self._robot.footprint)
        self.ctx.publish(FOOTPRINT, Polygon(self.ctx.now_ns, "odom", corners))
        trajectory = self._planner.trajectory
        is_driven = self._follow is not None or self._steering.wanted(self.ctx.now_ns) is not None
        if is_driven and len(trajectory) > 0:
            self.ctx.publish(LOCAL_PATH, Path(self.ctx.now_ns, "odom", np.array(trajectory)))


def _slowed(wanted: BodyVelocity, most: float) -> BodyVelocity:
    """Return a velocity along the same arc that is at most so fast (m/s)."""
    speed = math.hypot(wanted.vx, wanted.vy)
    if speed <= most:
        return wanted
    share = most / speed
    return BodyVelocity(share * wanted.vx, share * wanted.vy, share * wanted.wz)


def _length_left(path: np.ndarray, odom_from_base: SE2) -> float:
    """Length of the path from its point nearest to the robot to its end, metres."""
    nearest = int(np.argmin(np.hypot(path[:, 0] - odom_from_base.x, path[:, 1] - odom_from_base.y)))
    rest = path[nearest:, :2]
    return float(np.hypot(*np.diff(rest, axis=0).T).sum()) if len(rest) > 1 else 0.0
