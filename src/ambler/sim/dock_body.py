"""What a simulated dock is made of: a lip with the contacts, a low body behind it, a panel above.

What a dock is recognized by is on the panel, markers or strips of retro-reflecting film, or before it, two plates that meet in a V.
The body of docks for scanners is so low that these look over it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.camera import Print, marker_print, plain_print
from ambler.sim.solids import Shape, SimDock, Solid

LIP_GAP = 0.008  # metres that the contacts' springs give before the lip stops the robot
LIP_DEPTH, LIP_HEIGHT, LIP_WIDTH = 0.03, 0.10, 0.4
BODY_GAP, BODY_HEIGHT = 0.02, 0.24
PANEL_DEPTH, PANEL_HEIGHT = 0.03, 0.60
PAPER = 0.001  # metres by which the markers stand off the panel
FILM = 0.002  # metres by which reflectors do
FILM_ALBEDO = 600.0  # white paint has 1: film sends the light back to where it came from, not everywhere
PROFILE = (0.1, 0.32)  # heights of a V shape and of reflectors, metres
PLATE = 0.02  # its thickness
CONTACTS = "_contacts"  # ends the name of the solid that a robot may touch
V_PLATE, STRIP = "_v_plate", "_strip"  # end the names of what scanners recognize a dock by


def dock_solids(dock: SimDock) -> tuple[Solid, ...]:
    """Return the solids of a dock."""
    front, panel = dock.front, dock.panel
    body_height = BODY_HEIGHT if dock.markers else LIP_HEIGHT

    def box(part: str, x: tuple[float, float], width: float, height: float) -> Solid:
        pose = dock.world_from_dock @ SE2(0.5 * (x[0] + x[1]), 0.0, 0.0)
        return Solid(dock.name + part, Shape.BOX, pose, x[1] - x[0], width, 0.0, height, 0.5)

    return (
        box(CONTACTS, (front + LIP_GAP, front + LIP_GAP + LIP_DEPTH), LIP_WIDTH, LIP_HEIGHT),
        box("_body", (front + BODY_GAP, panel), dock.width, body_height),
        box("_panel", (panel, panel + PANEL_DEPTH), dock.width, PANEL_HEIGHT),
        *_v_solids(dock),
        *_strips(dock),
    )


def without_marks(solids: Sequence[Solid], docks: Sequence[SimDock]) -> tuple[Solid, ...]:
    """Return the solids without the plates of V shapes, and with reflectors as dull as the panels behind them."""
    plates, strips = ({dock.name + end for dock in docks} for end in (V_PLATE, STRIP))
    left = (s for s in solids if s.name not in plates)
    return tuple(replace(s, albedo=0.5) if s.name in strips else s for s in left)


def _v_solids(dock: SimDock) -> tuple[Solid, ...]:
    """Two plates whose front faces are the legs, and a cheek behind the end of each, so that nobody looks behind them."""
    v = dock.v_shape
    if v is None:
        return ()
    out = []
    for side in (1.0, -1.0):
        corner = dock.world_from_dock @ SE2(v.x, 0.0, side * (math.pi - 0.5 * v.angle))
        plate = corner @ SE2(0.5 * v.leg, -side * 0.5 * PLATE, 0.0)
        out.append(Solid(dock.name + V_PLATE, Shape.BOX, plate, v.leg, PLATE, *PROFILE, 0.5))
        x = v.x - v.leg * math.cos(0.5 * v.angle) + PLATE
        y = side * (v.leg * math.sin(0.5 * v.angle) - 0.5 * PLATE)
        if x < dock.panel:
            middle = dock.world_from_dock @ SE2(0.5 * (x + dock.panel), y, 0.0)
            out.append(Solid(dock.name + "_cheek", Shape.BOX, middle, dock.panel - x, PLATE, *PROFILE, 0.5))
    return tuple(out)


def _strips(dock: SimDock) -> tuple[Solid, ...]:
    def strip(y: float, width: float) -> Solid:
        pose = dock.world_from_dock @ SE2(dock.panel - 0.5 * FILM, y, 0.0)
        return Solid(dock.name + STRIP, Shape.BOX, pose, FILM, width, *PROFILE, FILM_ALBEDO)

    return tuple(strip(r.y, r.width) for r in dock.reflectors)


def marker_poses(dock: SimDock) -> tuple[SE3, ...]:
    """Return the pose of every marker in the world: x to the right and y up for who looks at it, z towards them."""
    facing = SE3.from_rpy((0.0, 0.0, 0.0), 0.5 * math.pi, 0.0, -0.5 * math.pi)
    base = SE3.from_se2(dock.world_from_dock)
    return tuple(
        base @ SE3((dock.panel - PAPER, m.y, m.z)) @ facing @ SE3.from_rpy(m.place, *m.turn) for m in dock.markers
    )


def dock_prints(dock: SimDock) -> tuple[Print, tuple[Print, ...]]:
    """Return the panel's face and the markers on it as a camera sees them."""
    facing = SE3.from_rpy((0.0, 0.0, 0.0), 0.5 * math.pi, 0.0, -0.5 * math.pi)
    middle = 0.5 * (BODY_HEIGHT + PANEL_HEIGHT)
    face = SE3.from_se2(dock.world_from_dock) @ SE3((dock.panel, 0.0, middle)) @ facing
    board = plain_print(130, dock.width, PANEL_HEIGHT - BODY_HEIGHT, face)
    markers = tuple(
        marker_print(m.dictionary, m.number, m.size, pose)
        for m, pose in zip(dock.markers, marker_poses(dock), strict=True)
    )
    return board, markers
