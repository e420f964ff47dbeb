"""The dynamic visibility graph: contours of what the robot's centre must not enter become polygons, their outer corners become nodes, and
nodes that see each other along a taut line are joined.

Two layers. The local one is what an update found where cells changed: contours and their corners. The global one holds the nodes and
edges that lasted: a node of the global layer that a local corner confirms gets a vote, one that is looked for in vain loses one, and an edge
is used while most of its last tests found it open. What is blocked now is never used, whatever the votes say. Beside edges of sight there are contour edges
(two corners in turn along one polygon) and trajectory edges (the robot has driven there). A floor is a level of a map of ground: each has nodes and edges of its own.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.units import Radians
from ambler.kernels import level_contour, line_of_sight
from ambler.kernels import visibility as kernels
from ambler.planning.clearance_map import TILE, Box, Changes, ClearanceMap, UnknownPrice, grown
from ambler.planning.graph_arrays import GraphArrays, copied_arrays, empty_arrays

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

CORNER, GAP, DRIVEN = 0, 1, 2
UNIT = 16.0
LEAP = 3.0  # metres between two places of a robot that it need not have driven
AGAIN = 0.3  # metres from a node of a way that was driven before within which no other one is made
Curve = tuple[F64, bool]  # points (y, x) in cells, and whether it closes


@dataclass(frozen=True, slots=True)
class VisibilityGraphConfig:
    """Lengths are in cells of the grid unless they say otherwise: corners lie `level` away from what is forbidden and edges keep `least`,
    so that a polygon may be simplified by their difference (`tolerance`). `reach` (m) is the longest edge of sight. A corner confirms a node within `match` and
    moves it when it is more than `moved` away; `misses` updates in a row that look for a node in vain remove it. `refresh` limits how many nodes
    an update joins anew where something was freed, and with far ones (None: all); then a way may be longer for some updates, never wrong."""

    # A cell's corner lies 0.71 from its centre; what interpolation (0.15) and the step of sight lines (0.125) can miss is added
    least: float = 1.0
    tolerance: float = 0.6  # slanted walls of a grid stay smooth from half a cell on
    level: float = 1.6
    least_turn: Radians = 0.12  # rad; less is the wave of a slanted wall
    slack: float = 0.1  # sine of the angle by which a leg may enter the obstacle that it should support
    reach: float = 40.0
    match: float = 2.5
    moved: float = 0.75
    misses: int = 3
    refresh: int | None = None
    near: float = (
        7.5  # metres within which a new node is joined at once where `refresh` limits the work; far ones follow in turn
    )
    context: int = 24  # cells around a change in which contours are followed, so that their corners come out the same


@dataclass(frozen=True, slots=True)
class Updated:
    """What an update did: corners found, nodes added, moved and removed, edges tested again."""

    corners: int = 0
    added: int = 0
    moved: int = 0
    removed: int = 0
    tested: int = 0


class VisibilityGraph:
    """Feed `update` with the cells of a floor, `drive` with where the robot is; `search` finds ways on it. Floors are numbered from 0; positions in
    metres, in the frame of the grids."""

    def __init__(self, config: VisibilityGraphConfig | None = None, price: UnknownPrice | None = None) -> None:
        self.config = config or VisibilityGraphConfig()
        self.price = price
        self.floors: list[ClearanceMap] = [ClearanceMap(price)]
        self._a = empty_arrays(64, 32)
        self.next_ident = 0
        self.pending: dict[int, tuple[U8, int]] = {}
        self.waiting: list[int] = []  # nodes that are yet to be joined with far ones
        self.track: tuple[int | None, tuple[int, float, float] | None] = (None, None)

    # What it holds

    @property
    def arrays(self) -> GraphArrays:
        """The nodes and edges as the kernels see them."""
        return self._a

    @property
    def node_count(self) -> int:
        """How many nodes there are."""
        return int(self._a.is_alive.sum())

    @property
    def edge_count(self) -> int:
        """How many edges are open now."""
        a = self._a
        slots = np.arange(a.neighbor.shape[1]) < a.degree[:, None]
        return int(((a.state[:, :, kernels.OPEN] > 0) & slots & a.is_alive[:, None]).sum()) // 2

    def restore(self, nodes: int, slots: int) -> GraphArrays:
        """Begin anew with room for so many nodes and slots; returns the arrays, to be filled with what was saved."""
        self._a = empty_arrays(nodes, slots)
        return self._a

    def contours(self, floor: int = 0) -> tuple[NDArray[np.float32], ...]:
        """Return the simplified contours of a floor, float32 (N, 2) each in metres; those that close end where they begin."""
        ground, out = self.floor(floor), []
        if ground.spec is None:
            return ()
        x, y, r = ground.spec.origin_x, ground.spec.origin_y, ground.spec.resolution
        for curve, is_closed in self._curves(ground, (0, ground.spec.height, 0, ground.spec.width)):
            line = np.vstack((curve, curve[:1])) if is_closed else curve
            rows = np.stack((x + (line[:, 1] + 0.5) * r, y + (line[:, 0] + 0.5) * r), axis=1)
            out.append(rows.astype(np.float32))
        return tuple(out)

    def floor(self, number: int) -> ClearanceMap:
        """Return what is known of a floor, which begins to exist."""
        while len(self.floors) <= number:
            self.floors.append(ClearanceMap(self.price))
        return self.floors[number]

    # Updates

    def update(self, spec: GridSpec, cells: U8, floor: int = 0, hidden: U8 | None = None) -> Updated:
        """Take the cells of a floor: uint8 [iy, ix] of clearance_map.UNKNOWN, FREE, FORBIDDEN, and uint8 where a wall is supposed."""
        return self.update_box(spec, cells, (0, spec.height, 0, spec.width), floor, hidden)

    def update_box(self, spec: GridSpec, cells: U8, box: Box, floor: int = 0, hidden: U8 | None = None) -> Updated:
        """Take the cells of a box (y0, y1, x0, x1) of the grid of a floor; what was known of the rest stays."""
        ground = self.floor(floor)
        if ground.spec != spec:
            ground.set_grid(spec)
            self._place_in_cells(floor, spec)
            self.pending.pop(floor, None)
        changes = ground.update_box(cells, box, hidden)
        if changes.is_empty:
            self._refresh(floor, ground, changes)
            return Updated()
        tested = kernels.retest(self._a.graph, _ground(ground, floor), changes.dirty, TILE, self.config.least)
        found, moved, removed, corners, seen = [], 0, 0, 0, []
        for changed in changes.boxes:
            curves = self._curves(ground, grown(changed, self.config.context, spec))
            local = self._corners(ground, curves, changed)
            corners += len(local)
            seen.append((grown(changed, self.config.context, spec), curves))
            new, moved_here, removed_here = self._take(local, ground, floor, changed)
            found += new
            moved, removed = moved + moved_here, removed + removed_here
        self._join(np.array(sorted(set(found)), np.int64), ground, floor)
        for near, curves in seen:
            self._follow_contours(floor, ground, near, curves)
        self._refresh(floor, ground, changes)
        return Updated(corners, len(found) - moved, moved, removed, int(tested))

    def _place_in_cells(self, floor: int, spec: GridSpec) -> None:
        """Bring the nodes of a floor into the cells of its grid."""
        a = self._a
        mine = a.is_alive & (a.nodes[:, kernels.FLOOR] == floor)
        a.nodes[mine, kernels.X] = (a.place[mine, 0] - spec.origin_x) / spec.resolution - 0.5
        a.nodes[mine, kernels.Y] = (a.place[mine, 1] - spec.origin_y) / spec.resolution - 0.5

    def _curves(self, ground: ClearanceMap, box: Box) -> list[Curve]:
        """Return the simplified curves (y, x) of the level within a box, and whether each closes."""
        y0, y1, x0, x1 = box
        level = self.config.level * UNIT + 0.25  # between two values, so that no cell lies on it
        size = 4096
        while True:
            points, starts = np.empty((size, 2)), np.empty(size // 4 + 2, np.int64)
            closed = np.empty(size // 4 + 2, np.bool_)
            count = level_contour.trace(ground.field, level, y0, y1, x0, x1, points, starts, closed)
            if count >= 0:
                break
            size *= 4
        curves = []
        for k in range(count):
            curve = points[starts[k] : starts[k + 1]]
            if len(curve) < 2:
                continue
            keep = np.empty(len(curve), np.bool_)
            level_contour.simplify(curve, bool(closed[k]), self.config.tolerance, keep)
            curves.append((curve[keep], bool(closed[k])))
        return curves

    def _corners(self, ground: ClearanceMap, curves: list[Curve], box: Box) -> F64:
        """Return the corners that the contours have where a box of cells changed, and gaps too narrow for contours, (M, 8) as nodes."""
        assert ground.spec is not None
        found = []
        for curve, is_closed in curves:
            out = np.empty((len(curve), 6))
            count = level_contour.corners(curve, is_closed, self.config.least_turn, out)
            rows = np.zeros((count, 8))
            rows[:, :6], rows[:, kernels.IS_CORNER] = out[:count], 1.0
            found.append(rows)
        near = grown(box, 8, ground.spec)
        cells = np.empty((512, 2), np.int64)
        count = level_contour.narrow_cells(
            ground.field, self.config.level * UNIT + 0.25, self.config.least * UNIT, *near, cells
        )
        gaps = np.zeros((count, 8))
        gaps[:, :2] = cells[:count]
        found.append(gaps)
        rows = np.vstack(found)
        inside = (rows[:, 0] >= near[0]) & (rows[:, 0] < near[1]) & (rows[:, 1] >= near[2]) & (rows[:, 1] < near[3])
        return rows[inside]

    def _take(self, local: F64, ground: ClearanceMap, floor: int, box: Box) -> tuple[list[int], int, int]:
        """Let the local layer vote for the nodes of the global one in a box; returns the nodes that are new or moved, how many moved, and how
        many were removed."""
        a, c = self._a, self.config
        assert ground.spec is not None
        y0, y1, x0, x1 = grown(box, 8, ground.spec)
        at = a.nodes
        mine = a.is_alive & (at[:, kernels.FLOOR] == floor) & (a.kind != DRIVEN)
        mine &= (at[:, 0] >= y0) & (at[:, 0] < y1) & (at[:, 1] >= x0) & (at[:, 1] < x1)
        candidates = np.flatnonzero(mine)
        out = np.empty(len(local), np.int64)
        kernels.match_corners(local, a.nodes, candidates, c.match, out)
        changed, moved = [], 0
        for row, node in zip(local, out.tolist(), strict=True):
            if node < 0:
                changed.append(self._add(row, floor, CORNER if row[kernels.IS_CORNER] else GAP))
                continue
            a = self._a
            a.missed[node], a.seen[node] = 0, a.seen[node] + 1
            off = np.hypot(*(a.nodes[node, :2] - row[:2]))
            a.nodes[node, 2:6] = row[2:6]
            if (
                off > c.moved
                or line_of_sight.clearance(ground.field, a.nodes[node, 0], a.nodes[node, 1]) < c.least + 0.1
            ):
                kernels.drop_node(a.graph, node)
                a.nodes[node, :2] = row[:2]
                a.place[node] = self._metres(ground.spec, row)
                changed.append(node)
                moved += 1
        is_met = np.zeros(len(self._a.nodes), np.bool_)
        is_met[out[out >= 0]] = True
        return changed, moved, self._miss(candidates[~is_met[candidates]], ground)

    def _miss(self, nodes: I64, ground: ClearanceMap) -> int:
        """Take votes from nodes that no corner confirmed; those within an obstacle, or missed too often, go."""
        a, removed = self._a, 0
        for node in nodes.tolist():
            a.missed[node] += 1
            y, x = a.nodes[node, :2]
            is_buried = (
                not line_of_sight.is_inside(ground.field, y, x)
                or line_of_sight.clearance(ground.field, y, x) < self.config.least
            )
            if is_buried or a.missed[node] >= self.config.misses:
                self._remove(node)
                removed += 1
        return removed

    def _join(self, ids: I64, ground: ClearanceMap, floor: int, *, is_far: bool = False) -> None:
        if len(ids) == 0:
            return
        assert ground.spec is not None
        c = self.config
        is_new = np.zeros(len(self._a.nodes), np.bool_)
        is_new[ids] = True
        reach = c.reach
        if c.refresh is not None and not is_far:
            reach = min(c.near, c.reach)
            self.waiting = (self.waiting + ids.tolist())[-len(self._a.nodes) :]
        cells = reach / ground.spec.resolution
        while not kernels.connect(self._a.graph, _ground(ground, floor), ids, is_new, cells, c.least, c.slack):
            self._widen()

    def _refresh(self, floor: int, ground: ClearanceMap, changes: Changes) -> None:
        """Join nodes that see each other since something was freed; what the limit leaves is done by the next updates."""
        assert ground.spec is not None
        if self.waiting and self.config.refresh is not None:
            turn = self._next_waiting(floor, max(1, self.config.refresh // 4))
            self._join(np.array(sorted(set(turn)), np.int64), ground, floor, is_far=True)
        freed, first = changes.freed, 0
        if floor in self.pending:
            older, done = self.pending[floor]
            if freed.any():
                freed = older | freed
            else:
                freed, first = older, done
        if not freed.any():
            return
        c, resolution, n = self.config, ground.spec.resolution, len(self._a.nodes)
        last = n if c.refresh is None else min(n, first + c.refresh)
        while not kernels.reconnect(
            self._a.graph, _ground(ground, floor), freed, TILE, first, last, c.reach / resolution, c.least, c.slack
        ):
            self._widen()
        if last < n:
            self.pending[floor] = (freed, last)
        else:
            self.pending.pop(floor, None)

    def _next_waiting(self, floor: int, count: int) -> list[int]:
        """Take up to so many nodes of a floor from those that wait; those that are gone do not wait any more."""
        a, turn, others = self._a, list[int](), list[int]()
        for k, node in enumerate(self.waiting):
            if len(turn) == count:
                others += self.waiting[k:]
                break
            if a.is_alive[node]:
                (turn if a.nodes[node, kernels.FLOOR] == floor else others).append(node)
        self.waiting = others
        return turn

    def _follow_contours(self, floor: int, ground: ClearanceMap, near: Box, curves: list[Curve]) -> None:
        """Join nodes that follow each other along a contour near what changed."""
        a = self._a
        mine = np.flatnonzero(a.is_alive & (a.nodes[:, kernels.FLOOR] == floor) & (a.kind == CORNER))
        at = a.nodes[mine, :2]
        inside = (at[:, 0] >= near[0]) & (at[:, 0] < near[1]) & (at[:, 1] >= near[2]) & (at[:, 1] < near[3])
        mine, at = mine[inside], at[inside]
        if len(mine) >= 2:
            for curve, is_closed in curves:
                self._join_along(curve, is_closed, mine, at, ground)

    def _join_along(self, curve: F64, is_closed: bool, mine: I64, at: F64, ground: ClearanceMap) -> None:
        assert ground.spec is not None
        out = np.empty((len(curve), 6))
        count = level_contour.corners(curve, is_closed, self.config.least_turn, out)
        if count < 2:
            return
        gaps = (out[:count, None, 0] - at[None, :, 0]) ** 2 + (out[:count, None, 1] - at[None, :, 1]) ** 2
        nearest, far = np.argmin(gaps, axis=1), np.min(gaps, axis=1)
        for k in range(count if is_closed and count > 2 else count - 1):
            m = (k + 1) % count
            if max(far[k], far[m]) > self.config.match**2 or nearest[k] == nearest[m]:
                continue
            i, j = int(mine[nearest[k]]), int(mine[nearest[m]])
            a, b = self._a.nodes[i], self._a.nodes[j]
            k_old = kernels.slot_of(self._a.graph, i, j)
            if k_old >= 0 and self._a.state[i, k_old, kernels.KIND] == kernels.CONTOUR:
                continue
            if line_of_sight.is_clear(ground.field, a[0], a[1], b[0], b[1], self.config.least):
                self._edge(i, j, kernels.CONTOUR, ground)

    def _edge(self, i: int, j: int, kind: int, ground: ClearanceMap) -> None:
        assert ground.spec is not None
        while not kernels.add_edge(self._a.graph, _ground(ground, 0), i, j, kind):
            self._widen()

    # Where the robot drives

    def drive(self, x: float, y: float, floor: int = 0) -> None:
        """Take where the robot is: when it no longer sees the last node of its way, its last place becomes one."""
        ground = self.floor(floor)
        if ground.spec is None:
            return
        last, before = self.track
        here = (floor, x, y)
        if before is not None and (before[0] != floor or math.hypot(x - before[1], y - before[2]) > LEAP):
            last, before = None, None  # its way begins anew on another floor, and where it was not seen to drive
        if last is not None and not self._a.is_alive[last]:
            last = None
        if last is not None and self._sees(last, x, y, floor):
            self.track = (last, here)
            return
        self.track = (self._bridge_to(here if last is None or before is None else before, last), here)

    def _bridge_to(self, where: tuple[int, float, float], last: int | None) -> int:
        floor, x, y = where
        ground = self.floor(floor)
        node = self._driven_before(x, y, floor, last)
        if node is None:
            node = self._add_driven(x, y, floor)
            self._join(np.array([node]), ground, floor)
        if last is not None:
            self._edge(last, node, kernels.TRAJECTORY, ground)
        return node

    def _add_driven(self, x: float, y: float, floor: int) -> int:
        spec = self.floor(floor).spec
        assert spec is not None
        row = np.zeros(8)
        row[kernels.Y], row[kernels.X] = self._cell(spec, x, y)
        return self._add(row, floor, DRIVEN)

    def _driven_before(self, x: float, y: float, floor: int, last: int | None) -> int | None:
        """Return the node nearest to a place that a way left there before, and that both the place and the way's last node see; None without one. A robot on
        its rounds would else add to the graph for as long as it drives."""
        a = self._a
        away = np.hypot(a.place[:, 0] - x, a.place[:, 1] - y)
        near = np.flatnonzero(a.is_alive & (a.kind == DRIVEN) & (a.nodes[:, kernels.FLOOR] == floor) & (away <= AGAIN))
        for node in near[np.argsort(away[near], kind="stable")].tolist():
            node_x, node_y = a.place[node].tolist()
            is_next = last is None or (last != node and self._sees(last, node_x, node_y, floor))
            if is_next and self._sees(node, x, y, floor):
                return int(node)
        return None

    def _sees(self, node: int, x: float, y: float, floor: int) -> bool:
        ground, at = self.floor(floor), self._a.nodes[node]
        if at[kernels.FLOOR] != floor or ground.spec is None:
            return False
        return bool(line_of_sight.is_open(ground.field, at[0], at[1], *self._cell(ground.spec, x, y)))

    def add_way(self, points: F64, floor: int = 0) -> None:
        """Add a way (N, 2) in metres that contours and gaps do not show, such as one found cell by cell, as nodes in a row."""
        ground = self.floor(floor)
        assert ground.spec is not None
        nodes = [self._add_driven(x, y, floor) for x, y in points.tolist()]
        self._join(np.array(nodes, np.int64), ground, floor)
        for i, j in itertools.pairwise(nodes):
            self._edge(i, j, kernels.TRAJECTORY, ground)

    # The search

    def search(
        self,
        start: tuple[float, float],
        goal: tuple[float, float],
        *,
        heading: float = 0.0,
        turning: float = 0.0,
        needs_votes: bool = True,
        floor: int = 0,
    ) -> tuple[F64, float] | None:
        """Return the corners (N, 2) in metres of the least-cost way on a floor and its cost (m), None when the graph holds none. A radian of turning from
        `heading` at the start costs `turning` metres. Without `needs_votes` every edge counts that is open now."""
        here = self.floor(floor)
        if here.spec is None:
            return None
        a, c, resolution = self._a, self.config, here.spec.resolution
        sy, sx = self._cell(here.spec, *start)
        gy, gx = self._cell(here.spec, *goal)
        direct = line_of_sight.leg_cost(here.field, here.price, sy, sx, gy, gx, resolution)
        if (
            direct <= np.hypot(gy - sy, gx - sx) * resolution + 1e-9
        ):  # nothing can be shorter, and it turns towards the goal
            return np.array([start, goal]), float(direct)
        direct += turning * float(line_of_sight.turned(heading, gy - sy, gx - sx))
        costs, parent = np.empty(len(a.nodes)), np.empty(len(a.nodes), np.int32)
        ground = _ground(here, floor)
        kernels.sight_costs(a.graph, ground, sy, sx, heading, turning, c.slack, costs)
        node, cost = kernels.search(a.graph, ground, costs, gy, gx, needs_votes, c.slack, parent)
        if node < 0 or direct <= cost:
            return (np.array([start, goal]), float(direct)) if np.isfinite(direct) else None
        way = []
        while node >= 0:
            way.append(a.place[node])
            node = int(parent[node])
        points = np.array([start, *way[::-1], goal])
        is_new = np.hypot(*np.diff(points, axis=0).T) > 1e-9
        is_new[-1] |= not is_new.any()
        return points[np.concatenate(([True], is_new))], float(cost)

    # Nodes

    def _cell(self, spec: GridSpec, x: float, y: float) -> tuple[float, float]:
        return (y - spec.origin_y) / spec.resolution - 0.5, (x - spec.origin_x) / spec.resolution - 0.5

    def _metres(self, spec: GridSpec, row: F64) -> tuple[float, float]:
        return (
            spec.origin_x + (row[kernels.X] + 0.5) * spec.resolution,
            spec.origin_y + (row[kernels.Y] + 0.5) * spec.resolution,
        )

    def _add(self, row: F64, floor: int, kind: int) -> int:
        free = np.flatnonzero(~self._a.is_alive)
        if len(free) == 0:
            free = np.array([len(self._a.nodes)])
            self._lengthen()
        node, a = int(free[0]), self._a
        spec = self.floor(floor).spec
        assert spec is not None
        a.nodes[node] = row
        a.nodes[node, kernels.FLOOR] = floor
        a.is_alive[node], a.degree[node] = True, 0
        a.ident[node], a.kind[node], a.missed[node], a.seen[node] = self.next_ident, kind, 0, 1
        a.place[node] = self._metres(spec, row)
        self.next_ident += 1
        return node

    def _remove(self, node: int) -> None:
        a = self._a
        kernels.drop_node(a.graph, node)
        a.is_alive[node] = False

    def _lengthen(self) -> None:
        self._a = copied_arrays(self._a, 2 * len(self._a.nodes), self._a.neighbor.shape[1])

    def _widen(self) -> None:
        self._a = copied_arrays(self._a, len(self._a.nodes), 2 * self._a.neighbor.shape[1])


def _ground(known: ClearanceMap, floor: int) -> kernels.Ground:
    """Return what is known of a floor as the kernels take it."""
    assert known.spec is not None
    return kernels.Ground(known.field, known.price, floor, known.spec.resolution)
