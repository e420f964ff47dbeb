"""Where a kerb may go on that is seen only from afar: a level LiDAR sees a row of stones 5 m away, and nothing of it beside the robot.

Ground that cannot be seen is assumed to go on as the robot stands. A low thing that is long and straight, and ends where ground is only assumed, goes on there as far as it
was seen, as a rule; and what is told as ground there, at the edge of what can be seen, may be its top: a single ring of returns, with no floor before it.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.kernels.ground_map import ASSUMED, STOOD, UNKNOWN
from ambler.perception.ground_level import FAR, Level

F64 = NDArray[np.float64]
LOW = 0.3  # metres over the ground around it: what is higher shows itself from near, too
AROUND = 0.5  # metres within which that ground is looked for
BESIDE = 0.4  # metres: the foot of something high is no low thing
GAP = 0.3  # metres between pieces of one thing
LEAST, STRAIGHT = 1.5, 0.25  # metres: how long it is at least, and how far from a line (RMS) at most
TAIL = 3.0  # metres of its end that say where it goes on
MOST = 6.0  # metres that it goes on at most
HALF, SPREAD = 0.3, 0.1  # metres to either side, and more for each metre on
ENDS = 1.5  # metres of known ground that end it: a level LiDAR takes the edge of a kerb for ground in the last metre in which it sees that and no floor
RIM = 0.5  # metres beside ground that is only assumed in which what is seen has no floor before it
STEP = 0.1
BORDER = 8.0  # metres around what is assumed in which such things are looked for


def beyond_low_edges(level: Level) -> NDArray[np.bool_]:
    """Return the cells (bool [iy, ix]) of ground that is only assumed, or was seen beside such, onto which a long low thing may go on."""
    out = np.zeros(level.spec.shape, np.bool_)
    assumed = level.evidence == ASSUMED
    rows, columns = (np.flatnonzero(assumed.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return out
    border, r = round(BORDER / level.spec.resolution), level.spec.resolution
    inner = np.s_[
        max(0, rows[0] - border) : rows[-1] + border + 1, max(0, columns[0] - border) : columns[-1] + border + 1
    ]
    evidence, near = level.evidence[inner], out[inner]
    for thing in _things(evidence, level.heights[inner], level.reaches[inner], r):
        for end, ahead, length in _ends(thing):
            _draw(near, evidence, r, end, ahead, min(length, MOST))
    rim = 2 * round(RIM / r) + 1
    is_rim = cv2.dilate(assumed[inner].astype(np.uint8), np.ones((rim, rim), np.uint8)) > 0
    near &= is_rim & (evidence > 0) & (level.firm[inner] != STOOD)
    return out


def _things(
    evidence: NDArray[np.int8], heights: NDArray[np.float32], reaches: NDArray[np.float32], resolution: float
) -> list[F64]:
    """Return the cells (N, 2), x and y in metres, of each low thing that is large enough."""
    wide = 2 * round(AROUND / resolution) + 1
    is_ground = (evidence > 0) & (evidence != ASSUMED) & np.isfinite(heights)
    ground = cv2.erode(np.where(is_ground, heights, FAR).astype(np.float32), np.ones((wide, wide), np.uint8))
    known = (evidence <= 0) & (evidence != UNKNOWN)
    high = known & ~((reaches - ground < LOW) & (ground < FAR))  # where no ground is seen, nothing tells that it is low
    beside = 2 * round(BESIDE / resolution) + 1
    low = known & (cv2.dilate(high.astype(np.uint8), np.ones((beside, beside), np.uint8)) == 0)
    gap = 2 * round(0.5 * GAP / resolution) + 1
    labels, count = ndimage.label(cv2.dilate(low.astype(np.uint8), np.ones((gap, gap), np.uint8)), np.ones((3, 3)))
    labels[~low] = 0
    iy, ix = np.nonzero(labels)
    of = labels[iy, ix]
    points = (np.column_stack((ix, iy)) + 0.5) * resolution
    sizes = np.bincount(of, minlength=count + 1)
    return [points[of == k] for k in np.flatnonzero(sizes >= LEAST / resolution) if k > 0]


def _ends(thing: F64) -> list[tuple[F64, F64, float]]:
    """Return both ends of a straight thing, the directions in which it would go on, and how long it is (m); none of others."""
    axis, away = _line(thing)
    along = (thing - thing.mean(axis=0)) @ axis
    length = float(np.ptp(along))
    if length < LEAST or away > STRAIGHT:
        return []
    out = []
    for sign in (-1.0, 1.0):
        past = sign * along
        tail = thing[past >= past.max() - TAIL]
        ahead, _ = _line(tail)
        ahead = ahead * np.sign(ahead @ (sign * axis))
        out.append((thing[past >= past.max() - GAP].mean(axis=0), ahead, length))
    return out


def _line(points: F64) -> tuple[F64, float]:
    """Return the direction of the line through points and how far they lie from it, RMS."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    return vectors[:, 1], math.sqrt(max(float(values[0]), 0.0))


def _draw(
    out: NDArray[np.bool_], evidence: NDArray[np.int8], resolution: float, end: F64, ahead: F64, length: float
) -> None:
    """Mark the strip onto which a thing may go on, until it comes to ground that is known."""
    known = 0.0
    for far in np.arange(STEP, length + 1e-9, STEP):
        x, y = end + far * ahead
        iy, ix = math.floor(y / resolution), math.floor(x / resolution)
        if not (0 <= iy < out.shape[0] and 0 <= ix < out.shape[1]):
            return
        known = known + STEP if evidence[iy, ix] not in (ASSUMED, UNKNOWN) and far > GAP else 0.0
        if known >= ENDS:
            return
        reach = math.ceil((HALF + SPREAD * far) / resolution)
        out[max(0, iy - reach) : iy + reach + 1, max(0, ix - reach) : ix + reach + 1] = True
