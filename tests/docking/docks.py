"""Docks of every kind, and what sensors see of them: rendered pictures, scans with noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ambler.core.camera import MarkerSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.dock import Contacts, Dock, DockKind, DockMarker, VShape
from ambler.sim.camera import FRONT_CAMERA, CameraSpec, Light, PrintCamera, marker_print, plain_print

OUTLINE = np.array([[0.62, -0.3], [0.95, -0.3], [0.95, 0.3], [0.62, 0.3]])
BASE_FROM_CAMERA = SE3.from_rpy((0.58, 0.0, 0.32), -0.5 * math.pi, 0.0, -0.5 * math.pi)
MARKERS = (
    DockMarker(MarkerSpec("4X4_50", 3, 0.12), 0.95, 0.0, 0.34),
    DockMarker(MarkerSpec("APRILTAG_36H11", 8, 0.08), 0.95, 0.14, 0.34),
    DockMarker(MarkerSpec("4X4_50", 5, 0.08), 0.95, -0.14, 0.34),
)
MARKER_DOCK = Dock("charger", DockKind.MARKERS, SE2(4.0, 1.0, 0.5), OUTLINE, markers=MARKERS)
ONE_MARKER = replace(MARKER_DOCK, markers=MARKERS[:1])
NOTCH = Dock(
    "notch", DockKind.V_SHAPE, SE2(), OUTLINE, contacts=Contacts.SWITCH,
    v_shape=VShape(math.radians(120.0), 0.22, SE2(0.8, 0.0, 0.0)),
)  # fmt: skip
WEDGE = replace(NOTCH, name="wedge", v_shape=VShape(math.radians(240.0), 0.22, SE2(0.7, 0.05, 0.1)))
REFLECTORS = Dock(
    "strips", DockKind.REFLECTORS, SE2(), OUTLINE, contacts=Contacts.NONE,
    reflectors=np.array([[0.7, -0.3], [0.7, -0.05], [0.7, 0.3]]),
)  # fmt: skip


class View:
    """A robot with a front camera before a dock with markers."""

    def __init__(self, dock: Dock, seed: int = 1, samples: int = 4) -> None:
        self.dock = dock
        self.camera = PrintCamera(CameraSpec(samples=samples), np.random.default_rng(seed))

    def picture(self, base_from_dock: SE2, light: Light | None = None, hidden: tuple[int, ...] = ()) -> np.ndarray:
        """What the camera sees when the dock lies there; `hidden` markers are missing."""
        pose = SE3.from_se2(base_from_dock)
        prints = [
            marker_print(m.spec.dictionary, m.spec.number, m.spec.size, pose @ m.dock_from_marker)
            for m in self.dock.markers
            if m.spec.number not in hidden
        ]
        back = DockMarker(MarkerSpec("", 0, 1.0), 0.955, 0.0, 0.4).dock_from_marker
        return self.camera.take([BASE_FROM_CAMERA], [plain_print(120, 0.8, 0.5, pose @ back), *prints], light)


FRONT = FRONT_CAMERA


def scan_of(
    segments: np.ndarray, rng: np.random.Generator, noise: float = 0.004, step: float = math.radians(0.25)
) -> np.ndarray:
    """Points (N, 2) of a scanner at the origin that sees segments (K, 4) of (x, y, x, y), in the order of the beams."""
    angles = np.arange(-math.pi, math.pi, step)
    ranges = np.full(len(angles), np.inf)
    c, s = np.cos(angles), np.sin(angles)
    for x0, y0, x1, y1 in segments:
        ex, ey = x1 - x0, y1 - y0
        det = c * ey - s * ex
        with np.errstate(divide="ignore", invalid="ignore"):
            along, across = (x0 * ey - y0 * ex) / det, (x0 * s - y0 * c) / det
        hit = (np.abs(det) > 1e-12) & (along > 0.05) & (across >= 0.0) & (across <= 1.0)
        ranges[hit] = np.minimum(ranges[hit], along[hit])
    keep = np.isfinite(ranges)
    r = ranges[keep] + rng.normal(0.0, noise, int(keep.sum()))
    return np.stack((r * c[keep], r * s[keep]), axis=1)


def segments_of_v(dock: Dock, base_from_dock: SE2) -> np.ndarray:
    """The two legs, flat wings beside them, and two walls of a room."""
    v = dock.v_shape
    assert v is not None
    corner = base_from_dock @ v.dock_from_corner
    half = 0.5 * v.angle
    # Seen from the corner the robot lies at -x: the legs lead away at half the angle from there.
    ends = [
        SE2().transform(np.array([[-v.leg * math.cos(half), sign * v.leg * math.sin(half)]]))[0] for sign in (1, -1)
    ]
    local = np.array([[0.0, 0.0], ends[0], ends[0] + [0.0, 0.3], ends[1], ends[1] - [0.0, 0.3]])
    p = corner.transform(local)
    pairs = ((0, 1), (1, 2), (0, 3), (3, 4))
    walls = [[-1.0, -2.5, 5.0, -2.5], [-1.0, 2.5, 5.0, 2.5]]
    return np.array([[*p[a], *p[b]] for a, b in pairs] + walls)
