"""The tour with full knowledge of the plan: what an explorer's path is measured against (the art-gallery problem, then a round tour).

Viewpoints are chosen one by one, each time the one that sees most of what none has seen (greedy cover), among cells where the robot can
stand; the shortest round from the start is sought by 2-opt and Or-opt over planned lengths; then viewpoints are left out whose share is
seen from the way between the others. No bound, but a good plan of somebody who knows the building.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN
from ambler.core.se2 import SE2
from ambler.exploration.grid_world import GridWorld
from ambler.kernels.grid_world import sense

F64 = NDArray[np.float64]
Seen = NDArray[np.bool_]
LEAST_GAIN = 1e-9


@dataclass(frozen=True, slots=True)
class KnownTourConfig:
    """Viewpoints lie on every `spacing` metres where the robot can stand; together with the way between them they see at least `share` of the
    floor that it can reach. On the way the scanner looks every `step` metres."""

    spacing: float = 0.5
    share: float = 0.99
    step: float = 0.5


@dataclass(frozen=True, slots=True)
class KnownTour:
    """Length of the round in metres, how many viewpoints it has, the share of the reachable floor that it sees, its cells (iy, ix)."""

    length: float
    viewpoints: int
    coverage: float
    cells: tuple[tuple[int, int], ...]


def known_tour(world: GridWorld, config: KnownTourConfig | None = None) -> KnownTour:
    """Return a round tour from the pose of `world` that sees its floor, by its scanner's range; the world is not changed."""
    return _Planner(world, config or KnownTourConfig()).tour()


class _Planner:
    """Holds what each stop and each leg sees."""

    def __init__(self, world: GridWorld, config: KnownTourConfig) -> None:
        self.world, self.config = world, config
        self.floor = world.reachable
        self.wanted = int(np.ceil(config.share * np.count_nonzero(self.floor)))
        self.stride = max(1, round(config.spacing / world.spec.resolution))
        self._legs: dict[tuple[int, int], tuple[float, Seen]] = {}
        self._fields: dict[int, NDArray[np.float32]] = {}

    def tour(self) -> KnownTour:
        """Cover, order, leave out."""
        spec = self.world.spec
        self.cells = [spec.cell_of(self.world.pose.x, self.world.pose.y), *self._cover()]
        order = self._leave_out(shorten(list(range(len(self.cells))), self._lengths()))
        again = shorten(order, self._lengths())
        if self._seen_on(again) >= min(self.wanted, self._seen_on(order)):  # another order sees other things on its way
            order = again
        length = sum(self._leg(a, b)[0] for a, b in _round(order))
        share = self._seen_on(order) / int(np.count_nonzero(self.floor))
        return KnownTour(length, len(order) - 1, share, tuple(self.cells[k] for k in order))

    def _seen_on(self, order: list[int]) -> int:
        return int(np.count_nonzero(np.logical_or.reduce([self._leg(a, b)[1] for a, b in _round(order)])))

    def _cover(self) -> list[tuple[int, int]]:
        """Return the cells of viewpoints that see the floor together with the start, by greedy cover."""
        spots = np.argwhere(self.floor[:: self.stride, :: self.stride]) * self.stride
        sights = np.array([np.packbits(self._seen_from(iy, ix)[self.floor]) for iy, ix in spots])
        start = self.world.spec.cell_of(self.world.pose.x, self.world.pose.y)
        known = np.packbits(self._seen_from(*start)[self.floor])
        sights_left, chosen = sights & ~known, list[tuple[int, int]]()
        count = int(np.bitwise_count(known).sum())
        while count < self.wanted:
            gains = np.bitwise_count(sights_left).sum(axis=1, dtype=np.int64)
            best = int(np.argmax(gains))
            if gains[best] == 0:
                break
            chosen.append((int(spots[best, 0]), int(spots[best, 1])))
            count += int(gains[best])
            sights_left &= ~sights[best]
        return chosen

    def _seen_from(self, iy: int, ix: int) -> Seen:
        """Return the reachable floor that the scanner sees from a cell's centre, without gaps between beams."""
        w = self.world
        reach = w.reach_cells
        low_y, low_x = max(0, int(iy - reach) - 1), max(0, int(ix - reach) - 1)
        box = np.s_[low_y : int(iy + reach) + 2, low_x : int(ix + reach) + 2]
        built = np.full(w.truth[box].shape, OCC_UNKNOWN, np.int8)
        beams = int(np.ceil(2.0 * np.pi * reach))
        at = (ix + 0.5 - low_x, iy + 0.5 - low_y)
        sense(np.ascontiguousarray(w.truth[box]), OCC_OCCUPIED, *at, beams, reach, OCC_FREE, OCC_OCCUPIED, built)
        seen = np.zeros(w.truth.shape, np.bool_)
        seen[box] = built == OCC_FREE
        return seen & self.floor

    def _lengths(self) -> F64:
        n = len(self.cells)
        out = np.zeros((n, n))
        for a in range(n):
            field = self._field(a)
            for b, cell in enumerate(self.cells):
                out[a, b] = field[cell]
        return 0.5 * (out + out.T)

    def _field(self, stop: int) -> NDArray[np.float32]:
        if stop not in self._fields:
            self._fields[stop] = self.world.distances_from(SE2(*self.world.spec.center_of(*self.cells[stop])))
        return self._fields[stop]

    def _leg(self, a: int, b: int) -> tuple[float, Seen]:
        """Return the length of the way between two stops and the floor that is seen on it, both stops included."""
        key = (min(a, b), max(a, b))
        if key not in self._legs:
            field, cell = self._field(key[1]), self.cells[key[0]]
            seen = self._seen_from(*cell) | self._seen_from(*self.cells[key[1]])
            gone = 0.0
            while (below := self.world.downhill(field, cell)) is not None:
                gone += float(field[cell] - field[below])
                cell = below
                if gone >= self.config.step:
                    seen |= self._seen_from(*cell)
                    gone = 0.0
            self._legs[key] = (float(field[self.cells[key[0]]]), seen)
        return self._legs[key]

    def _leave_out(self, order: list[int]) -> list[int]:
        """Drop the stops that are not needed, the one first that saves most of the way."""
        lengths = self._lengths()
        times = np.zeros(self.floor.shape, np.int32)
        for a, b in _round(order):
            times += self._leg(a, b)[1]
        while True:
            best, best_saving = None, LEAST_GAIN
            for k in range(1, len(order)):
                before, stop, after = order[k - 1], order[k], order[(k + 1) % len(order)]
                saving = lengths[before, stop] + lengths[stop, after] - lengths[before, after]
                if saving > best_saving and self._is_spare(times, before, stop, after):
                    best, best_saving = k, float(saving)
            if best is None:
                return order
            before, stop, after = order[best - 1], order[best], order[(best + 1) % len(order)]
            times += self._leg(before, after)[1]
            times -= self._leg(before, stop)[1].astype(np.int32) + self._leg(stop, after)[1]
            order = [*order[:best], *order[best + 1 :]]

    def _is_spare(self, times: NDArray[np.int32], before: int, stop: int, after: int) -> bool:
        """Say whether enough stays seen when a stop is passed by."""
        left = times - self._leg(before, stop)[1] - self._leg(stop, after)[1] + self._leg(before, after)[1]
        return int(np.count_nonzero(left > 0)) >= min(self.wanted, int(np.count_nonzero(times > 0)))


def _round(order: list[int]) -> list[tuple[int, int]]:
    return list(zip(order, [*order[1:], order[0]], strict=True)) if len(order) > 1 else [(order[0], order[0])]


def shorten(order: list[int], lengths: F64) -> list[int]:
    """Return a shorter round over the stops of `order` that begins with the first one: the order of the nearest, then 2-opt and Or-opt."""
    left, best = list(order[1:]), [order[0]]
    while left:
        best.append(left.pop(int(np.argmin([lengths[best[-1], k] for k in left]))))
    while (better := _better(best, lengths)) is not None:
        best = better
    return best


def _better(order: list[int], lengths: F64) -> list[int] | None:
    """Return the order after the first move that shortens the round, None when there is none."""
    n = len(order)
    at = [*order, order[0]]
    for i in range(1, n):
        for j in range(i, n):
            a, b, c, d = at[i - 1], at[i], at[j], at[j + 1]
            if i < j and lengths[a, c] + lengths[b, d] < lengths[a, b] + lengths[c, d] - LEAST_GAIN:
                return [*order[:i], *reversed(order[i : j + 1]), *order[j + 1 :]]
            if j - i > 2:
                continue
            rest = [*order[:i], *order[j + 1 :]]
            saved = lengths[a, b] + lengths[c, d] - lengths[a, d]
            for k in range(1, len(rest) + 1):
                e, f = rest[k - 1], rest[k % len(rest)]
                if lengths[e, b] + lengths[c, f] - lengths[e, f] < saved - LEAST_GAIN:
                    return [*rest[:k], *order[i : j + 1], *rest[k:]]
    return None
