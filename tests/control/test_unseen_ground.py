"""Ground that is only assumed is driven onto slowly; ground that was seen is not."""

import math

import numpy as np
import pytest

from ambler.control.unseen_ground import UnseenGround, UnseenGroundConfig
from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_ASSUMED, GridSpec
from ambler.core.messages import OccupancyGrid


def eastward(length: float = 6.0) -> np.ndarray:
    """A path along y = 1 from x = 1 on."""
    x = np.arange(1.0, 1.0 + length + 1e-6, 0.1)
    return np.column_stack((x, np.ones_like(x), np.zeros_like(x)))


def asks(assumed_from: float, assumed_to: float) -> UnseenGround:
    data = np.zeros((20, 100), np.int8)
    data[:, round(assumed_from * 10) : round(assumed_to * 10)] = OCC_ASSUMED
    ground = UnseenGround(UnseenGroundConfig(speed=0.3, ahead=1.2))
    ground.set_map(OccupancyGrid(0, "map", GridSpec(0.1, 100, 20, 0.0, 0.0), data))
    return ground


@pytest.mark.parametrize(
    ("at", "is_slow"), [(1.0, False), (2.5, False), (2.9, True), (3.5, True), (4.9, True), (5.2, False)]
)
def test_the_next_metres_decide(at: float, is_slow: bool) -> None:
    most = asks(4.0, 5.0).speed_most(eastward(), 7.0 - at)
    assert most == (0.3 if is_slow else math.inf)


def test_what_lies_beside_the_path_or_off_the_map_does_not_matter() -> None:
    ground = asks(4.0, 5.0)
    beside = eastward()
    beside[:, 1] += 3.0  # beyond the map
    assert ground.speed_most(beside, 3.5) == math.inf
    assert ground.speed_most(np.zeros((0, 3)), 0.0) == math.inf


def test_before_a_map_nothing_is_assumed() -> None:
    assert UnseenGround(UnseenGroundConfig()).speed_most(eastward(), 6.0) == math.inf


def test_grey_cells_of_other_maps_are_seen() -> None:
    ground = asks(4.0, 5.0)
    data = np.full((20, 100), OCC_ASSUMED + 1, np.int8)
    ground.set_map(OccupancyGrid(0, "map", GridSpec(0.1, 100, 20, 0.0, 0.0), data))
    assert ground.speed_most(eastward(), 3.5) == math.inf


@pytest.mark.parametrize("wrong", [{"speed": 0.0}, {"ahead": -1.0}])
def test_bad_input_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(BadInputError):
        UnseenGroundConfig(**wrong)
