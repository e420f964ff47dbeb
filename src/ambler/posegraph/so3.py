"""Rotations of space by the dozen: exponentials, logarithms and their derivatives of arrays (N, 3) and (N, 3, 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def skew_all(v: F64) -> F64:
    """Return the matrices (N, 3, 3) of the cross product with vectors (N, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - out.transpose(0, 2, 1)


def exp_all(v: F64) -> F64:
    """Return the rotation matrices (N, 3, 3) of rotation vectors (N, 3) (Rodrigues)."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    small = np.maximum(angle, 1e-12)
    k = skew_all(v)
    first = np.where(angle < 1e-6, 1.0 - angle**2 / 6.0, np.sin(angle) / small)
    second = np.where(angle < 1e-6, 0.5 - angle**2 / 24.0, (1.0 - np.cos(angle)) / small**2)
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def log_all(rotations: F64) -> F64:
    """Return the rotation vectors (N, 3) of rotation matrices (N, 3, 3), up to half a turn."""
    axis = 0.5 * np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(axis, axis=1)
    cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    out = axis * np.where(sine < 1e-7, 1.0, angle / np.maximum(sine, 1e-300))[:, None]
    for k in np.flatnonzero(cosine < -0.99):  # near half a turn the sine says nothing of the axis
        out[k] = angle[k] * _axis_of(rotations[k], axis[k])
    return np.asarray(out)


def inverse_right_jacobians(v: F64) -> F64:
    """Return the inverses (N, 3, 3) of the right Jacobians of the exponential at rotation vectors (N, 3)."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    k = skew_all(v)
    half = 0.5 * np.maximum(angle, 1e-12)
    second = np.where(angle < 1e-4, 1.0 / 12.0, (1.0 - half / np.tan(half)) / np.maximum(angle, 1e-12) ** 2)
    return np.asarray(np.eye(3) + 0.5 * k + second * (k @ k))


def _axis_of(rotation: F64, sine_axis: F64) -> F64:
    """Return the unit axis of a rotation near half a turn."""
    values, vectors = np.linalg.eigh(0.5 * (rotation + rotation.T))
    axis = vectors[:, int(np.argmax(values))]
    return np.asarray(axis if float(axis @ sine_axis) >= 0.0 else -axis)
