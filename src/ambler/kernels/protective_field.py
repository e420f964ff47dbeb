"""How fast a footprint may go along an arc and still stop before it touches points. Exact: no poses are sampled.

In the footprint's frame a point moves on a circle (a line when nothing turns). With tau = tan(w t / 2) / (w / 2) the signed distance
g(t) = n . R(-w t) (p - d(t)) - c from an edge's line, times 1 + (w tau / 2)^2, is the quadratic c0 + c1 tau + c2 tau^2:

    c0 = n . p - c,  c1 = w (n x p) - n . v,  c2 = -w/2 (w/2 (n . p + c) + n x v)

which stays exact while w goes to 0. A point enters the footprint where one edge's quadratic falls through zero and no other edge's
is positive. The length of the arc until then depends on the arc alone, not on the speed; the speed allowed depends on that length alone.
"""

import math

import numpy as np

from ambler.kernels.jit import jit_short

CORNER = 1e-9  # metres outside of the other edges within which an entry still counts, so that no corner lets a point slip through


@jit_short
def braking_time(vx, vy, wz, ax, ay, az):
    """Return the seconds until every axis can stand, braking with `ax`, `ay` (m/s^2) and `az` (rad/s^2)."""
    return max(abs(vx) / ax, abs(vy) / ay, abs(wz) / az)


@jit_short
def stopping_time(scale, reaction, braking):
    """Return the arc time covered before the robot stands, in seconds of motion at full wanted velocity."""
    return scale * reaction + 0.5 * scale * scale * braking


@jit_short
def safe_scale(contact, reaction, braking):
    """Return the largest share 0..1 of the wanted velocity whose `stopping_time` does not exceed the time of `contact`."""
    if contact >= stopping_time(1.0, reaction, braking):
        return 1.0
    if contact <= 0.0:
        return 0.0
    return min(1.0, 2.0 * contact / (reaction + math.sqrt(reaction * reaction + 2.0 * braking * contact)))


@jit_short
def crossing_time(c0, c1, c2, k):
    """Return when the quadratic in tau falls through zero, as a time t = atan(k tau) / k >= 0 within one turn; inf if never."""
    square = c1 * c1 - 4.0 * c0 * c2
    if square < 0.0:
        return np.inf
    root = math.sqrt(square)
    if c1 > 0.0:
        if c2 == 0.0:
            return np.inf
        tau = -(c1 + root) / (2.0 * c2)
    elif root > c1:
        tau = 2.0 * c0 / (root - c1)
    else:
        return np.inf
    half = k * tau
    t = math.atan(half) / k if abs(half) > 1e-9 else tau
    if t >= 0.0:
        return t
    return t + math.pi / abs(k) if k != 0.0 else np.inf  # in the second half of the turn


@jit_short
def entry_time(x, y, k, normals, offsets, across, grown, foremost, latest):
    """Return when the point (x, y) enters the footprint `grown` by some metres on all sides while the footprint moves with the body
    velocity v and turns with w = 2 k; inf if not until `latest`. The point is outside of the edge `foremost`. `across` float64
    (E, 2): n . v and n x v of every edge."""
    first = latest
    has_entered = False
    for m in range(-1, normals.shape[0]):
        e = foremost if m < 0 else m
        c0, c1, c2 = edge_quadratic(x, y, k, normals, offsets, across, grown, e)
        t = crossing_time(c0, c1, c2, k)
        if m < 0:
            if t > latest:
                return np.inf  # it cannot be inside before it has crossed this edge
        elif t <= first and _is_within(t, x, y, k, normals, offsets, across, grown, e):
            first, has_entered = t, True
    return first if has_entered else np.inf


@jit_short
def edge_quadratic(x, y, k, normals, offsets, across, grown, e):
    """Return (c0, c1, c2) of one edge; k = w / 2."""
    along = normals[e, 0] * x + normals[e, 1] * y
    limit = offsets[e] + grown
    c1 = 2.0 * k * (normals[e, 0] * y - normals[e, 1] * x) - across[e, 0]
    return along - limit, c1, -k * (k * (along + limit) + across[e, 1])


@jit_short
def _is_within(t, x, y, k, normals, offsets, across, grown, edge):
    """Say whether no edge but `edge` has the point outside at the time t."""
    half = k * t
    c, run = math.cos(half), math.sin(half) / k if abs(half) > 1e-9 else t
    for e in range(normals.shape[0]):
        c0, c1, c2 = edge_quadratic(x, y, k, normals, offsets, across, grown, e)
        if e != edge and (c0 * c + c1 * run) * c + c2 * run * run > CORNER:
            return False
    return True


@jit_short
def contact_time(points, normals, offsets, radius, twist, horizon, margin, tolerance, self_depth, min_points):
    """Return the time at which the footprint, moving with the constant body `twist` (vx, vy, wz), comes nearer than `margin` to
    `min_points` of the points (N, 2); inf if not within `horizon` seconds.

    A point that is already nearer counts from where the motion has brought it nearer still by `tolerance`, so a motion that leads
    away is always free. Points deeper inside than `self_depth` are the robot itself. `radius` is that of the circle about the
    base around the footprint with its margin.
    """
    drift = math.hypot(twist[0], twist[1])
    reach = radius + drift * horizon  # turning brings no point nearer to the base
    fastest = drift + abs(twist[2]) * reach
    across = np.empty((normals.shape[0], 2))
    for e in range(normals.shape[0]):
        across[e, 0] = normals[e, 0] * twist[0] + normals[e, 1] * twist[1]
        across[e, 1] = normals[e, 0] * twist[1] - normals[e, 1] * twist[0]
    first = np.full(min_points, np.inf)
    latest = horizon
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        if max(abs(x), abs(y)) > reach:
            continue
        clearance, foremost = -np.inf, 0
        for e in range(normals.shape[0]):
            d = normals[e, 0] * x + normals[e, 1] * y - offsets[e]
            if d > clearance:
                clearance, foremost = d, e
        grown = min(margin, clearance - tolerance)
        if clearance <= -self_depth or clearance - grown > fastest * latest:
            continue
        t = entry_time(x, y, 0.5 * twist[2], normals, offsets, across, grown, foremost, latest)
        for m in range(min_points):
            if t < first[m]:
                first[m], t = t, first[m]
        latest = min(latest, first[min_points - 1])
    return first[min_points - 1]


@jit_short
def free_scale(points, normals, offsets, radius, twist, braking, reaction, margin, tolerance, self_depth, min_points):
    """Return the share 0..1 of `twist` from which the robot, which needs `reaction` and then `braking` seconds from full speed, still
    stops before the contact with `min_points` of the points. See `contact_time`."""
    horizon = stopping_time(1.0, reaction, braking)
    contact = contact_time(points, normals, offsets, radius, twist, horizon, margin, tolerance, self_depth, min_points)
    return safe_scale(contact, reaction, braking)


@jit_short
def carry_points(points, x, y, cos, sin, first, out):
    """Write the points (N, 2), moved by a pose, into the rows of `out` from `first` on; returns the row after them."""
    for i in range(points.shape[0]):
        out[first + i, 0] = x + cos * points[i, 0] - sin * points[i, 1]
        out[first + i, 1] = y + sin * points[i, 0] + cos * points[i, 1]
    return first + points.shape[0]


def warm_up() -> None:
    """Compile every kernel of this module."""
    normals = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    offsets, points, twist = np.ones(4), np.full((2, 2), 1.2), np.array([0.5, 0.0, 0.1])
    braking = braking_time(0.5, 0.0, 0.1, 1.0, 1.0, 1.0)
    stopping_time(1.0, 0.2, braking)
    safe_scale(0.1, 0.2, braking)
    crossing_time(0.1, -0.5, 0.0, 0.05)
    contact_time(points, normals, offsets, 1.5, twist, 1.0, 0.03, 1e-4, 0.05, 2)
    free_scale(points, normals, offsets, 1.5, twist, braking, 0.2, 0.03, 1e-4, 0.05, 2)
    carry_points(points, 0.1, 0.0, 1.0, 0.0, 0, points.copy())
