"""When a pose is believed, doubted and given up: scripted scans of which a stated share fits the map, runs through its walls, or is hidden."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.localization.localizer import INITIAL_COVARIANCE, Estimate, Mode, Observation
from ambler.localization.relocalizer import Hypothesis, Relocalizer, RelocalizerConfig
from ambler.localization.supervisor import (
    LocalizationState,
    SearchResult,
    Supervision,
    Supervisor,
    SupervisorConfig,
)
from ambler.localization.surface_map import SurfaceMap
from tests.localization import rooms

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
PERIOD_NS = 100_000_000
HERE = SE2(7.0, 4.0, 0.3)
STANDING = SE2()
GIVEN_UP = (LocalizationState.LOST, LocalizationState.RELOCALIZING)


class Believer:
    """A localizer that never changes its mind: what is judged is the supervisor alone."""

    def __init__(self) -> None:
        self._estimate: Estimate | None = None

    @property
    def estimate(self) -> Estimate | None:
        return self._estimate

    def set_pose(
        self, stamp_ns: int, odom_from_base: SE2, map_from_base: SE2, covariance: F64 = INITIAL_COVARIANCE
    ) -> None:
        self._estimate = Estimate(stamp_ns, map_from_base, covariance, 1.0, Mode.FULL, 1.0, True)

    def request_update(self) -> None:
        pass

    def update(self, observation: Observation) -> Estimate:
        assert self._estimate is not None
        return self._estimate


class Leaper(Believer):
    """One that leaps at its eleventh observation, and whose covariance tells as much of it as it is told to."""

    def __init__(self, leap: SE2, sigma: float) -> None:
        super().__init__()
        self._leap, self._sigma, self._count = leap, sigma, 0

    def update(self, observation: Observation) -> Estimate:
        self._count += 1
        pose = HERE if self._count <= 10 else HERE @ self._leap
        covariance = np.diag([self._sigma**2, self._sigma**2, 1e-4])
        self._estimate = Estimate(observation.stamp_ns, pose, covariance, 1.0, Mode.FULL, 1.0, True)
        return self._estimate


@lru_cache(maxsize=1)
def office() -> tuple[rooms.Room, SurfaceMap, Relocalizer]:
    room = rooms.office()
    surfaces = SurfaceMap.from_occupancy(*room.occupancy())
    return room, surfaces, Relocalizer(surfaces, RelocalizerConfig())


def scan(through: float = 0.0, hidden: float = 0.0) -> F32:
    """Return a scan from HERE of which a share of the beams, evenly spread, goes a metre beyond the wall, and another ends before it."""
    room, _, _ = office()
    points = room.scan(HERE, np.random.default_rng(0), beams=240, sigma=0.0)
    ranges = np.hypot(points[:, 0], points[:, 1])
    longer, k = np.ones(len(points)), np.arange(len(points))
    share = (k * 0.6180339887) % 1.0  # evenly spread, whatever the share
    longer[share < through] = ((ranges + 1.0) / ranges)[share < through]
    longer[share > 1.0 - hidden] = 0.4
    return (points * longer[:, None]).astype(np.float32)


class Watch:
    """A supervisor that stands at HERE and is shown scans ten times a second; it never searches."""

    def __init__(self, localizer: Believer | None = None) -> None:
        _, surfaces, relocalizer = office()
        localizer = localizer or Believer()
        localizer.set_pose(0, SE2(), HERE)
        relocalizer.reset()
        self.supervisor = Supervisor(surfaces, localizer, relocalizer, SupervisorConfig())
        self.now_ns = 0

    def show(self, points: F32, seconds: float, odom_from_base: SE2 = STANDING) -> list[Supervision]:
        out = []
        for _ in range(round(seconds * 1e9 / PERIOD_NS)):
            out.append(self.supervisor.step(Observation(self.now_ns, odom_from_base, points)))
            self.now_ns += PERIOD_NS
        return out


def seconds_until(told: list[Supervision], states: tuple[LocalizationState, ...]) -> float:
    first = next((k for k, s in enumerate(told) if s.state in states), None)
    return math.inf if first is None else first * PERIOD_NS * 1e-9


def test_shares_are_told_as_they_are() -> None:
    (told,) = Watch().show(scan(through=0.1, hidden=0.2), 0.1)
    assert abs(told.through - 0.1) < 0.03
    assert abs(told.explained - 0.7) < 0.05


def test_a_third_of_the_scan_behind_the_walls_is_a_wrong_pose_after_a_second() -> None:
    """Two thirds fit, which people in the way would explain; but nothing explains returns from behind walls."""
    watch = Watch()
    assert {s.state for s in watch.show(scan(), 1.0)} == {LocalizationState.TRACKING}
    told = watch.show(scan(through=0.33), 2.0)
    assert told[0].explained > 0.6
    assert 0.9 <= seconds_until(told, GIVEN_UP) <= 1.2


@pytest.mark.parametrize(
    ("leap", "sigma", "is_lost"),
    [
        (SE2(0.3, 0.0, 0.0), 0.02, False),  # pushed by somebody
        (SE2(1.0, 0.0, 0.0), 0.02, True),
        (SE2(0.0, 0.0, 1.6), 0.02, True),
        (SE2(1.0, 0.0, 0.0), 0.5, False),  # it was not known better
    ],
)
def test_a_pose_that_leaps_is_not_believed(leap: SE2, sigma: float, is_lost: bool) -> None:
    """Whatever explains the scan there: particles have gathered somewhere else, and of many places that look alike this may be one."""
    watch = Watch(Leaper(leap, sigma))
    assert seconds_until(watch.show(scan(), 1.0), GIVEN_UP) == math.inf
    told = watch.show(scan(), 0.3)
    assert (told[0].state is LocalizationState.LOST) == is_lost
    assert not is_lost or "jumped" in told[0].text


def test_a_tenth_of_the_scan_behind_the_walls_is_an_open_door() -> None:
    watch = Watch()
    watch.show(scan(), 1.0)
    assert {s.state for s in watch.show(scan(through=0.1), 5.0)} == {LocalizationState.TRACKING}


def test_a_glimpse_is_not_enough_to_be_lost() -> None:
    """Half a second of nonsense, again and again, each time followed by a good scan."""
    watch = Watch()
    for _ in range(5):
        assert seconds_until(watch.show(scan(through=0.5), 0.5), GIVEN_UP) == math.inf
        watch.show(scan(), 0.2)


def test_a_scan_that_is_hidden_for_the_most_part_degrades_and_then_loses_the_pose() -> None:
    """Half of it fits: drive slowly. A quarter fits: the pose is not believed any more."""
    watch = Watch()
    watch.show(scan(), 1.0)
    told = watch.show(scan(hidden=0.5), 3.0)
    assert 0.4 < told[0].explained < 0.58
    assert 0.2 <= seconds_until(told, (LocalizationState.DEGRADED,)) <= 0.5
    assert seconds_until(told, GIVEN_UP) == math.inf
    told = watch.show(scan(hidden=0.75), 3.0)
    assert 0.9 <= seconds_until(told, GIVEN_UP) <= 1.2


@pytest.mark.parametrize("count", [0, 3])
def test_a_robot_at_rest_that_sees_nothing_for_a_while_is_doubted_and_not_lost(count: int) -> None:
    """By its odometry it cannot have gone elsewhere; and what was carried meanwhile is lost when it sees again. The few returns fit the map: they are dirt all the same."""
    watch, little = Watch(), scan()[:count]
    watch.show(scan(), 1.0)
    told = watch.show(little, 20.0)
    assert {s.state for s in told[4:]} == {LocalizationState.DEGRADED}
    assert told[-1].estimate is not None
    assert watch.supervisor.take_search() is None, "there is nothing to search with"
    assert {s.state for s in watch.show(scan(), 0.3)} == {LocalizationState.TRACKING}
    watch.show(little, 20.0)
    assert watch.show(scan(through=0.4), 2.0)[-1].state in GIVEN_UP


def test_scans_without_returns_between_do_not_refute_what_speaks_against_a_pose() -> None:
    watch = Watch()
    watch.show(scan(), 1.0)
    told: list[LocalizationState] = []
    for _ in range(6):
        told += [s.state for s in (*watch.show(scan(through=0.4), 0.4), *watch.show(scan()[:0], 0.1))]
    assert told[-1] in GIVEN_UP


def test_a_robot_that_moves_without_seeing_is_lost() -> None:
    watch, nothing = Watch(), scan()[:0]
    watch.show(scan(), 1.0)
    assert 0.9 <= seconds_until(watch.show(nothing, 3.0, SE2(0.3, 0.0, 0.0)), GIVEN_UP) <= 1.2
    turned = Watch()
    turned.show(scan(), 1.0)
    assert 0.9 <= seconds_until(turned.show(nothing, 3.0, SE2(0.0, 0.0, 0.5)), GIVEN_UP) <= 1.2


def test_a_pose_from_which_nothing_was_ever_seen_is_lost() -> None:
    assert 0.9 <= seconds_until(Watch().show(scan()[:0], 3.0), GIVEN_UP) <= 1.2


def compared(rival: float, here: float) -> LocalizationState:
    """Return the state after two searches that found a place of quality `rival` 4 m away, against `here`."""
    watch = Watch()
    watch.show(scan(), 1.0)
    there = Hypothesis(HERE @ SE2(-4.0, 0.0, 0.0), np.eye(3), rival)
    for _ in range(2):
        (now,) = watch.show(scan(hidden=0.3), 0.1)
        observation = Observation(now.stamp_ns, SE2(), scan(hidden=0.3))
        result = SearchResult(observation, watch.supervisor._series, office()[2], None, there, here)
        watch.supervisor.commit(result)
    return watch.supervisor.state


def test_another_place_must_be_much_better() -> None:
    assert compared(rival=0.75, here=0.65) is LocalizationState.TRACKING, "a tenth of the scan is chance"
    assert compared(rival=0.85, here=0.5) is LocalizationState.LOST
    assert compared(rival=0.6, here=0.2) is LocalizationState.TRACKING, "a bad place is no rival, however bad this one"
