"""The tour with full knowledge: it sees what it claims, visits what only a visit shows, and is as short as small rounds can be."""

from itertools import permutations

import numpy as np

from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, GridSpec
from ambler.core.se2 import SE2
from ambler.exploration.grid_world import GridWorld
from ambler.exploration.known_tour import known_tour, shorten
from ambler.planning.distance import distance_field


def world(rows: list[str], reach: float = 20.0) -> GridWorld:
    """Return a world of cells of 0.5 m from a picture: # occupied, S the start, row 0 on top; each sign is 4 x 4 cells of 0.25 m."""
    signs = np.array([list(row) for row in rows])[::-1]
    cells = np.kron(signs == "#", np.ones((4, 4), bool))
    iy, ix = np.argwhere(signs == "S")[0]
    spec = GridSpec(0.25, cells.shape[1], cells.shape[0], 0.0, 0.0)
    truth = np.where(cells, OCC_OCCUPIED, OCC_FREE).astype(np.int8)
    return GridWorld(spec, truth, SE2(ix + 0.6, iy + 0.6), distance_field, sensor_range=reach)


def test_a_room_that_is_seen_from_the_start_needs_no_way() -> None:
    tour = known_tour(world(["######", "#    #", "# S  #", "######"]))
    assert tour.length == 0.0
    assert tour.coverage == 1.0


def test_a_corridor_as_far_as_the_scanner_sees_needs_less_way_than_one_beyond_it() -> None:
    rows = ["#" * 32, "#S" + " " * 29 + "#", "#" * 32]
    near, far = known_tour(world(rows, reach=25.0)), known_tour(world(rows, reach=5.0))
    assert 0.0 < near.length < 15.0
    assert 2 * (30.0 - 5.0 - 2.0) < far.length <= 2 * 30.0  # there, up to the range, and back
    assert min(near.coverage, far.coverage) >= 0.99


def test_every_side_room_is_visited_or_looked_into_and_the_world_stays_as_it_was() -> None:
    rows = [
        "###################",
        "#   #   #   #     #",
        "#   #   #   #     #",
        "# ### ### ###  ####",
        "#                 #",
        "#S                #",
        "###################",
    ]
    place = world(rows)
    before = place.built.copy()
    tour = known_tour(place)
    np.testing.assert_array_equal(place.built, before)
    assert place.driven == 0.0
    assert tour.coverage >= 0.99
    assert tour.viewpoints >= 2
    assert 20.0 < tour.length < 60.0
    for cell in tour.cells:  # driven as planned, the scanner of the world sees as much
        to_stop, here = (
            place.distances_from(SE2(*place.spec.center_of(*cell))),
            place.spec.cell_of(place.pose.x, place.pose.y),
        )
        while (below := place.downhill(to_stop, here)) is not None:
            here = below
            place.pose = SE2(*place.spec.center_of(*here))
            place.sense()
        assert here == cell
    assert place.coverage() >= 0.97


def test_rounds_of_six_stops_are_nearly_as_short_as_the_best_of_all_orders() -> None:
    ratios = []
    for seed in range(20):
        points = np.random.default_rng(seed).uniform(0.0, 10.0, (6, 2))
        lengths = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))

        def around(order: tuple[int, ...], lengths: np.ndarray = lengths) -> float:
            return float(sum(lengths[a, b] for a, b in zip(order, (*order[1:], order[0]), strict=True)))

        best = min(around((0, *rest)) for rest in permutations(range(1, 6)))
        found = shorten(list(range(6)), lengths)
        assert found[0] == 0
        assert sorted(found) == list(range(6))
        ratios.append(around(tuple(found)) / best)
    assert max(ratios) < 1.05
    assert np.mean(ratios) < 1.005
