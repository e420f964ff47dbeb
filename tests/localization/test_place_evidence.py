"""What tells places apart that look alike: separate things, each counted once, and never one alone that may have been carried away."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.localization.localizer import Observation
from ambler.localization.place_evidence import EXPLAINED, TOO_FAR, TOO_NEAR, PlaceEvidence
from ambler.localization.relocalizer import Hypothesis, RelocalizationState, Relocalizer, RelocalizerConfig
from ambler.localization.surface_map import SurfaceMap
from tests.localization import rooms

S = 1_000_000_000


def view(spots: list[tuple[float, float]], label: int, returns: int = 5) -> tuple[rooms.F64, rooms.NDArray[np.int8]]:
    """So many returns at each spot, all judged alike."""
    return np.repeat(np.array(spots), returns, axis=0), np.full(returns * len(spots), label, np.int8)


def evidence(*views: tuple[rooms.F64, rooms.NDArray[np.int8]]) -> PlaceEvidence:
    out = PlaceEvidence()
    for points, labels in views:
        out = out.with_view(points, labels)
    return out


def test_things_are_counted_once_however_often_they_are_seen() -> None:
    spots = [(1.1, 1.1), (1.4, 1.7), (6.2, 1.1), (9.2, 4.3)]  # the first two are one thing
    right = evidence(*[view(spots, EXPLAINED)] * 3)
    assert right.things_over(evidence(*[view(spots, TOO_NEAR)] * 3)) == (3, 0)
    assert right.things_over(evidence(*[view(spots, TOO_FAR)] * 3)) == (0, 3)
    assert right.things_over(right) == (0, 0)
    assert evidence(view(spots, TOO_NEAR)).things_over(right) == (0, 0)


def test_what_neither_explains_and_single_beams_tell_nothing() -> None:
    spots = [(1.1, 1.1), (6.2, 1.1)]
    person = evidence(view(spots, TOO_NEAR))
    assert person.things_over(person) == (0, 0)
    assert evidence(view(spots, EXPLAINED, 2)).things_over(evidence(view(spots, TOO_NEAR, 2))) == (0, 0)


def hallway(name: str, without: int | None = None) -> rooms.Room:
    """30 m by 2.4 m: cupboards in a row on both sides, at uneven distances; one may be gone."""
    places = [
        (2.0, 0.15),
        (5.0, 2.25),
        (8.6, 0.15),
        (11.1, 2.25),
        (13.0, 0.15),
        (17.9, 2.25),
        (21.8, 0.15),
        (23.2, 2.25),
    ]
    solids = [rooms.box(x, y, 0.8, 0.3) for k, (x, y) in enumerate(places) if k != without]
    return rooms.Room(name, (28.0, 2.4), tuple(solids))


def searched(
    world: rooms.Room, known: rooms.Room, start: SE2, steps: int, reach: float = 6.0
) -> list[tuple[RelocalizationState, float]]:
    """Let a robot with short sight drive 0.35 m between views; per view the state, and how far the best place is off."""
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*known.occupancy()), RelocalizerConfig())
    rng, out, motion = np.random.default_rng(4), [], SE2()
    for k in range(steps):
        points = world.scan(start @ motion, rng, reach=reach)
        answer = relocalizer.update(Observation(k * S, motion, points))
        best = answer.hypotheses[0].map_from_base if answer.hypotheses else SE2()
        out.append((answer.state, math.hypot(best.x - (start @ motion).x, best.y - (start @ motion).y)))
        motion = motion @ SE2(0.35, 0.0, 0.05 * (-1) ** k)
    return out


def test_a_hallway_that_looks_alike_everywhere_is_told_apart_by_several_things() -> None:
    room = hallway("hallway")
    views = searched(room, room, SE2(10.5, 1.2, 0.1), 5)
    states = [state for state, _ in views]
    assert states[0] is not RelocalizationState.FOUND
    assert RelocalizationState.FOUND in states
    assert all(away < 0.1 for state, away in views if state is RelocalizationState.FOUND)


def alike(without: int | None = None) -> rooms.Room:
    """Two equal halls of 14 m in a row, with a post in the first only; it may be gone."""
    posts = [rooms.box(5.0, 0.15, 0.8, 0.3), rooms.box(9.5, 3.85, 0.8, 0.3)]
    halls = [rooms.box(14.1, 2.0, 0.2, 4.0)]
    second = [rooms.box(19.2, 0.15, 0.8, 0.3), rooms.box(23.7, 3.85, 0.8, 0.3)]
    post = [] if without == 0 else [rooms.box(8.0, 2.0, 0.4, 0.4)]
    return rooms.Room("alike", (28.2, 4.0), (*posts, *halls, *second, *post))


def test_one_thing_that_was_carried_away_does_not_prove_another_place() -> None:
    """The post of the first hall is gone: the second hall explains all that is seen, and is not where the robot is."""
    views = searched(alike(without=0), alike(), SE2(6.0, 2.0, 0.1), 5, reach=20.0)
    assert all(state is not RelocalizationState.FOUND for state, _ in views)
    assert any(away > 10.0 for _, away in views), "the wrong hall must look better, or this says nothing"


@pytest.mark.parametrize(("things", "is_believed"), [(0, True), (1, True), (2, False)])
def test_a_place_that_leads_is_not_believed_against_several_things(things: int, is_believed: bool) -> None:
    """Returns of long walls make it lead by 0.2; what the other place explains instead may have been moved once, not twice."""
    room = alike()
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*room.occupancy()), RelocalizerConfig())
    wall, spots = view([(40.1, 1.1)], EXPLAINED), [(1.1 + 5.0 * k, 1.1) for k in range(things)]
    seen = [evidence(wall, *(view([spot], label) for spot in spots)) for label in (TOO_NEAR, EXPLAINED)]
    best = Hypothesis(SE2(6.0, 2.0, 0.1), np.eye(3), 0.8, seen[0])
    other = Hypothesis(SE2(20.2, 2.0, 0.1), np.eye(3), 0.6, seen[1])
    relocalizer._hypotheses = (best, other)
    assert relocalizer._is_alone() == is_believed


def test_what_is_contradicted_is_counted_by_spots() -> None:
    spots = [(1.1 + k, 1.1) for k in range(10)]
    mixed = evidence(view(spots[:6], EXPLAINED), view(spots[6:9], TOO_NEAR), view(spots[9:], TOO_FAR, 3))
    assert mixed.contradicted == pytest.approx(0.4)
    person = evidence(view(spots[:9], EXPLAINED), view(spots[9:], TOO_NEAR, 500))
    assert person.contradicted == pytest.approx(0.1), "however many beams meet her"
    assert evidence(view(spots[:6], EXPLAINED), view(spots[6:], TOO_NEAR, 2)).contradicted == 0.0
    assert PlaceEvidence().contradicted == 0.0


@pytest.mark.parametrize(("known", "is_contradicted"), [(-1, False), (0, True)])
def test_what_stands_where_the_map_knows_nothing_contradicts_no_place(known: int, is_contradicted: bool) -> None:
    """Half of the room lay behind furniture on the day of its map; or the map says that half of it is free floor, and its walls stand on that."""
    room = rooms.Room("half", (12.0, 4.0), ())
    cells, spec = room.occupancy()
    cells[:, spec.cell_of(6.5, 2.0)[1] :] = known
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(cells, spec), RelocalizerConfig())
    start = SE2(5.0, 2.0, 0.1)
    seen = Observation(S, SE2(), room.scan(start, np.random.default_rng(4), reach=20.0))
    here = relocalizer._with_view(Hypothesis(start, np.eye(3), 0.8), seen)
    assert (here.evidence.counts[:, EXPLAINED] > 0).sum() > 20
    assert here.evidence.contradicted == 0.0 if not is_contradicted else here.evidence.contradicted > 0.3


@pytest.mark.parametrize(("wrong", "is_believed"), [(2, True), (4, False)])
def test_no_place_is_believed_of_which_much_is_contradicted(wrong: int, is_believed: bool) -> None:
    """Nothing else comes near: the robot may stand where the map knows nothing."""
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*alike().occupancy()), RelocalizerConfig())
    spots = [(1.1 + 5.0 * k, 1.1) for k in range(10)]
    seen = evidence(view(spots[wrong:], EXPLAINED), view(spots[:wrong], TOO_NEAR))
    relocalizer._hypotheses = (Hypothesis(SE2(6.0, 2.0, 0.1), np.eye(3), 0.85, seen, 4, 3),)
    assert (relocalizer._answer(S).state is RelocalizationState.FOUND) == is_believed


@pytest.mark.parametrize(
    ("wrong", "quality", "confirmations", "way", "has_rival", "is_believed"),
    [
        (4, 0.75, 8, 3.1, False, True),
        (4, 0.75, 7, 3.1, False, False),
        (4, 0.75, 20, 2.9, False, False),
        (4, 0.65, 20, 9.0, False, False),
        (5, 0.75, 20, 9.0, False, False),
        (4, 0.75, 20, 9.0, True, False),
    ],
)
def test_a_place_that_is_found_again_and_again_along_a_way_may_have_changed_more(
    wrong: int, quality: float, confirmations: int, way: float, has_rival: bool, is_believed: bool
) -> None:
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*alike().occupancy()), RelocalizerConfig())
    spots = [(1.1 + 5.0 * k, 1.1) for k in range(10)]
    seen = evidence(view(spots[wrong:], EXPLAINED), view(spots[:wrong], TOO_NEAR))
    place = Hypothesis(SE2(6.0, 2.0, 0.1), np.eye(3), quality, seen, confirmations + 1, confirmations, way)
    rival = Hypothesis(SE2(20.2, 2.0, 0.1), np.eye(3), quality - 0.2, evidence(view(spots, TOO_NEAR)))
    relocalizer._hypotheses = (place, rival) if has_rival else (place,)
    assert (relocalizer._answer(S).state is RelocalizationState.FOUND) == is_believed


def test_the_way_along_which_a_place_was_followed_is_told() -> None:
    room, rng = hallway("hallway"), np.random.default_rng(4)
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*room.occupancy()), RelocalizerConfig())
    ways = []
    for k in range(5):
        odom = SE2(0.5 * k, 0.0, 0.0)
        found = relocalizer.update(Observation(k * S, odom, room.scan(SE2(10.5, 1.2, 0.1) @ odom, rng, reach=6.0)))
        ways.append(found.hypotheses[0].way)
    assert ways == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])


@pytest.mark.parametrize(("elsewhere", "is_believed"), [(0, True), (2, True), (6, False)])
def test_no_place_is_believed_to_which_the_way_does_not_lead(elsewhere: int, is_believed: bool) -> None:
    """The robot stands where the map does not know, and all that it sees looks like a place of the map; on most of its way there nothing did."""
    room, other, rng = (
        alike(),
        rooms.Room("other", (5.0, 3.0), (rooms.box(2.0, 2.5, 0.5, 0.5),)),
        np.random.default_rng(4),
    )
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*room.occupancy()), RelocalizerConfig())
    begin, odoms = SE2(2.0, 2.0, 0.0), [SE2(0.8 * k, 0.0, 0.0) for k in range(9)]
    for k, odom in enumerate(odoms):
        there = (other, SE2(1.0 + 0.3 * k, 1.0, 0.0)) if k < elsewhere else (room, begin @ odom)
        looked = Observation(k * S, odom, there[0].scan(there[1], rng, reach=20.0))
        relocalizer._past, relocalizer._odom_of_viewpoint = relocalizer._with_past(looked), odom
    seen = evidence(view([(1.1 + 5.0 * k, 1.1) for k in range(10)], EXPLAINED))
    relocalizer._hypotheses = (Hypothesis(begin @ odoms[-1], np.eye(3), 0.85, seen, 4, 3),)
    state = relocalizer._answer(9 * S).state
    assert state is (RelocalizationState.FOUND if is_believed else RelocalizationState.NOT_FOUND)


def test_a_robot_that_was_carried_while_it_was_lost_is_found_all_the_same() -> None:
    """Its way does not lead to where it is: after some refusals that counts no more."""
    other, rng = rooms.Room("other", (8.0, 3.0), (rooms.box(2.0, 2.5, 0.5, 0.5),)), np.random.default_rng(4)
    room = hallway("hallway")
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*room.occupancy()), RelocalizerConfig())
    states, odoms = [], [SE2(0.35 * k, 0.0, 0.05 * (-1) ** k) for k in range(30)]
    for k, odom in enumerate(odoms):
        if k < 12:
            points = other.scan(SE2(1.0, 1.0, 0.0) @ odom, rng, reach=20.0)
        else:
            points = room.scan(SE2(10.5, 1.2, 0.1) @ odoms[12].inverse() @ odom, rng, reach=6.0)
        states.append(relocalizer.update(Observation(k * S, odom, points)).state)
    assert RelocalizationState.FOUND not in states[:15], "else it was not lost, or its way led there"
    assert RelocalizationState.FOUND in states[15:23]


def test_only_the_last_metres_of_the_way_are_remembered() -> None:
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*alike().occupancy()), RelocalizerConfig())
    for k in range(60):
        nothing = Observation(k * S, SE2(0.5 * (k // 2), 0.0, 0.0), np.zeros((0, 2), np.float32))
        relocalizer._past = relocalizer._with_past(nothing)
    places = [view.odom_from_base.x for view in relocalizer._past]
    assert places[-1] == pytest.approx(14.5)
    assert places[0] == pytest.approx(14.5 - RelocalizerConfig().past_way)
    assert len(places) == len(set(places)), "a place is one viewpoint"


def test_a_place_that_comes_up_late_is_not_confirmed_by_what_confirmed_another() -> None:
    relocalizer = Relocalizer(SurfaceMap.from_occupancy(*alike().occupancy()), RelocalizerConfig())
    spots = evidence(view([(1.1 + 5.0 * k, 1.1) for k in range(10)], EXPLAINED))
    old = Hypothesis(SE2(20.2, 2.0, 0.1), np.eye(3), 0.6, spots, 5, 4)
    new = Hypothesis(SE2(6.0, 2.0, 0.1), np.eye(3), 0.95, spots, 1, 0)
    relocalizer._viewpoints, relocalizer._hypotheses = 5, (new, old)
    assert relocalizer._answer(S).state is RelocalizationState.VERIFYING
    relocalizer._hypotheses = (old,)
    assert relocalizer._answer(S).state is RelocalizationState.FOUND
