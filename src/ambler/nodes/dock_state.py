"""What the docking node is told about its robot: where it is in the map, its battery, whether the gate holds it, its camera."""

from __future__ import annotations

import numpy as np

from ambler.core.camera import CameraModel
from ambler.core.errors import TransformError
from ambler.core.messages import BatteryState, CameraInfo, GateState, GateStatus, PowerSupply, Transforms
from ambler.core.se2 import SE2
from ambler.core.transforms import TransformTree

MAP_AGE_NS = 1_500_000_000


class RobotState:
    """The newest of everything; what was never told is None."""

    def __init__(self) -> None:
        self.camera: CameraModel | None = None
        self.supply: PowerSupply | None = None
        self.is_held = False
        self._tree = TransformTree(history=2.0)
        self._map_ns: int | None = None

    @property
    def has_contact(self) -> bool | None:
        """Whether the contacts of a charger are closed."""
        if self.supply in (None, PowerSupply.UNKNOWN):
            return None
        return self.supply is not PowerSupply.DISCHARGING

    @property
    def is_charging(self) -> bool | None:
        """Whether current flows in, or the battery is full."""
        if self.supply in (None, PowerSupply.UNKNOWN):
            return None
        return self.supply in (PowerSupply.CHARGING, PowerSupply.FULL)

    def take_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)
            if edge.parent == "map":
                self._map_ns = edge.stamp_ns

    def take_camera(self, info: CameraInfo) -> None:
        self.camera = info.model

    def take_battery(self, battery: BatteryState) -> None:
        self.supply = battery.supply

    def take_gate(self, status: GateStatus) -> None:
        self.is_held = status.state is not GateState.ARMED

    def map_from_base(self, now_ns: int) -> SE2 | None:
        """The pose in the map, None while it is unknown, old or no number."""
        if self._map_ns is None or now_ns - self._map_ns > MAP_AGE_NS:
            return None
        try:
            pose = self._tree.lookup("map", "base").to_se2()
        except TransformError:
            return None
        return pose if np.isfinite(pose.as_array()).all() else None
