"""How far the map may be bent between two submaps: the graph of submaps with what scan matching drifts, and what loop closures hold.

The pose graph's own edges say how well scans fit. They do not know that a whole chain of matches may lean the same way, so windows
drawn from them are too narrow by far after a kilometre. Here a chain of submaps drifts in proportion to its way, and the proportion is
learned from the closures that were found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.posegraph.marginals import Marginals
from ambler.posegraph.solver import PoseGraph
from ambler.slam2d.config import DriftConfig

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DriftGraph:
    """Chain and closures of a number of submaps, as they were at one moment; `scale` multiplies the standard deviations of the chain. `lengths` and `doubts`
    (S, 2), variances m^2 and rad^2 of matches that hardly anything spoke for, lead from the submap before to each."""

    lengths: tuple[float, ...]
    doubts: F64
    loops: tuple[tuple[int, int], ...]
    scale: float
    config: DriftConfig

    def covariances(self, submap_poses: F64) -> Drift:
        """Return what is known about each pair of submaps at poses (S, 3)."""
        c, n = self.config, len(self.lengths)
        chain = np.arange(1, n)
        loops = np.array(self.loops, np.int64).reshape(-1, 2)
        lengths = np.array(self.lengths)[1:]
        linear = np.concatenate(
            (self.scale * c.linear_per_metre * lengths + c.least[0], np.full(len(loops), c.closure[0]))
        )
        angular = np.concatenate(
            (self.scale * c.angular_per_metre * lengths + c.least[1], np.full(len(loops), c.closure[1]))
        )
        doubts = np.concatenate((self.doubts[1:], np.zeros((len(loops), 2))))
        information = np.zeros((len(linear), 3, 3))
        information[:, 0, 0] = information[:, 1, 1] = 1.0 / (linear**2 + doubts[:, 0])
        information[:, 2, 2] = 1.0 / (angular**2 + doubts[:, 1])
        a, b = np.concatenate((chain - 1, loops[:, 0])), np.concatenate((chain, loops[:, 1]))
        z = np.zeros((len(a), 3))  # where it is solved; the covariances do not ask for the residuals
        flags = np.zeros(len(a), np.bool_)
        return Drift(Marginals(PoseGraph(submap_poses, a, b, z, information, flags)) if n > 1 else None, n)


class Drift:
    """Relative covariances of submaps."""

    def __init__(self, marginals: Marginals | None, submaps: int) -> None:
        self._marginals = marginals
        self._everyone = np.arange(submaps)
        self._known: dict[int, F64] = {}

    def of(self, submap: int) -> F64:
        """Return the covariance (S, 3, 3) of one submap's (x, y, yaw) in the frame of each."""
        if submap not in self._known:
            if self._marginals is None:
                self._known[submap] = np.zeros((len(self._everyone), 3, 3))
            else:
                self._known[submap] = self._marginals.relative(submap, self._everyone)
        return self._known[submap]
