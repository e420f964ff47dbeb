"""What a simulated dock is made of: a lip with the contacts, a low body behind it, a panel with the markers above."""

from __future__ import annotations

import math

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.camera import Print, marker_print, plain_print
from ambler.sim.solids import Shape, SimDock, Solid

LIP_GAP = 0.008  # metres that the contacts' springs give before the lip stops the robot
LIP_DEPTH, LIP_HEIGHT, LIP_WIDTH = 0.03, 0.10, 0.4
BODY_GAP, BODY_HEIGHT = 0.02, 0.24
PANEL_DEPTH, PANEL_HEIGHT = 0.03, 0.60
PAPER = 0.001  # metres by which the markers stand off the panel
CONTACTS = "_contacts"  # ends the name of the solid that a robot may touch


def dock_solids(dock: SimDock) -> tuple[Solid, ...]:
    """Return the solids of a dock in the map frame."""
    front, panel = dock.front, dock.panel

    def box(part: str, x: tuple[float, float], width: float, height: float) -> Solid:
        pose = dock.map_from_dock @ SE2(0.5 * (x[0] + x[1]), 0.0, 0.0)
        return Solid(dock.name + part, Shape.BOX, pose, x[1] - x[0], width, 0.0, height, 0.5)

    return (
        box(CONTACTS, (front + LIP_GAP, front + LIP_GAP + LIP_DEPTH), LIP_WIDTH, LIP_HEIGHT),
        box("_body", (front + BODY_GAP, panel), dock.width, BODY_HEIGHT),
        box("_panel", (panel, panel + PANEL_DEPTH), dock.width, PANEL_HEIGHT),
    )


def marker_poses(dock: SimDock) -> tuple[SE3, ...]:
    """Return the pose of every marker in the map frame: x to the right and y up for who looks at it, z towards them."""
    facing = SE3.from_rpy((0.0, 0.0, 0.0), 0.5 * math.pi, 0.0, -0.5 * math.pi)
    base = SE3.from_se2(dock.map_from_dock)
    return tuple(base @ SE3((dock.panel - PAPER, m.y, m.z)) @ facing for m in dock.markers)


def dock_prints(dock: SimDock) -> tuple[Print, tuple[Print, ...]]:
    """Return the panel's face and the markers on it as a camera sees them."""
    facing = SE3.from_rpy((0.0, 0.0, 0.0), 0.5 * math.pi, 0.0, -0.5 * math.pi)
    middle = 0.5 * (BODY_HEIGHT + PANEL_HEIGHT)
    face = SE3.from_se2(dock.map_from_dock) @ SE3((dock.panel, 0.0, middle)) @ facing
    board = plain_print(130, dock.width, PANEL_HEIGHT - BODY_HEIGHT, face)
    markers = tuple(
        marker_print(m.dictionary, m.number, m.size, pose)
        for m, pose in zip(dock.markers, marker_poses(dock), strict=True)
    )
    return board, markers
