"""Whether a mapping robot believes its map: few returns, a pose that is wrong, people, and the time it takes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.localization.map_trust import KnownFloor, MapTrust, MapTrustConfig, MapTrustJudge
from tests.registration.room import ranges_at

SPEC = GridSpec(0.05, 300, 300, -7.5, -7.5)
S = 1_000_000_000
USUAL, BAD = 0.75, 0.4  # scores of matches
ANGLES = np.linspace(-np.pi, np.pi, 360, endpoint=False)


def room_map() -> NDArray[np.int8]:
    """Draw what a scanner in the middle of the room sees: floor up to the walls, unknown beyond."""
    cells = np.full(SPEC.shape, -1, np.int8)
    ends = view(SE2())
    for share in np.linspace(0.0, 1.0, 300):
        iy, ix = SPEC.cells_of(share * ends).T
        cells[iy, ix] = 0
    iy, ix = SPEC.cells_of(ends).T
    cells[iy, ix] = 100
    return cells


def view(map_from_base: SE2) -> NDArray[np.float64]:
    """Returns in the base frame."""
    ranges = ranges_at(map_from_base, ANGLES)
    return np.stack((ranges * np.cos(ANGLES), ranges * np.sin(ANGLES)), axis=1)


@pytest.fixture
def judge() -> MapTrustJudge:
    judge = MapTrustJudge()
    judge.set_map(SPEC, room_map())
    judge.update(-S, SE2(), view(SE2()), USUAL)
    return judge


def hold(
    judge: MapTrustJudge, seconds: float, true: SE2, believed: SE2, begin: float = 0.0, speed: float = 0.0
) -> MapTrust:
    """Feed scans at 10 Hz from a true place, put where the robot believes to be; they match badly where that is wrong."""
    points, score = believed.transform(view(true)), USUAL if true.distance_to(believed) < 0.2 else BAD
    for k in range(round(seconds * 10)):
        t = begin + 0.1 * k
        judge.update(round(t * S), SE2(speed * 0.1 * k, 0.0), points, score)
    return judge.state


def test_a_robot_that_is_right_is_believed_wherever_it_stands(judge: MapTrustJudge) -> None:
    for place in (SE2(), SE2(0.8, -0.5, 1.0), SE2(-0.7, 0.6, -2.0)):
        assert hold(judge, 5.0, place, place) is MapTrust.GOOD
        assert judge.may_map


def test_a_pose_that_is_wrong_is_noticed_and_walls_are_kept_from_the_first_scan_on(judge: MapTrustJudge) -> None:
    wrong = SE2(0.9, 0.7, 0.6)
    judge.update(0, SE2(), wrong.transform(view(SE2())), BAD)
    assert not judge.may_map
    assert judge.state is MapTrust.GOOD, "one scan is no reason to turn back"
    assert hold(judge, 3.0, SE2(), wrong, 0.1) is MapTrust.DEGRADED
    assert "lie where the map is free" in judge.text
    assert hold(judge, 31.0, SE2(), wrong, 3.1) is MapTrust.LOST
    assert hold(judge, 0.9, SE2(), SE2(), 40.0) is MapTrust.LOST, "it must agree for a while"
    assert hold(judge, 0.5, SE2(), SE2(), 40.9) is MapTrust.GOOD
    assert judge.may_map


def test_a_plain_without_returns_is_lost_after_some_metres(judge: MapTrustJudge) -> None:
    nothing = np.zeros((0, 2))
    assert not judge.may_match(nothing)
    states = [judge.update(k * S // 10, SE2(0.08 * k, 0.0), nothing, 0.0) for k in range(130)]
    assert states[15] is MapTrust.GOOD
    assert states[25] is MapTrust.DEGRADED
    way = 0.08 * states.index(MapTrust.LOST)
    assert way == pytest.approx(8.0, abs=0.2)


def test_a_crowd_close_by_is_no_contradiction(judge: MapTrustJudge) -> None:
    points = view(SE2())
    points[:150] *= 1.0 / np.hypot(*points[:150].T)[:, None]  # people one metre away on 150 of 360 degrees
    for k in range(100):
        assert judge.update(k * S // 10, SE2(), points, BAD) is MapTrust.GOOD


def test_a_wall_that_submaps_place_a_little_apart_is_no_contradiction(judge: MapTrustJudge) -> None:
    assert hold(judge, 5.0, SE2(), SE2(0.1, -0.08, 0.02)) is MapTrust.GOOD


def test_what_fits_as_well_as_usual_is_right_however_it_contradicts_older_parts(judge: MapTrustJudge) -> None:
    """A loop that is not closed yet: the newest submap and the scan agree, and both lie beside what was mapped long ago."""
    points = SE2(0.9, 0.7, 0.6).transform(view(SE2()))
    for k in range(100):
        assert judge.update(k * S // 10, SE2(), points, USUAL - 0.1) is MapTrust.GOOD
        assert judge.may_map


def test_nonsense_is_refused() -> None:
    with pytest.raises(BadInputError):
        MapTrustConfig(most_contradicting=0.0)


def test_returns_are_judged_as_on_the_whole_map() -> None:
    """Only what lies around returns is looked at; a slow twin looks at all cells."""
    rng, slack = np.random.default_rng(2), 0.2
    occupancy = rng.choice(np.array([-1, 0, 0, 0, 0, 0, 100], np.int8), (60, 80), p=[0.3, *[0.138] * 5, 0.01])
    spec = GridSpec(0.05, 80, 60, -1.0, 2.0)
    iy, ix = np.nonzero(occupancy >= 100)
    for size in (0.2, 1.0, 5.0):
        points = np.array([1.0, 3.5]) + rng.uniform(-size, size, (200, 2))
        known = floor = 0
        for y, x in spec.cells_of(points):
            if 0 <= y < 60 and 0 <= x < 80 and occupancy[y, x] >= 0:
                known += 1
                away = np.maximum(np.abs(iy - y), np.abs(ix - x)).min()
                floor += occupancy[y, x] == 0 and away > round(slack / 0.05)
        share, count = KnownFloor(spec, occupancy, slack).contradiction(points)
        assert count == known > 0
        assert share == pytest.approx(floor / known)
        assert 0.05 < share < 0.95
    assert KnownFloor(spec, occupancy, slack).contradiction(np.full((3, 2), 99.0)) == (0.0, 0)
