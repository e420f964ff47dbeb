"""A planar room as wall segments, seen by exact ray casting in NumPy; no symmetry, with pillars, a stub wall and a slanted corner."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.registration.planar_scan import PlanarScan

F64 = NDArray[np.float64]
BEAMS = 360


def loop_of(*corners: tuple[float, float]) -> list[tuple[float, float, float, float]]:
    """Return the segments of a closed polygon."""
    return [(*a, *b) for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)]


def box_at(x: float, y: float, size: float, yaw: float) -> list[tuple[float, float, float, float]]:
    """Return the segments of a turned square."""
    corners = SE2(x, y, yaw).transform(0.5 * size * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]))
    return loop_of(*((float(a), float(b)) for a, b in corners))


# x0, y0, x1, y1 in metres. An L of 9 m x 7 m with one slanted corner.
WALLS: F64 = np.array(
    [
        *loop_of((-4.03, -3.02), (3.9, -3.02), (5.01, -1.9), (5.01, 1.48), (2.97, 1.48), (2.97, 4.04), (-4.03, 4.04)),
        *box_at(-2.3, 1.8, 0.4, 0.0),
        *box_at(2.6, -1.4, 0.5, 0.6),
        (-1.0, -3.02, -1.0, -1.6),
        (0.4, 4.04, 0.4, 2.5),
    ]
)

# A straight corridor along x whose ends are out of sight.
CORRIDOR: F64 = np.array([(-60.0, -1.03, 60.0, -1.03), (-60.0, 1.04, 60.0, 1.04)])


def ranges_at(sensor: SE2, angles: F64, walls: F64 = WALLS) -> F64:
    """Return float64 (N,) distances along beams at `angles` of the sensor frame; infinite where nothing stands."""
    yaw = sensor.yaw + np.asarray(angles, np.float64)[:, None]
    dx, dy = np.cos(yaw), np.sin(yaw)
    ax, ay = walls[:, 0] - sensor.x, walls[:, 1] - sensor.y
    ex, ey = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    # sensor + t d = a + u e: both by cross products.
    cross = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (ax * ey - ay * ex) / cross
        u = (ax * dy - ay * dx) / cross
    is_hit = (np.abs(cross) > 1e-12) & (t > 0.0) & (u >= -1e-12) & (u <= 1.0 + 1e-12)
    return np.asarray(np.where(is_hit, t, np.inf).min(axis=1))


def beam_angles(beams: int = BEAMS) -> F64:
    """Return float64 (beams,) angles all around, from -pi on."""
    return np.arange(beams, dtype=np.float64) * (2.0 * math.pi / beams) - math.pi


def scan_at(
    sensor: SE2,
    stamp_ns: int = 0,
    walls: F64 = WALLS,
    rng: np.random.Generator | None = None,
    sigma: float = 0.01,
    range_max: float = 30.0,
) -> PlanarScan:
    """Return the scan in the sensor's own frame: ideal, or with Gaussian range noise `sigma` (m) when `rng` is given."""
    angles = beam_angles()
    ranges = ranges_at(sensor, angles, walls)
    if rng is not None:
        ranges = ranges + rng.normal(0.0, sigma, len(ranges))
    seen = ranges < range_max
    points = ranges[seen, None] * np.column_stack((np.cos(angles[seen]), np.sin(angles[seen])))
    return PlanarScan(stamp_ns, points.astype(np.float32), np.zeros((0, 2), np.float32))


def distance_to_walls(points: F64, walls: F64 = WALLS) -> F64:
    """Return float64 (N,): each point's distance to the nearest wall."""
    a, e = walls[:, :2], walls[:, 2:] - walls[:, :2]
    t = np.clip(((points[:, None] - a) * e).sum(-1) / (e * e).sum(-1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points[:, None] - (a + t[..., None] * e), axis=-1).min(axis=1))


def is_clear(x: float, y: float, clearance: float = 0.35) -> bool:
    """Say whether a robot may stand at a point: inside the room and away from every wall."""
    here = np.array([[x, y]])
    beams = ranges_at(SE2(x, y), beam_angles(36))
    in_pillar = (abs(x + 2.3) < 0.2 and abs(y - 1.8) < 0.2) or math.hypot(x - 2.6, y + 1.4) < 0.36
    return bool(np.isfinite(beams).all()) and not in_pillar and float(distance_to_walls(here)[0]) > clearance


def random_pose(rng: np.random.Generator) -> SE2:
    """Draw a clear pose in the room."""
    while True:
        x, y = float(rng.uniform(-3.8, 4.8)), float(rng.uniform(-2.8, 3.8))
        if is_clear(x, y):
            return SE2(x, y, float(rng.uniform(-math.pi, math.pi)))
