"""Truth in a map that a robot made: relative to the keyframes of the run that made it.

A made map is bent by centimetres, so a place in the world has no one place in it. The true pose there is that of the keyframe which was taken
nearest by, as SLAM estimated it, composed with the true pose relative to that keyframe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MadeMapTruth:
    """`true`: where the keyframes truly were, in the world; `estimated`: where they are in the map; both float64 (N, 3) of (x, y, yaw)."""

    true: F64
    estimated: F64

    def __post_init__(self) -> None:
        if len(self.true) == 0 or self.true.shape != self.estimated.shape:
            raise BadInputError(f"{len(self.estimated)} keyframes, and the truth of {len(self.true)}")

    def pose(self, world_from_base: SE2) -> SE2:
        """Return one pose of the world in the map."""
        return SE2.from_array(self.poses(world_from_base.as_array()[None])[0])

    def poses(self, world_from_bases: F64) -> F64:
        """Return poses (M, 3) of the world in the map: `map_from_keyframe @ keyframe_from_base`, each by its nearest keyframe."""
        _, nearest = cKDTree(self.true[:, :2]).query(world_from_bases[:, :2])
        true, told = self.true[nearest], self.estimated[nearest]
        turn = told[:, 2] - true[:, 2]
        c, s = np.cos(turn), np.sin(turn)
        dx, dy = (world_from_bases[:, :2] - true[:, :2]).T
        yaw = world_from_bases[:, 2] + turn
        return np.column_stack(
            [told[:, 0] + c * dx - s * dy, told[:, 1] + s * dx + c * dy, np.arctan2(np.sin(yaw), np.cos(yaw))]
        )
