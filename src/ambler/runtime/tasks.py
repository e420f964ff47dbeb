"""The services and tasks of the stack, the second half of the one table: names, records, ROS names and definitions.

Those marked `is_outside` may be offered to people and machines outside the robot. The others are for its own nodes and
application: an approach permit lifts the gate's protection, and saving takes any path.
"""

from __future__ import annotations

from typing import Any, TypeVar

from ambler.core.requests import (
    ApproachRequest,
    DockFeedback,
    DockGoal,
    DockReport,
    EndProgramRequest,
    ExploreFeedback,
    ExploreGoal,
    ExploreResult,
    FollowPathFeedback,
    FollowPathGoal,
    GateReply,
    GateRequest,
    LevelRequest,
    NavigateFeedback,
    NavigateGoal,
    NavigateResult,
    Nothing,
    PicturesRequest,
    PlanReply,
    PlanRequest,
    RecoverGoal,
    RecoveryKind,
    SaveMapRequest,
    ScanStationFeedback,
    ScanStationGoal,
    ScanStationResult,
    TeachDockGoal,
    TeachDockReport,
    UndockGoal,
)
from ambler.runtime.node import Service, Task
from ambler.wire.ros_types import TRIGGER

# The records are part of the table, so that nodes find all of it in one place.
__all__ = [
    "ARM",
    "CAMERA_PICTURES",
    "CHOOSE_LEVEL",
    "CLEAR_GLOBAL_COSTMAP",
    "CLEAR_LOCAL_COSTMAP",
    "CLICKED_GOAL_OVER",
    "COMPUTE_PATH",
    "DOCK",
    "DOCK_FAILURES",
    "EMERGENCY_STOP",
    "END_PROGRAM",
    "EXPLORE",
    "FINISH_MAP",
    "FOLLOW_PATH",
    "LEVEL_NOT_REACHED",
    "NAVIGATE",
    "NEAREST_REACHED",
    "NO_SUCH_LEVEL",
    "PAUSE",
    "PERMIT_APPROACH",
    "RECOVER",
    "RELOCALIZE",
    "RESET_STOP",
    "REVOKE_APPROACH",
    "SAVE_CLOUD",
    "SAVE_GLASS",
    "SAVE_GRAPH",
    "SAVE_MAP",
    "SAVE_STATIONS",
    "SCAN_STATION",
    "SIT",
    "STAND",
    "STOP_CHARGING",
    "TEACH_DOCK",
    "UNDOCK",
    "ApproachRequest",
    "DockFeedback",
    "DockGoal",
    "DockReport",
    "EndProgramRequest",
    "ExploreFeedback",
    "ExploreGoal",
    "ExploreResult",
    "FollowPathFeedback",
    "FollowPathGoal",
    "GateReply",
    "GateRequest",
    "LevelRequest",
    "NavigateFeedback",
    "NavigateGoal",
    "NavigateResult",
    "Nothing",
    "PicturesRequest",
    "PlanReply",
    "PlanRequest",
    "RecoverGoal",
    "RecoveryKind",
    "SaveMapRequest",
    "ScanStationFeedback",
    "ScanStationGoal",
    "ScanStationResult",
    "TeachDockGoal",
    "TeachDockReport",
    "UndockGoal",
    "all_services",
    "all_tasks",
    "service_named",
    "task_named",
]

Q = TypeVar("Q")
R = TypeVar("R")
G = TypeVar("G")
F = TypeVar("F")

_SERVICES: dict[str, Service[Any, Any]] = {}
_TASKS: dict[str, Task[Any, Any, Any]] = {}


def _service(name: str, request: type[Q], reply: type[R], ros_type: str, *, is_outside: bool = False) -> Service[Q, R]:
    service = Service(name, request, reply, f"/{name}", ros_type, is_outside)
    _SERVICES[name] = service
    return service


def _task(
    name: str,
    goal: type[G],
    feedback: type[F],
    result: type[R],
    failures: tuple[str, ...],
    ros_type: str,
    *,
    is_outside: bool = False,
) -> Task[G, F, R]:
    task = Task(name, goal, feedback, result, failures, f"/{name}", ros_type, is_outside)
    _TASKS[name] = task
    return task


def all_services() -> tuple[Service[Any, Any], ...]:
    """Return every declared service in the order of declaration."""
    return tuple(_SERVICES.values())


def all_tasks() -> tuple[Task[Any, Any, Any], ...]:
    """Return every declared task in the order of declaration."""
    return tuple(_TASKS.values())


def service_named(name: str) -> Service[Any, Any]:
    """Return a service by its name or ROS name; raises KeyError."""
    return _SERVICES[name.removeprefix("/")]


def task_named(name: str) -> Task[Any, Any, Any]:
    """Return a task by its name or ROS name; raises KeyError."""
    return _TASKS[name.removeprefix("/")]


COMPUTE_PATH = _service("compute_path", PlanRequest, PlanReply, "ambler_msgs/srv/ComputePath", is_outside=True)
CLEAR_GLOBAL_COSTMAP = _service("clear_global_costmap", Nothing, Nothing, TRIGGER, is_outside=True)
CLEAR_LOCAL_COSTMAP = _service("clear_local_costmap", Nothing, Nothing, TRIGGER, is_outside=True)
ARM = _service("arm", GateRequest, GateReply, "ambler_msgs/srv/GateCommand", is_outside=True)
PAUSE = _service("pause", GateRequest, GateReply, "ambler_msgs/srv/GateCommand", is_outside=True)
EMERGENCY_STOP = _service("emergency_stop", GateRequest, GateReply, "ambler_msgs/srv/GateCommand", is_outside=True)
RESET_STOP = _service("reset_stop", GateRequest, GateReply, "ambler_msgs/srv/GateCommand", is_outside=True)
CHOOSE_LEVEL = _service("choose_level", LevelRequest, Nothing, "ambler_msgs/srv/ChooseLevel")
SAVE_MAP = _service("save_map", SaveMapRequest, Nothing, "ambler_msgs/srv/SaveMap")
SAVE_CLOUD = _service("save_cloud", SaveMapRequest, Nothing, "ambler_msgs/srv/SaveMap")
SAVE_GLASS = _service("save_glass", SaveMapRequest, Nothing, "ambler_msgs/srv/SaveMap")
SAVE_GRAPH = _service("save_graph", SaveMapRequest, Nothing, "ambler_msgs/srv/SaveMap")
SAVE_STATIONS = _service("save_stations", SaveMapRequest, Nothing, "ambler_msgs/srv/SaveMap")
CAMERA_PICTURES = _service(
    "camera_pictures", PicturesRequest, Nothing, "ambler_msgs/srv/CameraPictures", is_outside=True
)
STAND = _service("stand", Nothing, Nothing, TRIGGER, is_outside=True)
SIT = _service("sit", Nothing, Nothing, TRIGGER, is_outside=True)
STOP_CHARGING = _service("stop_charging", Nothing, Nothing, TRIGGER, is_outside=True)
PERMIT_APPROACH = _service("permit_approach", ApproachRequest, GateReply, "ambler_msgs/srv/PermitApproach")
REVOKE_APPROACH = _service("revoke_approach", Nothing, Nothing, TRIGGER)
END_PROGRAM = _service("end_program", EndProgramRequest, Nothing, "ambler_msgs/srv/EndProgram", is_outside=True)
RELOCALIZE = _service("relocalize", Nothing, Nothing, TRIGGER, is_outside=True)


FOLLOW_PATH = _task(
    "follow_path",
    FollowPathGoal,
    FollowPathFeedback,
    Nothing,
    ("INVALID_PATH", "TRANSFORM_MISSING", "STALE_INPUT", "NO_VALID_CONTROL", "FAILED_TO_MAKE_PROGRESS", "HELD"),
    "ambler_msgs/action/FollowPath",
)
RECOVER = _task(
    "recover",
    RecoverGoal,
    Nothing,
    Nothing,
    ("COLLISION_AHEAD", "TIMEOUT", "STALE_INPUT"),
    "ambler_msgs/action/Recover",
)
NEAREST_REACHED = "NEAREST_REACHED"
"""The goal of a drive cannot be reached, and the robot stands as near to it as it can."""
NO_SUCH_LEVEL = "NO_SUCH_LEVEL"
"""The goal lies on a level that the map does not have."""
LEVEL_NOT_REACHED = "LEVEL_NOT_REACHED"
"""No passage led the robot towards the level of its goal."""
NAVIGATE = _task(
    "navigate",
    NavigateGoal,
    NavigateFeedback,
    NavigateResult,
    (
        NEAREST_REACHED,
        *("NO_VALID_PATH", "GOAL_OUTSIDE_MAP", "START_OUTSIDE_MAP", "START_OCCUPIED", "RECOVERIES_EXHAUSTED", "LOST"),
        *(NO_SUCH_LEVEL, LEVEL_NOT_REACHED),
    ),
    "ambler_msgs/action/Navigate",
    is_outside=True,
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
DOCK = _task("dock", DockGoal, DockFeedback, DockReport, DOCK_FAILURES, "ambler_msgs/action/Dock", is_outside=True)
UNDOCK = _task(
    "undock", UndockGoal, DockFeedback, DockReport, DOCK_FAILURES, "ambler_msgs/action/Dock", is_outside=True
)
TEACH_DOCK = _task(
    "teach_dock",
    TeachDockGoal,
    DockFeedback,
    TeachDockReport,
    ("UNKNOWN_DOCK", "NOT_DOCKED", "NOT_CALIBRATED", "DOCK_NOT_SEEN", "DOCK_NOT_SAVED", "STALE_INPUT", "LOST"),
    "ambler_msgs/action/TeachDock",
    is_outside=True,
)
FINISH_MAP = _task("finish_map", Nothing, Nothing, Nothing, (), "ambler_msgs/action/FinishMap", is_outside=True)
"""Search once more for loop closures among everything that is known, and optimize; before a map is saved, while the robot stands."""
EXPLORE = _task(
    "explore",
    ExploreGoal,
    ExploreFeedback,
    ExploreResult,
    ("STUCK", "LOST", "RETURN_FAILED"),
    "ambler_msgs/action/Explore",
    is_outside=True,
)

SCAN_STATION = _task(
    "scan_station",
    ScanStationGoal,
    ScanStationFeedback,
    ScanStationResult,
    ("NOT_AT_REST", "MOVED", "LOST", "STALE_INPUT"),
    "ambler_msgs/action/ScanStation",
)

CLICKED_GOAL_OVER = "CLICKED_GOAL_OVER"
"""Code of the status with which the navigator says that a goal clicked by a person is over; explorers wait for it."""
