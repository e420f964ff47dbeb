"""Drives for measurements: a simulated robot follows a route by its true pose, as if on rails, while everything is recorded.

So the drive does not depend on the localization that is measured with it, and one recording serves every method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import RobotConfig, default_config
from ambler.apps.robot import sensing_nodes
from ambler.bridges.recorder import Recorder
from ambler.core.messages import Odometry
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.devices.table import device_nodes
from ambler.nodes.devices.truth import TruthNode
from ambler.perception.scanner_profile import calibrated_robot
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.stack import Stack
from ambler.runtime.topics import IMU, MERGED_CLOUD, ODOMETRY, SCAN, TRUE_POSE, TRUE_START, VELOCITY_COMMAND
from ambler.sim.body import Body
from ambler.sim.devices import SimulatedBase
from ambler.sim.ground_truth import GroundTruth
from ambler.sim.movers import distance_to_polygon
from ambler.sim.robot_devices import robot_devices
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec
from ambler.sim.world import BodySpec, SimulationConfig, World

F64 = NDArray[np.float64]
SENSING = ("odometry", "scanners")  # the settings on which a recording depends
RECORDED = (SCAN, MERGED_CLOUD, ODOMETRY, IMU, TRUE_POSE, TRUE_START)  # the raw scans are in the merged ones


@dataclass(frozen=True, slots=True)
class Route:
    """Way points (x, y) in the frame of the start pose, driven forward at `speed` m/s, curves and all, after standing for `rest` s. The
    robot looks along its way; `turn` radians are turned in place (rad/s: `turn_rate`) before it leaves. It waits while somebody before it is
    nearer than `room` metres. The drive ends `rest_after` seconds after the last point (None: only with its time)."""

    points: tuple[tuple[float, float], ...] = ()
    speed: float = 0.6
    turn_rate: float = 0.6
    turn: float = 0.0
    rest: float = 1.0
    room: float = 0.0
    rest_after: float | None = None


class Rail:
    """Commands that keep a base on its route: pure pursuit of the true pose, slower in curves and before the end."""

    def __init__(self, route: Route) -> None:
        self._route = route
        self._points = np.array(route.points, float).reshape(-1, 2)
        self._next = 0
        self._turned = 0.0
        self._last_yaw: float | None = None

    @property
    def is_done(self) -> bool:
        """Whether the last point was reached."""
        return self._next >= len(self._points)

    def compute_command(self, seconds: float, map_from_base: SE2) -> BodyVelocity:
        """Return the command at `seconds` after the start of the drive."""
        route = self._route
        if seconds < route.rest:
            return BodyVelocity()
        if self._last_yaw is not None:
            self._turned += wrap_angle(map_from_base.yaw - self._last_yaw)
        self._last_yaw = map_from_base.yaw
        left = route.turn - self._turned
        if self._next == 0 and abs(left) > 0.05 and left * route.turn > 0.0:
            return BodyVelocity(0.0, 0.0, math.copysign(route.turn_rate, left))
        while self._next < len(self._points):
            target = map_from_base.inverse().transform(self._points[self._next][None])[0]
            distance = math.hypot(*target)
            if distance > 0.25:
                return self._towards(target, distance)
            self._next += 1
        return BodyVelocity()

    def _towards(self, target: F64, distance: float) -> BodyVelocity:
        route, bearing = self._route, math.atan2(target[1], target[0])
        wz = max(-route.turn_rate, min(route.turn_rate, 2.0 * bearing))
        if abs(bearing) > 0.5:
            return BodyVelocity(0.0, 0.0, wz)
        return BodyVelocity(min(route.speed, 0.15 + distance) * math.cos(bearing) ** 4, 0.0, wz)


class RailedBase(SimulatedBase):
    """A base that follows a route by its true pose, told in the frame of its start; commands from outside are not expected."""

    def __init__(self, world: World, body: Body, route: Route) -> None:
        super().__init__(world, body)
        self.rail, self._frame, self._room = Rail(route), TruthFrame(body.start), route.room

    def read(self, now_ns: int) -> Sequence[Odometry]:
        """Command the base, then let time pass as for any base."""
        world_from_base = self._body.world_from_base.to_se2()
        command = self.rail.compute_command(self._world.elapsed_ns * 1e-9, self._frame.pose(world_from_base))
        self.command(BodyVelocity() if self._is_somebody_ahead(world_from_base) else command)
        return super().read(now_ns)

    def _is_somebody_ahead(self, world_from_base: SE2) -> bool:
        if self._room <= 0.0:
            return False
        footprint = self._body.footprint_world
        for walker in self._world.crowd.walkers:
            ahead = world_from_base.inverse().transform(np.array([walker.position]))[0, 0]
            gap = distance_to_polygon(walker.position, footprint) - walker.person.radius
            if ahead > 0.0 and gap < self._room:
                return True
        return False


def record_drive(
    folder: Path,
    world: WorldSpec,
    robot: SimRobot,
    route: Route,
    duration: float,
    config: SimulationConfig,
    start: SE2 | None = None,
    settings: RobotConfig | None = None,
) -> Path:
    """Drive `route` for `duration` seconds from `start` in the world (None: its start) and record merged scan and cloud, odometry, IMU
    and truth into `folder`; returns it. Of `settings` (None: the robot's defaults) what `SENSING` names is used."""
    settings = settings if settings is not None else default_config(robot.model)
    running = World(world, [BodySpec("robot", robot, start)], config)
    devices = robot_devices(running, "robot")
    (body,) = running.bodies
    base = RailedBase(running, body, route)
    nodes = device_nodes(robot.model, replace(devices, base=base))
    nodes.append(TruthNode(GroundTruth(running, body)))
    nodes += sensing_nodes(calibrated_robot(robot.model, settings.scanners), settings)
    recorder = Recorder(folder)
    executor = LockstepExecutor(Stack(nodes, external=(VELOCITY_COMMAND,)))
    with executor:
        executor.tap(lambda topic, *told: recorder.on_message(topic, *told) if topic in RECORDED else None)
        if route.rest_after is None:
            executor.run(duration)
        else:
            while not base.rail.is_done and executor.now_ns < duration * 1e9:
                executor.run(1.0)
            executor.run(route.rest_after)
    recorder.close()
    return folder
