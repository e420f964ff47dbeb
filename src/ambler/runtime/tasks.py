"""The services and tasks of the stack, the second half of the one table."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Frontier, Path
from ambler.core.se2 import SE2
from ambler.runtime.node import Service, Task


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
    """Save the map as `<stem>.pgm` and `<stem>.yaml`."""

    stem: str


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
class TeachDockRequest:
    """Save where the robot stands now as the docked pose of a known dock."""

    name: str


@dataclass(frozen=True, slots=True)
class TeachDockReply:
    """The dock's new pose in the map."""

    map_from_dock: SE2


COMPUTE_PATH = Service("compute_path", PlanRequest, PlanReply)
CLEAR_GLOBAL_COSTMAP = Service("clear_global_costmap", Nothing, Nothing)
CLEAR_LOCAL_COSTMAP = Service("clear_local_costmap", Nothing, Nothing)
ARM = Service("arm", GateRequest, GateReply)
PAUSE = Service("pause", GateRequest, GateReply)
EMERGENCY_STOP = Service("emergency_stop", GateRequest, GateReply)
RESET_STOP = Service("reset_stop", GateRequest, GateReply)
SAVE_MAP = Service("save_map", SaveMapRequest, Nothing)
SAVE_GLASS = Service("save_glass", SaveMapRequest, Nothing)
CAMERA_PICTURES = Service("camera_pictures", PicturesRequest, Nothing)
STOP_CHARGING = Service("stop_charging", Nothing, Nothing)
PERMIT_APPROACH = Service("permit_approach", ApproachRequest, GateReply)
REVOKE_APPROACH = Service("revoke_approach", Nothing, Nothing)
TEACH_DOCK = Service("teach_dock", TeachDockRequest, TeachDockReply)
RELOCALIZE = Service("relocalize", Nothing, Nothing)


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


@dataclass(frozen=True, slots=True)
class RecoverGoal:
    """Turn by `amount` radians in place, or back up by `amount` metres."""

    kind: RecoveryKind
    amount: float


@dataclass(frozen=True, slots=True)
class NavigateGoal:
    """Drive to a pose of the map."""

    map_from_goal: SE2
    xy_tolerance: float = 0.15
    yaw_tolerance: float = 0.2


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
    """Named state of the explorer and what is still open."""

    state: str
    frontiers_open: int
    goals_reached: int
    known_area: float


@dataclass(frozen=True, slots=True)
class ExploreResult:
    """The proof: the frontiers that remain, each with its reason; and whether the robot came home."""

    remaining: tuple[Frontier, ...]
    goals_reached: int
    is_home: bool


@dataclass(frozen=True, slots=True)
class DockGoal:
    """Drive to a dock of the database and dock."""

    name: str


@dataclass(frozen=True, slots=True)
class UndockGoal:
    """Back out of a dock to its staging pose."""

    name: str


@dataclass(frozen=True, slots=True)
class DockFeedback:
    """Named state of the docking, one sentence, failed final approaches so far, and metres to the docked pose (None: not seen)."""

    state: str
    text: str
    attempts: int
    distance: float | None


@dataclass(frozen=True, slots=True)
class DockReport:
    """How it went: final approaches, seconds in all and from the staging pose on, the dock in the base frame by the last sightings."""

    attempts: int
    seconds: float
    docking_seconds: float
    base_from_dock: SE2 | None


FOLLOW_PATH = Task(
    "follow_path",
    FollowPathGoal,
    FollowPathFeedback,
    Nothing,
    ("INVALID_PATH", "TRANSFORM_MISSING", "STALE_INPUT", "NO_VALID_CONTROL", "FAILED_TO_MAKE_PROGRESS"),
)
RECOVER = Task("recover", RecoverGoal, Nothing, Nothing, ("COLLISION_AHEAD", "TIMEOUT", "STALE_INPUT"))
NEAREST_REACHED = "NEAREST_REACHED"
"""The goal of a drive cannot be reached, and the robot stands as near to it as it can."""
NAVIGATE = Task(
    "navigate",
    NavigateGoal,
    NavigateFeedback,
    NavigateResult,
    (
        NEAREST_REACHED,
        *("NO_VALID_PATH", "GOAL_OUTSIDE_MAP", "START_OUTSIDE_MAP", "START_OCCUPIED", "RECOVERIES_EXHAUSTED", "LOST"),
    ),
)
DOCK_FAILURES = (
    "UNKNOWN_DOCK",
    "NOT_DOCKED",
    "NOT_CALIBRATED",
    "NAVIGATION_FAILED",
    "DOCK_NOT_SEEN",
    "DOCK_LOST",
    "OUTSIDE_LIMITS",
    "NO_CONTACT",
    "NO_CHARGE",
    "BLOCKED",
    "TIMEOUT",
    "STALE_INPUT",
    "LOST",
)
DOCK = Task("dock", DockGoal, DockFeedback, DockReport, DOCK_FAILURES)
UNDOCK = Task("undock", UndockGoal, DockFeedback, DockReport, DOCK_FAILURES)
FINISH_MAP = Task("finish_map", Nothing, Nothing, Nothing, ())
"""Search once more for loop closures among everything that is known, and optimize; before a map is saved, while the robot stands."""
EXPLORE = Task("explore", ExploreGoal, ExploreFeedback, ExploreResult, ("STUCK", "LOST", "RETURN_FAILED"))

CLICKED_GOAL_OVER = "CLICKED_GOAL_OVER"
"""Code of the status with which the navigator says that a goal clicked by a person is over; explorers wait for it."""
