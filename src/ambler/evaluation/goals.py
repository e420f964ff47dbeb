"""Random goals that a robot can reach, and what the truth of a recording says of the drives to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Contact, Odometry
from ambler.core.se2 import SE2
from ambler.evaluation.collisions import find_collisions
from ambler.evaluation.truth_frame import TruthFrame
from ambler.runtime.topics import CONTACT, TRUE_POSE
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec
from ambler.sim.truth import reachable_cells
from ambler.wire.mcap_reader import read_recording

RESOLUTION = 0.05
MARGIN = 0.05
MOVING = 0.05


def draw_goals(world: WorldSpec, robot: SimRobot, count: int, rng: np.random.Generator) -> tuple[SE2, ...]:
    """Draw poses of the drawn map, uniformly over the places that the robot's circumscribed circle and 5 cm more can get to from the
    start, with any heading; fewer goals are the first of more. Raises BadInputError if there is none."""
    radius = robot.model.circumscribed_radius + MARGIN
    spec, reachable = reachable_cells(world.from_start(), radius, RESOLUTION, robot.sensor_height)
    cells = np.argwhere(reachable)
    if len(cells) == 0:
        raise BadInputError(f"world {world.name}: {robot.model.name} cannot get anywhere from its start")
    chances = rng.random((count, 2))
    centers = spec.centers_of(cells[(chances[:, 0] * len(cells)).astype(np.int64)])
    yaws = (chances[:, 1] - 0.5) * 2.0 * math.pi
    return tuple(SE2(float(x), float(y), float(yaw)) for (x, y), yaw in zip(centers, yaws, strict=True))


@dataclass(frozen=True, slots=True)
class DriveSpan:
    """A drive as the robot tells it: the goal, how it ended, and the instants between which it was under way."""

    goal: SE2
    code: str
    begun_ns: int
    ended_ns: int


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive to a goal by the truth: how it ended, seconds, the path's length (m), the median speed while moving (m/s; None if it
    never moved), and how far from the goal it ended (m)."""

    code: str
    seconds: float
    path_length: float
    speed: float | None
    error: float


def judge_drives(recording: Path, spans: Sequence[DriveSpan], frame: TruthFrame) -> tuple[list[Drive], int]:
    """Return what truly became of each drive, and the number of collisions; `frame` is that of the goals. Raises BadInputError if the
    recording cannot be read."""
    truth: list[tuple[int, float, float]] = []
    contacts: list[Contact] = []
    for recorded in read_recording(recording, [TRUE_POSE.ros_name, CONTACT.ros_name]):
        if recorded.topic == TRUE_POSE.ros_name:
            message = recorded.decode_as(Odometry)
            pose = frame.pose(message.pose.to_se2())
            truth.append((message.stamp_ns, pose.x, pose.y))
        else:
            contacts.append(recorded.decode_as(Contact))
    rows = np.array(truth).reshape(-1, 3)
    return [_judge(rows, span) for span in spans], len(find_collisions(contacts))


def _judge(truth: NDArray[np.float64], span: DriveSpan) -> Drive:
    goal, code = span.goal, span.code
    rows = truth[(truth[:, 0] >= span.begun_ns) & (truth[:, 0] <= span.ended_ns)]
    seconds = (span.ended_ns - span.begun_ns) * 1e-9
    if len(rows) < 2:
        return Drive(code, seconds, 0.0, None, math.nan)
    steps = np.hypot(np.diff(rows[:, 1]), np.diff(rows[:, 2]))
    speeds = steps / (np.diff(rows[:, 0]) * 1e-9)
    moving = speeds[speeds > MOVING]
    error = math.hypot(rows[-1, 1] - goal.x, rows[-1, 2] - goal.y)
    return Drive(code, seconds, float(steps.sum()), float(np.median(moving)) if len(moving) else None, error)
