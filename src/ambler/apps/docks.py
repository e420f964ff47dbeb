"""The docks of a simulated world as a surveyor would have entered them into a robot's database."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ambler.core.camera import MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.docking.dock import Dock, DockKind, DockMarker, VShape
from ambler.sim.dock_body import FILM, PANEL_DEPTH, PAPER
from ambler.sim.solids import SimDock, WorldSpec

RIM = 0.02  # metres by which a drawn outline is larger than the dock


def docks_of_world(world: WorldSpec, path: Path) -> DockDatabase:
    """Return the docks of a world, in the frame in which it is given (`WorldSpec.seen_from`), to be kept in `path`."""
    return DockDatabase(path, {dock.name: _drawn(dock) for dock in world.docks})


def dock_of_world(world: WorldSpec, name: str) -> SimDock:
    """Return a dock of a world by its name; raises BadInputError with the known names."""
    for dock in world.docks:
        if dock.name == name:
            return dock
    known = ", ".join(dock.name for dock in world.docks)
    raise BadInputError(f"world {world.name} has no dock {name!r}; there are {known or 'none'}")


def _drawn(dock: SimDock) -> Dock:
    side = 0.5 * dock.width + RIM
    near, far = dock.front - RIM, dock.panel + PANEL_DEPTH + RIM
    outline = np.array([[near, -side], [far, -side], [far, side], [near, side]])
    plain = Dock(dock.name, DockKind.MARKERS, dock.world_from_dock, outline)
    if dock.v_shape is not None:
        v = dock.v_shape
        return replace(plain, kind=DockKind.V_SHAPE, v_shape=VShape(v.angle, v.leg, SE2(v.x, 0.0, 0.0)))
    if dock.reflectors:
        strips = np.array([[dock.panel - FILM, strip.y] for strip in dock.reflectors])
        return replace(plain, kind=DockKind.REFLECTORS, reflectors=strips)
    markers = tuple(
        DockMarker(MarkerSpec(m.dictionary, m.number, m.size), dock.panel - PAPER, m.y, m.z) for m in dock.markers
    )
    return replace(plain, markers=markers)
