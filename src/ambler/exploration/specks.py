"""Small things that shut a way: a beam that an edge tears in two, or somebody's foot, may stand for good in a map that nobody saw from near again.

What is a few cells large and stands apart may be a post as well, so it is not taken out of the map: the robot is led to where it sees it well, and what it sees
there decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_FREE, COST_INSCRIBED, COST_LETHAL, COST_UNKNOWN
from ambler.core.messages import CostGrid
from ambler.core.se2 import SE2

Mask = NDArray[np.bool_]
Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class SpecksConfig:
    """A speck is at most `cells` large. It is looked at from `distance` metres, or from as near to that as one can stand between `nearest` and `farthest`: where scanners
    that look down see it as well; a look is worth its way where the robot could move over `least_area` (m²) behind. Looks at places within `again` metres of one another are at one thing, which gets `looks` of them."""

    cells: int = 4
    distance: float = 2.0
    nearest: float = 0.8
    farthest: float = 3.0
    least_area: float = 1.0
    again: float = 0.5
    looks: int = 2


class Specks:
    """Finds what to look at, and from where; remembers what was looked at."""

    def __init__(self, config: SpecksConfig, inscribed_radius: float) -> None:
        self.config = config
        self._inscribed_radius = inscribed_radius
        self._looks: list[tuple[Place, Place]] = []  # at what, and from where

    def opened(self, costs: CostGrid) -> tuple[CostGrid, Mask]:
        """Return the costs as they would be without any speck, and where specks are [iy, ix]."""
        lethal = costs.data == COST_LETHAL
        labels, stats = cv2.connectedComponentsWithStats(lethal.astype(np.uint8), connectivity=8)[1:3]
        is_small = stats[:, cv2.CC_STAT_AREA] <= self.config.cells
        is_small[0] = False
        specks = is_small[labels]
        reach = self._inscribed_radius / costs.spec.resolution
        is_wide = _distance_to(lethal & ~specks) > reach
        data = costs.data.copy()
        data[(data >= COST_INSCRIBED) & (data != COST_UNKNOWN) & is_wide] = COST_FREE
        return CostGrid(costs.stamp_ns, costs.frame, costs.spec, data), specks

    def look(
        self,
        costs: CostGrid,
        specks: Mask,
        reached: Mask,
        beyond: Mask,
        wanted: NDArray[np.floating],
        reach: float,
        robot: Place,
    ) -> SE2 | None:
        """Return from where to look at the nearest to the `robot` of the `specks` that part the cells that are `reached` from those `beyond` (bool [iy, ix] of `costs`) that lie within `reach`
        metres of places that are `wanted` (N, 2); None where nothing is left to look at. The look counts as made."""
        spec = costs.spec
        labels, stats = cv2.connectedComponentsWithStats(beyond.astype(np.uint8), connectivity=8)[1:3]
        goals = np.zeros(spec.shape, np.bool_)
        cells = spec.cells_of(wanted)
        cells = cells[np.all((cells >= 0) & (cells < spec.shape), axis=1)]
        goals[cells[:, 0], cells[:, 1]] = True
        is_wanted = np.zeros(len(stats), np.bool_)
        is_wanted[labels[_distance_to(goals) <= reach / spec.resolution]] = True
        is_wanted &= stats[:, cv2.CC_STAT_AREA] * spec.resolution**2 >= self.config.least_area
        is_wanted[0] = False
        gap = _distance_to(reached) + _distance_to(is_wanted[labels])
        iy, ix = np.nonzero(specks & (gap <= 2.0 * (self._inscribed_radius / spec.resolution + 2.0)))
        things = spec.centers_of(np.stack([iy, ix], axis=1))
        for k in np.argsort(np.hypot(*(things - robot).T), kind="stable"):
            thing = (float(things[k, 0]), float(things[k, 1]))
            before = [place for other, place in self._looks if math.dist(thing, other) <= self.config.again]
            place = self._place(costs, reached, thing, before) if len(before) < self.config.looks else None
            if place is not None:
                self._note(costs, things, (place.x, place.y))
                return place
        return None

    def _note(self, costs: CostGrid, things: NDArray[np.float64], place: Place) -> None:
        """Count a look at all `things` (N, 2) that are seen well from a place."""
        for x, y in things:
            if math.dist(place, (x, y)) <= self.config.farthest and _sees(costs, place, (x, y)):
                self._looks.append(((float(x), float(y)), place))

    def _place(self, costs: CostGrid, reached: Mask, thing: Place, before: list[Place]) -> SE2 | None:
        """Return where to stand, on cells that are reached, to see a thing, looking at it; elsewhere than `before`."""
        c, spec = self.config, costs.spec
        iy, ix = np.nonzero(reached)
        away = np.hypot(*(spec.centers_of(np.stack([iy, ix], axis=1)) - thing).T)
        is_fit = (away >= c.nearest) & (away <= c.farthest)
        iy, ix, away = iy[is_fit], ix[is_fit], away[is_fit]
        for k in np.argsort(np.abs(away - c.distance), kind="stable"):
            px, py = spec.center_of(int(iy[k]), int(ix[k]))
            if any(math.dist((px, py), other) <= c.nearest for other in before):
                continue
            if _sees(costs, (px, py), thing):
                return SE2(px, py, math.atan2(thing[1] - py, thing[0] - px))
        return None


def _distance_to(cells: Mask) -> NDArray[np.float32]:
    """Return the distance in cells to the nearest of the marked ones; inf where there is none."""
    if not cells.any():
        return np.full(cells.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~cells).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


def _sees(costs: CostGrid, place: Place, thing: Place) -> bool:
    """Whether nothing lethal or unknown lies between a place and the last cells before a thing."""
    spec = costs.spec
    n = max(2, math.ceil(2.0 * math.dist(place, thing) / spec.resolution))
    along = np.linspace(place, thing, n)[: max(1, n - 4)]
    iy, ix = spec.cells_of(along).T
    between = costs.data[iy, ix]
    return not bool(np.any((between == COST_LETHAL) | (between == COST_UNKNOWN)))
