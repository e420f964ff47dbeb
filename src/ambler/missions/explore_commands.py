"""What the exploration mission sees, is told and commands: states, configuration, view, commands."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import CostGrid, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.core.units import Radians
from ambler.exploration.choice import ChoiceConfig
from ambler.missions.drive_to import DriveTo
from ambler.missions.stations import StationsConfig
from ambler.runtime.tasks import ExploreResult


class ExploreState(enum.Enum):
    """What the mission is doing."""

    IDLE = "idle"
    STARTING = "starting"
    CHOOSING = "choosing"
    DRIVING = "driving"
    LOOKING = "looking"
    RETURNING = "returning"
    CHANGING_LEVEL = "changing_level"
    DOUBTING = "doubting"
    SCANNING = "scanning"
    FINISHED = "finished"
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class ExploreConfig:
    """Times in seconds, lengths in metres. `goal_shift` is how far a frontier's goal may move before it is sent again;
    a target that cannot be reached any more once the robot is within `visit_range` of it counts as looked at;
    a robot that stands within `home_near` of an occupied home is at home; `lookout_time` is how long it may drive to where the way home is
    shut. After drives to `shut_failures` places that failed from one it waits and turns
    there before it tries again, doubts the terrain within `doubted` metres, and is stuck after `stuck_failures` and `stuck_time`. A way home that stays shut is tried again for `return_time`: who stands there leaves, and waiting costs less than a robot that is fetched; every second time it makes room, to where it was last `give_way` metres away, and farther by as much with each time up to `give_way_most` metres, for who waits for the robot to leave. A level that a robot cannot come to in `level_tries` drives is left out. A robot whose map is in doubt goes `doubt_way` metres back along its way, beyond what SLAM lets pass before it doubts, and has
    `doubt_time` to find itself again before the exploration ends as LOST. Where people were about within `company_time`, nothing is taken to be shut, and no drive to be
    hopeless, that they may stand in the way of: the robot goes there and looks, up to `company_looks` times in a row that show nothing new, and is stuck after `company_patience` times `stuck_time` only, and tries the way home for as many times `return_time`. While it drives through a map of
    n times `wide_cells` cells (50 m square), n > 1, the frontiers are searched every n seconds only."""

    start_timeout: float = 60.0
    look_time: float = 1.5
    sweep_time: float = 2.5
    near: float = 1.0
    visit_range: float = 6.0
    progress_timeout: float = 30.0
    progress_distance: float = 0.3
    goal_shift: float = 0.4
    shut_failures: int = 3
    stuck_failures: int = 8
    stuck_time: float = 120.0
    stuck_distance: float = 0.5
    doubted: float = 1.5
    min_reachable_area: float = 0.5
    return_time: float = 180.0
    return_pause: float = 8.0
    give_way: float = 2.0
    give_way_most: float = 10.0
    lookout_time: float = 120.0
    held_timeout: float = 10.0
    max_resumes: int = 5
    xy_tolerance: float = 0.3
    yaw_tolerance: Radians = 0.6
    home_xy_tolerance: float = 0.15
    home_yaw_tolerance: Radians = 0.2
    home_near: float = 0.6
    wide_cells: int = 1_000_000
    level_tries: int = 4
    doubt_way: float = 4.0
    doubt_time: float = 90.0
    company_time: float = 60.0
    company_looks: int = 6
    company_patience: float = 15.0
    choice: ChoiceConfig = field(default_factory=ChoiceConfig)
    stations: StationsConfig = field(default_factory=StationsConfig)


@dataclass(frozen=True, slots=True)
class ExploreView:
    """What the mission sees at one instant; both grids and the pose are in the map frame. In a place of several levels the grids are those of `level`, and
    `passages` are as in core.messages.GroundLevels. `tilt` (rad) is by how much the base leans."""

    now_ns: int
    map: OccupancyGrid
    costs: CostGrid
    map_from_base: SE2
    level: int = 0
    passages: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 5)))
    tilt: float = 0.0


@dataclass(frozen=True, slots=True)
class TurnAround:
    """Turn in place by `angle` radians; the end must be reported with the same `drive`."""

    drive: int
    angle: float


@dataclass(frozen=True, slots=True)
class HoldStation:
    """Collect a dense cloud for `seconds` as soon as the robot is at rest; the end must be reported with the same `drive`."""

    drive: int
    seconds: float
    level: int


@dataclass(frozen=True, slots=True)
class StopDriving:
    """Cancel the running drive or station; its end need not be reported."""


@dataclass(frozen=True, slots=True)
class ClearCosts:
    """Clear the global costmap of what only its obstacle layer believes."""


@dataclass(frozen=True, slots=True)
class DoubtTerrain:
    """Have the terrain within `radius` metres of the robot forgotten: what shuts it in there it may not see any more, and never have been."""

    radius: float


@dataclass(frozen=True, slots=True)
class ChangeLevel:
    """Take this level for the one that the robot is on as soon as what it sees fits it."""

    level: int


@dataclass(frozen=True, slots=True)
class Ended:
    """The mission is over: SUCCEEDED, CANCELLED or a failure of the EXPLORE task, with one sentence and the proof."""

    code: str
    text: str
    result: ExploreResult


Command = DriveTo | TurnAround | HoldStation | StopDriving | ClearCosts | DoubtTerrain | ChangeLevel | Ended
