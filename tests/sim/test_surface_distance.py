"""Distances of points from the surfaces of a world, against what geometry says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.sim.scene import build_scene
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.surface_distance import surface_distances

SLANTED = SE2(3.0, 1.0, math.radians(35.0))
BOX = Solid("box", Shape.BOX, SLANTED, 2.0, 1.0, 0.0, 2.0)
SCENE = build_scene(WorldSpec("place", (BOX,), SE2()))


@pytest.mark.parametrize("away", [0.0, 0.004, 0.1, -0.03])
def test_points_beside_a_slanted_wall_and_over_the_floor(away: float) -> None:
    rng = np.random.default_rng(5)
    along, up = rng.uniform(-0.6, 0.6, 200), rng.uniform(0.5, 1.5, 200)
    wall = SLANTED.transform(np.column_stack([along, np.full(200, 0.5 + away)]))
    found = surface_distances(SCENE, np.column_stack([wall, up]))
    assert found == pytest.approx(np.full(200, abs(away)), abs=1e-6)
    floor = np.column_stack([rng.uniform(-6.0, -3.0, (200, 2)), np.full(200, away)])
    assert surface_distances(SCENE, floor) == pytest.approx(np.full(200, abs(away)), abs=1e-6)


def test_what_is_farther_than_is_looked_for_is_nowhere() -> None:
    points = np.array([[-5.0, -5.0, 1.2], [-5.0, -5.0, 0.4]])
    assert surface_distances(SCENE, points, reach=1.0).tolist() == [math.inf, 0.4]
