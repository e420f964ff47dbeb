"""The pose of known points from a picture: weighted reprojection errors, Gauss-Newton on SE(3), perturbations on the right.

Points of the target are seen as rays by a camera that is mounted on a base. When base and target are known to stand upright on one
floor, that knowledge enters as a measurement of height, roll and pitch; without it the base is the camera itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3, Quaternion, quaternion_multiply

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LevelPrior:
    """Standard deviations of the target's height over the base's floor (m) and of its roll and pitch (rad)."""

    height: float = 0.01
    lean: float = math.radians(0.5)


@dataclass(frozen=True, slots=True, eq=False)
class CornerPose:
    """`base_from_target` with its covariance (6, 6) and the weighted squared error, which is chi-squared for a right model."""

    base_from_target: SE3
    covariance: F64
    error: float


def fit_corner_pose(
    points_target: F64,
    rays: F64,
    information: F64,
    guess: SE3,
    camera_from_base: SE3 | None = None,
    level: LevelPrior | None = None,
) -> CornerPose | None:
    """Fit `base_from_target` to rays (N, 2) of points (N, 3) with the information matrix (2N, 2N); None if it fails to converge or the
    target is behind the camera."""
    mount = camera_from_base if camera_from_base is not None else SE3()
    rotation_mount = mount.matrix()[:3, :3]
    pose = previous = guess
    damping, last = 1e-6, math.inf
    hessian, gradient = np.eye(6), np.zeros(6)
    for _ in range(40):
        system = _normal_equations(points_target, rays, information, pose, mount, rotation_mount, level)
        if system is None:
            return None
        h, g, error = system
        if error > last * (1.0 + 1e-12) + 1e-15:
            pose, damping = previous, damping * 10.0
            if damping > 1e6:
                return None
        else:
            previous, hessian, gradient = pose, h, g
            improvement, last = last - error, error
            damping = max(damping * 0.2, 1e-9)
            if improvement < 1e-9 * (1.0 + error):
                break
        step = np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), -gradient)
        pose = perturbed(previous, np.asarray(step, np.float64))
    try:
        covariance = np.linalg.inv(hessian)
    except np.linalg.LinAlgError:
        return None
    return CornerPose(previous, 0.5 * (covariance + covariance.T), last)


def perturbed(pose: SE3, step: F64) -> SE3:
    """Return the pose moved by a small (x, y, z, roll, pitch, yaw) of its own frame."""
    angle = float(np.linalg.norm(step[3:]))
    s = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    turn: Quaternion = (math.cos(0.5 * angle), s * float(step[3]), s * float(step[4]), s * float(step[5]))
    dx, dy, dz = pose.rotate((float(step[0]), float(step[1]), float(step[2])))
    x, y, z = pose.translation
    q = quaternion_multiply(pose.rotation, turn)
    n = math.sqrt(sum(c * c for c in q))
    return SE3((x + dx, y + dy, z + dz), (q[0] / n, q[1] / n, q[2] / n, q[3] / n))


def _normal_equations(
    points: F64, rays: F64, information: F64, pose: SE3, mount: SE3, rotation_mount: F64, level: LevelPrior | None
) -> tuple[F64, F64, float] | None:
    rotation = pose.matrix()[:3, :3]
    seen = mount.transform(pose.transform(points))
    if float(seen[:, 2].min()) <= 1e-6:
        return None
    z = seen[:, 2]
    residual = (seen[:, :2] / z[:, None] - rays).reshape(-1)
    turned = rotation_mount @ rotation
    # d(point in camera) = turned (dt + dtheta x point)
    jacobian = np.zeros((len(points), 3, 6))
    jacobian[:, :, :3] = turned
    jacobian[:, :, 3:] = -turned @ _cross_matrices(points)
    image = np.zeros((len(points), 2, 3))
    image[:, 0, 0] = image[:, 1, 1] = 1.0 / z
    image[:, 0, 2], image[:, 1, 2] = -seen[:, 0] / z**2, -seen[:, 1] / z**2
    j = (image @ jacobian).reshape(-1, 6)
    h, g = j.T @ information @ j, j.T @ information @ residual
    error = float(residual @ information @ residual)
    if level is not None:
        row = rotation[2]
        e = np.array([pose.translation[2], row[0], row[1]])
        d = np.zeros((3, 6))
        d[0, :3] = row
        d[1, 4], d[1, 5] = -row[2], row[1]
        d[2, 3], d[2, 5] = row[2], -row[0]
        w = np.array([level.height, level.lean, level.lean]) ** -2
        h, g, error = h + d.T @ (w[:, None] * d), g + d.T @ (w * e), error + float(w @ (e * e))
    return h, g, error


def _cross_matrices(points: F64) -> F64:
    out = np.zeros((len(points), 3, 3))
    out[:, 0, 1], out[:, 0, 2] = -points[:, 2], points[:, 1]
    out[:, 1, 0], out[:, 1, 2] = points[:, 2], -points[:, 0]
    out[:, 2, 0], out[:, 2, 1] = -points[:, 1], points[:, 0]
    return out
