"""The command that every mission which drives somewhere gives."""

from __future__ import annotations

from dataclasses import dataclass

from ambler.core.se2 import SE2


@dataclass(frozen=True, slots=True)
class DriveTo:
    """Drive to a pose of the map with the navigator, in place of a running drive; the end must be reported with the same `drive`."""

    drive: int
    map_from_goal: SE2
    xy_tolerance: float
    yaw_tolerance: float
