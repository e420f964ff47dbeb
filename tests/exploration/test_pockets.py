"""Small patches of unknown."""

import numpy as np

from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid
from ambler.exploration.frontier_map import FrontierMap
from ambler.exploration.pockets import are_in_pockets

SPEC = GridSpec(0.1, 100, 80, -2.0, 1.0)


def answers(data: np.ndarray, most: float) -> dict[float, bool]:
    """Where along x the frontiers of a map lie, and whether each borders on small patches only."""
    groups = FrontierMap(50).update(SPEC, data)
    small = are_in_pockets(groups, OccupancyGrid(0, "map", SPEC, data), most)
    return {round(centroid[0], 1): bool(k) for (_, centroid), k in zip(groups.parts, small, strict=True)}


def walled() -> np.ndarray:
    """A hall of which all is known."""
    data = np.full((80, 100), 100, np.int8)
    data[1:-1, 1:-1] = 0
    return data


def hall() -> np.ndarray:
    """A walled hall with unknown patches of 1 and 4 m², apart by more than a metre, and unknown at the map's right edge."""
    data = walled()
    data[20:30, 10:20] = -1
    data[20:40, 40:60] = -1
    data[1:-1, 95:] = -1
    return data


def test_patches_are_told_apart_by_their_area() -> None:
    for most, small in ((0.9, []), (1.1, [-0.5]), (4.1, [-0.5, 3.0])):
        found = answers(hall(), most)
        assert len(found) == 3
        assert [x for x in sorted(found) if found[x]] == small


def test_what_reaches_the_edge_of_the_map_goes_on_beyond_it() -> None:
    assert answers(hall(), 1000.0) == {-0.5: True, 3.0: True, 7.5: False}


def test_a_patch_that_hangs_together_with_a_large_one_is_large() -> None:
    data = hall()
    data[25, 20:40] = -1
    assert not any(answers(data, 4.1).values())


def test_a_map_without_frontiers_has_none_in_pockets() -> None:
    data = walled()
    groups = FrontierMap(50).update(SPEC, data)
    assert are_in_pockets(groups, OccupancyGrid(0, "map", SPEC, data), 1.0).shape == (0,)


def test_floor_at_the_edge_of_the_map_borders_on_what_is_outside() -> None:
    data = walled()
    data[20:40, 99] = 0
    assert answers(data, 1000.0) == {7.9: False}
