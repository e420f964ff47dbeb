"""What a robot can be sent to do, one step after the other, and how each step ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ambler.core.se2 import SE2
from ambler.runtime.node import Task


@dataclass(frozen=True, slots=True)
class ExploreStep:
    """Explore until no reachable frontier is left and come home; then have the map finished and saved."""


@dataclass(frozen=True, slots=True)
class NavigateStep:
    """Drive to a pose of the map, on a `level` of a map of ground (None: as in core.requests.NavigateGoal). One that fails does not end the program."""

    map_from_goal: SE2
    xy_tolerance: float = 0.15
    yaw_tolerance: float = 0.2
    level: int | None = None


@dataclass(frozen=True, slots=True)
class DockStep:
    """Drive to a known dock and dock."""

    dock: str


@dataclass(frozen=True, slots=True)
class UndockStep:
    """Back out of a dock to its staging pose."""

    dock: str


@dataclass(frozen=True, slots=True)
class TeachStep:
    """Save where the robot stands as the docked pose of a known dock."""

    dock: str


@dataclass(frozen=True, slots=True)
class TaskStep:
    """Send a goal of any task that some node serves: a mission of one's own."""

    task: Task[Any, Any, Any]
    goal: Any


Step = ExploreStep | NavigateStep | DockStep | UndockStep | TeachStep | TaskStep
NAMES: dict[type[Any], str] = {
    ExploreStep: "explore",
    NavigateStep: "navigate",
    DockStep: "dock",
    UndockStep: "undock",
    TeachStep: "teach",
    TaskStep: "task",
}


def name_of(step: Step) -> str:
    """Return the word for a kind of step, as in the names of results."""
    return NAMES[type(step)]


@dataclass(frozen=True, slots=True)
class StepEnd:
    """How a step ended: SUCCEEDED or a named failure, why in one sentence, the task's result (None where there is none), and the instants
    of the executor between which it was done."""

    step: Step
    code: str
    text: str
    result: Any
    begun_ns: int
    ended_ns: int

    @property
    def is_success(self) -> bool:
        return self.code == "SUCCEEDED"


@dataclass(frozen=True, slots=True)
class ProgramEnd:
    """How a program ended. `code` is SUCCEEDED, the first failure's, NOT_LOCALIZED, or why it was ended from outside; `states` are the
    states that docking told, with their instants; `where` is the pose in the map that the robot found before its first step."""

    code: str
    text: str
    ends: tuple[StepEnd, ...]
    states: tuple[tuple[int, str], ...] = ()
    where: SE2 | None = None

    @property
    def is_success(self) -> bool:
        return self.code == "SUCCEEDED"


def kinds() -> dict[str, type[Any]]:
    """Return the kinds of steps by their words."""
    return {word: kind for kind, word in NAMES.items()}
