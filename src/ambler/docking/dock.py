"""What a dock is.

The frame `dock` is where the robot's base frame lies when the robot is docked: x points into the dock, so the wanted pose of the base
is the origin, and the way to it leads along x. Everything that marks a dock is told in this frame.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import MarkerSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3

F64 = NDArray[np.float64]


class DockKind(enum.Enum):
    """What a dock is recognized by."""

    MARKERS = "markers"
    V_SHAPE = "v_shape"
    REFLECTORS = "reflectors"


class Contacts(enum.Enum):
    """What confirms that the robot is docked: current into the battery, a contact that closes, or the pose alone."""

    CHARGE = "charge"
    SWITCH = "switch"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class DockMarker:
    """A marker of a dock: its middle at (x, y, z) of the dock frame, z from the floor, turned by `yaw` from facing the robot."""

    spec: MarkerSpec
    x: float
    y: float
    z: float
    yaw: float = 0.0

    @property
    def dock_from_marker(self) -> SE3:
        """The marker's frame: its z axis points out of the dock, against x; its y axis up."""
        upright = SE3.from_rpy((0.0, 0.0, 0.0), 0.5 * math.pi, 0.0, -0.5 * math.pi)
        return SE3.from_rpy((self.x, self.y, self.z), 0.0, 0.0, self.yaw) @ upright


@dataclass(frozen=True, slots=True)
class VShape:
    """Two straight legs of `leg` metres that meet in a corner, a notch in the dock or a wedge on it. `angle` is the one between the legs
    as the scanner sees it: below pi for a notch that recedes, above for a wedge. `dock_from_corner`: the corner, its x along
    the line that halves the angle, into the dock."""

    angle: float
    leg: float
    dock_from_corner: SE2


@dataclass(frozen=True, slots=True, eq=False)
class Dock:
    """A dock in the map.

    map_from_dock      where the base stands when docked
    offset             correction of every detected pose, in the dock frame, from trying where contacts meet best
    approach_distance  metres before the docked pose at which the robot stages and aligns
    outline            convex polygon (N, 2) in the dock frame, counter-clockwise: the only thing that may be approached closely
    markers, v_shape, reflectors (K, 2)   what it is recognized by, as `kind` says
    dockings           how often its pose was refined
    """

    name: str
    kind: DockKind
    map_from_dock: SE2
    outline: F64
    offset: SE2 = field(default_factory=SE2)
    approach_distance: float = 1.0
    contacts: Contacts = Contacts.CHARGE
    markers: tuple[DockMarker, ...] = ()
    v_shape: VShape | None = None
    reflectors: F64 = field(default_factory=lambda: np.empty((0, 2)))
    dockings: int = 0

    @property
    def map_from_staging(self) -> SE2:
        """Where the approach begins."""
        return self.map_from_dock @ SE2(-self.approach_distance, 0.0, 0.0)
