"""What the explorer remembers of frontiers it went to in vain, so that it neither insists nor gives up too early.

A refusal belongs to a place, not to a number: a later frontier is the same one when most of its cells lie beside the cells
of the remembered one. A refused frontier may be tried again when the map near it has changed, at most `max_attempts` times.
Where the ground near the robot is assumed, frontiers close when it comes near and open with another shape when it leaves: these are known by
where they lie (`exploration/visits.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.core.messages import Frontier, OccupancyGrid
from ambler.exploration.visits import Visits, VisitsConfig

UNKNOWN, FREE, OCCUPIED = 0, 1, 2


@dataclass(frozen=True, slots=True)
class MemoryConfig:
    """`match_distance` (m) and `match_ratio` say when two frontiers are the same one; the map has changed near a frontier when
    at least `change_cells` cells within `change_radius` (m) of its middle changed between unknown, free and occupied. A look in vain speaks for the
    place that it was made from: a frontier is looked at from up to `max_other_places` more, if it has goals so far apart, before it is left
    alone."""

    max_attempts: int = 3
    max_looks: int = 2
    match_distance: float = 0.25
    match_ratio: float = 0.5
    change_radius: float = 1.5
    change_cells: int = 40
    max_other_places: int = 2
    visits: VisitsConfig = field(default_factory=VisitsConfig)


def classify(occupancy: NDArray[np.int8], free_below: int, assumed: int | None = None) -> NDArray[np.uint8]:
    """Return UNKNOWN, FREE or OCCUPIED for each cell; what is only `assumed` is unknown."""
    known = np.where(occupancy < free_below, FREE, OCCUPIED)
    is_unknown = (occupancy < 0) | (occupancy == assumed if assumed is not None else False)
    return np.where(is_unknown, UNKNOWN, known).astype(np.uint8)


def patch_around(
    occupancy: OccupancyGrid, center: tuple[float, float], radius: float, free_below: int, assumed: int | None = None
) -> NDArray[np.uint8]:
    """Return the classes of a square about a point, uint8 (2 n + 1, 2 n + 1); outside the grid is unknown."""
    spec, data = occupancy.spec, occupancy.data
    n = round(radius / spec.resolution)
    iy, ix = spec.cell_of(*center)
    patch = np.zeros((2 * n + 1, 2 * n + 1), np.uint8)
    y0, y1 = max(0, iy - n), min(spec.height, iy + n + 1)
    x0, x1 = max(0, ix - n), min(spec.width, ix + n + 1)
    if y0 < y1 and x0 < x1:
        inside = classify(data[y0:y1, x0:x1], free_below, assumed)
        patch[y0 - iy + n : y1 - iy + n, x0 - ix + n : x1 - ix + n] = inside
    return patch


@dataclass(slots=True)
class Refusal:
    """One remembered place: its cells (m), how often it was tried and looked at in vain, why, the map around it then, where it was
    looked at from (x, y), and the `box` of its cells (x0, y0, x1, y1)."""

    tree: cKDTree
    center: tuple[float, float]
    attempts: int
    looks: int
    reason: str
    patch: NDArray[np.uint8]
    places: tuple[tuple[float, float], ...] = ()
    is_pardoned: bool = False
    box: tuple[float, float, float, float] = field(init=False)

    def __post_init__(self) -> None:
        (x0, y0), (x1, y1) = self.tree.mins.tolist(), self.tree.maxes.tolist()
        self.box = (x0, y0, x1, y1)


class FrontierMemory:
    """Remembers refusals and says which frontiers are not worth another drive."""

    def __init__(self, config: MemoryConfig, free_below: int, assumed: int | None = None) -> None:
        self.config = config
        self._free_below, self._assumed = free_below, assumed
        self._refusals: list[Refusal] = []
        self._visits = None if assumed is None else Visits(config.visits)

    def __len__(self) -> int:
        return len(self._refusals)

    def refuse(
        self,
        frontier: Frontier,
        reason: str,
        occupancy: OccupancyGrid,
        *,
        has_looked: bool,
        place: tuple[float, float] | None = None,
    ) -> None:
        """Remember that a drive to this frontier failed, or (`has_looked`) that the robot stood there, at `place`, and nothing changed."""
        if has_looked:
            self.visit(frontier, occupancy)
        patch = self._patch(occupancy, frontier.centroid)
        old, cells = self.find(frontier), frontier.cells.astype(np.float64)
        attempts, looks, places = (0, 0, ()) if old is None else (old.attempts, old.looks, old.places)
        if old is not None:  # all of it stays refused: a frontier that is a part of another one may take turns with it
            self._refusals.remove(old)
            cells = np.unique(np.concatenate((old.tree.data, cells)), axis=0)
        self._refusals.append(
            Refusal(
                cKDTree(cells),
                frontier.centroid,
                attempts + (not has_looked),
                looks + has_looked,
                reason,
                patch,
                places if place is None else (*places, place),
            )
        )

    def visit(self, frontier: Frontier, occupancy: OccupancyGrid) -> None:
        """Remember that the robot was there, where ground is assumed: three visits are enough, whatever comes of them."""
        if self._visits is not None:
            self._visits.add(frontier, occupancy)

    def find(self, frontier: Frontier) -> Refusal | None:
        """Return the remembered place that this frontier is, or None."""
        cells = frontier.cells.astype(np.float64)
        reach = self.config.match_distance
        (x0, y0), (x1, y1) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
        for refusal in reversed(self._refusals):
            left, bottom, right, top = refusal.box
            if right < x0 - reach or left > x1 + reach or top < y0 - reach or bottom > y1 + reach:
                continue
            near = np.isfinite(refusal.tree.query(cells, distance_upper_bound=reach)[0])
            if near.mean() >= self.config.match_ratio:
                return refusal
        return None

    def places_in_vain(self, frontier: Frontier) -> tuple[tuple[float, float], ...]:
        """Return the places (x, y) from which this frontier was looked at often enough, while it deserves a look from another one."""
        c, refusal = self.config, self.find(frontier)
        if refusal is None or refusal.looks < c.max_looks or len(refusal.places) >= c.max_looks + c.max_other_places:
            return ()
        return refusal.places

    def reason_against(self, frontier: Frontier, occupancy: OccupancyGrid, *, is_elsewhere: bool = False) -> str:
        """Return why this frontier must not be tried now, or an empty text. `is_elsewhere`: its goal is none of the places that it was
        looked at from in vain."""
        if self._visits is not None and self._visits.at(frontier, occupancy.spec) >= self.config.max_attempts:
            return f"given up after {self.config.max_attempts} visits: it closes and opens again"
        refusal = self.find(frontier)
        if refusal is None or refusal.is_pardoned or is_elsewhere:
            return ""
        tried = refusal.attempts + refusal.looks
        if tried >= self.config.max_attempts:
            return f"given up after {tried} attempts: {refusal.reason}"
        is_refused = refusal.attempts > 0 or refusal.looks >= self.config.max_looks
        if not is_refused or self._has_changed(refusal, occupancy):
            return ""
        if refusal.looks >= self.config.max_looks:
            return f"looked at {refusal.looks} times: {refusal.reason}"
        return f"attempt {refusal.attempts} failed: {refusal.reason}"

    def pardon(self) -> int:
        """Give every place that is still refused for a failed drive one more attempt; return how many there are."""
        pardoned = 0
        for refusal in self._refusals:
            if refusal.attempts and refusal.looks < self.config.max_looks:
                refusal.is_pardoned = True
                refusal.attempts = self.config.max_attempts - 1 - refusal.looks
                pardoned += 1
        return pardoned

    def _has_changed(self, refusal: Refusal, occupancy: OccupancyGrid) -> bool:
        now = self._patch(occupancy, refusal.center)
        return int(np.count_nonzero(now != refusal.patch)) >= self.config.change_cells

    def _patch(self, occupancy: OccupancyGrid, center: tuple[float, float]) -> NDArray[np.uint8]:
        return patch_around(occupancy, center, self.config.change_radius, self._free_below, self._assumed)
