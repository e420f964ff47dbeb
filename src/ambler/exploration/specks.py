"""Small things that shut a way: a beam that an edge tears in two, or somebody's foot, may stand for good in a map that nobody saw from near again.

What is a few cells large and stands apart may be a post as well, so it is not taken out of the map: the robot is led to where it sees it well, and what it sees
there decides. What still stands though the robot came past it again later was looked at as well.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_FREE, COST_INSCRIBED, COST_LETHAL, COST_UNKNOWN
from ambler.core.messages import CostGrid
from ambler.core.se2 import SE2

RIM = 2.0  # cells by which costs may end farther from a thing than the robot's radius

Mask = NDArray[np.bool_]
Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class SpecksConfig:
    """A speck is at most `cells` large. It is looked at from `distance` metres, or from as near to that as one can stand between `nearest` and `farthest`: where scanners
    that look down see it as well; a look is worth its way where the robot could move over `least_area` (m²) behind. Looks at places within `again` metres of one another are at one thing, which gets `looks` of them. Those in passing count
    if they lie `apart` seconds apart: who stands there may have gone meanwhile."""

    cells: int = 4
    distance: float = 2.0
    nearest: float = 0.8
    farthest: float = 3.0
    least_area: float = 1.0
    again: float = 0.5
    looks: int = 2
    apart: float = 20.0


@dataclass(frozen=True, slots=True)
class _Look:
    thing: Place
    place: Place
    stamp_ns: int


class Specks:
    """Finds what to look at, and from where; remembers what was looked at."""

    def __init__(self, config: SpecksConfig, inscribed_radius: float) -> None:
        self.config = config
        self._inscribed_radius = inscribed_radius
        self._looks: defaultdict[tuple[int, int], list[_Look]] = defaultdict(list)  # by squares of `again` metres

    def opened(self, costs: CostGrid) -> tuple[CostGrid, Mask]:
        """Return the costs as they would be without any speck, and where specks are [iy, ix]. Only what lies near one changes: costs may end a cell farther from walls than the
        robot's radius, and that rim, opened, would join all places along walls."""
        lethal = costs.data == COST_LETHAL
        specks = _small(lethal, self.config.cells)
        reach = self._inscribed_radius / costs.spec.resolution
        is_opened = (_distance_to(lethal & ~specks) > reach) & (_distance_to(specks) <= reach + RIM)
        data = costs.data.copy()
        data[(data >= COST_INSCRIBED) & (data != COST_UNKNOWN) & is_opened] = COST_FREE
        return CostGrid(costs.stamp_ns, costs.frame, costs.spec, data), specks

    def pass_by(self, costs: CostGrid, robot: Place) -> None:
        """Count looks at what is seen well from where the robot is now."""
        c, spec = self.config, costs.spec
        if not spec.contains(*robot):
            return
        reach = math.ceil((c.farthest + c.again) / spec.resolution)
        row, column = spec.cell_of(*robot)
        top, left = max(0, row - reach), max(0, column - reach)
        lethal = costs.data[top : max(0, row + reach + 1), left : max(0, column + reach + 1)] == COST_LETHAL
        if lethal.any():
            iy, ix = np.nonzero(_small(lethal, c.cells))
            self._note(costs, spec.centers_of(np.stack([iy + top, ix + left], axis=1)), robot, is_passing=True)

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
            before = [look.place for look in self._looks_at(thing)]
            place = self._place(costs, reached, thing, before) if len(before) < self.config.looks else None
            if place is not None:
                self._note(costs, things, (place.x, place.y))
                return place
        return None

    def _looks_at(self, thing: Place) -> list[_Look]:
        row, column = self._square(thing)
        near = (self._looks.get((row + i, column + k), ()) for i in (-1, 0, 1) for k in (-1, 0, 1))
        return [look for looks in near for look in looks if math.dist(thing, look.thing) <= self.config.again]

    def _square(self, thing: Place) -> tuple[int, int]:
        return math.floor(thing[0] / self.config.again), math.floor(thing[1] / self.config.again)

    def _note(self, costs: CostGrid, things: NDArray[np.float64], place: Place, *, is_passing: bool = False) -> None:
        """Count a look at all `things` (N, 2) that are seen well from a place."""
        c = self.config
        away = np.hypot(*(things - place).T)
        for x, y in things[(away >= c.nearest) & (away <= c.farthest)]:
            thing, before = (float(x), float(y)), self._looks_at((x, y))
            is_old = any(
                costs.stamp_ns - look.stamp_ns < c.apart * 1e9 or math.dist(place, look.place) <= c.nearest
                for look in before
            )
            if len(before) < c.looks and not (is_passing and is_old) and _sees(costs, place, thing):
                self._looks[self._square(thing)].append(_Look(thing, place, costs.stamp_ns))

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


def _small(lethal: Mask, cells: int) -> Mask:
    """Return those cells [iy, ix] that stand in groups of at most so many."""
    labels, stats = cv2.connectedComponentsWithStats(lethal.astype(np.uint8), connectivity=8)[1:3]
    is_small = stats[:, cv2.CC_STAT_AREA] <= cells
    is_small[0] = False
    return np.asarray(is_small[labels])


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
