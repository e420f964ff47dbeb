"""What the matchers need of a probability grid; `grids.ProbabilityGrid` is one."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class CellGrid(Protocol):
    """`cells` uint16 [iy, ix] (0 unknown, 1 ... 32767 a probability of 0.1 ... 0.9); `frame` float64 (resolution, x, y of the outer corner)."""

    cells: NDArray[np.uint16]
    frame: NDArray[np.float64]
