"""A kinematic base that obeys its acceleration limits, in a world of lethal cells: what every local planner is driven against."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.control.checkers import GoalChecker
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.protocols import BodyVelocity, LocalPlanner
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]
RESOLUTION = 0.05
PERIOD = 0.05

DIFF = RobotModel(
    "diff",
    DriveKind.DIFFERENTIAL,
    np.array([[0.25, -0.2], [0.25, 0.2], [-0.25, 0.2], [-0.25, -0.2]]),
    VelocityLimits(0.8, -0.3, 0.0, 1.5),
)
SPOT = RobotModel(
    "spot",
    DriveKind.OMNI,
    np.array([[0.55, -0.25], [0.55, 0.25], [-0.55, 0.25], [-0.55, -0.25]]),
    VelocityLimits(0.8, -0.4, 0.4, 1.2),
)
ROBOTS = {"diff": DIFF, "spot": SPOT}


class World:
    """Lethal cells on a large grid; `window` cuts the rolling local costmap around a place."""

    def __init__(self, size: float = 16.0) -> None:
        cells = round(size / RESOLUTION)
        self.spec = GridSpec(RESOLUTION, cells, cells, -size / 2, -size / 2)
        self.costs = np.zeros(self.spec.shape, np.uint8)

    def block(self, x0: float, y0: float, x1: float, y1: float) -> World:
        """Make every cell that a box touches lethal."""
        a, b = self.spec.cell_of(x0 + 1e-6, y0 + 1e-6), self.spec.cell_of(x1 - 1e-6, y1 - 1e-6)
        self.costs[max(0, a[0]) : b[0] + 1, max(0, a[1]) : b[1] + 1] = COST_LETHAL
        return self

    def window(self, x: float, y: float, size: float) -> tuple[NDArray[np.uint8], GridSpec]:
        cells = round(size / RESOLUTION)
        iy, ix = self.spec.cell_of(x, y)
        iy = min(max(0, iy - cells // 2), self.spec.height - cells)
        ix = min(max(0, ix - cells // 2), self.spec.width - cells)
        part = np.ascontiguousarray(self.costs[iy : iy + cells, ix : ix + cells])
        origin = (self.spec.origin_x + ix * RESOLUTION, self.spec.origin_y + iy * RESOLUTION)
        return part, GridSpec(RESOLUTION, cells, cells, *origin)

    def touches(self, robot: RobotModel, pose: SE2) -> bool:
        """Whether a lethal cell's centre lies inside the robot's footprint: a slow, independent check."""
        cells = np.argwhere(self.costs == COST_LETHAL)
        points = pose.inverse().transform(self.spec.centers_of(cells)) if len(cells) else np.empty((0, 2))
        a, b = robot.footprint, np.roll(robot.footprint, -1, axis=0)
        inside = np.ones(len(points), bool)
        for p, q in zip(a, b, strict=True):
            inside &= (q[0] - p[0]) * (points[:, 1] - p[1]) - (q[1] - p[1]) * (points[:, 0] - p[0]) > 0.0
        return bool(inside.any())


@dataclass
class Drive:
    """What happened on a drive."""

    poses: list[SE2] = field(default_factory=list)
    commands: list[BodyVelocity] = field(default_factory=list)
    velocities: list[BodyVelocity] = field(default_factory=list)
    is_reached: bool = False
    collisions: int = 0

    @property
    def seconds(self) -> float:
        return len(self.commands) * PERIOD


def step_velocity(v: BodyVelocity, command: BodyVelocity, limits: VelocityLimits, dt: float) -> BodyVelocity:
    def axis(value: float, target: float, up: float, down: float) -> float:
        rate = down if value * target < 0 or abs(target) < abs(value) else up
        return value + math.copysign(min(abs(target - value), rate * dt), target - value)

    return BodyVelocity(
        axis(v.vx, command.vx, limits.ax_max, limits.ax_brake),
        axis(v.vy, command.vy, limits.ay_max, limits.ay_brake),
        axis(v.wz, command.wz, limits.az_max, limits.az_max),
    )


def drive(
    planner: LocalPlanner,
    robot: RobotModel,
    world: World,
    path: F64,
    start: SE2,
    seconds: float = 60.0,
    xy_tolerance: float = 0.15,
    yaw_tolerance: float = 0.2,
    window: float = 5.0,
    delay: int = 1,
    log: Drive | None = None,
) -> Drive:
    """Follow a path until it is reached or the time is over; commands take effect `delay` control periods later."""
    planner.set_path(path)
    checker = GoalChecker(xy_tolerance, yaw_tolerance)
    goal = SE2.from_array(path[-1])
    pose, v = start, BodyVelocity()
    log = Drive() if log is None else log
    waiting = [BodyVelocity()] * delay
    for _ in range(round(seconds / PERIOD)):
        if checker.update(pose, goal, v, getattr(planner, "path_left", 0.0)):
            log.is_reached = True
            break
        costs, spec = world.window(pose.x, pose.y, window)
        command = planner.compute_command(costs, spec, pose, v)
        waiting.append(command)
        obeyed = waiting.pop(0)
        for _ in range(5):
            v = step_velocity(v, obeyed, robot.limits, PERIOD / 5)
            pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * PERIOD / 5)
        log.poses.append(pose)
        log.commands.append(command)
        log.velocities.append(v)
        log.collisions += world.touches(robot, pose)
    return log


def line(*points: tuple[float, float], yaw: float | None = None) -> F64:
    """A path along straight lines, at 5 cm, its poses looking along it and the last one at `yaw`."""
    parts = []
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        count = max(2, round(math.hypot(x1 - x0, y1 - y0) / 0.05) + 1)
        heading = math.atan2(y1 - y0, x1 - x0)
        parts.append(
            np.stack((np.linspace(x0, x1, count), np.linspace(y0, y1, count), np.full(count, heading)), axis=1)
        )
    path = np.concatenate(parts)
    if yaw is not None:
        path[-1, 2] = yaw
    return path


def arc(radius: float, angle: float) -> F64:
    """A path along an arc to the left, from the origin looking along x."""
    a = np.linspace(0.0, angle, max(2, round(abs(radius * angle) / 0.05)))
    return np.stack((radius * np.sin(a), radius * (1.0 - np.cos(a)), a), axis=1)
