"""Covariances of planar poses, perturbed on the right, through fixed offsets."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


def adjoint(pose: SE2) -> F64:
    """Return the adjoint (3, 3): it maps a perturbation (x, y, yaw) of the pose's own frame to one of its parent frame."""
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return np.array([[c, -s, pose.y], [s, c, -pose.x], [0.0, 0.0, 1.0]])


def through_offset(covariance: F64, b_from_c: SE2) -> F64:
    """Return the covariance of `a_from_b @ b_from_c` from that of `a_from_b`, both (3, 3), with an exact offset."""
    turn = adjoint(b_from_c.inverse())
    return np.asarray(turn @ covariance @ turn.T)


def difference(a: SE2, b: SE2) -> F64:
    """Return b as seen from a, (x, y, yaw) float64 (3,): the perturbation that leads from a to b, to first order."""
    return (a.inverse() @ b).as_array()
