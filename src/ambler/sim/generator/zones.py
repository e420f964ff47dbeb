"""Zones that tile an outline become a building: walls where they meet, doors that connect all of them, windows outside."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ambler.sim.generator.furnish import Furnisher, nothing
from ambler.sim.generator.plan import Piece, Plan, Point
from ambler.sim.generator.rect import Rect, around

NEAR = 1e-6
DOOR_END = 0.2  # metres of wall that remain beside a door
BEFORE_DOOR = 1.0  # metres that furniture keeps off a door, on both sides
SILL, LINTEL = 0.9, 2.1  # heights of windows
NICHE = 1.3  # metres; what is narrower need not be entered
POST = 1.3  # metres between the posts of a front of glass


@dataclass(frozen=True, slots=True)
class Style:
    """How a building is built: thickness of walls, width of doors, how many rooms have a second door, how much of a facade is window, how
    many of the rooms that may have one have a front of glass."""

    inner: float
    outer: float
    door: tuple[float, float]
    extra_doors: float = 0.15
    windows: float = 0.5
    glass_fronts: float = 0.0


@dataclass(frozen=True, slots=True)
class Zone:
    """A part of a building. Zones of one `space` have no wall between them: the corridors are space 0, a room of several parts another
    one, and None is a room of its own. `door` overrides the style's width; zones without `has_doors` are reached from their space."""

    rect: Rect
    furnish: Furnisher = nothing
    space: int | None = None
    has_doors: bool = True
    door: tuple[float, float] | None = None
    may_have_glass: bool = False

    @property
    def is_corridor(self) -> bool:
        return self.space == 0


@dataclass(frozen=True, slots=True)
class Edge:
    """Where two zones meet, or a zone the outside (`b` None): from `a` to `b` along x (`is_level`) or y at `across`."""

    first: int
    second: int | None
    is_level: bool
    across: float
    begin: float
    end: float

    @property
    def length(self) -> float:
        return self.end - self.begin

    def point(self, along: float) -> Point:
        """Return the point at a coordinate along it."""
        return (along, self.across) if self.is_level else (self.across, along)


@dataclass
class Building:
    """What was built: its zones, the walls' style, and outer doors that were asked for as (point on the facade, width)."""

    plan: Plan
    zones: Sequence[Zone]
    style: Style
    entrances: Sequence[tuple[Point, float]] = ()
    edges: list[Edge] = field(default_factory=list)

    def build(self) -> None:
        """Put walls, doors, windows and furniture."""
        self.edges = [*inner_edges(self.zones), *outer_edges(self.zones)]
        doors = self._doors()
        for k, edge in enumerate(self.edges):
            if edge.second is None:
                self._facade(edge)
            elif not self._is_open(edge):
                self._partition(edge, doors.get(k, []))
        for zone in self.zones:
            if min(zone.rect.width, zone.rect.depth) > NICHE:
                self.plan.floors.append(zone.rect.inset(0.5 * self.style.outer))
        for zone in self.zones:
            zone.furnish(self.plan, zone.rect.inset(0.5 * self.style.outer))

    def _doors(self) -> dict[int, list[tuple[float, float]]]:
        """Choose which edges have a door: first what connects everything, rooms to corridors before rooms to rooms, then some more."""
        rng, zones = self.plan.rng, self.zones
        group = list(range(len(zones)))

        def root(k: int) -> int:
            while group[k] != k:
                k = group[k]
            return k

        inner = [k for k, e in enumerate(self.edges) if e.second is not None]
        for k in inner:
            edge = self.edges[k]
            if edge.second is not None and self._is_open(edge):
                group[root(edge.first)] = root(edge.second)
        doors: dict[int, list[tuple[float, float]]] = {}
        ranked = sorted(inner, key=lambda k: self._rank(self.edges[k], float(rng.random())))
        for k in ranked:
            edge = self.edges[k]
            if edge.second is None or self._is_open(edge):
                continue
            if not (zones[edge.first].has_doors and zones[edge.second].has_doors):
                continue
            is_needed = root(edge.first) != root(edge.second)
            is_extra = rng.random() < self.style.extra_doors * (1.0 if edge.length > 2.0 else 0.3)
            door = self._door_in(edge) if is_needed or is_extra else None
            if door is not None:
                doors[k] = [door]
                group[root(edge.first)] = root(edge.second)
        return doors

    def _is_open(self, edge: Edge) -> bool:
        """Whether there is no wall at an edge."""
        first = self.zones[edge.first].space
        return edge.second is not None and first is not None and first == self.zones[edge.second].space

    def _rank(self, edge: Edge, luck: float) -> tuple[bool, float]:
        assert edge.second is not None
        has_corridor = self.zones[edge.first].is_corridor or self.zones[edge.second].is_corridor
        return (not has_corridor, luck - 0.2 * min(edge.length, 5.0))

    def _door_in(self, edge: Edge) -> tuple[float, float] | None:
        """Draw a door for an edge as (distance from its begin, width), None where it is too short; keep its surroundings clear."""
        rng, assert_second = self.plan.rng, edge.second
        assert assert_second is not None
        own = self.zones[edge.first].door or self.zones[assert_second].door or self.style.door
        width = float(np.round(rng.uniform(*own), 2))
        end = DOOR_END + 0.5 * self.style.outer
        room = edge.length - width - 2 * end
        if room < 0.0:
            return None
        at = float(rng.uniform(0.0, room)) if rng.random() < 0.5 else float(rng.choice([0.0, room]))
        middle = end + 0.5 * width + at
        self._keep_clear(edge, edge.begin + middle, width)
        return middle, width

    def _keep_clear(self, edge: Edge, along: float, width: float) -> None:
        size = (width + 0.2, 2 * BEFORE_DOOR) if edge.is_level else (2 * BEFORE_DOOR, width + 0.2)
        self.plan.keep_clear(around(edge.point(along), *size))

    def _partition(self, edge: Edge, doors: list[tuple[float, float]]) -> None:
        plan, a, b = self.plan, edge.point(edge.begin), edge.point(edge.end)
        assert edge.second is not None
        zones = (self.zones[edge.first], self.zones[edge.second])
        is_front = any(z.may_have_glass for z in zones) and any(z.is_corridor for z in zones)
        is_glass = is_front and edge.length > 2.0 and plan.rng.random() < self.style.glass_fronts
        plan.wall(a, b, 0.06 if is_glass else self.style.inner, doors, is_glass=is_glass)
        if is_glass:
            self._posts(edge, doors)

    def _posts(self, edge: Edge, doors: list[tuple[float, float]]) -> None:
        """Put the posts of a front of glass: at its ends, beside its doors, and every 1.3 m."""
        ends = [0.0, edge.length, *(at + side * (0.5 * w + 0.05) for at, w in doors for side in (-1.0, 1.0))]
        inner = np.linspace(0.0, edge.length, max(2, round(edge.length / POST) + 1))
        places = ends + [float(x) for x in inner if all(abs(x - at) > 0.5 * w + 0.2 for at, w in doors)]
        for along in places:
            self.plan.fixed.box("post", edge.point(edge.begin + along), (0.1, 0.1, self.plan.wall_height))

    def _facade(self, edge: Edge) -> None:
        """Put an outer wall: its entrances, and windows between solid pieces."""
        plan, style = self.plan, self.style
        doors = [
            ((p[0] if edge.is_level else p[1]) - edge.begin, width)
            for p, width in self.entrances
            if abs((p[1] if edge.is_level else p[0]) - edge.across) < 0.05
            and edge.begin < (p[0] if edge.is_level else p[1]) < edge.end
        ]
        if doors or edge.length < 2.4 or plan.rng.random() > style.windows:
            plan.wall(edge.point(edge.begin), edge.point(edge.end), style.outer, sorted(doors))
            for at, width in doors:
                self._keep_clear(edge, edge.begin + at, width)
            return
        count = max(1, int(edge.length / 3.5))
        width = float(plan.rng.uniform(1.0, 0.7 * edge.length / count))
        stops = [0.0]
        for k in range(count):
            middle = (k + 0.5) * edge.length / count
            stops += [middle - 0.5 * width, middle + 0.5 * width]
        stops.append(edge.length)
        for k, (a, b) in enumerate(itertools.pairwise(stops)):
            low, high = edge.begin + a, edge.begin + b
            plan.wall(edge.point(low), edge.point(high), style.outer, height=SILL if k % 2 else None)
            if k % 2:
                self._pane(plan.fixed, edge, low, high)

    def _pane(self, piece: Piece, edge: Edge, low: float, high: float) -> None:
        """Put a pane over the sill, and the lintel over the pane."""
        middle, length = edge.point(0.5 * (low + high)), high - low
        thin = (length, 0.04) if edge.is_level else (0.04, length)
        thick = (length, self.style.outer) if edge.is_level else (self.style.outer, length)
        piece.box("pane", middle, (*thin, LINTEL - SILL), base=SILL, is_glass=True)
        if self.plan.wall_height > LINTEL + 0.02:
            piece.box("lintel", middle, (*thick, self.plan.wall_height - LINTEL), base=LINTEL, albedo=0.7)


def inner_edges(zones: Sequence[Zone]) -> list[Edge]:
    """Return where zones meet."""
    edges = []
    for i, a in enumerate(zones):
        for j in range(i + 1, len(zones)):
            b = zones[j].rect
            for is_level, touching, low, high in (
                (False, _meets(a.rect.x0, a.rect.x1, b.x0, b.x1), max(a.rect.y0, b.y0), min(a.rect.y1, b.y1)),
                (True, _meets(a.rect.y0, a.rect.y1, b.y0, b.y1), max(a.rect.x0, b.x0), min(a.rect.x1, b.x1)),
            ):
                if touching is not None and high - low > 0.05:
                    edges.append(Edge(i, j, is_level, touching, low, high))
    return edges


def _meets(a0: float, a1: float, b0: float, b1: float) -> float | None:
    """Return the coordinate at which two intervals touch end to end, None where they do not."""
    if abs(a1 - b0) < NEAR:
        return a1
    return a0 if abs(a0 - b1) < NEAR else None


def outer_edges(zones: Sequence[Zone]) -> list[Edge]:
    """Return the parts of the zones' sides that no other zone shares."""
    shared = inner_edges(zones)
    edges = []
    for k, zone in enumerate(zones):
        r = zone.rect
        sides = (
            (True, r.y0, r.x0, r.x1),
            (True, r.y1, r.x0, r.x1),
            (False, r.x0, r.y0, r.y1),
            (False, r.x1, r.y0, r.y1),
        )
        for is_level, across, begin, end in sides:
            taken = sorted(
                (e.begin, e.end)
                for e in shared
                if k in (e.first, e.second) and e.is_level == is_level and abs(e.across - across) < NEAR
            )
            at = begin
            for low, high in [*taken, (end, end)]:
                if low - at > 0.02:
                    edges.append(Edge(k, None, is_level, across, at, low))
                at = max(at, high)
    return edges


Layout = Callable[[Plan], list[Zone]]
