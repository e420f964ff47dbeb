"""A saved map of ground: a level is told by the height at which the robot stands, and changed where both carry it."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.messages import Transforms, TransformStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.ground_server import GroundServerNode
from ambler.perception.known_ground import KnownGround, KnownLevel
from ambler.runtime.tasks import CHOOSE_LEVEL, LevelRequest
from ambler.runtime.topics import GROUND_LEVELS, MAP, TRANSFORMS
from tests.hand_made_context import HandMadeContext

DECK = 3.0
PASSAGES = np.array([[0.0, 1.0, 7.0, 2.0, 0.0], [1.0, 0.0, 7.0, 2.0, 0.0]])


def two_decks() -> KnownGround:
    """20 m by 4 m: the lower deck with a ramp from x = 4 to 10 m, seen up to 8 m; the upper deck from 10 m on and the ramp from 6 m, which both know in between. The upper deck
    goes back over the lower one beside the ramp."""
    x = 0.05 + 0.1 * np.arange(200)
    rise = np.clip((x - 4.0) * DECK / 6.0, 0.0, DECK)
    spec = GridSpec(0.1, 200, 40, 0.0, 0.0)
    lower = np.tile(np.where(x < 8.0, rise, np.nan), (40, 1)).astype(np.float32)
    upper = np.tile(np.where(x > 6.0, rise, np.nan), (40, 1)).astype(np.float32)
    upper[30:, :100] = DECK
    lower[30:] = 0.0
    levels = [KnownLevel(spec, np.where(np.isfinite(h), 0, -1).astype(np.int8), h) for h in (lower, upper)]
    return KnownGround(levels, PASSAGES)


def at(x: float, y: float, z: float) -> SE3:
    return SE3.from_se2(SE2(x, y), z)


def test_the_height_says_on_which_of_two_levels_above_each_other_a_robot_is():
    ground = two_decks()
    assert not ground.update(at(2.0, 3.5, 0.1))
    assert ground.active == 0
    assert ground.update(at(2.0, 3.5, DECK - 0.2))
    assert ground.active == 1


def test_a_level_that_carries_the_robot_is_left_for_the_wanted_one_only():
    ground = two_decks()
    for x in np.arange(2.0, 7.5, 0.5):
        assert not ground.update(at(x, 1.0, max(0.0, (x - 4.0) * DECK / 6.0)))
    ground.wanted = 1
    assert not ground.update(at(5.0, 1.0, 0.5)), "the wanted level is not there yet"
    assert ground.update(at(7.0, 1.0, 1.5))
    assert (ground.active, ground.wanted) == (1, None)
    ground.wanted = 0
    assert ground.update(at(7.0, 1.0, 1.5))


def test_a_wanted_level_is_not_changed_to_where_it_ends():
    ground = two_decks()
    ground.active, ground.wanted = 1, 0
    assert not ground.update(at(7.9, 0.5, 1.95))
    assert not ground.update(at(7.6, 0.5, 1.8))
    assert ground.update(at(7.1, 0.5, 1.55)), "the lower level goes on for 0.9 m"
    ground.active, ground.wanted, ground.passages = 1, 0, np.array([[1.0, 0.0, 7.7, 0.5, 0.0]])
    assert ground.update(at(7.9, 0.5, 1.95)), "a passage"


def test_driving_on_beyond_what_a_level_knows_changes_it_unasked():
    ground = two_decks()
    assert ground.update(at(9.5, 1.0, 2.75))
    assert ground.active == 1
    assert not ground.update(at(50.0, 1.0, 0.0)), "outside of all levels the last one stays"
    assert not ground.update(at(-3.0, -3.0, 0.0))


def test_a_start_is_put_on_its_ground():
    ground = two_decks()
    assert ground.standing_at(SE2(7.0, 1.0, 0.5)).translation == pytest.approx((7.0, 1.0, 1.5), abs=0.03)
    assert ground.level_at(SE2(15.0, 1.0)) == 1
    with pytest.raises(BadInputError, match="no ground"):
        ground.standing_at(SE2(25.0, 1.0))


def test_what_is_no_ground_is_refused():
    with pytest.raises(BadInputError, match="at least one"):
        KnownGround(())
    with pytest.raises(BadInputError, match="none of 2"):
        KnownGround(two_decks().levels, np.array([[0.0, 2.0, 0.0, 0.0, 0.0]]))


def placed(context: HandMadeContext, base: SE3, map_from_odom: SE3) -> None:
    now = context.now_ns
    edges = (TransformStamped(now, "map", "odom", map_from_odom),)
    edges += (TransformStamped(now, "odom", "base", map_from_odom.inverse() @ base),)
    context.callbacks[TRANSFORMS.name](Transforms(now, edges))
    context.run(1.0)


def test_the_server_tells_the_level_before_its_map_and_nothing_while_the_place_is_unknown():
    context, ground = HandMadeContext(), two_decks()
    context.start(GroundServerNode(ground))
    odom = SE3.from_rpy((3.0, -2.0, 1.0), 0.0, 0.0, 0.7)
    context.run(3.0)
    assert [m.active for m in context.messages(GROUND_LEVELS)] == [0]
    placed(context, at(2.0, 1.0, 0.0), odom)
    assert len(context.messages(MAP)) == 1
    placed(context, at(15.0, 1.0, DECK), odom)
    assert [m.active for m in context.messages(GROUND_LEVELS)] == [0, 1]
    told = zip(context.messages(GROUND_LEVELS), context.messages(MAP), strict=True)
    assert all(levels.stamp_ns <= level.stamp_ns for levels, level in told), "the planner waits for the map of a level"
    topics = [topic for _, topic, _ in context.published if topic in (MAP, GROUND_LEVELS)]
    assert topics == [GROUND_LEVELS, MAP, GROUND_LEVELS, MAP]
    np.testing.assert_array_equal(context.messages(MAP)[1].data, ground.levels[1].occupancy)
    np.testing.assert_array_equal(context.messages(GROUND_LEVELS)[1].passages, PASSAGES)


def test_the_server_changes_to_a_chosen_level_at_the_passage():
    context = HandMadeContext()
    context.start(GroundServerNode(two_decks()))
    placed(context, at(7.0, 2.0, 1.5), SE3())
    assert len(context.messages(MAP)) == 1
    context.services[CHOOSE_LEVEL.name](LevelRequest(1))
    placed(context, at(7.0, 2.0, 1.5), SE3())
    assert [m.active for m in context.messages(GROUND_LEVELS)] == [0, 1]
    with pytest.raises(BadInputError, match="no level 2"):
        context.services[CHOOSE_LEVEL.name](LevelRequest(2))
