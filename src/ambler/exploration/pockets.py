"""Patches of unknown cells: what is enclosed by known ones, and how much it could hold."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.messages import OccupancyGrid
from ambler.exploration.frontier_map import FrontierGroups


def patch_areas(occupancy: OccupancyGrid) -> NDArray[np.float64]:
    """Return for each cell of a map, [iy, ix], the area (m²) of the patch of unknown that it is in: 0 for a known one, inf where the patch reaches the map's edge, because it goes on beyond it."""
    is_unknown = np.pad(occupancy.data < 0, 1, constant_values=True)
    patches, count = ndimage.label(is_unknown)
    areas = np.bincount(patches.ravel(), minlength=count + 1) * occupancy.spec.resolution**2
    areas[patches[0, 0]] = math.inf
    areas[0] = 0.0
    return np.asarray(areas[patches[1:-1, 1:-1]])


def are_in_pockets(groups: FrontierGroups, occupancy: OccupancyGrid, most: float) -> NDArray[np.bool_]:
    """Tell which groups (N,) of frontier cells of a map border on no patch of unknown cells larger than `most` m²."""
    if not len(groups):
        return np.zeros(0, np.bool_)
    is_large = np.pad((patch_areas(occupancy) > most).astype(np.uint8), 1, constant_values=1)
    beside = cv2.dilate(is_large, np.ones((3, 3), np.uint8))[1:-1, 1:-1]
    return np.asarray(np.maximum.reduceat(beside.ravel()[groups.cells], groups.starts[:-1]) == 0, np.bool_)
