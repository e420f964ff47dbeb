"""What the docking node is told about its robot: where it is in the map, its battery, whether the gate holds it, its camera."""

from __future__ import annotations

import numpy as np

from ambler.core.camera import CameraModel
from ambler.core.errors import TransformError
from ambler.core.messages import BatteryState, CameraInfo, GateState, GateStatus, PowerSupply, Transforms
from ambler.core.se2 import SE2
from ambler.core.transforms import TransformTree
from ambler.runtime.topics import BATTERY

MAP_AGE_NS = 1_500_000_000


class RobotState:
    """The newest of everything; what was never told is None."""

    def __init__(self) -> None:
        self.camera: CameraModel | None = None
        self._battery: BatteryState | None = None
        self.is_held = False
        self._tree = TransformTree(history=2.0)
        self._map_ns: int | None = None

    def has_contact(self, now_ns: int) -> bool | None:
        """Whether the contacts of a charger are closed, None while nobody tells."""
        supply = self._supply(now_ns)
        return None if supply is None else supply is not PowerSupply.DISCHARGING

    def is_charging(self, now_ns: int) -> bool | None:
        """Whether current flows in, or the battery is full; None while nobody tells."""
        supply = self._supply(now_ns)
        return None if supply is None else supply in (PowerSupply.CHARGING, PowerSupply.FULL)

    def take_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)
            if edge.parent == "map":
                self._map_ns = edge.stamp_ns

    def take_camera(self, info: CameraInfo) -> None:
        self.camera = info.model

    def take_battery(self, battery: BatteryState) -> None:
        self._battery = battery

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

    def _supply(self, now_ns: int) -> PowerSupply | None:
        """What feeds the battery, None when that is unknown or was told too long ago."""
        battery = self._battery
        if battery is None or battery.supply is PowerSupply.UNKNOWN:
            return None
        return battery.supply if BATTERY.max_age is None or now_ns - battery.stamp_ns <= BATTERY.max_age * 1e9 else None
