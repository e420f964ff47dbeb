"""The dynamic visibility graph against brute force, and what it must never do: cross an obstacle, forget a way home, give up before all is tried."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ambler.core.errors import BadInputError, NoValidPathError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.kernels import level_contour, line_of_sight
from ambler.kernels import visibility as kernels
from ambler.planning.clearance_map import FORBIDDEN, FREE, UNKNOWN, ClearanceMap, UnknownPrice
from ambler.planning.graph_state import from_arrays, to_arrays, view_of
from ambler.planning.visibility_graph import DRIVEN, VisibilityGraph, VisibilityGraphConfig
from ambler.planning.visibility_planner import PlanStatus, VisibilityConfig, VisibilityPlanner
from ambler.studies.planner_worlds import inflated
from ambler.wire.graph_files import load_graph, save_graph

SPEC = GridSpec(0.05, 240, 200, -6.0, -5.0)
Rectangle = tuple[int, int, int, int]  # y0, y1, x0, x1 in cells


def blocks(seed: int, count: int = 12) -> tuple[list[Rectangle], np.ndarray]:
    """Return random blocks that overlap or lie 30 cm apart, and the cells that they make, uint8."""
    rng = np.random.default_rng(seed)
    drawn: list[Rectangle] = []
    for y, x, h, w in rng.integers([8, 8, 6, 6], [160, 200, 34, 34], (4 * count, 4)).tolist():
        new = (y, y + h, x, x + w)
        if len(drawn) < count and all(gap(new, other) < 0 or gap(new, other) >= 6 for other in drawn):
            drawn.append(new)
    cells = np.full(SPEC.shape, FREE, np.uint8)
    for y0, y1, x0, x1 in drawn:
        cells[y0:y1, x0:x1] = FORBIDDEN
    return drawn, cells


def gap(a: Rectangle, b: Rectangle) -> int:
    """Return how many cells lie between two blocks along the axis on which they are further apart; negative when they overlap."""
    return max(a[0] - b[1], b[0] - a[1], a[2] - b[3], b[2] - a[3])


def passes(a: np.ndarray, b: np.ndarray, rectangle: Rectangle) -> bool:
    """Say whether a segment of points (y, x), in cell borders, passes through the inside of a rectangle (Liang and Barsky's clipping)."""
    first, last = 0.0, 1.0
    for axis, (low, high) in enumerate((rectangle[:2], rectangle[2:])):
        d = b[axis] - a[axis]
        if abs(d) < 1e-12:
            if not low + 1e-9 < a[axis] < high - 1e-9:
                return False
            continue
        t = sorted(((low - a[axis]) / d, (high - a[axis]) / d))
        first, last = max(first, t[0]), min(last, t[1])
    return last - first > 1e-9


def shortest(rectangles: list[Rectangle], start: np.ndarray, goal: np.ndarray) -> float:
    """Return the length (cells) of the shortest way among rectangles: all their corners, all pairs, Dijkstra."""
    points = [start, goal]
    points += [np.array([y, x], float) for y0, y1, x0, x1 in rectangles for y in (y0, y1) for x in (x0, x1)]
    graph = np.zeros((len(points), len(points)))
    for i, j in itertools.combinations(range(len(points)), 2):
        if not any(passes(points[i], points[j], r) for r in rectangles):
            graph[i, j] = max(1e-9, float(np.hypot(*(points[i] - points[j]))))
    return float(dijkstra(csr_array(graph), directed=False, indices=0)[1])


def borders(x: float, y: float) -> np.ndarray:
    return np.array([(y - SPEC.origin_y) / SPEC.resolution, (x - SPEC.origin_x) / SPEC.resolution])


def free_places(cells: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    found = np.argwhere(cells != FORBIDDEN)
    return SPEC.centers_of(found[rng.integers(len(found), size=count)])


def length_of(path: np.ndarray) -> float:
    return float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())


@pytest.mark.parametrize("seed", range(10))
def test_paths_are_as_short_as_brute_force_finds(seed: int) -> None:
    """Corners are passed at 1.6 cells, of which the last 0.6 are what simplifying may take: 8 cm more at each of the few corners."""
    rectangles, cells = blocks(seed)
    graph = VisibilityGraph()
    graph.update(SPEC, cells)
    places = free_places(cells, np.random.default_rng(seed), 24)
    compared = 0
    for start, goal in zip(places[::2], places[1::2], strict=True):
        true = shortest(rectangles, borders(*start), borders(*goal)) * SPEC.resolution
        found = graph.search(tuple(start), tuple(goal))
        if not math.isfinite(true):
            assert found is None
            continue
        assert found is not None
        bends = len(found[0]) - 2
        assert length_of(found[0]) == pytest.approx(found[1])
        assert true - 0.01 <= found[1] <= true * 1.005 + 0.08 * bends
        compared += 1
    assert compared >= 8


@pytest.mark.parametrize("seed", range(6))
def test_no_edge_and_no_path_touches_what_is_forbidden_after_many_changes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    _, cells = blocks(seed)
    graph = VisibilityGraph()
    for _ in range(8):
        y, x = rng.integers(0, 180, 2)
        cells[y : y + 14, x : x + 14] = rng.choice([FREE, FORBIDDEN, UNKNOWN])
        graph.update(SPEC, cells)
        places = free_places(cells, rng, 12)
        for start, goal in zip(places[::2], places[1::2], strict=True):
            found = graph.search(tuple(start), tuple(goal))
            if found is not None:
                assert not touches(cells, found[0])
    for edge in view_of(graph, 0, "map").edges.astype(float):
        assert not touches(cells, edge[:, :2])


def touches(cells: np.ndarray, corners: np.ndarray) -> bool:
    """Say whether a polyline enters a forbidden cell, looked at every millimetre."""
    for a, b in itertools.pairwise(corners):
        n = max(2, math.ceil(float(np.hypot(*(b - a))) / 0.001))
        at = SPEC.cells_of(a + (b - a) * np.linspace(0.0, 1.0, n)[:, None])
        if (cells[at[:, 0], at[:, 1]] == FORBIDDEN).any():
            return True
    return False


def test_many_small_updates_come_to_the_same_sight_as_one_of_everything() -> None:
    rng = np.random.default_rng(3)
    _, cells = blocks(3)
    graph = VisibilityGraph()
    graph.update(SPEC, cells)
    for _ in range(12):
        y, x = rng.integers(0, 180, 2)
        kept = cells[y : y + 9, x : x + 9].copy()
        cells[y : y + 9, x : x + 9] = FORBIDDEN
        graph.update(SPEC, cells)
        cells[y : y + 9, x : x + 9] = kept
        graph.update(SPEC, cells)
    fresh = VisibilityGraph()
    fresh.update(SPEC, cells)
    np.testing.assert_array_equal(graph.floor(0).field, fresh.floor(0).field)
    places = free_places(cells, rng, 40)
    for start, goal in zip(places[::2], places[1::2], strict=True):
        a = graph.search(tuple(start), tuple(goal), needs_votes=False)
        b = fresh.search(tuple(start), tuple(goal))
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert a[1] == pytest.approx(b[1], rel=0.01, abs=0.05)


def test_corners_that_a_wall_hid_from_each_other_are_joined_when_it_goes() -> None:
    cells = np.full(SPEC.shape, FREE, np.uint8)
    cells[60:140, 60:64] = cells[60:140, 170:174] = FORBIDDEN
    walled = cells.copy()
    walled[:, 115:119] = FORBIDDEN
    graph, fresh = VisibilityGraph(), VisibilityGraph()
    graph.update(SPEC, walled)
    start, goal = SPEC.center_of(100, 50), SPEC.center_of(100, 184)
    assert graph.search(start, goal) is None
    graph.update(SPEC, cells)
    fresh.update(SPEC, cells)
    found, wanted = graph.search(start, goal), fresh.search(start, goal)
    assert found is not None
    assert wanted is not None
    assert found[1] == pytest.approx(wanted[1], rel=0.005)


def test_contours_lie_on_their_level_and_clearance_is_exact() -> None:
    _, cells = blocks(1)
    ground = ClearanceMap()
    ground.update(SPEC, cells)
    hits = np.argwhere(cells == FORBIDDEN)
    rng = np.random.default_rng(0)
    for y, x in rng.integers([0, 0], SPEC.shape, (200, 2)):
        true = np.hypot(*(hits - [y, x]).T).min()
        assert ground.field[y, x] == min(255, math.floor(16 * true)) or true > 15.0
    points, starts, closed = np.empty((20000, 2)), np.empty(500, np.int64), np.empty(500, np.bool_)
    count = level_contour.trace(ground.field, 26.0, 0, SPEC.height, 0, SPEC.width, points, starts, closed)
    assert count > 3
    for y, x in points[: starts[count]]:
        assert line_of_sight.clearance(ground.field, y, x) == pytest.approx(26.0 / 16.0, abs=1e-6)


# Votes, and several levels


def wall_scene(*, is_door_open: bool) -> np.ndarray:
    """Return cells with a wall across, and a door in it."""
    cells = np.full(LOCAL.shape, FREE, np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = (FORBIDDEN,) * 4
    cells[:, 77:83] = FORBIDDEN
    if is_door_open:
        cells[52:68, 77:83] = FREE
    return cells


LOCAL = GridSpec(0.1, 160, 120, -8.0, -6.0)


def test_votes_remove_a_door_that_closes_and_bring_it_back() -> None:
    graph = VisibilityGraph()
    for _ in range(3):
        graph.update(LOCAL, wall_scene(is_door_open=True))
    assert graph.search((-4.0, 0.0), (4.0, 0.0)) is not None
    graph.update(LOCAL, wall_scene(is_door_open=False))
    assert graph.search((-4.0, 0.0), (4.0, 0.0), needs_votes=False) is None  # at once: what is blocked is blocked
    through = [e for e in view_of(graph, 0, "map").edges if e[0, 0] * e[1, 0] < 0.0 and abs(e[:, 1]).max() < 6.0]
    assert not through
    for k in range(10):
        post = wall_scene(is_door_open=True)
        post[54 + k % 2, 70] = FORBIDDEN
        graph.update(LOCAL, post)
    assert graph.search((-4.0, 0.0), (4.0, 0.0)) is not None


def two_levels() -> tuple[np.ndarray, tuple[GridSpec, np.ndarray]]:
    """Return the costs of a level with a wall across and a door, and a wider one above it with a block in the middle."""
    lower = np.where(wall_scene(is_door_open=True) == FORBIDDEN, 254, 0).astype(np.uint8)
    wide = GridSpec(0.1, 200, 140, -10.0, -7.0)
    upper = np.zeros(wide.shape, np.uint8)
    upper[60:80, 80:120] = 254
    return lower, (wide, upper)


def test_levels_above_each_other_are_kept_apart_and_remembered() -> None:
    """Coming back to a level finds the same corners, and its ways are those of a planner that never left it."""
    lower, (wide, upper) = two_levels()
    planner, alone = VisibilityPlanner(), VisibilityPlanner()
    start, goal = SE2(-4.0, 2.0), SE2(4.0, 2.0)
    below = planner.plan(lower, LOCAL, start, goal)
    np.testing.assert_array_equal(below.path, alone.plan(lower, LOCAL, start, goal).path)
    corners = planner.view(0, "map").nodes
    planner.enter_level(1)
    above = planner.plan(upper, wide, start, goal)
    np.testing.assert_array_equal(above.path, VisibilityPlanner().plan(upper, wide, start, goal).path)
    assert abs(above.path[:, 1] - 2.0).max() < 0.3, "nothing of the door below stands in the way"
    seen = planner.view(0, "map")
    assert 4 <= len(seen.nodes) < len(corners) + 4
    assert len(seen.contours) == 1
    known = planner.graph.arrays.ident[planner.graph.arrays.is_alive].copy()
    planner.enter_level(0)
    again = planner.plan(lower, LOCAL, start, goal)
    np.testing.assert_array_equal(again.path, below.path)
    np.testing.assert_array_equal(planner.view(0, "map").nodes[: len(corners)], corners)
    assert set(known) <= set(planner.graph.arrays.ident[planner.graph.arrays.is_alive])


def test_a_level_is_as_it_was_left_however_much_happens_on_another() -> None:
    """While the robot is above, a block there is moved about: the nodes below are not asked whether they are still there, and nothing has to be found again."""
    lower, (wide, upper) = two_levels()
    planner, start, goal = VisibilityPlanner(), SE2(-4.0, 2.0), SE2(4.0, 2.0)
    planner.plan(lower, LOCAL, start, goal)
    arrays = planner.graph.arrays
    below = set(arrays.ident[arrays.is_alive].tolist())
    planner.enter_level(1)
    for step in range(6):
        planner.plan(np.roll(upper, step, axis=1), wide, start, goal)
    arrays = planner.graph.arrays
    assert below <= set(arrays.ident[arrays.is_alive].tolist())
    cells = np.where(lower >= 253, FORBIDDEN, FREE).astype(np.uint8)
    assert planner.graph.update(LOCAL, cells, 0).tested == 0


def test_a_way_that_was_driven_begins_anew_on_another_level() -> None:
    lower, (wide, upper) = two_levels()
    graph = VisibilityGraph()
    graph.update(LOCAL, np.where(lower > 0, FORBIDDEN, FREE).astype(np.uint8), 0)
    graph.update(wide, np.where(upper > 0, FORBIDDEN, FREE).astype(np.uint8), 1)
    for floor, x, y in ((0, -4.0, 0.0), (0, -2.0, 0.0), (1, -2.0, 0.0), (1, -3.0, 0.0), (0, -3.0, 0.0)):
        graph.drive(x, y, floor)
    a = graph.arrays
    for node in np.flatnonzero(a.is_alive).tolist():
        others = a.neighbor[node, : a.degree[node]]
        assert (a.nodes[others, kernels.FLOOR] == a.nodes[node, kernels.FLOOR]).all()
    driven = np.flatnonzero(a.is_alive & (a.kind == DRIVEN))
    assert {int(f) for f in a.nodes[driven, kernels.FLOOR]} == {0, 1}


def test_who_was_put_elsewhere_has_not_driven_there() -> None:
    """Between two runs with one graph a robot is carried, or driven by hand: what lies between is no way of its own, and may be a wall."""
    walls = np.full((100, 200), FREE, np.uint8)
    walls[:, 90:110] = FORBIDDEN
    graph = VisibilityGraph()
    graph.update(GridSpec(0.05, 200, 100, -5.0, -2.5), walls)
    around = [(-3.0, 0.0), (-2.0, 1.0), (-1.0, 0.0), (-1.0, -1.5)]
    for x, y in [*around, *((4.0 + x / 2.0, y) for x, y in around)]:
        graph.drive(x, y)
    a = graph.arrays
    for node in np.flatnonzero(a.is_alive).tolist():
        others = a.neighbor[node, : a.degree[node]]
        assert ((a.nodes[others, kernels.X] > 100) == (a.nodes[node, kernels.X] > 100)).all()


def test_rounds_add_no_nodes_without_end() -> None:
    """A robot drives around a wall again and again, never quite along the same line; from the second round on, hardly anything is new."""
    walls = np.full((100, 200), FREE, np.uint8)
    walls[20:80, 90:110] = FORBIDDEN
    graph = VisibilityGraph()
    graph.update(GridSpec(0.05, 200, 100, -5.0, -2.5), walls)
    rng, counts = np.random.default_rng(3), []
    for _ in range(30):
        for angle in np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False):
            x, y = np.array([2.5 * np.cos(angle), 2.0 * np.sin(angle)]) + rng.normal(0.0, 0.03, 2)
            graph.drive(float(x), float(y))
        counts.append(int((graph.arrays.is_alive & (graph.arrays.kind == DRIVEN)).sum()))
    assert counts[0] >= 2
    assert counts[-1] - counts[9] <= 2


# Unknown ground


def unknown_costs(known: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.where(known, truth, 255).astype(np.uint8)


def test_unreachable_is_never_said_while_a_frontier_is_left() -> None:
    """A goal in a closed cell of a building: the robot is sent to every piece of unknown ground before it is told that there is no way."""
    truth = np.zeros(SPEC.shape, np.uint8)
    truth[:3], truth[-3:], truth[:, :3], truth[:, -3:] = 254, 254, 254, 254
    truth[60:140, 60:64] = truth[60:140, 116:120] = truth[60:64, 60:120] = truth[136:140, 60:120] = 254
    goal = SE2(*SPEC.center_of(100, 90))
    planner = VisibilityPlanner(VisibilityConfig(is_unknown_allowed=True))
    known = np.zeros(SPEC.shape, np.bool_)
    place = SPEC.center_of(30, 30)
    for _ in range(300):
        see(known, truth, place)
        costs = inflated(unknown_costs(known, truth), inscribed=0.2)
        try:
            result = planner.plan(costs, SPEC, SE2(*place), goal)
        except NoValidPathError:
            break
        assert planner.status is not PlanStatus.UNREACHABLE
        for x, y in result.path[:12, :2].tolist():  # half a metre, but not through walls
            if truth[SPEC.cell_of(x, y)]:
                break
            place = (x, y)
    else:
        pytest.fail("it never came to an end")
    assert planner.status is PlanStatus.UNREACHABLE
    reached = np.zeros(SPEC.shape, np.uint8)
    ground = ClearanceMap()
    ground.update(SPEC, np.where(costs == 255, UNKNOWN, np.where(costs >= 253, FORBIDDEN, FREE)).astype(np.uint8))
    assert line_of_sight.flood(ground.field, ground.known, *SPEC.cell_of(*place), reached) == 0


def see(known: np.ndarray, truth: np.ndarray, place: tuple[float, float], reach: int = 70) -> None:
    """Mark what a robot sees from a place: along rays, up to the first obstacle."""
    iy, ix = SPEC.cell_of(*place)
    for angle in np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False):
        for d in range(reach):
            y, x = round(iy + d * math.sin(angle)), round(ix + d * math.cos(angle))
            if not SPEC.contains_cell(y, x):
                break
            known[y, x] = True
            if truth[y, x]:
                break


def test_a_way_that_was_begun_is_kept_while_the_other_is_hardly_better() -> None:
    truth = np.zeros(SPEC.shape, np.uint8)
    truth[60:140, 118:122] = 254
    planner = VisibilityPlanner(VisibilityConfig(is_unknown_allowed=True, turning=0.0))
    goal = SE2(*SPEC.center_of(100, 200))
    first = planner.plan(truth, SPEC, SE2(*SPEC.center_of(101, 40)), goal)
    side = np.sign(first.path[len(first.path) // 2, 1] - goal.y)
    for row in (99, 98, 100, 102, 103, 97):
        again = planner.plan(truth, SPEC, SE2(*SPEC.center_of(row, 44)), goal)
        assert np.sign(again.path[len(again.path) // 2, 1] - goal.y) == side


def test_what_hides_behind_a_cupboard_costs_more_than_open_unknown_ground() -> None:
    cells = np.full(SPEC.shape, UNKNOWN, np.uint8)
    cells[100:104, 60:120] = FORBIDDEN
    cells[112:116, 60:120] = FORBIDDEN
    ground = ClearanceMap(UnknownPrice(0.5, 3.0))
    ground.update(SPEC, cells)
    assert ground.price[108, 90] == 16 * 3.5
    assert ground.price[160, 90] == 16 * 0.5
    fresh = ClearanceMap(UnknownPrice(0.5, 3.0))
    for row in range(0, SPEC.height, 40):
        partial = np.full(SPEC.shape, UNKNOWN, np.uint8)
        partial[: row + 40] = cells[: row + 40]
        fresh.update(SPEC, partial)
    np.testing.assert_array_equal(fresh.price, ground.price)


# What is kept and shown


def test_a_graph_of_several_levels_is_saved_and_loaded_without_loss_and_goes_on_alike(tmp_path: Path) -> None:
    lower, (wide, upper) = two_levels()
    config = VisibilityConfig(is_unknown_allowed=True, margin=2.0, graph=VisibilityGraphConfig(refresh=2))
    planner, start, goal = VisibilityPlanner(config), SE2(-4.0, 2.0), SE2(4.0, 2.0)
    upper[:40] = 255
    for level, spec, costs in ((0, LOCAL, lower), (1, wide, upper), (0, LOCAL, np.where(lower > 0, 0, 254))):
        planner.enter_level(level)
        planner.plan(costs.astype(np.uint8), spec, start if level else SE2(0.0, 4.0), goal if level else SE2(0.0, 2.0))
    path = tmp_path / "site.vgraph"
    arrays = planner.to_arrays()
    assert len(arrays["waiting"]) > 0, "what is yet to be done belongs to it"
    save_graph(path, arrays)
    loaded = load_graph(path)
    assert sorted(loaded) == sorted(arrays)
    for name, array in arrays.items():
        assert loaded[name].dtype == array.dtype
        np.testing.assert_array_equal(loaded[name], array)
    other = VisibilityPlanner(config, loaded)
    planner = VisibilityPlanner(config, arrays)
    for one in (planner, other):
        for level, spec, costs in ((0, LOCAL, lower), (1, wide, upper)):
            one.enter_level(level)
            one.plan(costs, spec, start, goal)
    assert other.status is planner.status
    for name, array in planner.to_arrays().items():
        np.testing.assert_array_equal(other.to_arrays()[name], array, err_msg=name)


def test_a_graph_that_is_loaded_knows_what_the_saved_one_knew_and_need_not_find_it_again() -> None:
    lower, _ = two_levels()
    planner = VisibilityPlanner()
    planner.plan(lower, LOCAL, SE2(-4.0, 2.0), SE2(4.0, 2.0))
    other = VisibilityPlanner(saved=planner.to_arrays())
    assert other.graph.node_count == planner.graph.node_count > 0
    cells = np.where(lower >= 253, FORBIDDEN, FREE).astype(np.uint8)
    assert other.graph.update(LOCAL, cells).tested == 0, "the same cells: nothing is new"


def test_a_graph_loaded_where_unknown_ground_has_another_price_is_weighed_anew() -> None:
    costs = two_levels()[0]
    costs[:, 20:60] = np.where(costs[:, 20:60] > 0, 254, 255)
    start, goal = SE2(4.0, 2.0), SE2(-7.5, -2.0)
    dear = VisibilityPlanner(VisibilityConfig(is_unknown_allowed=True, margin=1.0))
    dear.plan(costs, LOCAL, start, goal)
    cheap = VisibilityConfig(is_unknown_allowed=True, margin=1.0, price=UnknownPrice())
    loaded = VisibilityPlanner(cheap, dear.to_arrays()).plan(costs, LOCAL, start, goal)
    assert loaded.cost == pytest.approx(VisibilityPlanner(cheap).plan(costs, LOCAL, start, goal).cost)
    shut = VisibilityPlanner(VisibilityConfig(), dear.to_arrays())
    with pytest.raises(NoValidPathError):
        shut.plan(costs, LOCAL, start, goal)


def dark_slalom() -> np.ndarray:
    """Return cells with two walls across: a short way leads through a door of each, over unknown ground between them, a long one around through two doors at the end of the walls, over known ground."""
    cells = np.full(SPEC.shape, FREE, np.uint8)
    cells[:, 88:92] = cells[:, 148:152] = FORBIDDEN
    cells[48:62, 88:92] = cells[138:152, 148:152] = cells[180:195, 88:92] = cells[180:195, 148:152] = FREE
    cells[:170, 92:148] = UNKNOWN
    return cells


def test_edges_of_a_loaded_graph_cost_what_unknown_ground_costs_now() -> None:
    """Where unknown ground has become cheap (or dear), a graph that was saved before leads the same way as one that is made now."""
    cells, start, goal = dark_slalom(), SPEC.center_of(55, 60), SPEC.center_of(145, 180)
    prices = (UnknownPrice(8.0), UnknownPrice())
    ways = []
    for price, other in (prices, prices[::-1]):
        saved, fresh = VisibilityGraph(price=price), VisibilityGraph(price=other)
        saved.update(SPEC, cells)
        fresh.update(SPEC, cells)
        loaded = from_arrays(to_arrays(saved), price=other)
        loaded.update(SPEC, cells)
        found, wanted = loaded.search(start, goal), fresh.search(start, goal)
        assert found is not None
        assert wanted is not None
        assert found[1] == pytest.approx(wanted[1])
        assert length_of(found[0]) == pytest.approx(length_of(wanted[0]))
        ways.append(length_of(wanted[0]))
    assert ways[0] < ways[1] - 1.0, "the price decides about the way"


def test_graphs_that_lack_something_are_refused() -> None:
    graph = VisibilityGraph()
    graph.update(SPEC, blocks(0)[1])
    arrays = to_arrays(graph)
    for name in ("nodes", "state", "counters", "waiting", "price"):
        with pytest.raises(BadInputError, match="visibility graph"):
            from_arrays({key: value for key, value in arrays.items() if key != name})
    with pytest.raises(BadInputError, match="visibility graph"):
        from_arrays({**arrays, "place": arrays["place"][:3]})


def test_the_same_observations_give_the_same_graph() -> None:
    def made() -> dict[str, np.ndarray]:
        graph = VisibilityGraph()
        rng = np.random.default_rng(5)
        for _ in range(6):
            cells = wall_scene(is_door_open=True)
            y, x = rng.integers(10, 100, 2)
            cells[y : y + 6, x : x + 6] = FORBIDDEN
            graph.update(LOCAL, cells)
        return to_arrays(graph)

    one, two = made(), made()
    for name, array in one.items():
        np.testing.assert_array_equal(array, two[name], err_msg=name)
