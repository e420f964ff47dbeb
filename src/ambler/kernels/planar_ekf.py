"""Kernel of the planar extended Kalman filter: predictions, corrections (Joseph form), and a history in which late measurements find
their place.

State (x, y, yaw, vx, vy, wz, gyro bias): pose in the odometry frame, velocity in the base frame. Constant velocity between steps,
driven by white acceleration noise, or by measured accelerations.
"""

import math

import numpy as np

from ambler.kernels.jit import jit_short

SIZE = 7
TWIST = 0
YAW_RATE = 1
POSE = 2
REFUSED_MOST = 5  # so many measurements refused in a row: the sensors are right, the filter is wrong
GYRO_MAX_AGE_NS = 100_000_000

# One measurement (`kind`, `z`, its covariance `r`; of wheels the variance `doubt` of lasting errors of their turning; accelerations that
# drive the prediction up to it) and the filter right after it: state `x` with covariance `p`, the last turn rate of a gyroscope
# (`gyro_ns` < 0: none), until when the wheels slip, and how many measurements in a row were refused.
ENTRY = np.dtype(
    [
        ("stamp_ns", "i8"),
        ("kind", "i8"),
        ("z", "f8", (3,)),
        ("r", "f8", (3, 3)),
        ("doubt", "f8"),
        ("acceleration", "f8", (2,)),
        ("x", "f8", (SIZE,)),
        ("p", "f8", (SIZE, SIZE)),
        ("gyro_ns", "i8"),
        ("gyro_rate", "f8"),
        ("gyro_variance", "f8"),
        ("slip_until_ns", "i8"),
        ("refused", "i8"),
    ]
)
# How measurements are judged, one record; see `localization.planar_ekf.EkfConfig`.
RULES = np.dtype(
    [
        ("density", "f8", (SIZE,)),
        ("gate", "f8"),
        ("slip_gate", "f8"),
        ("slip_factor", "f8"),
        ("slip_way_factor", "f8"),
        ("slip_hold_ns", "i8"),
    ]
)


@jit_short
def predict(x, p, dt, density, acceleration, work):
    """Carry `x` float64 (7,) and `p` (7, 7) over `dt` seconds in place.

    `density` float64 (7,): noise power of each state (variance per second). `acceleration` float64 (2,): m/s² along the axes of the
    base. `work` (7, 7) is scratch.
    """
    c, s = math.cos(x[2]), math.sin(x[2])
    vx, vy = x[3], x[4]
    half = 0.5 * x[5] * dt
    ch, sh = math.cos(x[2] + half), math.sin(x[2] + half)
    # d(state) / d(state): only the rows of x, y, yaw differ from the identity.
    f02, f03, f04 = (-sh * vx - ch * vy) * dt, ch * dt, -sh * dt
    f12, f13, f14 = (ch * vx - sh * vy) * dt, sh * dt, ch * dt
    f05, f15 = 0.5 * dt * f02, 0.5 * dt * f12
    ax = acceleration[0] + x[5] * vy * (1.0 if acceleration[0] != 0.0 or acceleration[1] != 0.0 else 0.0)
    ay = acceleration[1] - x[5] * vx * (1.0 if acceleration[0] != 0.0 or acceleration[1] != 0.0 else 0.0)
    x[0] += (ch * vx - sh * vy) * dt + 0.5 * (c * ax - s * ay) * dt * dt
    x[1] += (sh * vx + ch * vy) * dt + 0.5 * (s * ax + c * ay) * dt * dt
    x[2] += x[5] * dt
    x[3] += ax * dt
    x[4] += ay * dt
    for j in range(7):
        work[0, j] = p[0, j] + f02 * p[2, j] + f03 * p[3, j] + f04 * p[4, j] + f05 * p[5, j]
        work[1, j] = p[1, j] + f12 * p[2, j] + f13 * p[3, j] + f14 * p[4, j] + f15 * p[5, j]
        work[2, j] = p[2, j] + dt * p[5, j]
        for i in range(3, 7):
            work[i, j] = p[i, j]
    for i in range(7):
        p[i, 0] = work[i, 0] + f02 * work[i, 2] + f03 * work[i, 3] + f04 * work[i, 4] + f05 * work[i, 5]
        p[i, 1] = work[i, 1] + f12 * work[i, 2] + f13 * work[i, 3] + f14 * work[i, 4] + f15 * work[i, 5]
        p[i, 2] = work[i, 2] + dt * work[i, 5]
        for j in range(3, 7):
            p[i, j] = work[i, j]
    # White noise on the velocities reaches the pose within the same step.
    for a in range(3):
        b = a + 3
        q = density[b]
        p[b, b] += q * dt
        if a == 2:
            p[2, 5] += 0.5 * q * dt * dt
            p[5, 2] += 0.5 * q * dt * dt
            p[2, 2] += q * dt * dt * dt / 3.0
        else:
            ux, uy = (ch, sh) if a == 0 else (-sh, ch)
            p[0, b] += 0.5 * q * dt * dt * ux
            p[b, 0] += 0.5 * q * dt * dt * ux
            p[1, b] += 0.5 * q * dt * dt * uy
            p[b, 1] += 0.5 * q * dt * dt * uy
            cube = q * dt * dt * dt / 3.0
            p[0, 0] += cube * ux * ux
            p[0, 1] += cube * ux * uy
            p[1, 0] += cube * ux * uy
            p[1, 1] += cube * uy * uy
        p[a, a] += density[a] * dt
    p[6, 6] += density[6] * dt


@jit_short
def _invert(a, size, inverse):
    """Invert a symmetric positive definite matrix of `size` 1 or 3; False when it is not definite."""
    if size == 1:
        if a[0, 0] <= 0.0:
            return False
        inverse[0, 0] = 1.0 / a[0, 0]
        return True
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if a[0, 0] <= 0.0 or det <= 0.0:
        return False
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = c00 / det, c01 / det, c02 / det
    inverse[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) / det
    inverse[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) / det
    inverse[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / det
    inverse[1, 0], inverse[2, 0], inverse[2, 1] = inverse[0, 1], inverse[0, 2], inverse[1, 2]
    return True


@jit_short
def correct(x, p, kind, z, r, gate, work):
    """Correct by one measurement in place and return its squared Mahalanobis distance; beyond `gate` nothing is changed (-1: bad S).

    `kind` TWIST: z = (vx, vy, wz); YAW_RATE: z[0] = wz + bias; POSE: z = (x, y, yaw). `r` float64 (3, 3) its covariance
    (YAW_RATE: r[0, 0]). `work` float64 (4, 7, 7) is scratch.

    What a velocity tells of the gyroscope's bias does not move the pose: the bias turned all of the way behind, and odometry must
    not jump. The Joseph form keeps the covariance right for such a gain, too.
    """
    size = 1 if kind == YAW_RATE else 3
    first = 0 if kind == POSE else 3
    ph, gain, keep = work[0], work[1], work[2]
    s, inverse = work[3, :3, :3], work[3, 3:6, 3:6]
    nu0 = nu1 = nu2 = 0.0
    for i in range(7):
        if kind == YAW_RATE:
            ph[i, 0] = p[i, 5] + p[i, 6]
        else:
            for a in range(3):
                ph[i, a] = p[i, first + a]
    if kind == YAW_RATE:
        s[0, 0] = ph[5, 0] + ph[6, 0] + r[0, 0]
        nu0 = z[0] - x[5] - x[6]
    else:
        for a in range(3):
            for b in range(3):
                s[a, b] = ph[first + a, b] + r[a, b]
        nu0, nu1, nu2 = z[0] - x[first], z[1] - x[first + 1], z[2] - x[first + 2]
        if kind == POSE:
            nu2 = math.atan2(math.sin(nu2), math.cos(nu2))
    if not _invert(s, size, inverse):
        return -1.0
    if kind != POSE and p[6, 6] > 0.0:
        for i in range(3):
            by_bias = p[i, 6] / p[6, 6]
            for a in range(size):
                ph[i, a] -= by_bias * ph[6, a]
    distance = inverse[0, 0] * nu0 * nu0
    if size == 3:
        distance += inverse[1, 1] * nu1 * nu1 + inverse[2, 2] * nu2 * nu2
        distance += 2.0 * (inverse[0, 1] * nu0 * nu1 + inverse[0, 2] * nu0 * nu2 + inverse[1, 2] * nu1 * nu2)
    if distance > gate:
        return distance
    for i in range(7):
        for a in range(size):
            total = 0.0
            for b in range(size):
                total += ph[i, b] * inverse[b, a]
            gain[i, a] = total
        x[i] += gain[i, 0] * nu0
        if size == 3:
            x[i] += gain[i, 1] * nu1 + gain[i, 2] * nu2
    # Joseph form: (I - K H) P (I - K H)^T + K R K^T. `ph` becomes the left product.
    for i in range(7):
        for j in range(7):
            keep[i, j] = 1.0 if i == j else 0.0
        if kind == YAW_RATE:
            keep[i, 5] -= gain[i, 0]
            keep[i, 6] -= gain[i, 0]
        else:
            for a in range(3):
                keep[i, first + a] -= gain[i, a]
    for i in range(7):
        for j in range(7):
            total = 0.0
            for k in range(7):
                total += keep[i, k] * p[k, j]
            ph[i, j] = total
    for i in range(7):
        for j in range(i + 1):
            total = 0.0
            for k in range(7):
                total += ph[i, k] * keep[j, k]
            for a in range(size):
                for b in range(size):
                    total += gain[i, a] * r[a, b] * gain[j, b]
            p[i, j] = total
            p[j, i] = total
    return distance


@jit_short
def step(x, p, dt, density, acceleration, kind, z, r, gate, work):
    """Predict over `dt` and correct; see `predict` and `correct`."""
    if dt > 0.0:
        predict(x, p, dt, density, acceleration, work[0])
    return correct(x, p, kind, z, r, gate, work)


@jit_short
def _is_slipping(entry, rules):
    """Say whether wheels slip: their turning and the gyroscope's differ by more than what both state of themselves."""
    if entry.gyro_ns < 0 or entry.stamp_ns - entry.gyro_ns > GYRO_MAX_AGE_NS:
        return False
    difference = entry.z[2] - (entry.gyro_rate - entry.x[6])
    sigma2 = entry.r[2, 2] + entry.gyro_variance + entry.p[6, 6]
    if difference * difference > rules.slip_gate * rules.slip_gate * sigma2:
        entry.slip_until_ns = entry.stamp_ns + rules.slip_hold_ns
    return entry.stamp_ns < entry.slip_until_ns


@jit_short
def _weigh_wheels(entry, rules, r):
    """Write the covariance of the wheels' velocity, with what is known of lasting errors and of slip, into `r` (3, 3)."""
    r[:, :] = entry.r
    r[2, 2] += entry.doubt
    if _is_slipping(entry, rules):
        way, turning = math.sqrt(rules.slip_way_factor), math.sqrt(rules.slip_factor)
        for a in range(3):
            for b in range(3):
                r[a, b] *= (turning if a == 2 else way) * (turning if b == 2 else way)


@jit_short
def _filter(entry, before, rules, work):
    """Compute the filter after `entry` from the one after `before`."""
    entry.x[:] = before.x
    entry.p[:, :] = before.p
    entry.gyro_ns, entry.gyro_rate, entry.gyro_variance = before.gyro_ns, before.gyro_rate, before.gyro_variance
    entry.slip_until_ns = before.slip_until_ns
    r = work[4, :3, :3]
    r[:, :] = entry.r
    if entry.kind == YAW_RATE:
        entry.gyro_ns, entry.gyro_rate, entry.gyro_variance = entry.stamp_ns, entry.z[0], entry.r[0, 0]
    elif entry.kind == TWIST:
        _weigh_wheels(entry, rules, r)
    gate = rules.gate if before.refused < REFUSED_MOST else math.inf
    dt = (entry.stamp_ns - before.stamp_ns) * 1e-9
    distance = step(entry.x, entry.p, dt, rules.density, entry.acceleration, entry.kind, entry.z, r, gate, work)
    entry.refused = 0 if 0.0 <= distance <= gate else before.refused + 1


@jit_short
def insert(entries, count, at, stamp_ns, kind, z, r, doubt, acceleration, rules, work):
    """Put a measurement in as number `at` (not the first) of `count` entries sorted by stamp, and filter it and what follows; returns
    whether it was used.

    `entries` (> `count`,) of ENTRY, `rules` (1,) of RULES, `z` float64 (3,), `r` (3, 3), `acceleration` (2,), `work` (5, 7, 7) is scratch.
    """
    for k in range(count, at, -1):
        entries[k] = entries[k - 1]
    entry = entries[at]
    entry.stamp_ns, entry.kind, entry.doubt = stamp_ns, kind, doubt
    entry.z[:], entry.acceleration[:] = z, acceleration
    entry.r[:, :] = r
    for k in range(at, count + 1):
        _filter(entries[k], entries[k - 1], rules[0], work)
    return entry.refused == 0


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    x, p, work = np.zeros(7), np.eye(7), np.zeros((5, 7, 7))
    insert(np.zeros(2, ENTRY), 1, 1, 0, 0, np.zeros(3), np.eye(3), 0.0, np.zeros(2), np.zeros(1, RULES), work)
    step(x, p, 0.01, np.ones(7), np.zeros(2), 0, np.zeros(3), np.eye(3), 9.0, work)
    predict(x, p, 0.01, np.ones(7), np.zeros(2), work[0])
    correct(x, p, 0, np.zeros(3), np.eye(3), 9.0, work)
