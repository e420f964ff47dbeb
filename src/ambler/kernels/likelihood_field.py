"""Kernels that weigh particles against a map: the likelihood field and the beam model of Probabilistic Robotics (6.3, 6.4)."""

import math

import numpy as np

from ambler.kernels.jit import jit


@jit
def log_likelihood_field(distance, sigma, hit, rand, out):
    """Write `out` float32 (H, W): log(hit exp(-d² / 2 sigma²) + rand) of `distance` float32 (H, W), metres."""
    for iy in range(distance.shape[0]):
        for ix in range(distance.shape[1]):
            d = distance[iy, ix]
            out[iy, ix] = math.log(hit * math.exp(-0.5 * d * d / (sigma * sigma)) + rand)


@jit
def weigh_by_field(field, frame, particles, points, outside, scale, log_weights):
    """Write `log_weights` float64 (N,) = scale * sum over `points` float32 (B, 2) of the field at the end points.

    `particles` float64 (N, 3), `field` float32 (H, W) from `log_likelihood_field`; `outside` counts beyond the map.
    """
    inverse = 1.0 / frame[0]
    height, width = field.shape
    for i in range(particles.shape[0]):
        c, s = math.cos(particles[i, 2]) * inverse, math.sin(particles[i, 2]) * inverse
        ox = (particles[i, 0] - frame[1]) * inverse
        oy = (particles[i, 1] - frame[2]) * inverse
        total = 0.0
        for b in range(points.shape[0]):
            px, py = points[b, 0], points[b, 1]
            fx = ox + c * px - s * py
            fy = oy + s * px + c * py
            if fx >= 0.0 and fy >= 0.0 and fx < width and fy < height:
                total += field[int(fy), int(fx)]
            else:
                total += outside
        log_weights[i] = scale * total


@jit
def cast_ray(cells, frame, x, y, dx, dy, reach):
    """Return the distance from (x, y) along the unit vector (dx, dy) to the first cell >= 50 (its near face), at most `reach`."""
    height, width = cells.shape
    inverse = 1.0 / frame[0]
    fx, fy = (x - frame[1]) * inverse, (y - frame[2]) * inverse
    ix, iy = int(math.floor(fx)), int(math.floor(fy))
    step_x = 1 if dx > 0.0 else -1
    step_y = 1 if dy > 0.0 else -1
    delta_x = abs(1.0 / dx) if dx != 0.0 else 1e30
    delta_y = abs(1.0 / dy) if dy != 0.0 else 1e30
    next_x = ((ix + 1 - fx) if dx > 0.0 else (fx - ix)) * delta_x
    next_y = ((iy + 1 - fy) if dy > 0.0 else (fy - iy)) * delta_y
    limit = reach * inverse
    t = 0.0
    while t < limit:
        if ix < 0 or iy < 0 or ix >= width or iy >= height:
            return reach
        if cells[iy, ix] >= 50:
            return t * frame[0]
        if next_x < next_y:
            t = next_x
            next_x += delta_x
            ix += step_x
        else:
            t = next_y
            next_y += delta_y
            iy += step_y
    return reach


@jit
def weigh_by_beams(cells, frame, particles, points, model, scale, log_weights):
    """Write `log_weights` float64 (N,) of the beam model for the returns `points` float32 (B, 2), seen from the base.

    `model` float64 (7,): weights of hit, short, max, rand; sigma of hit (m); rate of short (1/m); largest range (m).
    """
    hit, short, at_max, rand, sigma, rate, reach = model[0], model[1], model[2], model[3], model[4], model[5], model[6]
    for i in range(particles.shape[0]):
        c, s = math.cos(particles[i, 2]), math.sin(particles[i, 2])
        total = 0.0
        for b in range(points.shape[0]):
            px, py = points[b, 0], points[b, 1]
            r = math.sqrt(px * px + py * py)
            if r < 1e-6:
                continue
            dx, dy = (c * px - s * py) / r, (s * px + c * py) / r
            expected = cast_ray(cells, frame, particles[i, 0], particles[i, 1], dx, dy, reach)
            e = r - expected
            p = rand / reach + hit * math.exp(-0.5 * e * e / (sigma * sigma))
            if e < 0.0:
                p += short * rate * math.exp(-rate * r)
            if r >= reach:
                p += at_max
            total += math.log(p)
        log_weights[i] = scale * total


@jit
def label_return(cells, frame, x, y, dx, dy, r, slack):
    """Judge a return at `r` metres along the unit vector (dx, dy) from (x, y): 0 explained, 1 too far, 2 too near."""
    expected = cast_ray(cells, frame, x, y, dx, dy, r + 2.0 * slack)
    if abs(r - expected) <= slack:
        return 0
    # A ray that grazes an edge may pass beside it: it contradicts only if its neighbours to both sides do as well.
    left = cast_ray(cells, frame, x - slack * dy, y + slack * dx, dx, dy, r + 2.0 * slack)
    right = cast_ray(cells, frame, x + slack * dy, y - slack * dx, dx, dy, r + 2.0 * slack)
    if r > expected:
        return 1 if r > left + slack and r > right + slack else 0
    return 2 if left > r + slack and right > r + slack else 0


@jit
def label_returns(cells, frame, points, pose, slack, labels):
    """Write `labels` int8 (N,) as `label_return` gives them, of returns float32 (N, 2) seen from one pose float64 (3,).

    -1, which says nothing: at the sensor itself, and too near where the map does not know whether anything stands.
    """
    height, width = cells.shape
    inverse = 1.0 / frame[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for b in range(points.shape[0]):
        px, py = points[b, 0], points[b, 1]
        r = math.sqrt(px * px + py * py)
        if r < 1e-6:
            labels[b] = -1
            continue
        dx, dy = (c * px - s * py) / r, (s * px + c * py) / r
        labels[b] = label_return(cells, frame, pose[0], pose[1], dx, dy, r, slack)
        if labels[b] != 2:
            continue
        ix = int(math.floor((pose[0] + r * dx - frame[1]) * inverse))
        iy = int(math.floor((pose[1] + r * dy - frame[2]) * inverse))
        if ix < 0 or iy < 0 or ix >= width or iy >= height or cells[iy, ix] < 0:
            labels[b] = -1


@jit
def contradictions(cells, frame, points, pose, slack, out):
    """Judge returns against the map from one pose float64 (3,): `out` int64 (3,) counts points explained, too far, too near.

    Explained: within `slack` metres of the first wall along the ray. Too far: the ray went through a wall of the map, which nothing
    but a wrong pose or a changed building explains. Too near: something stands in free space, as people do.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    out[:] = 0
    for b in range(points.shape[0]):
        px, py = points[b, 0], points[b, 1]
        r = math.sqrt(px * px + py * py)
        if r < 1e-6:
            continue
        dx, dy = (c * px - s * py) / r, (s * px + c * py) / r
        out[label_return(cells, frame, pose[0], pose[1], dx, dy, r, slack)] += 1


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    distance = np.zeros((4, 4), np.float32)
    field = np.zeros((4, 4), np.float32)
    log_likelihood_field(distance, 0.1, 0.9, 0.1, field)
    frame = np.array([1.0, 0.0, 0.0])
    cells = np.zeros((4, 4), np.int8)
    points = np.ones((2, 2), np.float32)
    particles, weights = np.ones((2, 3)), np.zeros(2)
    weigh_by_field(field, frame, particles, points, -1.0, 1.0, weights)
    cast_ray(cells, frame, 1.0, 1.0, 1.0, 0.0, 2.0)
    weigh_by_beams(cells, frame, particles, points, np.ones(7), 1.0, weights)
    label_return(cells, frame, 1.0, 1.0, 1.0, 0.0, 1.0, 0.1)
    label_returns(cells, frame, points, np.ones(3), 0.1, np.zeros(2, np.int8))
    contradictions(cells, frame, points, np.ones(3), 0.1, np.zeros(3, np.int64))
