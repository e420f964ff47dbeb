"""The node of the velocity gate: the only writer of the command to the base, at once on a request and with a heartbeat of 50 Hz."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError
from ambler.core.messages import (
    Code,
    GateState,
    GateStatus,
    LaserScan,
    Odometry,
    PointCloud,
    Range,
    VelocityCommand,
)
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels.footprint import footprint_edges
from ambler.nodes.devices.table import topics_of_kind
from ambler.nodes.range_view import RangeView
from ambler.perception.echoes import link
from ambler.perception.glass import SpecularConfig
from ambler.perception.level_ring import level_ring, sweep_stamps
from ambler.perception.near_panes import NearPanes
from ambler.runtime.node import Node, Topics
from ambler.runtime.tasks import (
    ARM,
    EMERGENCY_STOP,
    PAUSE,
    PERMIT_APPROACH,
    RESET_STOP,
    REVOKE_APPROACH,
    ApproachRequest,
    GateReply,
    GateRequest,
    Nothing,
)
from ambler.runtime.topics import (
    DOCKING_REQUEST,
    GATE_STATUS,
    ODOMETRY,
    RANGES,
    SCAN,
    STOP,
    TELEOP_REQUEST,
    VELOCITY_COMMAND,
    VELOCITY_REQUEST,
)
from ambler.safety.approach_permit import ApproachPermit
from ambler.safety.blind_memory import BlindMemory, IsFloor, see_all_around
from ambler.safety.config import GateConfig
from ambler.safety.field_of_view import FieldOfView, overlap
from ambler.safety.floor_memory import FloorMemory
from ambler.safety.gate import GateStep, VelocityGate
from ambler.safety.points import (
    F64,
    Floor,
    bridged,
    carried_to_stamp,
    has_measured,
    patch_means,
    points_of_cloud,
    points_of_scan,
    pulled_nearer,
    some_of_cloud,
)
from ambler.safety.stuck_scan import StuckScan
from ambler.safety.visitors import rim_of

PERIOD = 0.02
APART_NS = 1_000_000  # between a step of the heartbeat and one that a request begins, at least
STATUS_PERIOD_NS = 1_000_000_000
NEVER_NS = -(1 << 62)
# Metres by which what a cloud showed before may be nearer than it is remembered: at an edge half a column of the memory, and a walking body sways.
UNSEEN_NEARER = 0.02
PANE_NEAR, PANE_BESIDE = (
    1.0,
    0.25,
)  # metres beyond the robot's own reach: within which panes count, and by which one goes on beside
ARC_REACH, ARC_STEP = 2.0, 0.04  # metres: how far echoes count, and between the points of their arcs
LINK_REACH, LINK_AGE_NS = 0.5, 300_000_000  # two neighbouring arcs so near (m) and so fresh are one surface


class GateNode(Node):
    """Feeds the gate with every scanner of the robot and with odometry, and sends what it lets pass.

    `z_band` is the height above the floor in which points of a cloud are obstacles. The default reaches from 0.15 m to above the
    robot and its scanners, because a wall close by is hit only by beams that are still high. Of several planar scanners it takes
    each one's own scans, not the merged one, and remembers what leaves its sector for where no other one looks. A sensor of the
    robot that falls silent, or never speaks, stops it. Of a sensor whose clock is ahead (`SensorMount.clock_offset`)
    a point is taken from where the robot was when the beam was measured, and a scan is as old as it is. `specular` says how panes of glass shine.
    """

    name = "gate"
    inputs: Topics = (VELOCITY_REQUEST, ODOMETRY, SCAN)
    optional_inputs = (TELEOP_REQUEST, DOCKING_REQUEST, STOP)
    kept_inputs: Topics = (ODOMETRY,)
    outputs = (VELOCITY_COMMAND, GATE_STATUS)
    serves = (ARM, PAUSE, EMERGENCY_STOP, RESET_STOP, PERMIT_APPROACH, REVOKE_APPROACH)
    latency = 0.001
    commands = True

    def __init__(
        self,
        robot: RobotModel,
        config: GateConfig | None = None,
        z_band: tuple[float, float] | None = None,
        specular: SpecularConfig | None = None,
    ) -> None:
        self._robot = robot
        self._config = config if config is not None else GateConfig()
        self.gate = VelocityGate(self._config, robot)
        self._mounts = {m.frame: m for m in robot.sensors}
        self._memories: dict[str, BlindMemory] = {}
        self._repeats: dict[str, StuckScan] = {}
        self._stuck: set[str] = set()
        self._radius, self._edges = robot.circumscribed_radius, footprint_edges(robot.footprint, 0.0)
        self._panes = NearPanes(self._radius + PANE_NEAR, self._radius + PANE_BESIDE, specular)
        self._planar = robot.scanners
        self._has_many = len(self._planar) > 1
        self._clouds = robot.clouds
        self._scan_topics = topics_of_kind(robot, SensorKind.SCAN)
        self._cloud_topics = topics_of_kind(robot, SensorKind.CLOUD)
        self._rangers = robot.rangers
        self._known = (*self._planar, *self._clouds, *self._rangers)
        self._fields: dict[str, FieldOfView] = {}
        self._sees_all_around = False
        self._footprint, self._rim = robot.footprint, rim_of(robot.footprint)
        self._ranges = RangeView(robot)
        self._arcs: dict[str, tuple[int, F64]] = {}
        ring = sorted(self._rangers, key=lambda m: m.base_from_sensor.to_se2().yaw)
        self._neighbours = {m.frame: (ring[k - 1].frame, ring[(k + 1) % len(ring)].frame) for k, m in enumerate(ring)}
        ranges = (RANGES,) if self._rangers else ()
        self.inputs = (VELOCITY_REQUEST, ODOMETRY, *self._scan_topics, *self._cloud_topics, *ranges)
        tops = [m.base_from_sensor.translation[2] for m in robot.sensors]
        self._z_band = z_band if z_band is not None else (0.15, max(robot.body_height, *tops) + 0.1)
        self._reach = robot.circumscribed_radius + max(3.0, self._way_to_stand(robot))
        self._floor_memory = FloorMemory(self._reach, self._config.memory_travel)
        self._motion = BaseMotion()
        self._twist = np.zeros(3)
        self._status: GateStep | None = None
        self._status_ns = self._step_ns = 0

    def _way_to_stand(self, robot: RobotModel) -> float:
        """How far ahead of its sensor a robot at its fastest must see what it shall not touch, metres: its way until it stands, and what of itself is ahead."""
        limits = robot.limits
        ahead = max(limits.vx_max, -limits.vx_min)
        way = ahead * (self._config.reaction_time + 0.5 * ahead / limits.ax_brake)
        if limits.vy_max > 0.0:
            way = max(way, limits.vy_max * (self._config.reaction_time + 0.5 * limits.vy_max / limits.ay_brake))
        return way + robot.circumscribed_radius + self._config.margin

    def start(self) -> None:
        self.ctx.subscribe(VELOCITY_REQUEST, partial(self._on_request, "navigation"))
        self.ctx.subscribe(DOCKING_REQUEST, partial(self._on_request, "docking"))
        self.ctx.subscribe(TELEOP_REQUEST, partial(self._on_request, "teleop"))
        self.ctx.subscribe(STOP, self._on_stop_order)
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        if self._rangers:
            self.ctx.subscribe(RANGES, self._on_range)
        for mount in self._known:  # known from the start, so that one that never sends anything is missed
            self.gate.update_points(mount.frame, NEVER_NS, np.empty((0, 2)), SE2())
        for topic in self._scan_topics:
            self.ctx.subscribe(topic, self._on_scan)
        for topic in self._cloud_topics:
            self.ctx.subscribe(topic, self._on_cloud)
        self.ctx.serve(ARM, self._on_arm)
        self.ctx.serve(PAUSE, self._on_pause)
        self.ctx.serve(EMERGENCY_STOP, self._on_emergency_stop)
        self.ctx.serve(RESET_STOP, self._on_reset)
        self.ctx.serve(PERMIT_APPROACH, self._on_permit)
        self.ctx.serve(REVOKE_APPROACH, self._on_revoke)
        self.ctx.timer(PERIOD, self._step)

    def stop_now(self, reason: str) -> None:
        """Stop for good because a part of the robot failed; it cannot be reset while this process lives."""
        self.gate.hold_stop(self.ctx.now_ns, "system", reason)
        self._step()

    def _on_request(self, source: str, command: VelocityCommand) -> None:
        velocity = BodyVelocity(command.vx, command.vy, command.wz)
        now_ns = self.ctx.now_ns
        self.gate.request(source, command.stamp_ns, velocity, now_ns)
        # Waiting for the next beat would age what the request was made from.
        if now_ns - self._step_ns >= APART_NS:
            self._step()
        else:
            self.ctx.after(1e-9 * APART_NS, self._step)

    def _on_stop_order(self, order: Code) -> None:
        self.gate.order_stop(order.value)

    def _on_odometry(self, odometry: Odometry) -> None:
        told = (*odometry.pose.translation, *odometry.pose.rotation, *odometry.linear, *odometry.angular)
        if not all(map(math.isfinite, told)):
            self.gate.fault_odometry()
            return
        self._motion.add(odometry)
        self._twist = np.array([odometry.linear[0], odometry.linear[1], odometry.angular[2]])
        if self._rangers:
            self._ranges.add_odometry(odometry)
        self.gate.update_odometry(odometry.stamp_ns, odometry.pose.to_se2())
        up = odometry.pose.rotate((0.0, 0.0, 1.0))[2]
        self.gate.update_lean(odometry.stamp_ns, math.acos(min(max(up, -1.0), 1.0)))

    def _on_scan(self, scan: LaserScan) -> None:
        scan = self._robot.timed(scan)
        ends = (scan.angle_min, scan.angle_min + len(scan.ranges) * scan.angle_increment)
        # The rest is measured, and thrown away.
        seen = overlap((min(ends), max(ends)), self._mounts[scan.frame].azimuth)
        field = FieldOfView(scan.range_min, seen)
        self._know(scan.frame, field)
        mount = self._mounts[scan.frame].base_from_sensor
        panes = partial(self._panes_of_scan, scan, mount)
        self._take_points(scan, field, lambda there: points_of_scan(scan, there, self._twist), panes)

    def _panes_of_scan(self, scan: LaserScan, base_from_sensor: SE3, level_from_sensor: SE3) -> F64:
        """Panes of glass close by as far as the robot could touch them, points (N, 3) in the level base: they reflect where they are met squarely only."""
        odom_from_base, points = self._motion.planar_at(scan.stamp_ns), [np.empty((0, 3))]
        for seconds, flat in self._panes.look(scan, odom_from_base, base_from_sensor, self._twist):
            pane = level_from_sensor.transform(np.column_stack((flat, np.zeros(len(flat)))))
            points.append(carried_to_stamp(pane, np.full(len(pane), seconds), self._twist))
        return np.concatenate(points)

    def _panes_of_cloud(self, cloud: PointCloud) -> F64:
        """The same, from what a scanner of many rings sees at its own height."""
        ring, base_from_ring = level_ring(cloud, self._mounts[cloud.frame].base_from_sensor, self._motion)
        return self._panes_of_scan(ring, base_from_ring, base_from_ring)

    def _know(self, frame: str, field: FieldOfView) -> None:
        """Remember where a scanner looks, and find out when that has changed whether they look all around."""
        if self._fields.get(frame) == field:
            return
        self._fields[frame] = field
        scanners = [(self._mounts[f].base_from_sensor, seen) for f, seen in self._fields.items()]
        self._sees_all_around = see_all_around(self._rim, scanners)

    def _on_cloud(self, cloud: PointCloud) -> None:
        cloud, mount = self._robot.timed(cloud), self._mounts[cloud.frame]
        try:
            sweep, floor = self._sweep_of(cloud), self._floor_at(cloud)
        except StaleInputError:
            return  # its end was measured nobody knows where; if that lasts, its points are stale
        field = FieldOfView(mount.range_min, elevation=mount.elevation)
        around = (self._twist, self._reach, self._z_band)
        self._take_points(
            cloud,
            field,
            lambda _: points_of_cloud(cloud, sweep, *around, floor, mount.elevation[0]),
            lambda _: self._panes_of_cloud(cloud),
            None if floor is None else lambda points: floor.holds(points, self._z_band[0]),
            some_of_cloud(cloud, sweep, self._twist),
        )

    def _floor_at(self, cloud: PointCloud) -> Floor | None:
        """The floor around the robot, where it may slope. Raises StaleInputError."""
        if self._config.slope <= 0.0:
            return None
        odom_from_base = self._motion.pose_at(cloud.stamp_ns)
        level_from_base = _level_from_base(odom_from_base)
        up = level_from_base.rotate((0.0, 0.0, 1.0))
        upright = max(up[2], 0.5)
        lean = (-up[0] / upright, -up[1] / upright)
        odom_from_level = odom_from_base @ level_from_base.inverse()
        return Floor(self._config.slope, self._reach, self._radius, lean, self._floor_memory, odom_from_level)

    def _sweep_of(self, cloud: PointCloud) -> list[SE3]:
        """Where a scanner was in the level base all through its turn: a walking body leans by degrees meanwhile. Raises StaleInputError."""
        mount = self._mounts[cloud.frame].base_from_sensor
        return [_level_from_base(self._motion.pose_at(stamp_ns)) @ mount for stamp_ns in sweep_stamps(cloud)]

    def _take_points(
        self,
        scan: LaserScan | PointCloud,
        field: FieldOfView,
        points_of: Callable[[SE3], F64],
        panes_of: Callable[[SE3], F64],
        is_floor: IsFloor | None = None,
        beyond: F64 | None = None,
    ) -> None:
        if not has_measured(scan):
            return  # as if it had not come; if that lasts, its points are stale
        try:
            odom_from_base = self._motion.pose_at(scan.stamp_ns)
        except StaleInputError:
            return  # without a pose of that moment the points say nothing; if that lasts, they are stale
        if self._is_stuck(scan, odom_from_base.to_se2()):
            return  # its last points grow stale, and the robot stops
        level_from_sensor = _level_from_base(odom_from_base) @ self._mounts[scan.frame].base_from_sensor
        points, panes = points_of(level_from_sensor), panes_of(level_from_sensor)
        seen = np.concatenate((points, panes))
        unseen = self._unseen(scan, seen, odom_from_base, level_from_sensor, field, is_floor, beyond)
        if isinstance(scan, PointCloud):
            points = patch_means(points, level_from_sensor.translation[:2])
            unseen = pulled_nearer(bridged(unseen, points), UNSEEN_NEARER, *self._edges)
        told = (panes, unseen)  # each of these points stands for many
        together = np.concatenate((points, *told * self._config.min_points))[:, :2]
        self.gate.update_points(scan.frame, scan.stamp_ns, together, odom_from_base.to_se2())
        if self._rangers and isinstance(scan, LaserScan):
            self._ranges.add_scan(scan)
        elif self._rangers:
            self._ranges.add_points(scan.frame, odom_from_base.to_se2().transform(points[:, :2]))

    def _unseen(
        self,
        scan: LaserScan | PointCloud,
        points: F64,
        odom_from_base: SE3,
        base_from_sensor: SE3,
        field: FieldOfView,
        is_floor: IsFloor | None,
        beyond: F64 | None,
    ) -> F64:
        """Return what was seen before and is in the scanner's blind zone now, float64 (N, 3) in the level base frame."""
        normals, offsets = self._edges
        if field.has_all_beyond(float(np.min(offsets - normals @ np.array(base_from_sensor.translation[:2])))):
            return np.empty((0, 3))  # its blind zone lies within the footprint
        memory = self._memories.setdefault(
            scan.frame, BlindMemory(self._radius, self._config.memory_travel, self._footprint)
        )
        others = [(self._mounts[f].base_from_sensor, seen) for f, seen in self._fields.items() if f != scan.frame]
        may_leave = self._sees_all_around or not field.is_planar
        seconds = scan.stamp_ns * 1e-9 if may_leave else 0.0
        height = odom_from_base.translation[2]
        place = odom_from_base.to_se2()
        return memory.update(points, place, base_from_sensor, field, others, seconds, height, is_floor, beyond)

    def _on_range(self, measured: Range) -> None:
        """An echo that no scanner explains is an obstacle anywhere on its arc; one that nothing confirms yet leaves the last one."""
        measured = self._robot.timed(measured)
        placed = self._ranges.judge(measured)
        if placed is None:
            return
        arc = np.empty((0, 2))
        if placed.echo.is_unexplained and placed.echo.distance < ARC_REACH:
            arc = placed.odom_from_base.transform(placed.echo.arc(ARC_STEP))
        self._arcs[measured.frame] = (measured.stamp_ns, arc)
        points_odom = np.concatenate((arc, *self._links(measured.frame)))
        points = placed.odom_from_base.inverse().transform(points_odom)
        self.gate.update_points(measured.frame, measured.stamp_ns, points, placed.odom_from_base)

    def _links(self, frame: str) -> list[F64]:
        """Points between a transducer's arc and those of its two neighbours, in the odom frame."""
        stamp_ns, arc = self._arcs[frame]
        out: list[F64] = []
        for neighbour in self._neighbours[frame]:
            other_ns, other = self._arcs.get(neighbour, (NEVER_NS, arc[:0]))
            if len(arc) and len(other) and abs(stamp_ns - other_ns) < LINK_AGE_NS:
                out.append(link(arc, other, ARC_STEP, LINK_REACH))
        return out

    def _is_stuck(self, scan: LaserScan | PointCloud, odom_from_base: SE2) -> bool:
        values = scan.ranges if isinstance(scan, LaserScan) else scan.points
        is_stuck = self._repeats.setdefault(scan.frame, StuckScan()).update(values, odom_from_base)
        if is_stuck and scan.frame not in self._stuck:
            self.ctx.log("SCANNER_STUCK", f"{scan.frame} repeats itself while the robot moves", frame=scan.frame)
        (self._stuck.add if is_stuck else self._stuck.discard)(scan.frame)
        return is_stuck

    def _step(self) -> None:
        now_ns = self._step_ns = self.ctx.now_ns
        step = self.gate.step(now_ns)
        v = step.velocity
        self.ctx.publish(VELOCITY_COMMAND, VelocityCommand(now_ns, v.vx, v.vy, v.wz))
        last = self._status
        is_news = last is None or (step.state, step.reason, step.source) != (last.state, last.reason, last.source)
        if is_news or now_ns - self._status_ns >= STATUS_PERIOD_NS:
            self.ctx.publish(GATE_STATUS, GateStatus(now_ns, step.state, step.reason, step.source))
            if is_news:
                self.ctx.log(f"GATE_{GateState(step.state).name}", step.reason, source=step.source)
            self._status, self._status_ns = step, now_ns

    def _on_arm(self, request: GateRequest) -> GateReply:
        return GateReply(*self.gate.arm(self.ctx.now_ns))

    def _on_pause(self, request: GateRequest) -> GateReply:
        reason = f": {request.reason}" if request.reason else ""
        self.gate.pause(self.ctx.now_ns, f"PAUSED: by {request.source}{reason}")
        return GateReply(True, "paused")

    def _on_emergency_stop(self, request: GateRequest) -> GateReply:
        self.gate.emergency_stop(self.ctx.now_ns, request.source, request.reason)
        self._step()
        return GateReply(True, "stopped")

    def _on_permit(self, request: ApproachRequest) -> GateReply:
        now_ns = self.ctx.now_ns
        expires_ns = now_ns + round(request.seconds * 1e9)
        permit = ApproachPermit(request.odom_from_dock, request.outline, request.overrun, expires_ns)
        is_given, text = self.gate.permit_approach(permit, now_ns)
        if not is_given:
            self.ctx.log("APPROACH_REFUSED", text)
        return GateReply(is_given, text)

    def _on_revoke(self, request: Nothing) -> Nothing:
        self.gate.revoke_approach()
        return Nothing()

    def _on_reset(self, request: GateRequest) -> GateReply:
        return GateReply(*self.gate.reset(self.ctx.now_ns))


def _level_from_base(odom_from_base: SE3) -> SE3:
    """The lean of a body, without its place and heading."""
    lean = SE3((0.0, 0.0, 0.0), odom_from_base.rotation)
    return SE3.from_se2(SE2(0.0, 0.0, -lean.to_se2().yaw)) @ lean
