"""The code that stands for no return is found at the top of all readings; walls there are left alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.recordings import no_return
from ambler.recordings.no_return import beam_numbers
from ambler.wire.carmen import load_carmen
from tests.public_data import public
from tests.registration.room import loop_of, ranges_at
from tests.slam2d.drives import RING, around_the_ring, oval

ANGLES = np.radians(np.arange(-90, 91))
ROTUNDA = np.array(
    loop_of(*((12.0 * math.cos(a), 12.0 * math.sin(a)) for a in np.linspace(0.0, 2.0 * math.pi, 200)[:-1]))
)
CORRIDOR = np.array(loop_of((-1.0, -1.0), (21.0, -1.0), (21.0, 1.0), (-1.0, 1.0)))


def find_no_return(ranges: NDArray[np.float32], beams: int = len(ANGLES)) -> float | None:
    """Return what is found in readings of whole scans behind each other."""
    return no_return.find_no_return(ranges, np.arange(len(ranges)) % beams)


def readings(poses: list[SE2], walls: NDArray[np.float64], noise: float = 0.01) -> NDArray[np.float32]:
    """Return all readings of a drive in steps of a centimetre, as a SICK gives them."""
    rng = np.random.default_rng(3)
    ranges = np.concatenate([ranges_at(pose, ANGLES, walls) for pose in poses])
    return np.round(ranges + rng.normal(0.0, noise, len(ranges)), 2).astype(np.float32)


@pytest.mark.parametrize(
    ("reach", "codes"), [(8.0, (8.19,)), (8.0, (8.191, 8.187, 8.183)), (4.0, (4.095,)), (5.6, (5.6,))]
)
def test_codes_at_the_end_of_the_range_are_found(reach: float, codes: tuple[float, ...]) -> None:
    ranges = readings(around_the_ring(1.0), RING)
    is_far = ranges >= reach
    assert is_far.any()
    ranges[is_far] = np.random.default_rng(1).choice(codes, is_far.sum(), p=[0.8, 0.1, 0.1] if len(codes) > 1 else None)
    found = find_no_return(ranges)
    assert found is not None
    assert max(ranges[~is_far].max() - 0.05, 0.99 * reach) < found < min(codes)


def test_a_glitch_above_the_code_does_not_hide_it() -> None:
    ranges = readings(around_the_ring(1.0), RING)
    ranges[ranges >= 8.0] = 8.19
    ranges[100] = 655.35
    found = find_no_return(ranges)
    assert found is not None
    assert 8.1 < found < 8.19


@pytest.mark.parametrize(
    ("poses", "walls"),
    [
        (oval(1.0), RING),
        (around_the_ring(1.0), RING),
        ([SE2(0.2, 0.1, 0.02)] * 200, CORRIDOR),
        ([SE2(0.05 * k, 0.1, 0.02) for k in range(200)], CORRIDOR),
        ([SE2(0.0, 0.0, 0.0)] * 100 + [SE2(0.1 * k, 0.0, 0.0) for k in range(100)], CORRIDOR),
        ([SE2(0.01, 0.0, 0.05 * k) for k in range(100)], ROTUNDA),
    ],
    ids=["room", "ring", "parked in a corridor", "along a corridor", "parked, then along", "turning in a rotunda"],
)
def test_walls_are_no_code(poses: list[SE2], walls: NDArray[np.float64]) -> None:
    assert find_no_return(readings(poses, walls)) is None


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_what_a_parked_scanner_sees_farthest_away_is_no_code(noise: float) -> None:
    """A door at the end of a corridor, in three beams of 181, again and again the same."""
    walls = np.array([*loop_of((-1.0, -1.0), (8.0, -1.0), (8.0, 1.0), (-1.0, 1.0))])
    ranges = readings([SE2(0.2, 0.1, 0.0)] * 300, walls, noise).reshape(300, -1)
    ranges[:, 89:92] = np.round(20.0 + np.random.default_rng(2).normal(0.0, noise, (300, 3)), 2)
    assert find_no_return(ranges.ravel()) is None


def test_nothing_is_no_code() -> None:
    assert find_no_return(np.zeros(0, np.float32)) is None
    assert find_no_return(np.zeros(100, np.float32)) is None
    assert find_no_return(np.full(100, np.inf, np.float32)) is None


@pytest.mark.parametrize(
    "log", ["radish/fr079.clf.bz2", "carmen_keyframes/fhw.clf.gz", "carmen_keyframes/edmonton.clf.gz"]
)
def test_public_logs_have_their_code_and_no_other(log: str) -> None:
    scans = [line.ranges for line in load_carmen(public(log)).lasers]
    ranges, beams = np.concatenate(scans), beam_numbers(scans)
    code = no_return.find_no_return(ranges, beams)
    assert code is not None
    assert code > 50.0
    for limit in (29.0, 15.0, 10.0, 8.0, 6.0, 4.0):
        is_near = ranges < limit
        assert no_return.find_no_return(ranges[is_near], beams[is_near]) is None, "real walls"
        clipped = np.where(is_near, ranges, np.float32(limit + 0.01))
        found = no_return.find_no_return(clipped, beams)
        assert found == pytest.approx(limit, rel=0.01)
        assert not math.isclose(found or 0.0, code)
