"""The cone of an ultrasonic echo drawn into a grid of log odds: nothing before the echo, something on its arc, unknown behind.

After the idea of ROS's range sensor layer: certainty fades from the axis of the cone to its sides (1 - (angle / half)^2) and, beyond
a metre or so, with distance (a logistic step).
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit

UNSEEN = -1e30
LEAST_WIDTH = 0.75  # cells to either side of the axis: a narrower cone would pass between their centres


@jit
def draw_cone(log_odds, touched, origin_x, origin_y, resolution, cone, model, limits, now):
    """Add one measurement to `log_odds` float32 (H, W) and the time of it to the cells that it says something of, `touched` float64 (H, W).

    `cone` float64 (6,): x, y, yaw of the transducer, half angle (rad), how far it saw nothing (m), and the range of the echo (m; inf:
    none). `model` (5,): log odds added on the axis by an echo, and taken by its absence; half thickness of the arc (m); distance (m) of
    the step in certainty, and its width (m). `limits` (2,): least and largest log odds of a cell.
    """
    height, width = log_odds.shape
    x0, y0, yaw, half, free, echo = cone[0], cone[1], cone[2], cone[3], cone[4], cone[5]
    hit, miss, thickness, far, fade = model[0], model[1], model[2], model[3], model[4]
    reach = free if echo == np.inf else max(free, echo + thickness)
    ix0 = max(0, int(math.floor((x0 - reach - origin_x) / resolution)))
    ix1 = min(width, int(math.floor((x0 + reach - origin_x) / resolution)) + 1)
    iy0 = max(0, int(math.floor((y0 - reach - origin_y) / resolution)))
    iy1 = min(height, int(math.floor((y0 + reach - origin_y) / resolution)) + 1)
    c, s = math.cos(yaw), math.sin(yaw)
    for iy in range(iy0, iy1):
        dy = origin_y + (iy + 0.5) * resolution - y0
        for ix in range(ix0, ix1):
            dx = origin_x + (ix + 0.5) * resolution - x0
            along, across = c * dx + s * dy, c * dy - s * dx
            d = math.hypot(dx, dy)
            if along <= 0.0 or d > reach:
                continue
            off = abs(math.atan2(across, along)) / max(half, math.atan2(LEAST_WIDTH * resolution, d))
            if off >= 1.0:
                continue
            sure = (1.0 - off * off) * (0.5 - 0.5 * math.tanh((d - far) / fade))
            if abs(d - echo) <= thickness:
                change = hit * sure
            elif d < free:
                change = -miss * sure
            else:
                continue
            log_odds[iy, ix] = min(max(log_odds[iy, ix] + change, limits[0]), limits[1])
            touched[iy, ix] = now


@jit
def to_cells(log_odds, touched, now, decay, mark, clear, out):
    """Write 254 where the log odds are at least `mark`, 0 where at most `clear`, else 255, to `out` uint8 (H, W).

    Cells that nothing has been said of for more than `decay` seconds (inf: never) are forgotten.
    """
    height, width = log_odds.shape
    for iy in range(height):
        for ix in range(width):
            if now - touched[iy, ix] > decay:
                log_odds[iy, ix] = 0.0
                touched[iy, ix] = UNSEEN
            value = log_odds[iy, ix]
            out[iy, ix] = 254 if value >= mark else (0 if value <= clear else 255)


@jit
def draw_segments(grid, origin_x, origin_y, resolution, segments, value):
    """Set every cell of `grid` uint8 (H, W) that a segment of `segments` float64 (N, 4) passes, sampled at a quarter of a cell."""
    height, width = grid.shape
    for k in range(segments.shape[0]):
        x0, y0 = segments[k, 0], segments[k, 1]
        dx, dy = segments[k, 2] - x0, segments[k, 3] - y0
        steps = max(1, int(math.ceil(4.0 * math.hypot(dx, dy) / resolution)))
        for i in range(steps + 1):
            ix = int(math.floor((x0 + dx * i / steps - origin_x) / resolution))
            iy = int(math.floor((y0 + dy * i / steps - origin_y) / resolution))
            if 0 <= iy < height and 0 <= ix < width:
                grid[iy, ix] = value


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    log_odds, touched, out = np.zeros((4, 4), np.float32), np.full((4, 4), UNSEEN), np.zeros((4, 4), np.uint8)
    cone, model, limits = (
        np.array([0.0, 0.1, 0.0, 0.26, 0.1, 0.15]),
        np.array([1.0, 0.5, 0.05, 1.5, 0.5]),
        np.array([-2.0, 4.0]),
    )
    draw_cone(log_odds, touched, 0.0, 0.0, 0.05, cone, model, limits, 0.0)
    to_cells(log_odds, touched, 0.0, np.inf, 1.0, -1.0, out)
    draw_segments(out, 0.0, 0.0, 0.05, np.array([[0.0, 0.0, 0.1, 0.1]]), 254)
