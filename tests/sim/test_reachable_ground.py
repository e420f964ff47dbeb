"""Ground that a robot reaches, and surfaces that are visible from there: on made worlds whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.meshes import TriangleMesh
from ambler.sim.reachable_ground import GroundRules, reachable_ground, visible_surface
from ambler.sim.solids import Shape, Solid, WorldSpec

RULES = GroundRules(radius=0.3, clearance=0.8)


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> Solid:
    return Solid("box", Shape.BOX, SE2(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0), x1 - x0, y1 - y0, z0, z1)


def two_decks(slope_deg: float) -> WorldSpec:
    """A deck of 6 x 6 m, 2 m above another; a ramp beside them leads up."""
    run = 2.0 / math.tan(math.radians(slope_deg))
    corners = np.array([[6.0 - run, 6.0, 0.0], [6.0, 6.0, 2.0], [6.0, 9.0, 2.0], [6.0 - run, 9.0, 0.0]])
    ramp = TriangleMesh("ramp", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    low = 6.0 - run
    solids = (
        box(0.0, 6.0, 0.0, 6.0, 1.8, 2.0),
        box(6.0, 9.0, 0.0, 9.0, 0.0, 2.0),
        *(box(low - 2.2, 9.2, y - 0.2, y, 0.0, 4.0) for y in (0.0, 9.2)),
        *(box(x, x + 0.2, 0.0, 9.0, 0.0, 4.0) for x in (low - 2.2, 9.0)),
    )
    return WorldSpec("decks", solids, SE2(1.0, 3.0, 0.0), meshes=(ramp,))


def test_both_decks_are_reached_over_a_ramp_that_is_not_too_steep():
    world = two_decks(12.0)
    places = reachable_ground(world, world.start, RULES).places()
    upper = places[(places[:, 2] > 1.9) & (places[:, 0] < 5.0) & (places[:, 1] < 5.0)]
    lower = places[(places[:, 2] < 0.1) & (places[:, 0] < 5.0) & (places[:, 1] < 5.0) & (places[:, 0] > 1.0)]
    assert len(upper) * 0.01 == pytest.approx(5.0 * 4.7, rel=0.15)
    assert len(lower) > 1000


def test_a_steep_ramp_a_kerb_and_a_low_roof_stop_the_robot():
    world = two_decks(30.0)
    assert reachable_ground(world, world.start, RULES).places()[:, 2].max() < 0.5
    kerb = WorldSpec("kerb", (box(2.0, 12.0, -5.0, 5.0, 0.0, 0.12), box(-5.2, -5.0, -5.0, 5.0, 0.0, 1.0)), SE2())
    assert reachable_ground(kerb, kerb.start, RULES).places()[:, 0].max() < 1.8
    roof = WorldSpec("roof", (box(2.0, 5.0, -5.0, 5.0, 0.5, 0.6), box(-5.2, -5.0, -5.0, 5.0, 0.0, 1.0)), SE2())
    assert reachable_ground(roof, roof.start, RULES).places()[:, 0].max() < 1.8


def test_a_start_in_a_wall_is_refused():
    world = two_decks(12.0)
    with pytest.raises(BadInputError, match="cannot stand"):
        reachable_ground(world, SE2(9.1, 3.0, 0.0), RULES)


def test_the_far_side_of_a_wall_is_visible_only_where_the_robot_gets_there():
    def world(gap: float) -> WorldSpec:
        walls = (
            *(box(-4.2, 8.2, y - 0.1, y + 0.1, 0.0, 2.0) for y in (-4.1, 4.1)),
            *(box(x - 0.1, x + 0.1, -4.0, 4.0, 0.0, 2.0) for x in (-4.1, 8.1)),
            box(1.9, 2.1, -4.0, 4.0 - gap, 0.0, 2.0),
        )
        return WorldSpec("rooms", walls, SE2())

    for gap, is_seen in ((0.0, False), (1.5, True)):
        place = world(gap)
        surface = visible_surface(reachable_ground(place, place.start, RULES), 0.5, 10.0, spacing=1.0)
        far = surface.points[(surface.points[:, 0] > 2.3) & (surface.points[:, 2] > 0.1)]
        assert (len(far) > 200) == is_seen
        seen = np.unique(np.concatenate(surface.seen))
        np.testing.assert_array_equal(seen, np.arange(len(surface.points)))
