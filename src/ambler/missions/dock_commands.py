"""What the docking mission is told, sees and commands: states, configuration, view, commands, failures."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.control.planar_position import PlanarConfig
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.units import Radians
from ambler.docking.tracker import DockTrack
from ambler.missions.drive_to import DriveTo


class DockState(enum.Enum):
    """What the mission is doing; the last four are ends."""

    IDLE = "idle"
    STAGING = "staging"
    SEARCHING = "searching"
    ALIGNING = "aligning"
    APPROACHING = "approaching"
    CONFIRMING = "confirming"
    BACKING_OUT = "backing_out"
    UNDOCKING = "undocking"
    DOCKED = "docked"
    UNDOCKED = "undocked"
    FAILED = "failed"
    CANCELLED = "cancelled"


ENDS = (DockState.DOCKED, DockState.UNDOCKED, DockState.FAILED, DockState.CANCELLED)


@dataclass(frozen=True, slots=True)
class DockConfig:
    """Times in seconds, lengths in metres, angles in radians.

    attempts           final approaches before the mission fails
    stagings           drives to the staging pose that an unseen dock is worth
    search_turns       headings, from that of the staging pose, at which the mission looks for `look_time` each
    search_moves       sideways moves that follow, looked from with the same patience
    align_*            how exactly the robot must stand before the dock at the approach distance before it goes in
    lost_travel, blind_push   way without a detection at which the approach is given up, and near the dock is not
    limit_y, limit_yaw where the robot must be when `limit_at` metres are left, else it backs out
    contact_at         how many metres before the docked pose contacts may meet; contact that is told from farther away is none
    overrun            how far beyond the taught pose it pushes while it waits for the contact
    settle_*           what counts as docked where the dock has no contacts
    confirm_time       how long contact or charge may take to come; `contact_time` how long it must last
    wait_time          how long a robot that goes in waits for who stands in its way (people stay for some seconds) before it gives the attempt up
    blocked_time       how long the gate may hold a robot that backs out or leaves before it gives up
    permit_time        how long a permission for the gate lasts; it is renewed while needed
    final_speed        share of the speed in the last `final_distance`
    """

    attempts: int = 3
    stagings: int = 2
    staging_xy: float = 0.08
    staging_yaw: Radians = 0.08
    staging_near: float = 0.35
    look_time: float = 0.8
    search_turns: tuple[float, ...] = (0.0, 0.35, -0.35, 0.7, -0.7, 0.0)
    search_moves: tuple[float, ...] = (0.2, -0.2)
    search_timeout: float = 40.0
    align_xy: float = 0.03
    align_yaw: Radians = math.radians(1.5)
    align_timeout: float = 15.0
    align_sightings: int = 4
    approach_timeout: float = 20.0
    lost_travel: float = 0.10
    lost_age: float = 1.5
    blind_distance: float = 0.25
    blind_push: float = 0.35
    limit_at: float = 0.25
    limit_y: float = 0.02
    limit_yaw: Radians = math.radians(2.0)
    contact_at: float = 0.05
    overrun: float = 0.008
    settle_xy: float = 0.003
    settle_yaw: Radians = math.radians(0.15)
    settle_time: float = 0.3
    confirm_time: float = 4.0
    contact_time: float = 0.2
    back_timeout: float = 15.0
    back_xy: float = 0.05
    wait_time: float = 8.0
    blocked_time: float = 3.0
    stale_time: float = 0.5
    permit_time: float = 1.0
    final_distance: float = 0.08
    final_share: float = 0.25
    planar: PlanarConfig = field(default_factory=PlanarConfig)


@dataclass(frozen=True, slots=True)
class DockView:
    """What the mission sees at one instant.

    odom_from_base, velocity   of odometry; map_from_base of the localization, None while lost
    track                      the dock in the base frame, None while it is not known
    has_contact, is_charging   of the contacts and the battery, None when nobody tells
    is_held                    the gate holds the robot back
    is_fresh                   odometry and scans are not older than allowed
    """

    now_ns: int
    odom_from_base: SE2
    velocity: BodyVelocity
    map_from_base: SE2 | None
    track: DockTrack | None
    has_contact: bool | None = None
    is_charging: bool | None = None
    is_held: bool = False
    is_fresh: bool = True


@dataclass(frozen=True, slots=True)
class StopNavigation:
    """Cancel the running drive; its end need not be reported."""


@dataclass(frozen=True, slots=True)
class Move:
    """Ask the gate for a velocity until the next update."""

    velocity: BodyVelocity


@dataclass(frozen=True, slots=True)
class LookForDock:
    """Switch the detection of the dock on, with everything forgotten, or off."""

    is_wanted: bool


@dataclass(frozen=True, slots=True, eq=False)
class PermitApproach:
    """Allow the gate to let the robot near the dock's outline (N, 2), in the dock's frame, and nothing else, for `seconds`."""

    odom_from_dock: SE2
    outline: NDArray[np.float64]
    overrun: float
    seconds: float


@dataclass(frozen=True, slots=True)
class RevokeApproach:
    """Take the permission back."""


@dataclass(frozen=True, slots=True)
class StopCharging:
    """Ask the charger to stop before the contacts open."""


@dataclass(frozen=True, slots=True)
class DockResult:
    """How it went: attempts, seconds in all and from the staging pose on, and where the robot stands by the last detections: the
    dock's pose in the base frame and in the map (to refine the database), None if unknown."""

    attempts: int
    seconds: float
    docking_seconds: float
    base_from_dock: SE2 | None
    map_from_base: SE2 | None


@dataclass(frozen=True, slots=True)
class DockEnded:
    """The mission is over: SUCCEEDED, CANCELLED or one of `runtime.tasks.DOCK_FAILURES`, with one sentence."""

    code: str
    text: str
    result: DockResult


DockCommand = DriveTo | StopNavigation | Move | LookForDock | PermitApproach | RevokeApproach | StopCharging | DockEnded
