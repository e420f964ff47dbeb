"""Height of points over a floor that may slope: walking outwards from the robot over the lowest points of each direction, as long as they rise no
faster than a slope that can be driven (after the ray ground filters of M. Himmelsbach et al., "Fast segmentation of 3D point clouds", 2010)."""

import math

import numpy as np

from ambler.kernels.jit import jit

SECTORS, RING = 60, 0.05  # directions, and metres of a step outwards
WIDE = 0.05  # metres to either side for which a low point stands: directions are narrower than that near the robot
TOLERANCE = 0.06  # metres by which a low point may lie off a slope: what a gait shakes, and noise


@jit
def walk_floor(points, slope, gap, under, lean, floor):
    """Write the height of the floor around the robot into `floor` [sector, ring], from points (N, 3) in a level base frame that stands on it.

    A low point is floor when it lies below the line of `slope` (m per m) through every floor point nearer by, so that nothing creeps up a
    wall. Across more than `gap` metres without floor, counted from `under` metres around the base on, it must go on as it was: level, or before the first
    floor point as the robot leans, `lean` (rise per metre along x, along y). Where no floor is seen the last height holds.
    """
    rings = floor.shape[1]
    lows = np.full((SECTORS, rings), np.inf)
    for k in range(len(points)):
        ring, sector = _place(points[k, 0], points[k, 1])
        if ring >= rings:
            continue
        beside = min(int(WIDE / ((ring + 0.5) * RING) * SECTORS / (2.0 * math.pi) + 0.5), SECTORS // 2)
        for step in range(-beside, beside + 1):
            near = (sector + step) % SECTORS
            lows[near, ring] = min(lows[near, ring], points[k, 2])
    for sector in range(SECTORS):
        angle = (sector + 0.5) / SECTORS * 2.0 * math.pi - math.pi
        leaning = lean[0] * math.cos(angle) + lean[1] * math.sin(angle)
        least = TOLERANCE  # of height less slope times distance, over the floor so far
        here, last, is_first = 0.0, under, True
        for ring in range(rings):
            far = (ring + 0.5) * RING
            low = lows[sector, ring]
            if far - last <= gap:
                most = least + slope * far
            else:
                most = TOLERANCE + (max(0.0, min(leaning, slope)) * far if is_first else here)
            if low <= most:
                here, last, is_first = low, max(far, under), False
                least = min(least, low - slope * far + TOLERANCE)
            floor[sector, ring] = here


@jit
def heights_over(points, floor, out):
    """Write the height of points (N, 3) over the floor [sector, ring] in their direction into `out` (N,)."""
    for k in range(len(points)):
        ring, sector = _place(points[k, 0], points[k, 1])
        out[k] = points[k, 2] - (floor[sector, ring] if ring < floor.shape[1] else 0.0)


@jit
def _place(x, y):
    """Ring and sector of a point."""
    sector = int((math.atan2(y, x) + math.pi) / (2.0 * math.pi) * SECTORS) % SECTORS
    return int(math.hypot(x, y) / RING), sector


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    floor = np.zeros((SECTORS, 60))
    walk_floor(np.zeros((3, 3)), 0.3, 0.6, 0.3, np.zeros(2), floor)
    heights_over(np.zeros((3, 3)), floor, np.empty(3))
