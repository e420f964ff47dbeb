"""What one room needs of another, so that no two algorithm rooms import each other; nodes and apps inject the parts."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import PointCloud, VisibilityGraphView
from ambler.core.movers import Movers
from ambler.core.se2 import SE2


@dataclass(frozen=True, slots=True)
class PlanResult:
    """A path float64 (N, 3) of (x, y, yaw) in the grid's frame, its cost, and how far its end lies from the wanted goal."""

    path: NDArray[np.float64]
    cost: float
    goal_distance: float


class GlobalPlanner(Protocol):
    """Plans over a cost grid (uint8 [iy, ix]). Same input, same output; never through lethal or unknown cells."""

    def plan(self, costs: NDArray[np.uint8], spec: GridSpec, start: SE2, goal: SE2) -> PlanResult:
        """Return a path from start to goal or the nearest reachable cell; raises a PlanningError subclass."""
        ...


class PlanStatus(enum.Enum):
    """What the last plan was: a way over known ground, an attempt through unknown ground or to the edge of what is known, or none, though every frontier that can be
    reached was attempted. PLANNING: a goal for which neither is said yet."""

    PLANNING = "PLANNING"
    FREE_PATH = "FREE_PATH"
    ATTEMPTING = "ATTEMPTING"
    UNREACHABLE = "UNREACHABLE"


@runtime_checkable
class GraphPlanner(GlobalPlanner, Protocol):
    """A planner that keeps a graph from plan to plan, one for each level of a map of ground; `status` tells of the last plan."""

    status: PlanStatus

    def enter_level(self, level: int) -> None:
        """Take that the costs of the next plans are those of this level."""
        ...

    def view(self, stamp_ns: int, frame: str) -> VisibilityGraphView:
        """Return the graph of the level of the last plan as people are shown it, in the frame of that plan."""
        ...

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the graphs of all levels without loss, as named arrays of plain numbers."""
        ...


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """A velocity in the base frame: m/s, m/s, rad/s."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0


class LocalPlanner(Protocol):
    """Follows a path inside a local cost grid; both are in the odom frame."""

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The motion that the last command begins, for people to see: float64 (N, 3) of (x, y, yaw), empty when there is none."""
        ...

    def set_path(self, path_odom: NDArray[np.float64]) -> None:
        """Take a new path float64 (N, 3); raises InvalidPathError."""
        ...

    def compute_command(
        self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity
    ) -> BodyVelocity:
        """Return the next command; raises NoValidControlError when every admissible motion collides."""
        ...


@runtime_checkable
class MoverAware(Protocol):
    """A local planner that looks ahead at what moves; one that does not is held back before it all the same."""

    def set_movers(self, movers: Movers) -> None:
        """Take the movers of now, in the odom frame, before `compute_command`."""
        ...


@runtime_checkable
class TakesNo(Protocol):
    """A local planner that looks for another motion where the one that it likes best is refused, because it would start a contact with somebody."""

    def set_refusal(self, is_refused: Callable[[BodyVelocity], bool]) -> None:
        """Take who is asked, in `compute_command`, about velocities of the base."""
        ...


class LocalState(enum.StrEnum):
    """What a local planner is doing, or why it stands."""

    IDLE = "idle"
    DRIVING = "driving"
    SLOWED = "slowed"
    TURNING = "turning"
    LEAVING_DEAD_END = "leaving_dead_end"
    FROZEN = "frozen"
    BLOCKED = "blocked"
    LEANING = "leaning"
    GOAL_REACHED = "goal_reached"


@runtime_checkable
class TellsState(Protocol):
    """A local planner that says what it does and why."""

    state: LocalState
    reason: str


@dataclass(frozen=True, slots=True)
class Lean:
    """How a body leans and how fast that changes: rad and rad/s."""

    roll: float = 0.0
    pitch: float = 0.0
    roll_rate: float = 0.0
    pitch_rate: float = 0.0


@runtime_checkable
class LeanAware(Protocol):
    """A local planner that is slow on a lean, and stands on one from which the robot could fall."""

    def set_lean(self, lean: Lean) -> None:
        """Take the lean of now, before `compute_command`."""
        ...


@runtime_checkable
class Steers(Protocol):
    """A local planner that a person can steer: around what is in the way, where a direction and a speed point (a smart joystick)."""

    def steer(
        self,
        costs: NDArray[np.uint8],
        spec: GridSpec,
        odom_from_base: SE2,
        velocity: BodyVelocity,
        wanted: BodyVelocity,
    ) -> BodyVelocity:
        """Return the velocity that comes nearest to the wanted one; raises NoValidControlError."""
        ...


class CloudFilter(Protocol):
    """Says which returns of a scanner's clouds come from surfaces; it remembers the clouds before, so each scanner needs its own."""

    def keep(
        self,
        cloud: PointCloud,
        asked: NDArray[np.int64],
        place: Callable[[NDArray[np.int64]], NDArray[np.floating]],
    ) -> NDArray[np.bool_]:
        """Return which of the points `asked` (M,) are kept, bool (M,). `place` returns where points of some numbers (K,) lie in a frame that stands still, (K, 3)."""
        ...
