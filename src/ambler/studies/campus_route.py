"""Routes through campuses: along the ways of a drawn place around its loops and back to the start, as a robot drives them.

A route visits some crossings by ways that it has not used before, where there are any, so that it closes loops of several sizes, and
passes through houses. Corners are rounded, the robot weaves a little about the middle of its lane, and is slower in curves.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.sim.body import TICK

F64 = NDArray[np.float64]
Point = tuple[float, float]
USED = 4.0  # how many times as long a way counts that was used before
STEP = 0.02  # metres between the points of a path
RADIUS = 1.2  # metres, of rounded corners
WEAVE = 0.15  # metres, amplitude of each of two waves about the middle of the lane
TURN_RATE = 0.6  # rad/s in curves
SLOPE = 0.25  # change of the speed along the way, m/s per metre
REST = 1.0  # seconds at rest before and after
OVERLAP = 40.0  # metres that the first way is driven again at the end


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """True poses float64 (N, 3) of (x, y, yaw) in the world at every tick (5 ms), `loops` the lengths of the loops that the route closes, metres."""

    poses: F64
    loops: tuple[float, ...]

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return (len(self.poses) - 1) * TICK

    @property
    def length(self) -> float:
        """How far it goes, metres."""
        return float(np.sum(np.hypot(*np.diff(self.poses[::10, :2], axis=0).T)))


def draw_motion(
    ways: Sequence[Sequence[Point]], start: Point, visits: int, speed: float, rng: np.random.Generator
) -> Motion:
    """Draw a route from the crossing nearest to `start` over `visits` crossings and home, and drive it at up to `speed` m/s."""
    nodes = route_of(ways, start, visits, rng)
    path = _weaving(_rounded(np.array(nodes)), rng)
    return Motion(_driven(path, speed), _loops_of(nodes))


def route_of(ways: Sequence[Sequence[Point]], start: Point, visits: int, rng: np.random.Generator) -> list[Point]:
    """Return the crossings (x, y) of a route; it never turns back on the way. Raises BadInputError where there are no ways."""
    graph = _graph_of(ways)
    if not graph:
        raise BadInputError("a place without ways has no route")
    home = min(graph, key=lambda n: math.dist(n, start))
    used: set[frozenset[Point]] = set()
    route = [home]
    others = sorted(graph)
    for k in range(visits + 1):
        far = [n for n in others if math.dist(n, route[-1]) > 30.0]
        goal = home if k == visits else far[int(rng.integers(len(far)))]
        leg = _shortest(graph, route, goal, used)
        for a, b in itertools.pairwise([route[-1], *leg]):
            used.add(frozenset((a, b)))
        route += leg
    again = 0.0
    for point in route[1:]:
        if again > OVERLAP or point == route[-2]:
            break
        again += math.dist(route[-1], point)
        route.append(point)
    return route


def _graph_of(ways: Sequence[Sequence[Point]]) -> dict[Point, dict[Point, float]]:
    """Join ways where they cross or meet: they run along the axes."""
    lines = [tuple((round(x, 3), round(y, 3)) for x, y in way) for way in ways]
    graph: dict[Point, dict[Point, float]] = {}
    for a, b in lines:
        stops = {a, b}
        for c, d in lines:
            crossing = _crossing(a, b, c, d)
            if crossing is not None:
                stops.add(crossing)
        ordered = sorted(stops)
        for p, q in itertools.pairwise(ordered):
            graph.setdefault(p, {})[q] = graph.setdefault(q, {})[p] = math.dist(p, q)
    return graph


def _crossing(a: Point, b: Point, c: Point, d: Point) -> Point | None:
    """Return where a level and an upright line meet."""
    if abs(a[1] - b[1]) < 1e-6 and abs(c[0] - d[0]) < 1e-6:
        x, y = c[0], a[1]
        is_on = (
            min(a[0], b[0]) - 1e-6 <= x <= max(a[0], b[0]) + 1e-6
            and min(c[1], d[1]) - 1e-6 <= y <= max(c[1], d[1]) + 1e-6
        )
        return (x, y) if is_on else None
    if abs(a[0] - b[0]) < 1e-6 and abs(c[1] - d[1]) < 1e-6:
        return _crossing(c, d, a, b)
    return None


def _shortest(
    graph: dict[Point, dict[Point, float]], route: Sequence[Point], goal: Point, used: set[frozenset[Point]]
) -> list[Point]:
    """Return the way from the end of a route to a goal, used ways counting longer, that does not begin by turning back (Dijkstra)."""
    begin, before = route[-1], route[-2] if len(route) > 1 else None
    queue: list[tuple[float, int, Point, Point | None]] = [(0.0, 0, begin, before)]
    came: dict[tuple[Point, Point | None], tuple[Point, Point | None] | None] = {(begin, before): None}
    count = 0
    while queue:
        cost, _, here, last = heapq.heappop(queue)
        if here == goal and (here, last) != (begin, before):
            break
        for there, length in sorted(graph[here].items()):
            if there == last or (there, here) in came:
                continue
            count += 1
            came[there, here] = (here, last)
            weight = length * (USED if frozenset((here, there)) in used else 1.0)
            heapq.heappush(queue, (cost + weight, count, there, here))
    state: tuple[Point, Point | None] | None = (here, last)
    leg = []
    while state is not None and state != (begin, before):
        leg.append(state[0])
        state = came[state]
    return leg[::-1]


def _loops_of(nodes: Sequence[Point]) -> tuple[float, ...]:
    """Return the lengths of the ways between two visits of a crossing, where that is the first return to anywhere since."""
    loops, seen, at = [], {nodes[0]: 0.0}, 0.0
    for a, b in itertools.pairwise(nodes):
        at += math.dist(a, b)
        if b in seen:
            loops.append(at - seen[b])
        seen[b] = at
    return tuple(sorted({round(loop, 1) for loop in loops if loop > 60.0}))


def _rounded(corners: F64) -> F64:
    """Return a polyline (K, 2) with its corners rounded, every 2 cm."""
    points = [corners[:1]]
    for a, b, c in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        to_a, to_c = (a - b) / np.linalg.norm(a - b), (c - b) / np.linalg.norm(c - b)
        if abs(to_a[0] * to_c[1] - to_a[1] * to_c[0]) < 1e-6:
            continue
        middle = b + RADIUS * (to_a + to_c)  # of the circle: ways meet at right angles
        angles = np.linspace(0.0, 0.5 * math.pi, 24)[:, None]
        points.append(middle - RADIUS * (np.cos(angles) * to_c + np.sin(angles) * to_a))
    points.append(corners[-1:])
    line = np.concatenate(points)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    keep = np.concatenate([[True], np.diff(along) > 1e-9])
    steps = np.arange(0.0, along[-1], STEP)
    return np.stack([np.interp(steps, along[keep], line[keep, k]) for k in range(2)], axis=1)


def _weaving(path: F64, rng: np.random.Generator) -> F64:
    """Move a path to either side by two waves, which begin softly."""
    s = np.arange(len(path)) * STEP
    heading = _smooth(np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::-1])), 75)
    offset = np.zeros(len(path))
    for _ in range(2):
        length, phase = rng.uniform(12.0, 45.0), rng.uniform(0.0, 2.0 * math.pi)
        offset += WEAVE * np.sin(2.0 * math.pi * s / length + phase)
    offset *= np.minimum(1.0, np.minimum(s, s[::-1]) / 5.0)
    return np.asarray(path + offset[:, None] * np.stack([-np.sin(heading), np.cos(heading)], axis=1))


def _driven(path: F64, speed: float) -> F64:
    """Return the poses at every tick of a robot that drives a path: rest, drive with a heading that turns evenly, rest."""
    heading = _smooth(np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::-1])), 51)
    curvature = np.abs(np.gradient(heading, STEP))
    wanted = np.minimum(speed, TURN_RATE / np.maximum(curvature, 1e-6))
    wanted[0] = wanted[-1] = 0.1
    for order in (range(1, len(wanted)), range(len(wanted) - 2, -1, -1)):
        before = 1 if order.step < 0 else -1
        for k in order:
            wanted[k] = min(wanted[k], wanted[k + before] + SLOPE * STEP / max(wanted[k + before], 0.2) * 2.0)
    times = REST + np.concatenate([[0.0], np.cumsum(STEP / (0.5 * (wanted[1:] + wanted[:-1])))])
    ticks = np.arange(0.0, times[-1] + REST, TICK)
    return np.stack([np.interp(ticks, times, v) for v in (path[:, 0], path[:, 1], heading)], axis=1)


def _smooth(values: F64, count: int) -> F64:
    """Return moving means over an odd count."""
    padded = np.pad(values, count // 2, mode="edge")
    return np.convolve(padded, np.full(count, 1.0 / count), mode="valid")
