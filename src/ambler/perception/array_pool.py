"""Arrays that are used again once nobody refers to them: fresh memory costs one page fault for every 4 kB that is written."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

IDLE_REFERENCES = 3  # the pool's list, the loop's variable, and the argument of getrefcount; a view refers to its array
KEPT = 32


class ArrayPool:
    """Hands out arrays of any content. One that is still referred to, or a view of which is, is never handed out twice."""

    def __init__(self) -> None:
        self._arrays: list[NDArray[Any]] = []

    def take(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return an array of that shape and type with undefined content."""
        for array in self._arrays:
            if array.shape == shape and array.dtype == dtype and sys.getrefcount(array) == IDLE_REFERENCES:
                return array
        fresh = np.empty(shape, dtype)
        self._arrays = [*self._arrays[-KEPT + 1 :], fresh]
        return fresh
