"""Docks in a world file: what is written there, and the simulated dock that comes of it."""

from __future__ import annotations

import math
from itertools import pairwise

from pydantic import BaseModel, ConfigDict, Field, model_validator

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.solids import SimDock, SimMarker, SimReflector, SimVShape

V_GAP = 0.10  # metres between the front of a docked robot and the foremost edges of a V shape
MARKS = ("markers", "v_shape", "reflectors")
REFLECTORS_APART = 0.15  # metres from middle to middle that scanners tell apart


class Entry(BaseModel):
    """Part of a world file: no unknown fields, numbers only where numbers belong."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True, allow_inf_nan=False)


class PoseEntry(Entry):
    """A pose in the author's coordinates."""

    x: float
    y: float
    yaw_deg: float = 0.0

    def to_se2(self) -> SE2:
        """Return the pose in radians."""
        return SE2(self.x, self.y, math.radians(self.yaw_deg))


class _Marker(Entry):
    dictionary: str = "4X4_50"
    id: int = Field(ge=0)
    size: float = Field(default=0.12, gt=0)
    y: float = 0.0
    z: float = Field(default=0.34, gt=0)


class _VShape(Entry):
    angle_deg: float = Field(default=120.0, ge=60, le=300)
    leg: float = Field(default=0.34, ge=0.1)

    @model_validator(mode="after")
    def _is_bent(self) -> _VShape:
        if abs(self.angle_deg - 180.0) < 20.0:
            raise ValueError(f"angle_deg must be 60 to 160 (a notch) or 200 to 300 (a wedge), not {self.angle_deg:g}")
        return self


class _Reflector(Entry):
    y: float
    width: float = Field(default=0.05, gt=0, le=0.1)


class DockEntry(Entry):
    """A dock; exactly one of `markers`, `v_shape` and `reflectors` marks it."""

    name: str
    pose: PoseEntry
    front: float = Field(default=0.6, gt=0)
    width: float = Field(default=0.6, gt=0)
    panel: float = Field(default=0.95, gt=0)
    markers: tuple[_Marker, ...] | None = Field(default=None, min_length=1)
    v_shape: _VShape | None = None
    reflectors: tuple[_Reflector, ...] | None = Field(default=None, min_length=2)

    @model_validator(mode="after")
    def _has_one_mark(self) -> DockEntry:
        if sum(getattr(self, mark) is not None for mark in MARKS) != 1:
            raise ValueError(f"dock {self.name} needs exactly one of {', '.join(MARKS)}")
        return self


def sim_dock(where: str, entry: DockEntry) -> SimDock:
    """Return a dock; raises BadInputError, which begins with `where`, when its parts do not fit into it."""
    markers = tuple(SimMarker(k.dictionary, k.id, k.size, k.y, k.z) for k in entry.markers or ())
    v_shape = None if entry.v_shape is None else _v_shape(f"{where}.v_shape", entry, entry.v_shape)
    reflectors = _reflectors(f"{where}.reflectors", entry, entry.reflectors or ())
    return SimDock(entry.name, entry.pose.to_se2(), entry.front, entry.width, entry.panel, markers, v_shape, reflectors)


def _v_shape(where: str, entry: DockEntry, v: _VShape) -> SimVShape:
    angle = math.radians(v.angle_deg)
    ahead, aside = v.leg * math.cos(0.5 * angle), v.leg * math.sin(0.5 * angle)
    shape = SimVShape(angle, v.leg, entry.front + V_GAP + max(0.0, ahead))
    room = entry.panel - entry.front - V_GAP
    if aside > 0.5 * entry.width + 0.005 or abs(ahead) > room:
        raise BadInputError(
            f"{where}: legs of {v.leg:g} m reach {aside:.3f} m aside and {abs(ahead):.3f} m deep; the dock has "
            f"{0.5 * entry.width:.3f} m and {room:.3f} m"
        )
    return shape


def _reflectors(where: str, entry: DockEntry, strips: tuple[_Reflector, ...]) -> tuple[SimReflector, ...]:
    for strip in strips:
        if abs(strip.y) + 0.5 * strip.width > 0.5 * entry.width:
            raise BadInputError(f"{where}: the strip at y {strip.y:g} does not fit on a panel {entry.width:g} m wide")
    for a, b in pairwise(sorted(strip.y for strip in strips)):
        if b - a < REFLECTORS_APART - 1e-9:
            raise BadInputError(f"{where}: the strips at y {a:g} and {b:g} are nearer than {REFLECTORS_APART:g} m")
    return tuple(SimReflector(strip.y, strip.width) for strip in strips)
