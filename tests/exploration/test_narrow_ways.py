"""What is told of frontiers to which no way leads: the width of the widest one, measured at a gap of known size and place."""

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid
from ambler.exploration.narrow_ways import narrowest_places

R = 0.05


def two_rooms(*gaps: tuple[int, int]) -> OccupancyGrid:
    """Two free rooms of 40 x 40 cells beside each other; gaps (first cell, cells) in the wall of two cells between them; the second one's end is unknown."""
    data = np.full((42, 84), 100, np.int8)
    data[1:41, 1:41] = data[1:41, 43:78] = 0
    data[1:41, 78:] = -1
    for first, count in gaps:
        data[first : first + count, 41:43] = 0
    return OccupancyGrid(0, "map", GridSpec(R, 84, 42, 1.0, 2.0), data)


@pytest.mark.parametrize("count", [3, 6, 9, 13])
def test_a_gap_is_found_and_measured(count: int) -> None:
    place = narrowest_places(two_rooms((20, count)), 50, *_asked())[7]
    assert place.width == pytest.approx(count * R, abs=R + 1e-6)
    assert place.x == pytest.approx(1.0 + 42 * R, abs=R)
    assert place.y == pytest.approx(2.0 + (20 + count / 2) * R, abs=2 * R)
    assert f"{place.width:.2f} m wide" in str(place)


def test_of_two_gaps_the_wider_one_counts() -> None:
    place = narrowest_places(two_rooms((5, 3), (30, 7)), 50, *_asked())[7]
    assert place.width == pytest.approx(7 * R, abs=R + 1e-6)
    assert place.y > 2.0 + 25 * R


def test_what_no_free_ground_joins_has_no_narrowest_place() -> None:
    assert narrowest_places(two_rooms(), 50, *_asked()) == {}


def _asked() -> tuple[np.ndarray, np.ndarray]:
    """What is reached: the first room but for the strip along the wall; and what is wanted: the edge of the unknown."""
    reached, wanted = np.zeros((42, 84), np.bool_), np.zeros((42, 84), np.int64)
    reached[1:41, 1:37] = True
    wanted[1:41, 77] = 7
    return reached, wanted


def test_what_lies_far_behind_is_not_searched_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second room has 1400 cells before its edge: with 100 of them it is not come to, with all of them it is."""
    occupancy = two_rooms((20, 6))
    monkeypatch.setattr("ambler.exploration.narrow_ways.CELLS_MOST", 100)
    assert narrowest_places(occupancy, 50, *_asked()) == {}
    monkeypatch.setattr("ambler.exploration.narrow_ways.CELLS_MOST", 2000)
    assert list(narrowest_places(occupancy, 50, *_asked())) == [7]
