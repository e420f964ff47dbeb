"""Which loop closures are false: those whose relation between two scans is not the true one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle

FALSE_FROM = (0.5, math.radians(5.0))
"""Metres and radians beyond which a closure is false: more than any window of a good match, less than what two places differ by."""


@dataclass(frozen=True, slots=True)
class LoopError:
    """How far a closure's relation lies from the true one, metres and radians."""

    distance: float
    angle: float

    @property
    def is_false(self) -> bool:
        """Whether it is beyond `FALSE_FROM`."""
        return self.distance > FALSE_FROM[0] or self.angle > FALSE_FROM[1]


def loop_errors(
    relations: Sequence[SE2], from_poses: NDArray[np.float64], to_poses: NDArray[np.float64]
) -> list[LoopError]:
    """Compare relations from_from_to with the true poses (K, 3) of both ends."""
    errors = []
    for relation, a, b in zip(relations, from_poses, to_poses, strict=True):
        away = (SE2.from_array(a).inverse() @ SE2.from_array(b)).inverse() @ relation
        errors.append(LoopError(math.hypot(away.x, away.y), abs(wrap_angle(away.yaw))))
    return errors
