"""Kernels of the particle filter: motion models, systematic resampling, bins of KLD sampling, clusters.

Sources: Probabilistic Robotics, tables 5.6 (odometry motion) and 8.4 (KLD sampling, Fox 2001); AMCL's omnidirectional model.
"""

import math

import numpy as np

from ambler.kernels.jit import jit


@jit
def _wrap(a):
    return math.atan2(math.sin(a), math.cos(a))


@jit
def move_differential(particles, motion, alpha, noise):
    """Move `particles` float64 (N, 3) in place: turn, drive, turn. `motion` (x, y, yaw) in the old base frame, `alpha` (5,),
    `noise` float64 (N, 3) standard normal."""
    way = math.hypot(motion[0], motion[1])
    first = math.atan2(motion[1], motion[0]) if way > 0.01 else 0.0
    second = _wrap(motion[2] - first)
    a = min(abs(first), abs(_wrap(first - math.pi)))
    b = min(abs(second), abs(_wrap(second - math.pi)))
    sigma_first = math.sqrt(alpha[0] * a * a + alpha[1] * way * way)
    sigma_second = math.sqrt(alpha[0] * b * b + alpha[1] * way * way)
    sigma_way = math.sqrt(alpha[2] * way * way + alpha[3] * (a * a + b * b))
    for i in range(particles.shape[0]):
        turn = first + sigma_first * noise[i, 0]
        drive = way + sigma_way * noise[i, 1]
        heading = particles[i, 2] + turn
        particles[i, 0] += drive * math.cos(heading)
        particles[i, 1] += drive * math.sin(heading)
        particles[i, 2] = _wrap(heading + second + sigma_second * noise[i, 2])


@jit
def move_omni(particles, motion, alpha, noise):
    """Move `particles` float64 (N, 3) in place along and across the direction of motion, with noise of way, side and turn."""
    way = math.hypot(motion[0], motion[1])
    bearing = math.atan2(motion[1], motion[0]) if way > 1e-9 else 0.0
    turn2, way2 = motion[2] * motion[2], way * way
    sigma_way = math.sqrt(alpha[2] * way2 + alpha[3] * turn2)
    sigma_side = math.sqrt(alpha[3] * turn2 + alpha[4] * way2)
    sigma_turn = math.sqrt(alpha[0] * turn2 + alpha[1] * way2)
    for i in range(particles.shape[0]):
        c, s = math.cos(particles[i, 2] + bearing), math.sin(particles[i, 2] + bearing)
        drive = way + sigma_way * noise[i, 0]
        side = sigma_side * noise[i, 1]
        particles[i, 0] += drive * c - side * s
        particles[i, 1] += drive * s + side * c
        particles[i, 2] = _wrap(particles[i, 2] + motion[2] + sigma_turn * noise[i, 2])


@jit
def normalize(log_weights, weights):
    """Turn log weights (N,), added to the logs of `weights` (N,), into weights of sum 1; returns log of the mean likelihood."""
    n = weights.shape[0]
    best = -math.inf
    for i in range(n):
        log_weights[i] += math.log(max(weights[i], 1e-300))
        best = max(best, log_weights[i])
    total = 0.0
    for i in range(n):
        weights[i] = math.exp(log_weights[i] - best)
        total += weights[i]
    for i in range(n):
        weights[i] /= total
    return best + math.log(total)


@jit
def resample_systematic(weights, offset, chosen):
    """Write `chosen` int64 (M,): indices drawn by M equally spaced pointers from `offset` in [0, 1), in one pass."""
    m = chosen.shape[0]
    cumulated = weights[0]
    i = 0
    last = weights.shape[0] - 1
    for k in range(m):
        pointer = (k + offset) / m
        while pointer > cumulated and i < last:
            i += 1
            cumulated += weights[i]
        chosen[k] = i


@jit
def assign_bins(particles, size, keys, table, bins):
    """Give every particle its bin of x, y, yaw: `bins` int64 (N,) numbers from 0; returns how many bins are occupied.

    `size` float64 (2,): metres, radians. `keys` int64 (N, 3) gets the coordinates of bin k in row k. `table` int64 (T,), T a power
    of two >= 2 N, is scratch.
    """
    table[:] = -1
    mask = table.shape[0] - 1
    count = 0
    for i in range(particles.shape[0]):
        kx = int(math.floor(particles[i, 0] / size[0]))
        ky = int(math.floor(particles[i, 1] / size[0]))
        ka = int(math.floor(particles[i, 2] / size[1]))
        slot = (kx * 73856093 ^ ky * 19349663 ^ ka * 83492791) & mask
        while True:
            b = table[slot]
            if b < 0:
                keys[count, 0], keys[count, 1], keys[count, 2] = kx, ky, ka
                table[slot] = count
                bins[i] = count
                count += 1
                break
            if keys[b, 0] == kx and keys[b, 1] == ky and keys[b, 2] == ka:
                bins[i] = b
                break
            slot = (slot + 1) & mask
    return count


@jit
def _find(keys, table, kx, ky, ka):
    mask = table.shape[0] - 1
    slot = (kx * 73856093 ^ ky * 19349663 ^ ka * 83492791) & mask
    while True:
        b = table[slot]
        if b < 0:
            return -1
        if keys[b, 0] == kx and keys[b, 1] == ky and keys[b, 2] == ka:
            return b
        slot = (slot + 1) & mask


@jit
def heaviest_cluster(weights, keys, table, bins, count, turn_bins, label, todo, bin_weight):
    """Join neighbouring bins to clusters; `label` int64 (count,) numbers them. Returns (number of the heaviest, its weight).

    `turn_bins`: bins of a full turn. `todo` int64 (N,), `bin_weight` float64 (N,) are scratch; see `assign_bins`.
    """
    bin_weight[:count] = 0.0
    for i in range(weights.shape[0]):
        bin_weight[bins[i]] += weights[i]
    label[:count] = -1
    lowest = -(turn_bins // 2)
    best, best_weight = -1, -1.0
    clusters = 0
    for seed in range(count):
        if label[seed] >= 0:
            continue
        label[seed] = clusters
        todo[0] = seed
        waiting = 1
        weight = 0.0
        while waiting > 0:
            waiting -= 1
            b = todo[waiting]
            weight += bin_weight[b]
            for dx in range(-1, 2):
                for dy in range(-1, 2):
                    for da in range(-1, 2):
                        ka = (keys[b, 2] + da - lowest) % turn_bins + lowest
                        n = _find(keys, table, keys[b, 0] + dx, keys[b, 1] + dy, ka)
                        if n >= 0 and label[n] < 0:
                            label[n] = clusters
                            todo[waiting] = n
                            waiting += 1
        if weight > best_weight:
            best, best_weight = clusters, weight
        clusters += 1
    return best, best_weight


@jit
def moments(particles, weights, bins, label, cluster, mean, covariance):
    """Write weighted `mean` (3,) (yaw on the circle) and `covariance` (3, 3) of one cluster's particles."""
    w = sx = sy = sc = ss = 0.0
    for i in range(particles.shape[0]):
        if label[bins[i]] == cluster:
            w += weights[i]
            sx += weights[i] * particles[i, 0]
            sy += weights[i] * particles[i, 1]
            sc += weights[i] * math.cos(particles[i, 2])
            ss += weights[i] * math.sin(particles[i, 2])
    mean[0], mean[1], mean[2] = sx / w, sy / w, math.atan2(ss, sc)
    covariance[:, :] = 0.0
    for i in range(particles.shape[0]):
        if label[bins[i]] == cluster:
            dx, dy = particles[i, 0] - mean[0], particles[i, 1] - mean[1]
            da = _wrap(particles[i, 2] - mean[2])
            u = weights[i] / w
            covariance[0, 0] += u * dx * dx
            covariance[0, 1] += u * dx * dy
            covariance[0, 2] += u * dx * da
            covariance[1, 1] += u * dy * dy
            covariance[1, 2] += u * dy * da
            covariance[2, 2] += u * da * da
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = covariance[0, 1], covariance[0, 2], covariance[1, 2]


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    particles, noise, weights = np.zeros((4, 3)), np.zeros((4, 3)), np.full(4, 0.25)
    move_differential(particles, np.ones(3), np.ones(5), noise)
    move_omni(particles, np.ones(3), np.ones(5), noise)
    normalize(np.zeros(4), weights)
    resample_systematic(weights, 0.5, np.zeros(4, np.int64))
    keys, table, bins = np.zeros((4, 3), np.int64), np.zeros(8, np.int64), np.zeros(4, np.int64)
    count = assign_bins(particles, np.array([0.5, 0.1745]), keys, table, bins)
    label = np.zeros(4, np.int64)
    heaviest_cluster(weights, keys, table, bins, count, 36, label, np.zeros(4, np.int64), np.zeros(4))
    moments(particles, weights, bins, label, 0, np.zeros(3), np.zeros((3, 3)))
