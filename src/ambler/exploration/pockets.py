"""Small patches of unknown with known cells all around: what they could hold is small, too."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.messages import OccupancyGrid
from ambler.exploration.frontier_map import FrontierGroups


def are_in_pockets(groups: FrontierGroups, occupancy: OccupancyGrid, most: float) -> NDArray[np.bool_]:
    """Tell which groups (N,) of frontier cells of a map border on no patch of unknown cells larger than `most` m²; a patch at the map's edge goes on beyond it."""
    if not len(groups):
        return np.zeros(0, np.bool_)
    is_unknown = np.pad(occupancy.data < 0, 1, constant_values=True)
    patches, count = ndimage.label(is_unknown)
    is_large = np.bincount(patches.ravel(), minlength=count + 1) > most / occupancy.spec.resolution**2
    is_large[patches[0, 0]] = True
    is_large[0] = False
    beside = cv2.dilate(is_large[patches].astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1]
    return np.asarray(np.maximum.reduceat(beside.ravel()[groups.cells], groups.starts[:-1]) == 0, np.bool_)
