"""How uncertain the map's own frame has become. The filter takes the map for exact; in truth each metre of new map hangs on the one before.

A random walk in position and attitude per metre of way; an error of attitude moves all that comes after it. Error state: position and
rotation, both in the map (perturbed on the left). What was coasted along a direction that no plane faced adds a share of that way. The map that was
made at rest adds most, once: its planes go through the rings of a single place, and lean. A time in which nothing tells the speed adds what a lean accelerates meanwhile.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.lio.config import DriftConfig
from ambler.lio.measurements import skew

F64 = NDArray[np.float64]


class Drift:
    """Grows with every step of the way."""

    def __init__(self, config: DriftConfig) -> None:
        self._config = config
        self._covariance = np.zeros((6, 6))
        self._walks = np.diag(np.repeat([config.position**2, config.rotation**2], 3))
        self._begin = np.diag(np.repeat([config.begin_position**2, config.begin_rotation**2], 3))
        self._reach = 0.0
        self._coasted = np.zeros(3)
        self._unseen = np.zeros((3, 3))  # s for which nothing has told the speed along a direction
        self._sped = np.zeros((3, 3))

    @property
    def begin_left(self) -> float:
        """How much of what is seen was mapped at the start: 1 there, 0 away from it."""
        return math.exp(-self._reach / self._config.begin_m)

    def leave(self, reach: float) -> None:
        """Note how far from the start (m) the sensor has been."""
        left = self.begin_left
        self._reach = max(self._reach, reach)
        self._covariance += (left - self.begin_left) * self._begin

    def move(self, step: F64, frozen: F64) -> None:
        """Take a step (3,) in the map; `frozen` float64 (K, 3) are unit vectors along which it was coasted."""
        carried = np.eye(6)
        carried[:3, 3:] = -skew(step)
        self._covariance = carried @ self._covariance @ carried.T + float(np.linalg.norm(step)) * self._walks
        self._coasted += frozen.T @ (frozen @ step)

    def coast(self, seconds: float, frozen: F64) -> None:
        """Let a time pass in which nothing told the speed along `frozen` unit vectors (K, 3): the floor seems to tell exactly what is up, but its map leans, and
        gravity accelerates who coasts by that lean. Along what is seen again this is forgotten within `seen` seconds."""
        along = frozen.T @ frozen
        across = np.eye(3) - along
        kept = math.exp(-seconds / self._config.seen)
        self._unseen = along @ (self._unseen + seconds * np.eye(3)) @ along + kept * across @ self._unseen @ across
        self._sped += self._config.coasting_acceleration * seconds * self._unseen

    def covariance(self, rotation: F64) -> F64:
        """Return the covariance (6, 6) of position in the map and rotation perturbed on the right of `rotation` (3, 3)."""
        turned = np.eye(6)
        turned[3:, 3:] = rotation.T
        out = turned @ self._covariance @ turned.T
        out[:3, :3] += self._config.coasting**2 * np.outer(self._coasted, self._coasted)
        out[:3, :3] += self._sped @ self._sped.T
        return np.asarray(out)
