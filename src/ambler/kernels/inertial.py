"""Inertial propagation of pose, velocity and their covariance, motion compensation of clouds, and the sums of point-to-plane residuals.

The error state has its parts in this order: position (3), rotation (3, perturbed on the right), velocity (3), gyroscope bias (3), accelerometer bias
(3), gravity (2, on the sphere), and what is estimated on request behind them. Equations: FAST-LIO2 (Xu et al. 2022), sections IV-B
and IV-C, rotations after Sola, Deray and Atchuthan 2018.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit, jit_fused, jit_short, read_only

POSITION, ROTATION, VELOCITY, GYRO_BIAS, ACCEL_BIAS, GRAVITY, EXTRA = 0, 3, 6, 9, 12, 15, 17
# Columns of a trajectory float64 (K, KNOT): time, position, velocity, acceleration in the map, angular rate in the body from here to the next
# knot, rotation row by row.
T, P, V, A, W, R, KNOT = 0, 1, 4, 7, 10, 13, 22
SMALL = 1e-8


@jit
def so3_exp(wx, wy, wz, out):
    """Write the rotation matrix (3, 3) of a rotation vector (Rodrigues)."""
    angle2 = wx * wx + wy * wy + wz * wz
    angle = math.sqrt(angle2)
    if angle < SMALL:
        a, b = 1.0, 0.5
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - b * (wy * wy + wz * wz), b * wx * wy - a * wz, b * wx * wz + a * wy
    out[1, 0], out[1, 1], out[1, 2] = b * wx * wy + a * wz, 1.0 - b * (wx * wx + wz * wz), b * wy * wz - a * wx
    out[2, 0], out[2, 1], out[2, 2] = b * wx * wz - a * wy, b * wy * wz + a * wx, 1.0 - b * (wx * wx + wy * wy)


@jit
def right_jacobian(wx, wy, wz, out):
    """Write the right Jacobian (3, 3) of the exponential at a rotation vector."""
    angle2 = wx * wx + wy * wy + wz * wz
    angle = math.sqrt(angle2)
    if angle < 1e-4:
        a, b = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        a, b = (1.0 - math.cos(angle)) / angle2, (angle - math.sin(angle)) / (angle2 * angle)
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - b * (wy * wy + wz * wz), b * wx * wy + a * wz, b * wx * wz - a * wy
    out[1, 0], out[1, 1], out[1, 2] = b * wx * wy - a * wz, 1.0 - b * (wx * wx + wz * wz), b * wy * wz + a * wx
    out[2, 0], out[2, 1], out[2, 2] = b * wx * wz + a * wy, b * wy * wz - a * wx, 1.0 - b * (wx * wx + wy * wy)


@jit
def sphere_basis(gx, gy, gz, out):
    """Write two unit vectors that with the direction of `g` form a right-handed frame, as columns of (3, 2)."""
    n = math.sqrt(gx * gx + gy * gy + gz * gz)
    x, y, z = gx / n, gy / n, gz / n
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    out[0, 0], out[1, 0], out[2, 0] = 1.0 + sign * x * x * a, sign * b, -sign * x
    out[0, 1], out[1, 1], out[2, 1] = b, sign + y * y * a, -y


@jit
def _turned(a, b, out):
    """Write the product (3, 3) of two rotation matrices."""
    for r in range(3):
        for c in range(3):
            out[r, c] = a[r, 0] * b[0, c] + a[r, 1] * b[1, c] + a[r, 2] * b[2, c]


@jit
def _carry_covariance(f, covariance, moved):
    """Carry a symmetric covariance (N, N) on by a transition whose rows (R, C) differ from the identity's; `moved` (R, N) is scratch."""
    rows, n = moved.shape
    moved[:, :] = 0.0
    for r in range(rows):
        for k in range(f.shape[1]):
            if f[r, k] != 0.0:
                for c in range(n):
                    moved[r, c] += f[r, k] * covariance[k, c]
    for r in range(rows):
        for c in range(rows, n):
            covariance[r, c] = covariance[c, r] = moved[r, c]
        for c in range(r + 1):
            total = 0.0
            for k in range(f.shape[1]):
                total += moved[r, k] * f[c, k]
            covariance[r, c] = covariance[c, r] = total


@jit_short
def propagate(samples, position, rotation, velocity, gyro_bias, accel_bias, gravity, covariance, densities, knots):
    """Carry the state through IMU samples float64 (K, 7) of (time, rate, specific force), K >= 2, from the first one's time to the last one's.

    Between samples the mean of both holds. `position`, `rotation`, `velocity` and `covariance` (N, N) are changed in place; `densities` (4,)
    are the noise variances per second of gyroscope, accelerometer and of the random walks of their biases. `knots` float64 (K, KNOT)
    becomes the trajectory.
    """
    n = covariance.shape[0]
    # The rows of the transition that differ from the identity's.
    f, moved = np.zeros((GYRO_BIAS, EXTRA)), np.empty((GYRO_BIAS, n))
    step, jac, basis, half = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2)), np.empty((3, 3))
    sphere_basis(gravity[0], gravity[1], gravity[2], basis)
    w, a, e, world = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(samples.shape[0]):
        last = k + 1 == samples.shape[0]
        i = k - 1 if last else k
        for j in range(3):
            w[j] = 0.5 * (samples[i, 1 + j] + samples[i + 1, 1 + j]) - gyro_bias[j]
            a[j] = 0.5 * (samples[i, 4 + j] + samples[i + 1, 4 + j]) - accel_bias[j]
        dt = 0.0 if last else samples[k + 1, 0] - samples[k, 0]
        so3_exp(0.5 * w[0] * dt, 0.5 * w[1] * dt, 0.5 * w[2] * dt, step)
        _turned(rotation, step, half)
        for j in range(3):
            e[j] = step[j, 0] * a[0] + step[j, 1] * a[1] + step[j, 2] * a[2]
            world[j] = half[j, 0] * a[0] + half[j, 1] * a[1] + half[j, 2] * a[2] + gravity[j]
        knots[k, T] = samples[k, 0]
        knots[k, P : P + 3], knots[k, V : V + 3], knots[k, A : A + 3], knots[k, W : W + 3] = (
            position,
            velocity,
            world,
            w,
        )
        knots[k, R : R + 9] = rotation.ravel()
        if last:
            break
        for j in range(GYRO_BIAS):
            f[j, j] = 1.0
        right_jacobian(w[0] * dt, w[1] * dt, w[2] * dt, jac)
        so3_exp(-w[0] * dt, -w[1] * dt, -w[2] * dt, step)
        for r in range(3):
            # -R [e]x, e the force in the body at the step's beginning
            f[VELOCITY + r, ROTATION] = (rotation[r, 2] * e[1] - rotation[r, 1] * e[2]) * dt
            f[VELOCITY + r, ROTATION + 1] = (rotation[r, 0] * e[2] - rotation[r, 2] * e[0]) * dt
            f[VELOCITY + r, ROTATION + 2] = (rotation[r, 1] * e[0] - rotation[r, 0] * e[1]) * dt
            for c in range(3):
                f[ROTATION + r, ROTATION + c] = step[r, c]
                f[ROTATION + r, GYRO_BIAS + c] = -jac[r, c] * dt
                f[VELOCITY + r, ACCEL_BIAS + c] = -half[r, c] * dt
            for c in range(2):
                # dg = [Exp(B u) g]' = -[g]x B
                gx, gy, gz = gravity[0], gravity[1], gravity[2]
                bx, by, bz = basis[0, c], basis[1, c], basis[2, c]
                if r == 0:
                    turned = -(gy * bz - gz * by)
                elif r == 1:
                    turned = -(gz * bx - gx * bz)
                else:
                    turned = -(gx * by - gy * bx)
                f[VELOCITY + r, GRAVITY + c] = turned * dt
        for r in range(3):
            for c in range(EXTRA):
                # A step moves the position by half of what it changes the velocity by.
                f[POSITION + r, c] = (1.0 if c == POSITION + r else 0.0) + 0.5 * dt * (
                    f[VELOCITY + r, c] + (1.0 if c == VELOCITY + r else 0.0)
                )
        _carry_covariance(f, covariance, moved)
        for j in range(3):
            covariance[ROTATION + j, ROTATION + j] += densities[0] * dt
            covariance[VELOCITY + j, VELOCITY + j] += densities[1] * dt
            covariance[POSITION + j, POSITION + j] += densities[1] * dt * dt * dt / 3.0
            covariance[POSITION + j, VELOCITY + j] += densities[1] * dt * dt / 2.0
            covariance[VELOCITY + j, POSITION + j] += densities[1] * dt * dt / 2.0
            covariance[GYRO_BIAS + j, GYRO_BIAS + j] += densities[2] * dt
            covariance[ACCEL_BIAS + j, ACCEL_BIAS + j] += densities[3] * dt
        so3_exp(w[0] * dt, w[1] * dt, w[2] * dt, step)
        for j in range(3):
            position[j] += velocity[j] * dt + 0.5 * world[j] * dt * dt
            velocity[j] += world[j] * dt
        _turned(rotation, step, half)
        rotation[:, :] = half
    covariance[:, :] = 0.5 * (covariance + covariance.T)


@jit_fused
def compensate(points, times, knots, imu_from_lidar, out):
    """Move points float32 (M, 3) of the LiDAR, each taken at `times` float64 (M,), into the body's frame at the last knot, float64 (M, 3).

    Before the first and after the last knot the motion of the nearest one goes on. `imu_from_lidar` float64 (3, 4).
    """
    last = knots.shape[0] - 1
    k = 0
    step, here = np.empty((3, 3)), np.empty((3, 3))
    for m in range(points.shape[0]):
        t = times[m]
        while k > 0 and t < knots[k, T]:
            k -= 1
        while k < last and t >= knots[k + 1, T]:
            k += 1
        dt = t - knots[k, T]
        so3_exp(knots[k, W] * dt, knots[k, W + 1] * dt, knots[k, W + 2] * dt, step)
        for r in range(3):
            for c in range(3):
                here[r, c] = (
                    knots[k, R + 3 * r] * step[0, c]
                    + knots[k, R + 3 * r + 1] * step[1, c]
                    + knots[k, R + 3 * r + 2] * step[2, c]
                )
        x, y, z = float(points[m, 0]), float(points[m, 1]), float(points[m, 2])
        bx = imu_from_lidar[0, 0] * x + imu_from_lidar[0, 1] * y + imu_from_lidar[0, 2] * z + imu_from_lidar[0, 3]
        by = imu_from_lidar[1, 0] * x + imu_from_lidar[1, 1] * y + imu_from_lidar[1, 2] * z + imu_from_lidar[1, 3]
        bz = imu_from_lidar[2, 0] * x + imu_from_lidar[2, 1] * y + imu_from_lidar[2, 2] * z + imu_from_lidar[2, 3]
        ux = here[0, 0] * bx + here[0, 1] * by + here[0, 2] * bz
        uy = here[1, 0] * bx + here[1, 1] * by + here[1, 2] * bz
        uz = here[2, 0] * bx + here[2, 1] * by + here[2, 2] * bz
        ux += knots[k, P] + (knots[k, V] + 0.5 * knots[k, A] * dt) * dt - knots[last, P]
        uy += knots[k, P + 1] + (knots[k, V + 1] + 0.5 * knots[k, A + 1] * dt) * dt - knots[last, P + 1]
        uz += knots[k, P + 2] + (knots[k, V + 2] + 0.5 * knots[k, A + 2] * dt) * dt - knots[last, P + 2]
        for j in range(3):
            out[m, j] = knots[last, R + j] * ux + knots[last, R + 3 + j] * uy + knots[last, R + 6 + j] * uz


@jit_fused
def place_points(points, rotation, position, out):
    """Move points float64 (M, 3) of the body into the map."""
    for m in range(points.shape[0]):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        for j in range(3):
            out[m, j] = rotation[j, 0] * x + rotation[j, 1] * y + rotation[j, 2] * z + position[j]


@jit_fused
def sum_residuals(
    points, planes, is_plane, ranges, rotation, position, imu_from_lidar, motion, width, scale, information,
    gradient, moments,
):  # fmt: skip
    """Sum what point-to-plane residuals say of position, rotation and, with `width` 12 or 13, of the LiDAR's mount and its clock.

    `points` float64 (M, 3) in the body, `planes` (M, 4) in the map, `ranges` (M,) metres. A residual counts if 81 r^2 < range
    (FAST-LIO2), with weight 1 / (1 + (r / scale)^2)^2 (Geman and McClure). `motion` (6,) is velocity in the map and rate in the body,
    `imu_from_lidar` (3, 4). Writes `information` (width, width), `gradient` (width,), and `moments` (4,): inliers, sum of weights, sum
    of |r|, sum of w r^2.
    """
    information[:, :] = 0.0
    gradient[:] = 0.0
    moments[:] = 0.0
    h = np.zeros(width)
    for m in range(points.shape[0]):
        if not is_plane[m]:
            continue
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        nx, ny, nz = planes[m, 0], planes[m, 1], planes[m, 2]
        qx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + position[0]
        qy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + position[1]
        qz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + position[2]
        r = nx * qx + ny * qy + nz * qz + planes[m, 3]
        if not 81.0 * r * r < ranges[m]:
            continue
        u = r / scale
        weight = 1.0 / (1.0 + u * u)
        weight *= weight
        bx = rotation[0, 0] * nx + rotation[1, 0] * ny + rotation[2, 0] * nz
        by = rotation[0, 1] * nx + rotation[1, 1] * ny + rotation[2, 1] * nz
        bz = rotation[0, 2] * nx + rotation[1, 2] * ny + rotation[2, 2] * nz
        h[0], h[1], h[2] = nx, ny, nz
        h[3], h[4], h[5] = y * bz - z * by, z * bx - x * bz, x * by - y * bx
        if width > 6:
            # The point in the LiDAR's frame, as the mount is believed to be.
            dx, dy, dz = x - imu_from_lidar[0, 3], y - imu_from_lidar[1, 3], z - imu_from_lidar[2, 3]
            lx = imu_from_lidar[0, 0] * dx + imu_from_lidar[1, 0] * dy + imu_from_lidar[2, 0] * dz
            ly = imu_from_lidar[0, 1] * dx + imu_from_lidar[1, 1] * dy + imu_from_lidar[2, 1] * dz
            lz = imu_from_lidar[0, 2] * dx + imu_from_lidar[1, 2] * dy + imu_from_lidar[2, 2] * dz
            cx = imu_from_lidar[0, 0] * bx + imu_from_lidar[1, 0] * by + imu_from_lidar[2, 0] * bz
            cy = imu_from_lidar[0, 1] * bx + imu_from_lidar[1, 1] * by + imu_from_lidar[2, 1] * bz
            cz = imu_from_lidar[0, 2] * bx + imu_from_lidar[1, 2] * by + imu_from_lidar[2, 2] * bz
            h[6], h[7], h[8] = bx, by, bz
            h[9], h[10], h[11] = ly * cz - lz * cy, lz * cx - lx * cz, lx * cy - ly * cx
        if width > 12:
            wx, wy, wz = motion[3], motion[4], motion[5]
            h[12] = nx * motion[0] + ny * motion[1] + nz * motion[2]
            h[12] += bx * (wy * z - wz * y) + by * (wz * x - wx * z) + bz * (wx * y - wy * x)
        for i in range(width):
            wh = weight * h[i]
            gradient[i] += wh * r
            for j in range(i, width):
                information[i, j] += wh * h[j]
        moments[0] += 1.0
        moments[1] += weight
        moments[2] += abs(r)
        moments[3] += weight * r * r
    for i in range(width):
        for j in range(i):
            information[i, j] = information[j, i]


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    eye, zero = np.eye(3), np.zeros(3)
    samples = np.zeros((2, 7))
    samples[1, 0] = 0.01
    gravity, knots = np.array([0.0, 0.0, -9.8]), np.empty((2, KNOT))
    propagate(samples, zero.copy(), eye.copy(), zero.copy(), zero, zero, gravity, np.eye(EXTRA), np.ones(4), knots)
    mount, body = np.eye(3, 4), np.empty((1, 3))
    compensate(np.ones((1, 3), np.float32), np.zeros(1), knots, mount, body)
    compensate(read_only(np.ones((1, 3), np.float32)), np.zeros(1), knots, mount, body)
    place_points(body, eye, zero, np.empty((1, 3)))
    sum_residuals(
        *(body, np.ones((1, 4)), np.ones(1, np.bool_), np.ones(1), eye, zero, mount, np.zeros(6), 6, 0.1),
        *(np.empty((6, 6)), np.empty(6), np.empty(4)),
    )
