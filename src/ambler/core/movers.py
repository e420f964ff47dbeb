"""What moves around a robot, as its own scanners tell it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


def _none() -> F64:
    return np.zeros((0, 6))


@dataclass(frozen=True, slots=True, eq=False)
class Movers:
    """Tracked movers at the instant `stamp_ns`: `states` float64 (K, 6) of position (x, y), velocity (vx, vy) and the velocity at which it
    walked when it last walked, SI, in the odom frame. `rests` float64 (K,) says for how many seconds each has been where it is; None: nobody knows."""

    stamp_ns: int = 0
    states: F64 = field(default_factory=_none)
    rests: F64 | None = None

    def __len__(self) -> int:
        return len(self.states)

    def at(self, stamp_ns: int) -> Movers:
        """Return them as they will be at another instant, going on as they do."""
        states = self.states.copy()
        states[:, :2] += states[:, 2:4] * ((stamp_ns - self.stamp_ns) * 1e-9)
        return Movers(stamp_ns, states, self.rests)

    def near(self, place: SE2, distance: float) -> Movers:
        """Return those within so many metres of a place."""
        away = np.hypot(self.states[:, 0] - place.x, self.states[:, 1] - place.y)
        is_near = away <= distance
        return Movers(self.stamp_ns, self.states[is_near], None if self.rests is None else self.rests[is_near])


NOBODY = Movers()
