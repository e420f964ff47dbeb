"""What a scan of some time ago says of places where something is now: whether it came there since."""

import math

import numpy as np

from ambler.kernels.jit import jit

NOTHING, BLIND, STOOD, THROUGH = 0, 1, 2, 3
UNASKED = 255
UNKNOWN, CAME, WAS_THERE = 0, 1, 2


@jit
def testimony(azimuth, ranges, sector, reach, half_bin, behind, x, y):
    """Return what a scan says of a place in its scanner's frame.

    `azimuth` (M,) rad in -pi ... pi, ascending, and `ranges` (M,) m of its returns; `sector` (2,): middle and half of the azimuths in which it looks; `reach` (2,): the
    ranges between which it can tell. THROUGH: there are returns within `half_bin` rad of the direction, and all within that and within `behind` m beside the place lie
    farther than it by more than `behind` m, which odometry may have drifted since. STOOD: one does not. BLIND: the scanner does not look there, or got nothing back from there. NOTHING: too far to tell.
    """
    r, a = math.hypot(x, y), math.atan2(y, x)
    if r > reach[1]:
        return NOTHING
    if r < reach[0] or abs((a - sector[0] + math.pi) % (2.0 * math.pi) - math.pi) > sector[1]:
        return BLIND
    found, half = BLIND, max(half_bin, math.atan2(behind, r))
    for turn in range(-1, 2):
        at = a + turn * 2.0 * math.pi
        k = np.searchsorted(azimuth, at - half)
        while k < azimuth.shape[0] and azimuth[k] <= at + half:
            if ranges[k] <= r + behind:
                return STOOD
            if abs(azimuth[k] - at) <= half_bin:
                found = THROUGH
            k += 1
    return found


@jit
def mark_comers(azimuth, ranges, points, limits, tolerances, places, returns, asked, out):
    """Bring `out` uint8 (N,), of all older scans, up to what this scan says of `places` (N, 2): UNKNOWN, CAME since, or WAS_THERE.

    CAME: the scan looked through the place; or no older one found something there, this one is BLIND for it, none of its returns lies within `beside` m, and it looked
    through one of the `returns` (K, 2) of now within `near` m of the place. WAS_THERE: something stood there or before it. `points` (M, 2) are the scan's returns, `limits` (2, 2) sector and reach as in `testimony`, `tolerances` half_bin,
    behind, beside, near; `asked` uint8 (K,) is scratch. All in the frame of the scan's scanner.
    """
    half_bin, behind, beside, near = tolerances
    asked[:] = UNASKED
    for i in range(places.shape[0]):
        x, y = places[i, 0], places[i, 1]
        if out[i] == CAME:
            continue
        said = testimony(azimuth, ranges, limits[0], limits[1], half_bin, behind, x, y)
        if said == THROUGH:
            out[i] = CAME
        elif said == STOOD:
            out[i] = WAS_THERE
        if said != BLIND or out[i] == WAS_THERE:
            continue
        stood = False
        for k in range(points.shape[0]):
            dx, dy = points[k, 0] - x, points[k, 1] - y
            stood = stood or dx * dx + dy * dy < beside * beside
        if stood:
            out[i] = WAS_THERE
            continue
        for k in range(returns.shape[0]):
            dx, dy = returns[k, 0] - x, returns[k, 1] - y
            if dx * dx + dy * dy > near * near:
                continue
            if asked[k] == UNASKED:
                asked[k] = testimony(
                    azimuth, ranges, limits[0], limits[1], half_bin, behind, returns[k, 0], returns[k, 1]
                )
            if asked[k] == THROUGH:
                out[i] = CAME
                break


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    two, pair, few = np.zeros(2), np.zeros((2, 2)), np.zeros(2, np.uint8)
    mark_comers(two, two, pair, pair, (0.1, 0.1, 0.1, 0.1), pair, pair, few, few)
