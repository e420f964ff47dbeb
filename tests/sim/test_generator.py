"""Drawn places: a robot gets everywhere, doors lead somewhere, nothing low hides from planar scanners, and a seed is a place."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.sim.generator import floor as floors
from ambler.sim.generator.draw import KINDS, DrawnPlace, draw_place, parse_name
from ambler.sim.generator.furnish import against_wall
from ambler.sim.generator.picture import GLASS, REACHED, WALL, picture_of, save_picture
from ambler.sim.generator.plan import Plan
from ambler.sim.generator.rect import Rect, around, drawn_widths
from ambler.sim.generator.things import solid
from ambler.sim.generator.write import write_place
from ambler.sim.generator.zones import Zone, inner_edges, outer_edges
from ambler.sim.solids import Shape, Solid
from ambler.sim.truth import reachable_cells, truth_grid
from ambler.sim.world_file import load_world

SMALL = ("office", "flat", "ward", "warehouse", "corridor", "yard")
CLOSED = ("office", "flat", "ward", "warehouse", "corridor")
SEEDS = range(5)
LARGE = (("hall", 0), ("campus", 0))
PLACES = [(kind, seed) for kind in SMALL for seed in SEEDS] + list(LARGE)
SCAN_PLANES = (0.18, 0.28)  # of amr_omni and diff


class _Drawn(dict[tuple[str, int], DrawnPlace]):
    """Draws a place when it is asked for."""

    def __missing__(self, key: tuple[str, int]) -> DrawnPlace:
        self[key] = draw_place(*key)
        return self[key]


@pytest.fixture(scope="module")
def drawn() -> dict[tuple[str, int], DrawnPlace]:
    return _Drawn()


@pytest.mark.parametrize("key", PLACES, ids=str)
def test_both_sides_of_every_door_are_reached(key: tuple[str, int], drawn: dict[tuple[str, int], DrawnPlace]) -> None:
    place = drawn[key]
    for door in place.world.doors:
        leaf = door.leaf.world_from_solid
        sides = leaf.transform(np.array([[0.0, 0.75], [0.0, -0.75]]))
        near = 0.35  # furniture keeps off a door, and other walls may stand aslant of it
        for x, y in sides:
            assert _any_reached(place, x, y, near), f"{door.name} at {x:.2f}, {y:.2f}"


def _any_reached(place: DrawnPlace, x: float, y: float, near: float) -> bool:
    spec, reached = place.floor.spec, place.floor.reached
    (low_y, low_x), (high_y, high_x) = spec.cell_of(x - near, y - near), spec.cell_of(x + near, y + near)
    return bool(reached[low_y : high_y + 1, low_x : high_x + 1].any())


@pytest.mark.parametrize("key", PLACES, ids=str)
def test_the_start_is_free_for_the_largest_robot(
    key: tuple[str, int], drawn: dict[tuple[str, int], DrawnPlace]
) -> None:
    world = drawn[key].world
    here = np.array([[world.start.x, world.start.y]])
    gaps = [_distance(s, here)[0] for s in world.solids if s.z_min < 0.85]
    assert min(gaps) > 0.72


def _distance(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Return the distances of points (N, 2) from an upright solid, 0 inside."""
    local = solid.world_from_solid.inverse().transform(points)
    if solid.shape is Shape.CYLINDER:
        return np.asarray(np.maximum(np.hypot(*local.T) - 0.5 * solid.size_x, 0.0))
    off = np.maximum(np.abs(local) - [0.5 * solid.size_x, 0.5 * solid.size_y], 0.0)
    return np.asarray(np.hypot(*off.T))


@pytest.mark.parametrize("key", PLACES, ids=str)
def test_what_a_low_robot_could_run_into_crosses_the_planes_of_its_scanners(
    key: tuple[str, int], drawn: dict[tuple[str, int], DrawnPlace]
) -> None:
    low = [s for s in drawn[key].world.solids if s.z_min < 0.35 and s.z_max > 0.05]
    seen = [s for s in low if all(s.z_min < z < s.z_max for z in SCAN_PLANES)]
    hidden = [s for s in low if s not in seen and not _is_within_another(s, seen)]
    assert [s.name for s in hidden] == []


def _is_within_another(solid: Solid, others: list[Solid]) -> bool:
    """Tell whether another one lies over or around a solid's middle, as the box of a trolley over its wheels."""
    middle = np.array([[solid.world_from_solid.x, solid.world_from_solid.y]])
    return any(_distance(o, middle)[0] == 0.0 for o in others)


@pytest.mark.parametrize("kind", SMALL)
def test_the_floor_is_that_of_a_flood_fill_by_exact_distances(
    kind: str, drawn: dict[tuple[str, int], DrawnPlace]
) -> None:
    """A slow twin: the exact distance of every cell from every solid of the band, SciPy's labels; cells are 5 cm."""
    place = drawn[kind, 1]
    spec, reached = place.floor.spec, place.floor.reached
    centers = _centers(spec)
    distance = np.full(len(centers), np.inf)
    for s in place.world.solids:
        if s.z_min < floors.HEIGHTS[1] and s.z_max > floors.HEIGHTS[0]:
            distance = np.minimum(distance, _distance(s, centers))
    distance = distance.reshape(spec.shape)
    assert distance[reached].min() > floors.RADIUS - 0.05
    labels, _ = ndimage.label(distance > floors.RADIUS + 0.08)
    twin = labels == labels[spec.cell_of(place.world.start.x, place.world.start.y)]
    assert (twin & ~reached).sum() == 0


def _centers(spec: GridSpec) -> np.ndarray:
    return spec.centers_of(np.argwhere(np.ones(spec.shape, bool)))


@pytest.mark.parametrize("key", PLACES, ids=str)
def test_people_walk_where_nothing_stands(key: tuple[str, int], drawn: dict[tuple[str, int], DrawnPlace]) -> None:
    world = drawn[key].world
    for person in world.people:
        corners = np.array([*person.way, person.way[0]])
        steps = np.linspace(0.0, 1.0, 60)[:, None]
        way = np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(corners)])
        near = [s for s in world.solids if s.z_min < person.height and _distance(s, way).min() < 0.2]
        assert near == [], person.name


@pytest.mark.parametrize("kind", ["office", "ward", "warehouse"])
def test_people_do_not_meet(kind: str) -> None:
    """Each has a lane of his own: two who walk through each other are no sight that a scanner ever has."""
    together = 0
    for seed in range(12):
        ways = [np.array([*person.way, person.way[0]]) for person in draw_place(kind, seed).world.people]
        steps = np.linspace(0.0, 1.0, 100)[:, None]
        walked = [np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(way)]) for way in ways]
        for one, other in itertools.combinations(walked, 2):
            together += 1
            assert np.hypot(*(one[:, None] - other[None]).T).min() > 0.6
    assert together > 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_is_a_place_and_another_seed_another_one(kind: str) -> None:
    first = draw_place(kind, 3)
    assert first.content == draw_place(kind, 3).content
    assert first.content != draw_place(kind, 4).content


@pytest.mark.parametrize("kind", SMALL)
def test_places_of_a_kind_are_various(kind: str, drawn: dict[tuple[str, int], DrawnPlace]) -> None:
    worlds = [drawn[kind, seed].world for seed in SEEDS]
    sizes = {(round(b[2] - b[0]), round(b[3] - b[1])) for b in (w.bounds() for w in worlds)}
    assert len(sizes) >= len(SEEDS) - 1
    assert len({round(w.start.yaw, 1) for w in worlds}) >= len(SEEDS) - 1, "robots look anywhere"
    areas = [drawn[kind, seed].floor.area for seed in SEEDS]
    assert max(areas) > 1.2 * min(areas)
    assert len({len(w.solids) for w in worlds}) >= len(SEEDS) - 1


@pytest.mark.parametrize("key", [key for key in PLACES if key[0] in CLOSED], ids=str)
def test_closed_places_are_closed_and_small(key: tuple[str, int], drawn: dict[tuple[str, int], DrawnPlace]) -> None:
    """A robot in the doorway of nothing: no free cell of the true map touches its border."""
    place = drawn[key]
    _, free = reachable_cells(place.world, 0.1, 0.05, 0.28)
    assert not (free[0].any())
    assert not (free[-1].any())
    assert not (free[:, 0].any())
    assert not (free[:, -1].any())
    assert 20.0 < place.floor.area < 1500.0


@pytest.mark.parametrize("seed", SEEDS)
def test_yards_are_open(seed: int, drawn: dict[tuple[str, int], DrawnPlace]) -> None:
    _, grid = truth_grid(drawn["yard", seed].world, 0.28, 0.1)
    free = grid == 0
    assert free[0].any() or free[:, 0].any() or free[:, -1].any()


def test_halls_measure_ten_thousand_square_metres(drawn: dict[tuple[str, int], DrawnPlace]) -> None:
    x0, y0, x1, y1 = drawn["hall", 0].world.bounds()
    assert 9300.0 < (x1 - x0) * (y1 - y0) < 11000.0
    assert drawn["hall", 0].floor.area > 6500.0


def test_drawn_places_have_glass_clutter_of_all_heights_and_people() -> None:
    worlds = [draw_place(kind, seed).world for kind in CLOSED for seed in range(3)]
    solids = [s for w in worlds for s in w.solids]
    assert any(s.is_glass for s in solids)
    assert any(w.people for w in worlds)
    tops = np.array([s.z_max for s in solids if s.z_min == 0.0])
    for low, high in ((0.3, 0.6), (0.6, 0.9), (0.9, 1.3), (1.3, 2.2)):
        assert ((tops > low) & (tops <= high)).sum() > 5, (low, high)
    assert any(0.35 < s.z_min < 1.6 and not s.is_glass for s in solids), "table tops and wall cabinets"


def test_a_drawn_place_is_a_world_by_its_name_and_as_a_file(tmp_path: Path) -> None:
    place = draw_place("flat", 7)
    write_place(tmp_path / "flat.yaml", place)
    filed, named = load_world(tmp_path / "flat.yaml"), load_world("flat-7")
    assert named.name == "flat-7"
    assert filed.solids == named.solids == place.world.solids
    assert (filed.start, filed.people, filed.doors) == (named.start, named.people, named.doors)
    assert parse_name("flat-7") == ("flat", 7, 0)
    assert parse_name("flat-x") is parse_name("castle-7") is parse_name("office") is None


def test_what_is_no_kind_or_no_seed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="no kind of place 'castle'; there are office"):
        draw_place("castle", 1)
    with pytest.raises(BadInputError, match="seed -1"):
        draw_place("office", -1)
    with pytest.raises(BadInputError, match="no world 'castle-1'"):
        load_world("castle-1")
    with pytest.raises(BadInputError, match="cannot be written"):
        write_place(Path("/proc/nothing/x.yaml"), draw_place("flat", 7))
    with pytest.raises(BadInputError, match="picture"):
        save_picture(tmp_path / "flat.text", draw_place("flat", 7))


def test_a_picture_shows_walls_glass_and_the_floor_that_is_reached() -> None:
    place = next(p for p in (draw_place("flat", seed) for seed in range(9)) if any(s.is_glass for s in p.world.solids))
    image = picture_of(place, 40.0)
    for color in (WALL, GLASS, REACHED):
        assert (image == color).all(axis=2).sum() > 50
    x0, y0, *_ = place.world.bounds()
    start = place.world.start
    column, row = int((start.x - 0.6 - x0 + 0.5) * 40.0), image.shape[0] - int((start.y - 0.6 - y0 + 0.5) * 40.0)
    assert tuple(image[row, column]) == REACHED


def test_zones_share_edges_and_the_rest_is_outside() -> None:
    zones = [Zone(Rect(0, 0, 4, 3)), Zone(Rect(4, 1, 6, 5)), Zone(Rect(0, 3, 4, 5))]
    inner = {(e.first, e.second): e for e in inner_edges(zones)}
    assert inner[0, 1].length == 2.0
    assert inner[1, 2].length == 2.0
    assert inner[0, 2].length == 4.0
    outside = sum(e.length for e in outer_edges(zones))
    perimeter = sum(2 * (z.rect.width + z.rect.depth) for z in zones)
    assert outside == pytest.approx(perimeter - 2 * sum(e.length for e in inner.values()))


def test_rows_are_filled_and_things_stand_at_their_wall() -> None:
    rng = np.random.default_rng(5)
    widths = drawn_widths(rng, 20.0, 3.0, 5.0)
    parts = Rect(1, 0, 21, 4).cut_x(widths)
    assert parts[0].x0 == 1.0
    assert parts[-1].x1 == pytest.approx(21.0)
    assert all(a.x1 == b.x0 for a, b in itertools.pairwise(parts))
    plan = Plan(rng)
    room = around((0.0, 0.0), 6.0, 4.0)
    assert against_wall(plan, room, solid("chest", 1.5, 0.5, 1.0), sides=[1])
    (piece,) = plan.pieces
    assert room.x1 - piece.place.x1 < 0.06
    assert piece.place.width == pytest.approx(0.5)
    assert math.isclose(piece.place.depth, 1.5)
    assert not plan.put(solid("other", 0.5, 0.5, 1.0).placed(piece.place.center, 0))
