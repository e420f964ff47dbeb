"""An analytic flat world for tests: walls and pillars, a moving robot, scanners whose beams fire one after the other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]
Trajectory = Callable[[float], SE2]


@dataclass(frozen=True)
class Flatland:
    """Walls float64 (M, 4) of (x0, y0, x1, y1) and pillars float64 (P, 3) of (x, y, radius)."""

    walls: F64
    pillars: F64

    def cast(self, origins: F64, directions: F64) -> F64:
        """Return the distance of the nearest surface along each ray (N,), inf where there is none."""
        best = np.full(len(origins), np.inf)
        for x0, y0, x1, y1 in self.walls:
            ex, ey = x1 - x0, y1 - y0
            wx, wy = x0 - origins[:, 0], y0 - origins[:, 1]
            with np.errstate(divide="ignore", invalid="ignore"):
                side = directions[:, 0] * ey - directions[:, 1] * ex
                r = (wx * ey - wy * ex) / side
                s = (wx * directions[:, 1] - wy * directions[:, 0]) / side
            hit = (r > 0) & (s >= 0) & (s <= 1)
            best = np.where(hit & (r < best), r, best)
        for x, y, radius in self.pillars:
            wx, wy = x - origins[:, 0], y - origins[:, 1]
            along = wx * directions[:, 0] + wy * directions[:, 1]
            off2 = wx * wx + wy * wy - along * along
            half = np.sqrt(np.maximum(radius * radius - off2, 0.0))
            r = along - half
            best = np.where((off2 <= radius * radius) & (r > 0) & (r < best), r, best)
        return best

    def distance_to_surface(self, points: F64) -> F64:
        """Return how far each point (N, 2) lies from the nearest surface."""
        best = np.full(len(points), np.inf)
        for x0, y0, x1, y1 in self.walls:
            e = np.array([x1 - x0, y1 - y0])
            s = np.clip((points - [x0, y0]) @ e / (e @ e), 0.0, 1.0)
            best = np.minimum(best, np.linalg.norm(points - [x0, y0] - s[:, None] * e, axis=1))
        for x, y, radius in self.pillars:
            best = np.minimum(best, np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - radius))
        return best


def room(half: float = 6.0) -> Flatland:
    """A room with a skew wall, a thin partition, a box and three pillars; the space about the origin is free."""
    h = half
    outline = np.array([[-h, -h], [h, -0.8 * h], [1.1 * h, h], [-0.9 * h, 0.9 * h]])
    box = np.array([[2.2, 2.0], [3.0, 2.2], [2.8, 3.0], [2.0, 2.8]])
    walls = [np.concatenate([a, b]) for c in (outline, box) for a, b in zip(c, np.roll(c, -1, axis=0), strict=True)]
    walls.append(np.array([-2.5, -h + 0.2, -2.2, -2.5]))
    return Flatland(np.array(walls), np.array([[3.0, -1.5, 0.15], [-3.0, 1.0, 0.1], [0.5, 3.5, 0.3]]))


@dataclass(frozen=True)
class Beams:
    """How a scanner fires: `count` beams from `angle_min` in steps of `step` rad, one every `interval` seconds."""

    count: int = 541
    angle_min: float = -math.radians(135.0)
    step: float = math.radians(0.5)
    interval: float = 0.09 / 541
    range_max: float = 30.0
    period: float = 0.1


def take_scan(
    world: Flatland,
    trajectory: Trajectory,
    base_from_sensor: SE2,
    begin: float,
    beams: Beams = Beams(),
    frame: str = "scanner",
    upside_down: bool = False,
    clock_offset: float = 0.0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> LaserScan:
    """Simulate one scan that begins at `begin` seconds; an inverted scanner's beams run clockwise in the plane."""
    times = begin + np.arange(beams.count) * np.float64(np.float32(beams.interval))
    sign = -1.0 if upside_down else 1.0
    angles = np.float64(np.float32(beams.angle_min)) + np.arange(beams.count) * np.float64(np.float32(beams.step))
    poses = np.array([(trajectory(t) @ base_from_sensor).as_array() for t in times])
    heading = poses[:, 2] + sign * angles
    directions = np.column_stack([np.cos(heading), np.sin(heading)])
    ranges = world.cast(poses[:, :2], directions)
    if rng is not None:
        ranges = ranges + noise * rng.standard_normal(len(ranges))
    ranges[ranges > beams.range_max] = np.inf
    return LaserScan(
        round((begin + clock_offset) * 1e9),
        frame,
        beams.angle_min,
        beams.step,
        beams.interval,
        beams.period,
        0.05,
        beams.range_max,
        ranges.astype(np.float32),
        np.zeros(0, np.float32),
    )


def constant_twist(vx: float, vy: float, wz: float) -> Trajectory:
    """A trajectory through the origin at time 0 with a constant body velocity."""
    return lambda t: SE2.exp(np.array([vx, vy, wz]) * t)
