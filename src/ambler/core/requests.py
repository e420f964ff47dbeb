"""What services and tasks carry: frozen records, like messages, but asked for instead of published.

The table of services and tasks is `runtime.tasks`; every record has ROS definitions in `wire/srv` and `wire/action`, whose fields
have the same names (`wire.ros_records`).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Frontier, Path
from ambler.core.se2 import SE2

R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class TaskOutcome(Generic[R]):
    """How a task ended: `code` is SUCCEEDED, CANCELLED, PREEMPTED or one of the task's failures; `text` says why in one sentence."""

    code: str
    text: str
    result: R | None

    @property
    def is_success(self) -> bool:
        return self.code == "SUCCEEDED"


@dataclass(frozen=True, slots=True)
class Nothing:
    """An empty request or reply."""


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Ask for a path from the robot's pose to `map_from_goal`."""

    map_from_goal: SE2


@dataclass(frozen=True, slots=True)
class PlanReply:
    """A path in the map frame, its cost, and how far its end lies from the wanted goal, metres (0: exactly there)."""

    path: Path
    cost: float
    goal_distance: float


@dataclass(frozen=True, slots=True)
class GateRequest:
    """Ask the gate to arm, pause, stop or reset; `source` says who asks, `reason` why."""

    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class GateReply:
    """Whether the gate did it, and if not, why."""

    is_done: bool
    text: str


@dataclass(frozen=True, slots=True)
class SaveMapRequest:
    """Save the map as `<stem>.pgm` and `<stem>.yaml`, or what belongs to it beside them."""

    stem: str


@dataclass(frozen=True, slots=True)
class LevelRequest:
    """Draw into this level of the map of ground as soon as what the robot sees fits it."""

    level: int


@dataclass(frozen=True, slots=True)
class PicturesRequest:
    """Ask the camera for pictures for so many seconds from now on; nobody needs to say that they are no longer wanted."""

    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class ApproachRequest:
    """Ask the gate to let a dock's outline float64 (N, 2), in the dock's frame, be approached for `seconds`, and the base to go
    `overrun` metres beyond the docked pose (safety.approach_permit)."""

    odom_from_dock: SE2
    outline: NDArray[np.float64]
    overrun: float
    seconds: float


@dataclass(frozen=True, slots=True)
class EndProgramRequest:
    """Ask whoever carries out a program of steps to end it: `code` and one sentence say why, and become those of the program."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class FollowPathGoal:
    """Follow a path in the map frame to its end; newer paths on the `path` topic replace it while the goal is active."""

    path: Path
    xy_tolerance: float = 0.15
    yaw_tolerance: float = 0.2


@dataclass(frozen=True, slots=True)
class FollowPathFeedback:
    """How much path is left, metres."""

    distance_remaining: float


class RecoveryKind(enum.Enum):
    """What the base may do to free itself."""

    ROTATE = "rotate"
    BACK_UP = "back_up"
    MAKE_ROOM = "make_room"


@dataclass(frozen=True, slots=True)
class RecoverGoal:
    """Turn by `amount` radians in place, back up by `amount` metres, or go at most `amount` metres ahead or back to where there is room to turn."""

    kind: RecoveryKind
    amount: float


@dataclass(frozen=True, slots=True)
class NavigateGoal:
    """Drive to a pose of the map. `level` is the one of a map of ground (core.messages.GroundLevels) that the pose lies on; None: the one on which the robot
    is when it gets there."""

    map_from_goal: SE2
    xy_tolerance: float = 0.15
    yaw_tolerance: float = 0.2
    level: int | None = None


@dataclass(frozen=True, slots=True)
class NavigateFeedback:
    """Named state of the navigator, path left in metres, and recoveries used so far."""

    state: str
    distance_remaining: float
    recoveries: int


@dataclass(frozen=True, slots=True)
class NavigateResult:
    """Where the robot ended, and how far from the wanted goal (m)."""

    map_from_base: SE2 | None
    goal_distance: float
    recoveries: int


@dataclass(frozen=True, slots=True)
class ExploreGoal:
    """Explore until no reachable frontier is left, then return to the start if wanted."""

    return_to_start: bool = True
    boundary: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class ExploreFeedback:
    """Named state of the explorer, what is still open, and at how many stations it has held still."""

    state: str
    frontiers_open: int
    goals_reached: int
    known_area: float
    stations: int = 0


@dataclass(frozen=True, slots=True)
class ExploreResult:
    """The proof: the frontiers that remain, each with its reason; and whether the robot came home."""

    remaining: tuple[Frontier, ...]
    goals_reached: int
    is_home: bool


@dataclass(frozen=True, slots=True)
class ScanStationGoal:
    """Collect a dense cloud for `seconds` while the base is at rest; `level` is the one of a map of ground on which it stands."""

    seconds: float
    level: int = 0


@dataclass(frozen=True, slots=True)
class ScanStationFeedback:
    """What is being done, in words, and for how many seconds the base has held still."""

    state: str
    seconds: float


@dataclass(frozen=True, slots=True)
class ScanStationResult:
    """The station's number, from 1 on (0: nothing was kept), for how long it held, and how many scans and points it holds."""

    number: int
    seconds: float
    scans: int
    points: int


@dataclass(frozen=True, slots=True)
class DockGoal:
    """Drive to a dock of the database and dock."""

    name: str


@dataclass(frozen=True, slots=True)
class UndockGoal:
    """Back out of a dock to its staging pose."""

    name: str


@dataclass(frozen=True, slots=True)
class TeachDockGoal:
    """Save where the robot stands now as the docked pose of a known dock, and how what it sees there differs from that."""

    name: str


@dataclass(frozen=True, slots=True)
class TeachDockReport:
    """The dock's new pose in the map, the offset of its detections in its own frame, and of how many of them that is the mean."""

    map_from_dock: SE2
    offset: SE2
    sightings: int


@dataclass(frozen=True, slots=True)
class DockFeedback:
    """Named state of the docking, one sentence, failed final approaches so far, and metres to the docked pose (None: not seen)."""

    state: str
    text: str
    attempts: int
    distance: float | None


@dataclass(frozen=True, slots=True)
class DockReport:
    """How it went: final approaches, seconds in all and from the staging pose on, the dock in the base frame by the last detections."""

    attempts: int
    seconds: float
    docking_seconds: float
    base_from_dock: SE2 | None
