"""The map of ground: what is taken into it, what is forgotten again, what cannot be seen, and levels above one another."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_ASSUMED, OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import ground_map as kernels
from ambler.perception.ground_level import Level
from ambler.perception.ground_map import GroundMap, GroundMapConfig, Passage
from ambler.perception.terrain import Ground
from ambler.perception.terrain_window import TerrainWindow

CELL, STEP = 0.2, 0.08
LEVEL_LIDAR = SE3((0.0, 0.0, 0.62))
ALL_ROUND, MID_360 = (-0.5 * math.pi, 0.5 * math.pi), (math.radians(-7.0), math.radians(52.0))


def window(
    x0: float, x1: float, y0: float, y1: float, height: float = 0.0, things: list[tuple[float, float]] = ()
) -> TerrainWindow:  # type: ignore[assignment]
    """Return level ground between limits with voxels that stand on it."""
    xs, ys = np.arange(x0 + 0.1, x1, CELL), np.arange(y0 + 0.1, y1, CELL)
    x, y = (a.ravel() for a in np.meshgrid(xs, ys))
    points = np.column_stack((x, y, np.full(len(x), height)))
    voxels = np.array([(a, b, height + 0.5) for a, b in things]).reshape(-1, 3)
    above = np.concatenate((np.zeros(len(x)), np.full(len(voxels), 0.5)))
    kinds = np.concatenate((np.full(len(x), Ground.GROUND), np.zeros(len(voxels))))
    whole = np.concatenate((points, voxels)).astype(np.float32)
    return TerrainWindow.of_points(whole, above.astype(np.float32), kinds.astype(np.uint8), CELL, STEP)


def feed(
    ground: GroundMap, seen: TerrainWindow, base: SE3 | None = None, elevation: tuple[float, float] = ALL_ROUND
) -> None:
    base = base if base is not None else SE3()
    ground.update(seen, SE3(), base, base @ LEVEL_LIDAR, elevation)


def at(ground: GroundMap, x: float, y: float, level: int | None = None) -> int:
    k = ground.active if level is None else level
    return int(ground.occupancy(k)[ground.levels[k].spec.cell_of(x, y)])


def test_ground_is_free_things_on_it_are_not_and_the_rest_is_unknown():
    ground = GroundMap()
    feed(ground, window(-3.0, 3.0, -3.0, 3.0, 0.0, [(1.05, 1.05)]))
    assert at(ground, 2.5, -2.5) == OCC_FREE
    assert at(ground, 1.05, 1.05) == OCC_OCCUPIED
    assert at(ground, 1.25, 1.05) == OCC_FREE
    assert at(ground, 4.0, 0.0) == OCC_UNKNOWN


def test_what_left_is_free_again_after_some_looks_and_not_after_one():
    ground = GroundMap()
    feed(ground, window(-3.0, 3.0, -3.0, 3.0, 0.0, [(1.05, 1.05)]))
    feed(ground, window(-3.0, 3.0, -3.0, 3.0))
    assert at(ground, 1.05, 1.05) == OCC_OCCUPIED
    for _ in range(6):
        feed(ground, window(-3.0, 3.0, -3.0, 3.0))
    assert at(ground, 1.05, 1.05) == OCC_FREE


def test_a_kerb_that_was_seen_is_not_forgotten_for_looks_from_afar():
    """Terrain 6 m away is sparse and told five times a second: a kerb may be missing in it for a second or two."""
    ground, there = GroundMap(), SE3((-6.0, 0.0, 0.0))
    feed(ground, window(-8.0, 3.0, -3.0, 3.0, 0.0, [(1.05, 1.05)]), there)
    feed(ground, window(-8.0, 3.0, -3.0, 3.0, 0.0, [(1.05, 1.05)]), there)
    for _ in range(15):
        feed(ground, window(-8.0, 3.0, -3.0, 3.0), there)
    assert at(ground, 1.05, 1.05) == OCC_OCCUPIED
    for _ in range(15):
        feed(ground, window(-8.0, 3.0, -3.0, 3.0), there)
    assert at(ground, 1.05, 1.05) == OCC_FREE, "what left is forgotten from afar, too"


def with_a_thing(x: float, y: float, top: float) -> TerrainWindow:
    """Return level ground all around with a thing of a given height at a place."""
    seen = window(-9.0, 9.0, -9.0, 9.0, 0.0, [(x, y)])
    seen.tops[np.isfinite(seen.tops)] = top
    return seen


@pytest.mark.parametrize(
    ("away", "top", "is_kept"), [(4.5, 0.12, True), (1.5, 0.4, True), (1.5, 1.7, False), (4.9, 0.12, False)]
)
def test_what_is_lower_than_a_level_lidar_sees_there_stays_until_it_is_seen_from_afar(away, top, is_kept):
    """Within 5 m it sees no floor: ground that is told there is remembered, or the edge of a kerb. Somebody who left it would see."""
    ground, there = GroundMap(), SE3((1.05 - away, 1.05, 0.0))
    for _ in range(2):
        feed(ground, with_a_thing(1.05, 1.05, top), SE3((-4.8, 1.05, 0.0)), MID_360)
    assert at(ground, 1.05, 1.05) == OCC_OCCUPIED
    for _ in range(20):
        feed(ground, window(-9.0, 9.0, -9.0, 9.0), there, MID_360)
    assert (at(ground, 1.05, 1.05) == OCC_OCCUPIED) == is_kept
    for _ in range(40):
        feed(ground, window(-9.0, 9.0, -9.0, 9.0), SE3((-4.2, 1.05, 0.0)), MID_360)
    assert at(ground, 1.05, 1.05) == OCC_FREE


def test_where_a_kerb_would_go_on_beside_the_robot_nothing_is_assumed():
    """A level LiDAR sees it from 5 m on."""
    ground = GroundMap()
    kerb = [(2.05, float(y)) for y in np.arange(4.5, 8.5, 0.1)]
    seen = window(-9.0, 9.0, -9.0, 9.0, 0.0, kerb)
    seen.tops[np.isfinite(seen.tops)] = 0.12
    x, y = (
        seen.origin_x + (np.arange(seen.kinds.shape[1]) + 0.5) * CELL,
        seen.origin_y + (np.arange(seen.kinds.shape[0]) + 0.5) * CELL,
    )
    seen.kinds[np.hypot(x[None, :], y[:, None]) < 4.8] = 0
    for _ in range(3):
        feed(ground, seen, None, MID_360)
    version = ground.version
    feed(ground, seen, None, MID_360)
    assert ground.version == version, "the same again tells nothing new"
    assert at(ground, 2.05, 8.0) == OCC_OCCUPIED
    assert at(ground, 2.05, 2.5) == OCC_UNKNOWN
    assert at(ground, 0.55, 2.5) == OCC_ASSUMED
    assert at(ground, 2.05, -2.0) == OCC_ASSUMED


def test_a_tilted_lidar_sees_the_floor_before_it_and_not_behind_it():
    looks = SE3.from_rpy((0.0, 0.0, 0.62), 0.0, math.radians(28.0), 0.0)
    for x, is_kept in ((2.05, False), (-2.05, True)):
        ground = GroundMap()
        for _ in range(2):
            feed(ground, with_a_thing(x, 0.05, 0.2))
        for _ in range(20):
            ground.update(window(-9.0, 9.0, -9.0, 9.0), SE3(), SE3(), looks, MID_360)
        assert (at(ground, x, 0.05) == OCC_OCCUPIED) == is_kept


def test_what_was_in_the_way_is_forgotten_with_its_height():
    """Somebody leaves; a kerb that is told there later is judged by its own height."""
    ground, near, far = GroundMap(), SE3((-0.45, 1.05, 0.0)), SE3((-4.2, 1.05, 0.0))
    feed(ground, with_a_thing(1.05, 1.05, 1.7), near, MID_360)
    for _ in range(20):
        feed(ground, window(-9.0, 9.0, -9.0, 9.0), near, MID_360)
    assert at(ground, 1.05, 1.05) == OCC_FREE
    for _ in range(4):
        feed(ground, with_a_thing(1.05, 1.05, 0.12), far, MID_360)
    for _ in range(20):
        feed(ground, window(-9.0, 9.0, -9.0, 9.0), near, MID_360)
    assert at(ground, 1.05, 1.05) == OCC_OCCUPIED


def beside_a_car(*x_of_sides: float, top: float = 0.5) -> TerrainWindow:
    """Return level ground that is seen below a car as well, and those of its sides that stand at the given x."""
    sides = [(x, y) for x in x_of_sides for y in np.arange(-1.95, 2.0, 0.1).tolist()]
    seen = window(-6.0, 6.0, -3.0, 3.0, 0.0, sides)
    seen.tops[seen.tops > 0.0] = top
    return seen


@pytest.mark.parametrize("heights", [(0.2, 0.9), (0.9, 0.2)])
def test_a_window_tells_how_high_the_highest_voxel_reaches(heights):
    points = np.array([[0.1, 0.1, -2.0], *([0.05, 0.05, -2.0 + h] for h in heights)], np.float32)
    kinds = np.array([Ground.GROUND, 0, 0], np.uint8)
    seen = TerrainWindow.of_points(points, np.array([0.0, *heights], np.float32), kinds, CELL, STEP)
    np.testing.assert_allclose(seen.tops, [[-1.1, -np.inf], [-np.inf, -np.inf]], rtol=1e-6)


def test_ground_that_is_seen_below_a_car_says_nothing_of_the_side_behind_it():
    """The far side was seen from there; seen from here it is hidden, and the floor below it is not."""
    ground = GroundMap()
    for _ in range(3):
        feed(ground, beside_a_car(3.05), SE3((5.0, 0.0, 0.0)))
    for _ in range(20):
        feed(ground, beside_a_car(1.05), SE3((-1.0, 0.0, 0.0)))
    assert at(ground, 3.05, 0.0) == OCC_OCCUPIED
    for _ in range(20):
        feed(ground, beside_a_car(), SE3((-1.0, 0.0, 0.0)))
    assert at(ground, 3.05, 0.0) == OCC_FREE, "the car has driven away"


def test_below_a_car_there_is_no_ground_to_drive_on():
    ground = GroundMap()
    for _ in range(5):
        feed(ground, beside_a_car(1.05), SE3((-1.0, 0.0, 0.0)), (0.3, 1.0))
    assert at(ground, 2.0, 0.0) == OCC_UNKNOWN
    assert at(ground, 0.5, 0.0) == OCC_FREE
    assert at(ground, 1.5, 2.9) == OCC_FREE, "beside it there is"


def test_ground_that_is_seen_over_something_low_is_ground():
    ground = GroundMap()
    feed(ground, beside_a_car(1.05, top=0.25), SE3((-1.0, 0.0, 0.0)))
    assert at(ground, 1.4, 0.0) == OCC_UNKNOWN, "in its shadow"
    assert at(ground, 3.0, 0.0) == OCC_FREE


def test_ground_too_near_for_a_level_lidar_is_assumed_until_the_robot_is_away():
    ground = GroundMap()
    ring = window(5.0, 7.0, -3.0, 3.0)
    feed(ground, ring, elevation=MID_360)
    assert at(ground, 2.0, 0.0) == OCC_ASSUMED
    assert at(ground, 6.0, 0.0) == OCC_FREE
    for x in np.arange(0.5, 10.0, 0.5):
        feed(ground, window(x + 5.0, x + 7.0, -3.0, 3.0), SE3((x, 0.0, 0.0)), MID_360)
    assert at(ground, 2.0, 1.0) == OCC_UNKNOWN, "nobody has ever seen it"
    assert at(ground, 2.0, 0.0) == OCC_FREE, "the robot has driven over it"


def test_nothing_is_assumed_behind_a_wall():
    ground = GroundMap()
    wall = [(1.5, y) for y in np.arange(-2.95, 3.0, 0.1).tolist()]
    feed(ground, window(5.0, 7.0, -3.0, 3.0, 0.0), elevation=MID_360)
    assert at(ground, 2.5, 0.0) == OCC_ASSUMED
    ground = GroundMap()
    xs = window(1.4, 1.6, -3.0, 3.0, 0.0, wall)
    feed(ground, xs, elevation=MID_360)
    assert at(ground, 1.0, 0.0) == OCC_ASSUMED
    assert at(ground, 2.5, 0.0) == OCC_UNKNOWN


def test_the_map_says_when_what_was_assumed_has_been_seen():
    ground = GroundMap()
    feed(ground, window(5.0, 7.0, -3.0, 3.0), elevation=MID_360)
    feed(ground, window(5.0, 7.0, -3.0, 3.0), elevation=MID_360)
    version = ground.version
    feed(ground, window(2.0, 4.0, -1.0, 1.0), elevation=MID_360)
    assert ground.version > version
    assert at(ground, 2.0, 0.0) == OCC_FREE


def test_ground_beside_what_is_assumed_to_lie_higher_stays_ground():
    """A robot on an upper deck assumes its own height for the cells of the ramp that it never saw."""
    level = Level.empty(GridSpec(0.1, 40, 40, 0.0, 0.0))
    level.evidence[:], level.heights[:] = 4, 2.2
    level.evidence[10:30, 10:30], level.heights[10:30, 10:30] = kernels.ASSUMED, 2.9
    inside = np.zeros((40, 40), bool)
    inside[10:30, 10:30] = True
    assert (level.occupancy()[~inside] == OCC_FREE).all()
    assert (level.occupancy()[inside] == OCC_ASSUMED).mean() > 0.9
    assert (level.occupancy(OCC_UNKNOWN)[inside] == OCC_UNKNOWN).mean() > 0.9


def test_a_roof_beside_the_ground_is_no_ground():
    ground = GroundMap()
    floor, roof = window(-3.0, 1.0, -3.0, 3.0), window(1.6, 3.0, -1.0, 1.0, 0.9)
    whole = np.zeros((30, 30), np.uint8)
    heights = np.full((30, 30), np.nan, np.float32)
    for part in (floor, roof):
        iy, ix = round((part.origin_y + 3.0) / CELL), round((part.origin_x + 3.0) / CELL)
        ny, nx = part.kinds.shape
        whole[iy : iy + ny, ix : ix + nx], heights[iy : iy + ny, ix : ix + nx] = part.kinds, part.heights
    feed(ground, TerrainWindow(-3.0, -3.0, CELL, whole, np.full((60, 60), -np.inf, np.float32), heights))
    assert at(ground, 0.0, 0.0) == OCC_FREE
    assert at(ground, 2.5, 0.0) == OCC_UNKNOWN


def sloping(x0: float, x1: float, y0: float, y1: float, slope: float = 0.35) -> TerrainWindow:
    """Return ground that rises from 0 m at x = 30 to 3.5 m, and is level before and behind."""
    out = window(x0, x1, y0, y1)
    x = out.origin_x + (np.arange(out.heights.shape[1]) + 0.5) * CELL
    out.heights[:] = np.clip(slope * (30.0 - x), 0.0, 3.5)
    return out


def up_a_ramp(ground: GroundMap, slope: float = 0.35) -> None:
    """Drive along x over a deck at 0 m, and climb back beside it onto another one that is 3.5 m above it."""
    top = 30.0 - round(3.5 / slope)
    for x in np.arange(0.0, 31.0, 1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 2.0), SE3((x, 0.0, 0.0)))
    for x in np.arange(31.0, top, -1.0):
        feed(ground, sloping(x - 4.0, x + 4.0, 4.0, 8.0, slope), SE3((x, 6.0, min(slope * (30.0 - x), 3.5))))
    for x in np.arange(top - 1.0, top - 16.0, -1.0):
        feed(ground, window(x - 6.0, min(x + 6.0, top), -2.0, 8.0, 3.5), SE3((x, 4.0, 3.5)))


def test_an_upper_deck_is_a_level_of_its_own_and_leaves_the_lower_one_alone():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground)
    assert len(ground.levels) == 2
    assert ground.active == 1
    lower, upper = ground.levels
    assert lower.heights[lower.spec.cell_of(10.0, 0.0)] == pytest.approx(0.0, abs=0.01)
    assert upper.heights[upper.spec.cell_of(10.0, 0.0)] == pytest.approx(3.5, abs=0.01)
    ways = {(p.of_level, p.to_level) for p in ground.passages}
    assert ways == {(0, 1), (1, 0)}


def test_both_levels_know_the_ground_around_a_passage():
    """Who changes levels at the end of one stands in what closes it, and finds no way from there."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground, slope=0.15)
    place = ground.passages[0].map_from_base
    for level in (0, 1):
        for x, y in ((0.0, 0.0), (1.2, 0.0), (-1.2, 0.0), (0.0, 1.2), (0.0, -1.2)):
            assert at(ground, place.x + x, place.y + y, level=level) == OCC_FREE, (level, x, y)


def test_the_lower_level_keeps_nothing_of_the_deck():
    """It may lie above floor that the lower level knows, or will."""
    ground = GroundMap(GroundMapConfig(level_cells=100, level_back=1.0))
    up_a_ramp(ground, slope=0.35)
    place = ground.passages[0].map_from_base
    assert 0.35 * (30.0 - place.x) + 0.35 * GroundMapConfig().level_stand > 3.5, "the deck is within reach"
    assert not (ground.levels[0].heights > 3.5 - 0.08).any()


def test_ground_behind_a_wall_does_not_go_on_from_a_place():
    level = Level.empty(GridSpec(0.1, 40, 40, -2.0, -2.0))
    level.evidence[:], level.heights[:] = 4, 0.0
    level.evidence[30, :] = -4
    under = level.ground_under(SE3((0.0, 0.0, 0.0)), 1.6, 0.7)
    assert under[level.spec.cell_of(0.0, -1.5)]
    assert under[level.spec.cell_of(0.0, 0.9)]
    assert not under[level.spec.cell_of(0.0, 1.4)]
    assert not level.ground_under(SE3((0.0, 1.05, 0.0)), 1.6, 0.7).any()
    for x in (-2.05, 2.05):
        assert not level.ground_under(SE3((x, 0.0, 0.0)), 1.6, 0.7).any(), "the level does not reach there"


def test_one_comes_back_to_a_level_that_fits():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground)
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3())
    assert (ground.active, len(ground.levels)) == (0, 2)


def test_a_level_that_is_wanted_is_gone_to_where_both_are_one():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    both = window(0.0, 4.0, -2.0, 2.0)
    feed(ground, both, SE3((2.0, 0.0, 0.0)))
    ground._begin(both, SE2())
    ground.active = 1
    feed(ground, both, SE3((2.0, 0.0, 0.0)))
    ground.wanted = 0
    feed(ground, window(10.0, 14.0, -2.0, 2.0), SE3((12.0, 0.0, 0.0)))
    assert ground.active == 1, "nothing of it is seen here"
    feed(ground, both, SE3((2.0, 0.0, 0.0)))
    assert (ground.active, ground.wanted) == (0, None)


def test_a_level_that_is_wanted_is_not_gone_to_at_its_end():
    """Beyond its end it is closed, and who stands there finds no way; where a passage is known it was on both."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    feed(ground, window(0.0, 4.0, -2.0, 2.0), SE3((2.0, 0.0, 0.0)))
    ground._begin(window(0.0, 8.0, -2.0, 2.0), SE2())
    ground.active = 1
    for x, is_there in ((6.0, False), (3.7, False), (2.6, True)):
        ground.wanted = 0
        feed(ground, window(0.0, 8.0, -2.0, 2.0), SE3((x, 0.0, 0.0)))
        assert (ground.active == 0) == is_there, x
    ground.active, ground.wanted = 1, 0
    ground.passages.append(Passage(1, 0, SE2(3.6, 0.3, 0.0)))
    feed(ground, window(0.0, 8.0, -2.0, 2.0), SE3((3.7, 0.0, 0.0)))
    assert ground.active == 0


def test_the_upper_deck_seen_from_the_ramp_stays_on_its_own_level():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground)
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3())
    assert ground.active == 0
    feed(ground, window(14.0, 20.0, 5.0, 8.0, 3.5), SE3((19.0, 6.0, 3.0)))
    level = ground.levels[0]
    assert np.isnan(level.heights[level.spec.cell_of(15.0, 7.0)])


def deck_over_the_wall(*, is_known: bool) -> GroundMap:
    """Half way up a ramp, a deck is in view over its wall, above the floor that the lower level knows there."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground, slope=0.15)
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3())
    upper = ground.levels[1]
    for (x0, x1, y0, y1), height in (((10.0, 20.0, -2.0, 2.0), 3.5), ((16.2, 17.0, 4.0, 8.0), 2.0)):
        rows, columns = (slice(*(upper.spec.cell_of(x, y)[k] for x, y in ((x0, y0), (x1, y1)))) for k in (0, 1))
        if is_known == (height > 3.0):
            upper.heights[rows, columns], upper.evidence[rows, columns] = height, 4
        else:
            upper.heights[rows, columns], upper.evidence[rows, columns] = np.nan, kernels.UNKNOWN
    assert (ground.active, len(ground.levels)) == (0, 2)
    seen = sloping(10.0, 17.0, -2.0, 8.0, slope=0.15)
    y = seen.origin_y + (np.arange(len(seen.heights)) + 0.5) * CELL
    rises = seen.heights + 0.38 * np.maximum(4.0 - y, 0.0)[:, None]  # as if what is seen hung together
    seen.heights[:] = np.minimum(rises, 3.5)
    for x in (14.5, 13.5):
        feed(ground, seen, SE3((x, 4.2, 0.15 * (30.0 - x))))
    return ground


def test_a_known_deck_beside_the_ramp_begins_no_third_level():
    ground = deck_over_the_wall(is_known=True)
    assert (ground.active, len(ground.levels)) == (0, 2)
    lower = ground.levels[0]
    assert lower.heights[lower.spec.cell_of(13.5, 1.5)] == pytest.approx(0.0, abs=0.01)
    assert lower.heights[lower.spec.cell_of(15.0, 6.0)] == pytest.approx(2.25, abs=0.1)


def test_what_is_known_elsewhere_does_not_explain_a_new_deck():
    assert len(deck_over_the_wall(is_known=False).levels) == 3


def test_some_ground_of_another_level_does_not_change_this_one():
    """Less than makes a level: the first of an upper deck that is seen over the end of a ramp."""
    ground = GroundMap()
    for _ in range(3):
        feed(ground, window(-3.0, 3.0, -3.0, 3.0))
    for _ in range(9):
        feed(ground, window(-1.0, 0.0, 1.0, 2.0, 3.0), SE3((-0.5, 1.5, 3.0)))
    spot = ground.level.spec.cell_of(-0.5, 1.5)
    assert len(ground.levels) == 1
    assert ground.level.heights[spot] == pytest.approx(0.0, abs=0.01)
    assert at(ground, -2.0, -2.0) == OCC_FREE


def test_ground_that_ends_above_other_ground_is_an_end_to_look_at():
    ground = GroundMap(GroundMapConfig(level_cells=10_000))
    feed(ground, window(0.0, 4.0, -2.0, 2.0, 2.0), SE3((2.0, 0.0, 2.0)))
    level = ground.level
    iy, ix = level.spec.cell_of(4.1, 0.0)
    level.evidence[iy - 10 : iy + 10, ix : ix + 10], level.heights[iy - 10 : iy + 10, ix : ix + 10] = 4, 0.0
    assert at(ground, 3.5, 0.0) == OCC_FREE
    assert at(ground, 3.95, 0.0) == OCC_FREE
    assert at(ground, 4.2, 0.0) == OCC_UNKNOWN
    assert at(ground, 4.8, 0.0) == OCC_FREE


def test_what_another_level_knows_beyond_shared_ground_is_closed():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    both = window(0.0, 4.0, -2.0, 2.0)
    feed(ground, both, SE3((2.0, 0.0, 0.0)))
    ground._begin(both, SE2())
    ground.active = 1
    feed(ground, window(0.0, 8.0, -2.0, 2.0), SE3((2.0, 0.0, 0.0)))
    assert at(ground, 4.5, 0.0, level=0) == OCC_OCCUPIED
    assert at(ground, 7.5, 0.0, level=0) == OCC_UNKNOWN
    assert at(ground, 4.5, 0.0, level=1) == OCC_FREE


def of_kind(kind: Ground, x0: float, x1: float, y0: float, y1: float, height: float = 0.0) -> TerrainWindow:
    """Return a window whose cells are of a kind other than ground, without anything that stands on them."""
    xs, ys = np.arange(x0 + 0.1, x1, CELL), np.arange(y0 + 0.1, y1, CELL)
    x, y = (a.ravel() for a in np.meshgrid(xs, ys))
    points = np.column_stack((x, y, np.full(len(x), height))).astype(np.float32)
    above = np.full(len(x), 0.3, np.float32)
    return TerrainWindow.of_points(points, above, np.full(len(x), kind, np.uint8), CELL, STEP)


@pytest.mark.parametrize("kind", [Ground.DROP, Ground.STEEP, Ground.OBSTACLE])
def test_where_a_robot_has_stood_there_is_ground_whatever_the_terrain_says_later(kind):
    ground = GroundMap()
    feed(ground, window(-6.0, 6.0, -3.0, 3.0))
    for _ in range(9):
        feed(ground, of_kind(kind, -3.0, 3.0, -3.0, 3.0), SE3((3.0, 0.0, 0.0)))
    assert at(ground, 0.0, 0.0) == OCC_FREE, "below the robot"
    level = ground.level
    assert level.firm[level.spec.cell_of(0.0, 0.0)] == kernels.STOOD
    assert level.firm[level.spec.cell_of(0.0, 1.5)] == 1
    assert at(ground, 0.0, 1.5) == OCC_FREE, "beside it, in the plane of its wheels"
    assert at(ground, 1.5, 0.0) == OCC_OCCUPIED, "there it has not been"


def test_ground_beside_a_robot_that_lies_lower_than_its_wheels_is_not_firm():
    ground = GroundMap()
    feed(ground, window(-3.0, 3.0, -3.0, 0.8))
    feed(ground, window(-3.0, 3.0, 0.8, 3.0, -0.12))
    for _ in range(9):
        feed(ground, of_kind(Ground.DROP, -3.0, 3.0, 0.4, 1.4), SE3((2.5, 0.0, 0.0)))
    assert at(ground, 0.0, 0.7) == OCC_FREE
    assert at(ground, 0.0, 0.9) == OCC_OCCUPIED, "a kerb"


def test_who_stands_where_the_robot_has_stood_is_in_the_way():
    ground = GroundMap()
    feed(ground, window(-6.0, 6.0, -3.0, 3.0))
    for _ in range(3):
        feed(ground, window(-3.0, 3.0, -3.0, 3.0, 0.0, [(0.05, 0.05)]), SE3((2.0, 0.0, 0.0)))
    assert at(ground, 0.05, 0.05) == OCC_OCCUPIED


def test_a_drop_seen_from_afar_is_looked_at_and_one_seen_from_near_is_believed():
    for away, expected in ((6.0, OCC_UNKNOWN), (2.0, OCC_OCCUPIED)):
        ground = GroundMap()
        feed(ground, window(-2.0, 6.0, -2.0, 2.0))
        feed(ground, of_kind(Ground.DROP, 6.0, 7.0, -2.0, 2.0), SE3((6.5 - away, 0.0, 0.0)))
        assert at(ground, 6.5, 0.0) == expected


def test_a_deck_seen_from_the_ramp_is_given_back_when_the_robot_comes_below_it():
    """It is of the level that goes on beside it, and no third one."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground)
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3())
    lower, upper = ground.levels
    rows, columns = (slice(*sorted(lower.spec.cell_of(x, y)[k] for x, y in ((-6.0, 3.0), (0.0, 7.0)))) for k in (0, 1))
    assert np.isnan(lower.heights[rows, columns]).all()
    lower.heights[rows, columns], lower.evidence[rows, columns] = 3.5, 4
    for x in np.arange(-1.0, -5.0, -1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 8.0), SE3((x, 4.0, 0.0)))
    assert len(ground.levels) == 2
    assert ground.active == 0
    assert ground.levels[0].heights[ground.levels[0].spec.cell_of(-3.0, 5.0)] == pytest.approx(0.0, abs=0.01)
    assert upper.heights[upper.spec.cell_of(-1.0, 5.0)] == pytest.approx(3.5, abs=0.01)


def test_a_deck_on_which_the_robot_has_stood_is_not_given_away():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground)
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3())
    lower = ground.levels[0]
    rows, columns = (slice(*sorted(lower.spec.cell_of(x, y)[k] for x, y in ((-6.0, 3.0), (0.0, 7.0)))) for k in (0, 1))
    lower.heights[rows, columns], lower.evidence[rows, columns], lower.firm[rows, columns] = 3.5, 4, 1
    for x in np.arange(-1.0, -5.0, -1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 8.0), SE3((x, 4.0, 0.0)))
    assert len(ground.levels) == 3


def test_a_new_level_takes_along_what_was_seen_of_it_before():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    for x in np.arange(0.0, 20.0, 1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 2.0), SE3((x, 0.0, 0.0)))
    feed(ground, window(14.0, 26.0, 3.0, 13.0, 3.5), SE3((20.0, 8.0, 3.5)))
    for x in np.arange(19.0, 4.0, -1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 8.0, 3.5), SE3((x, 4.0, 3.5)))
    lower, upper = ground.levels
    assert upper.heights[upper.spec.cell_of(25.0, 12.0)] == pytest.approx(3.5, abs=0.01)
    assert np.isnan(lower.heights[lower.spec.cell_of(25.0, 12.0)])


def test_a_new_level_takes_along_islands_of_it_and_leaves_what_goes_on_below():
    """Where nothing of the deck was seen between the robot and an island of it, the island would stand in the level below it, and hide that."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    for x in np.arange(0.0, 20.0, 1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 2.0), SE3((x, 0.0, 0.0)))
    feed(ground, window(14.0, 26.0, 3.0, 13.0, 3.5), SE3((20.0, 8.0, 3.5)))
    lower = ground.levels[0]

    def cells(x0: float, x1: float) -> tuple[slice, slice]:
        (y0, a), (y1, b) = lower.spec.cell_of(x0, 5.0), lower.spec.cell_of(x1, 7.0)
        return slice(y0, y1), slice(a, b)

    island, hill = cells(1.0, 2.0), cells(4.0, 9.0)
    for patch in (island, hill):
        lower.evidence[patch], lower.heights[patch] = 4, 3.5
    lower.heights[hill][:, :20] = np.linspace(2.5, 3.5, 20)
    feed(ground, window(9.0, 20.0, -2.0, 8.0, 3.5), SE3((15.0, 4.0, 3.5)))
    lower, upper = ground.levels
    assert np.isnan(lower.heights[island]).all()
    assert upper.heights[upper.spec.cell_of(1.5, 6.0)] == pytest.approx(3.5)
    assert lower.heights[lower.spec.cell_of(8.5, 6.0)] == pytest.approx(3.5), "a hill is no deck"


def test_the_level_on_which_a_robot_began_keeps_its_number_whatever_was_drawn_into_it():
    """What was seen from a ramp stands above the lower deck: that becomes a level of its own, and home with it."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    for x in np.arange(0.0, 20.0, 1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 2.0), SE3((x, 0.0, 0.0)))
    lower = ground.levels[0]
    (y0, x0), (y1, x1) = lower.spec.cell_of(10.0, 2.2), lower.spec.cell_of(13.0, 4.0)
    lower.evidence[y0:y1, x0:x1], lower.heights[y0:y1, x0:x1] = 4, 3.5
    ground.passages = [Passage(0, 7, SE2(5.0, 0.0, 0.0)), Passage(7, 0, SE2(11.5, 3.0, 0.0))]
    feed(ground, window(6.0, 18.0, -2.0, 4.0), SE3((11.5, 1.0, 0.0)))
    assert (len(ground.levels), ground.active) == (2, 0)
    began, above = ground.levels
    assert began.is_ground(SE2())
    assert not above.is_ground(SE2())
    assert above.heights[above.spec.cell_of(11.5, 3.0)] == pytest.approx(3.5)
    ways = [(p.of_level, p.to_level) for p in ground.passages]
    assert ways == [(0, 7), (7, 1), (1, 0), (0, 1)]


def test_where_two_levels_meet_is_remembered_as_a_passage():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground)
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3())
    known = len(ground.passages)
    upper = ground.levels[1]
    rows, columns = (slice(*sorted(upper.spec.cell_of(x, y)[k] for x, y in ((-1.0, -3.0), (7.0, 4.0)))) for k in (0, 1))
    upper.heights[rows, columns], upper.evidence[rows, columns] = 0.0, 4
    upper.evidence[upper.spec.cell_of(3.0, 1.0)[0] :, columns] = kernels.UNKNOWN
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3((1.5, 0.5, 0.0)))
    assert len(ground.passages) == known, "the upper level ends beside the robot"
    upper.evidence[rows, columns] = 4
    feed(ground, window(-6.0, 6.0, -2.0, 2.0), SE3((3.0, 0.5, 0.0)))
    assert {(p.of_level, p.to_level) for p in ground.passages[known:]} == {(0, 1), (1, 0)}
    assert ground.passages[-1].map_from_base.x == pytest.approx(3.0)


def test_firm_ground_is_told_in_odom_where_the_robot_has_been():
    ground = GroundMap()
    shifted = SE3((10.0, -4.0, 1.0))
    base = SE3((0.5, 0.0, 0.2))
    ground.update(window(-6.0, 6.0, -3.0, 3.0, 0.2), shifted, base, base @ LEVEL_LIDAR, ALL_ROUND)
    points = ground.remembered(shifted, base)
    ahead, beside = np.abs(points[:, 0] - 0.5), np.abs(points[:, 1])
    assert 0.8 * 4.0 * 0.2 * 2.5 < 0.01 * len(points) <= 1.2 * 4.0 * 0.2 * 2.5
    assert ahead.max() < 0.26
    assert 2.3 < beside.max() < 2.6
    np.testing.assert_allclose(points[:, 2], 0.2, atol=1e-5)


def test_a_level_lidar_sees_no_floor_near_itself_but_the_robot_stands_on_another_level():
    ground = GroundMap(GroundMapConfig(level_cells=100))
    for x in np.arange(0.0, 31.0, 1.0):
        feed(ground, window(x - 6.0, x + 6.0, -2.0, 8.0), SE3((x, 0.0, 0.0)))
    feed(ground, window(19.5, 20.0, 1.0, 7.0, 3.5), SE3((14.0, 4.0, 3.5)), MID_360)
    assert len(ground.levels) == 2
    assert ground.active == 1


def test_single_cells_that_were_not_seen_are_ground_and_wider_holes_are_not():
    ground = GroundMap()
    feed(ground, window(-3.0, 3.0, -3.0, 3.0))
    level = ground.level
    for x, y, half in ((1.0, 0.5, 1), (-1.0, 1.5, 4)):
        iy, ix = level.spec.cell_of(x, y)
        level.evidence[iy - half : iy + half, ix - half : ix + half] = kernels.UNKNOWN
    level.evidence[level.spec.cell_of(1.05, -1.45)] = -3
    assert at(ground, 1.0, 0.5) == OCC_FREE
    assert at(ground, -1.0, 1.5) == OCC_UNKNOWN
    assert at(ground, 1.05, -1.45) == OCC_OCCUPIED, "what is in the way is never a hole"


@pytest.mark.parametrize(("height", "is_free"), [(0.0, True), (-3.0, False)])
def test_a_hole_that_another_level_knows_is_ground_where_it_lies_as_high_as_what_is_around(height, is_free):
    """The ramp between two decks, of which one saw what the other did not; and a shaft through which the deck below is seen."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    both = window(-4.0, 4.0, -3.0, 3.0)
    feed(ground, both)
    ground._begin(both, SE2())
    ground.active = 1
    feed(ground, both)
    upper, lower = ground.levels
    iy, ix = upper.spec.cell_of(2.0, 1.5)
    hole = np.s_[iy - 6 : iy + 6, ix - 6 : ix + 6]
    upper.evidence[hole], upper.heights[hole] = kernels.UNKNOWN, np.nan
    lower.heights[hole] = height
    upper.evidence[:, ix + 12 :], upper.heights[:, ix + 12 :] = kernels.UNKNOWN, np.nan
    lower.evidence[hole], lower.heights[:, : ix - 12] = 4, np.nan
    assert (at(ground, 2.0, 1.5, level=0) == OCC_FREE) is is_free


def test_on_ground_of_two_levels_the_robot_stays_on_the_one_it_wanted_whatever_speaks_against_it():
    """Near the top of a ramp the deck that is seen there speaks against the lower level: it belongs to the other one."""
    ground = GroundMap(GroundMapConfig(level_cells=100))
    up_a_ramp(ground)
    ground.wanted = 0
    lower, x = ground.levels[0], 23.0
    iy, ix = lower.spec.cell_of(x - 2.0, 4.5)
    lower.evidence[iy : iy + 30, ix : ix + 10], lower.heights[iy : iy + 30, ix : ix + 10] = 4, -2.0  # 300 cells
    for _ in range(3):
        feed(ground, sloping(x - 4.0, x + 4.0, 4.0, 8.0), SE3((x, 6.0, 0.35 * (30.0 - x))))
        assert ground.active == 0
    feed(ground, window(12.0, 18.0, 4.0, 8.0, 3.5), SE3((15.0, 6.0, 3.5)))
    assert ground.active == 1, "it stands on the deck, which the lower level does not know"


def merged_twin(
    seen: TerrainWindow,
    pose: SE2,
    evidence: np.ndarray,
    spec: tuple[float, float, float],
    clear_most: float,
    sensor: tuple[float, float, float],
    lowest: float,
    reaches: np.ndarray,
) -> np.ndarray:
    """What `merge` does, cell by cell, where a level sensor has told no height yet."""
    out = evidence.copy()
    back = pose.inverse()
    for iy, ix in np.ndindex(out.shape):
        x, y = spec[0] + (ix + 0.5) * spec[2], spec[1] + (iy + 0.5) * spec[2]
        px, py = back.transform(np.array([[x, y]]))[0]
        u, v = (px - seen.origin_x) / seen.cell, (py - seen.origin_y) / seen.cell
        if not (0.0 <= u < seen.kinds.shape[1] and 0.0 <= v < seen.kinds.shape[0]):
            continue
        kind = seen.kinds[int(v), int(u)]
        if kind == 0:
            continue
        count = 0 if out[iy, ix] == kernels.UNKNOWN else int(out[iy, ix])
        is_open = kind == Ground.GROUND and seen.tops[int(2 * v), int(2 * u)] == -np.inf
        if is_open and out[iy, ix] <= 0 and passes_below(seen, sensor, int(u), int(v)):
            continue
        if is_open and kernels.UNKNOWN < out[iy, ix] <= 0:
            head = np.array([x, y, max(0.02, reaches[iy, ix] - 0.4)])
            line = np.append(pose.inverse().transform(head[None, :2])[0], head[2]) - sensor
            is_hidden = math.atan2(line[2], math.hypot(*line[:2])) < lowest and reaches[iy, ix] > -np.inf
            if is_hidden or math.hypot(x, y) > clear_most:
                continue
        out[iy, ix] = min(count + 1, 4) if is_open else max(count - 3, -6)
    return out


def passes_below(seen: TerrainWindow, sensor: tuple[float, float, float], ix: int, iy: int) -> bool:
    """Whether a sensor sees a cell of a window below what stands in it."""
    x, y = seen.origin_x + (ix + 0.5) * seen.cell, seen.origin_y + (iy + 0.5) * seen.cell
    z, half = float(seen.heights[iy, ix]), 0.5 * seen.cell
    count = int(math.hypot(x - sensor[0], y - sensor[1]) / half) + 1
    for k in range(count):
        px, py, pz = np.array(sensor) + (np.array([x, y, z]) - sensor) * k / count
        jx, jy = math.floor((px - seen.origin_x) / half), math.floor((py - seen.origin_y) / half)
        if 0 <= jy < seen.tops.shape[0] and 0 <= jx < seen.tops.shape[1] and seen.tops[jy, jx] > pz + 0.05:
            return True
    return False


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_merge_is_its_twin(seed):
    rng = np.random.default_rng(seed)
    kinds = rng.choice([0, 1, 2, 3, 4], (12, 9)).astype(np.uint8)
    tops = np.where(rng.random((24, 18)) < 0.05, rng.uniform(-0.5, 1.0, (24, 18)), -np.inf).astype(np.float32)
    seen = TerrainWindow(-1.0, -1.2, CELL, kinds, tops, rng.normal(size=(12, 9), scale=0.1).astype(np.float32))
    pose = SE2(*rng.uniform(-0.5, 0.5, 2), float(rng.uniform(-3.0, 3.0)))
    evidence = rng.choice([kernels.UNKNOWN, -6, -2, 1, 4], (40, 40)).astype(np.int8)
    spec = (-2.0, -2.0, 0.1)
    clear_most = float(rng.choice([0.8, np.inf]))
    sensor = (*rng.uniform(-1.0, 0.5, 2), float(rng.choice([0.4, 5.0])))
    reaches = np.where(rng.random((40, 40)) < 0.5, rng.uniform(0.9, 2.0, (40, 40)), -np.inf).astype(np.float32)
    lowest = float(rng.uniform(-0.9, -0.1))
    expected = merged_twin(seen, pose, evidence, spec, clear_most, sensor, lowest, reaches)
    back = pose.inverse()
    turn = np.array([math.cos(back.yaw), math.sin(back.yaw), back.x, back.y])
    box, heights = np.array([0, 40, 0, 40]), np.zeros((40, 40), np.float32)
    firm = np.zeros((40, 40), np.uint8)
    args = (
        turn,
        0.0,
        np.zeros(2),
        np.array(sensor),
        np.eye(3),
        math.sin(lowest),
        np.array([np.inf, np.inf, 9.0, clear_most]),
        np.array(spec),
        box,
        evidence,
        heights,
        firm,
        reaches,
    )
    kernels.merge(seen.kinds, seen.tops, seen.heights, seen.origin, *args)
    np.testing.assert_array_equal(evidence, expected)


def test_bad_input_is_refused():
    with pytest.raises(BadInputError, match="resolution"):
        GroundMapConfig(resolution=0.0)
    with pytest.raises(BadInputError, match="2 points"):
        TerrainWindow.of_points(
            np.zeros((2, 3), np.float32), np.zeros(1, np.float32), np.zeros(2, np.uint8), CELL, STEP
        )
    with pytest.raises(BadInputError, match="no level"):
        _ = GroundMap().level


def test_single_cells_of_a_deck_in_the_level_below_it_give_way_and_a_deck_does_not():
    ground = GroundMap()
    feed(ground, window(-3.0, 3.0, -3.0, 3.0))
    level = ground.level
    lone, deck = level.spec.cell_of(1.0, 1.0), level.spec.cell_of(-2.0, 0.0)
    level.heights[lone], level.firm[lone] = 3.0, 1
    is_deck = np.s_[deck[0] - 5 : deck[0] + 5, deck[1] - 5 : deck[1] + 5]
    level.heights[is_deck] = 3.0
    feed(ground, window(-3.0, 3.0, -3.0, 3.0), SE3((0.0, 0.0, 0.0)))
    assert level.heights[lone] == pytest.approx(0.0, abs=0.05)
    assert level.firm[lone] == 0
    assert (level.heights[is_deck] == 3.0).mean() > 0.7
