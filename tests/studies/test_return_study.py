"""What a study of returns makes of its runs, and the places that it draws: on the ground of the map, where the robot truly can be, on levels that hang together."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se3 import SE3
from ambler.perception.known_ground import KnownGround, KnownLevel
from ambler.sim.reachable_ground import GroundRules, reachable_ground
from ambler.sim.world_file import load_world
from ambler.studies.return_study import has_returned, is_done, line, summarize
from ambler.studies.site_places import APART, draw_start, draw_way_points, free_pieces
from tests.perception.test_known_ground import two_decks

GOOD = {
    "label": "plot-1-go2",
    "explored": "finished",
    "explored_home": True,
    "explored_collisions": 0,
    "ended": "succeeded",
    "found_s": 3.0,
    "found_m": 0.05,
    "found_deg": 0.5,
    "wrong_poses": 0,
    "way_points": 5,
    "way_points_reached": 5,
    "collisions": 0,
}


@pytest.mark.parametrize(
    ("what", "value"), [("found_s", None), ("wrong_poses", 1), ("way_points_reached", 4), ("collisions", 1)]
)
def test_a_return_that_lacks_something_is_none(what, value):
    assert has_returned(GOOD)
    assert not has_returned({**GOOD, what: value})
    assert not is_done({**GOOD, what: value})


@pytest.mark.parametrize(
    ("what", "value"), [("explored", "time_limit"), ("explored_home", False), ("explored_collisions", 2)]
)
def test_an_exploration_that_lacks_something_spoils_the_run_but_not_the_return(what, value):
    assert is_done(GOOD)
    bad = {**GOOD, what: value}
    assert has_returned(bad)
    assert not is_done(bad)
    fields = summarize([GOOD, {**bad, "label": "other"}])
    assert (fields["runs"], fields["done"], fields["returned"], fields["bars.done"]) == (2, 1, 2, False)


def test_what_crashed_or_was_never_saved_counts_as_a_run():
    nothing = {"label": "x", "explored": "crashed", "ended": "not_explored"}
    fields = summarize([nothing])
    assert (fields["runs"], fields["done"], fields["way_points"], fields["found_s_median"]) == (1, 0, 0, None)
    assert "did not find out" in line(nothing)


def test_levels_hang_together_through_their_passages_only():
    ground = two_decks()
    lower, upper = free_pieces(ground, 0.4)
    spec = ground.levels[0].spec
    assert lower[spec.cell_of(2.0, 1.0)] == upper[spec.cell_of(15.0, 1.0)] > 0
    apart = KnownGround(ground.levels)
    lower, upper = free_pieces(apart, 0.4)
    assert lower[spec.cell_of(2.0, 1.0)] != upper[spec.cell_of(15.0, 1.0)]
    assert lower[spec.cell_of(2.0, 0.1)] == 0, "too near to the edge"


def test_way_points_lie_on_one_piece_apart_from_each_other_on_both_levels():
    ground = two_decks()
    pieces = free_pieces(ground, 0.4)
    piece = int(pieces[0][ground.levels[0].spec.cell_of(2.0, 1.0)])
    drawn = draw_way_points(ground, pieces, piece, 5, np.random.default_rng(1))
    for goal, level in drawn:
        assert ground.levels[level].height_at(goal.x, goal.y) is not None
        assert pieces[level][ground.levels[level].spec.cell_of(goal.x, goal.y)] == piece
    places = [(level, np.array([goal.x, goal.y])) for goal, level in drawn]
    near = [np.linalg.norm(a - b) for k, (m, a) in enumerate(places) for n, b in places[:k] if m == n]
    assert min(near) >= 0.5 * APART
    many = draw_way_points(ground, pieces, piece, 40, np.random.default_rng(1))
    assert {level for _, level in many} == {0, 1}
    with pytest.raises(BadInputError, match="no room"):
        draw_way_points(ground, pieces, 99, 5, np.random.default_rng(1))


def test_a_start_is_far_from_the_old_one_where_the_robot_truly_can_stand():
    world = load_world("ramp")
    truth = reachable_ground(world, world.start, GroundRules(0.3, 0.7))
    places = truth.places()
    low = np.floor(places[:, :2].min(axis=0) * 10.0) / 10.0 - 1.0
    size = np.ceil((places[:, :2].max(axis=0) - low) * 10.0).astype(int) + 10
    spec = GridSpec(0.1, int(size[0]), int(size[1]), float(low[0]), float(low[1]))
    heights = np.full(spec.shape, np.nan, np.float32)
    cells = spec.cells_of(places[:, :2])
    heights[cells[:, 0], cells[:, 1]] = places[:, 2]
    ground = KnownGround([KnownLevel(spec, np.where(np.isfinite(heights), 0, -1).astype(np.int8), heights)])
    pieces = free_pieces(ground, 0.2)
    rng = np.random.default_rng(3)
    away = np.hypot(places[:, 0], places[:, 1]).max()
    for _ in range(20):
        start, piece = draw_start(ground, pieces, truth, world, SE3(), rng)
        assert np.hypot(start.x, start.y) > 0.4 * away
        assert np.min(np.hypot(places[:, 0] - start.x, places[:, 1] - start.y)) < 0.1
        assert pieces[0][spec.cell_of(start.x, start.y)] == piece
    nowhere = [np.zeros_like(pieces[0])]
    with pytest.raises(BadInputError, match="no ground"):
        draw_start(ground, nowhere, truth, world, SE3(), rng)
