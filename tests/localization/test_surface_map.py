"""Surfaces of maps that a robot made: a wall at an angle, drawn twice and specked, tells nothing of a place along it; its end does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.localization.matcher import MatcherConfig, ScanMatcher
from ambler.localization.surface_map import SurfaceMap, without_slivers

SPEC = GridSpec(0.05, 500, 500, -12.5, -12.5)
HALF = 1.2  # metres from the middle of the corridor to its walls
THICK = 0.2  # metres of a wall


def made_corridor(yaw: float, seed: int, *, door: float | None = None) -> NDArray[np.int8]:
    """A corridor of 20 m through the origin, as two visits draw it; the left wall ends at `door` metres and goes on 2 m later."""
    rng, cells = np.random.default_rng(seed), np.full(SPEC.shape, -1, np.int8)
    y, x = np.mgrid[0:500, 0:500] * 0.05 - 12.475
    u, v = math.cos(yaw) * x + math.sin(yaw) * y, -math.sin(yaw) * x + math.cos(yaw) * y
    is_inside = (np.abs(u) < 10.0) & (np.abs(v) < HALF + 0.1)
    cells[is_inside] = 0
    along = rng.uniform(-10.0, 10.0, 30000)
    side = np.where(rng.random(30000) < 0.5, 1.0, -1.0)
    visit = np.where(np.sin(0.9 * along) > 0.3, 0.06, 0.0)  # here and there the second one drew the wall farther out
    across = side * (HALF + visit * (rng.random(30000) < 0.5) + rng.normal(0.0, 0.02, 30000))
    if door is not None:
        open_here = (side > 0.0) & (along > door) & (along < door + 2.0)
        along, across = along[~open_here], across[~open_here]
        cells[(u > door) & (u < door + 2.0) & (v > 0.0) & (v < HALF + 1.5)] = 0
        jamb = np.stack((np.full(400, door), rng.uniform(HALF, HALF + THICK, 400)))
        along, across = np.append(along, jamb[0]), np.append(across, jamb[1])
    px, py = math.cos(yaw) * along - math.sin(yaw) * across, math.sin(yaw) * along + math.cos(yaw) * across
    index = SPEC.cells_of(np.stack((px, py), axis=1))
    hits = np.zeros(SPEC.shape, np.int32)
    np.add.at(hits, (index[:, 0], index[:, 1]), 1)
    cells[hits >= 3] = 100
    return cells


def scan(yaw: float, *, door: float | None = None) -> NDArray[np.float32]:
    """What a scanner at the origin sees of it, looking along it: 720 beams."""
    rng, angle = np.random.default_rng(7), np.linspace(-math.pi, math.pi, 720, endpoint=False)
    with np.errstate(divide="ignore"):
        reach = np.where(np.abs(np.sin(angle)) > 0.0, HALF / np.abs(np.sin(angle)), np.inf)
    u = reach * np.cos(angle)
    if door is not None:
        through = (np.sin(angle) > 0.0) & (u > door) & (u < door + 2.0)
        to_jamb = np.where(np.cos(angle) < 0.0, door / np.minimum(np.cos(angle), -1e-9), 99.0)
        reach = np.where(through, np.where(to_jamb * np.sin(angle) < HALF + THICK, to_jamb, np.inf), reach)
    reach = reach + rng.normal(0.0, 0.01, 720)
    seen = reach < 9.0
    return np.stack((reach[seen] * np.cos(angle[seen]), reach[seen] * np.sin(angle[seen])), axis=1).astype(np.float32)


@pytest.mark.parametrize("yaw", [0.0, 0.32, 0.6, 1.9, -2.5])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_steps_and_specks_of_a_wall_at_an_angle_tell_of_no_place_along_it(yaw: float, seed: int) -> None:
    surfaces = SurfaceMap.from_occupancy(made_corridor(yaw, seed), SPEC)
    matcher = ScanMatcher(surfaces, MatcherConfig())
    points = matcher.thin(scan(yaw))
    along = np.array([math.cos(yaw), math.sin(yaw), 0.0, 0.0])
    for offset in (-0.4, -0.15, 0.1, 0.3):
        begin = np.array([offset * along[0], offset * along[1], yaw, 0.0])
        match = matcher.match(points, begin[None], 0.01)
        told = float(along @ match.full @ along) / float(np.trace(match.full[:2, :2]))
        assert match.score > 0.8
        assert told < 0.03, "a place along it seems to be known"
        assert abs(float((match.state - begin) @ along)) < 0.1, "the robot would be dragged along"


@pytest.mark.parametrize("yaw", [0.0, 0.32, 1.9])
def test_the_end_of_a_wall_still_tells_of_the_place_along_it(yaw: float) -> None:
    surfaces = SurfaceMap.from_occupancy(made_corridor(yaw, 4, door=-1.5), SPEC)
    matcher = ScanMatcher(surfaces, MatcherConfig())
    points = matcher.thin(scan(yaw, door=-1.5))
    for offset in (-0.05, 0.05):
        begin = SE2(0.0, 0.0, yaw) @ SE2(offset, 0.0)
        match = matcher.match(points, begin.as_array()[None] @ np.eye(3, 4), 0.01)
        assert match.determined == 3
        assert math.hypot(match.state[0], match.state[1]) < 0.06


@pytest.mark.parametrize("yaw", [0.0, 0.32, 0.78, 1.9])
def test_a_wall_that_was_mapped_from_one_side_has_no_face_towards_the_other(yaw: float) -> None:
    """Noise leaves free cells behind it; a robot in the room behind would take the wall for as thin as that."""
    cells = made_corridor(yaw, 5)
    surfaces = SurfaceMap.from_occupancy(cells, SPEC).surfaces
    u = math.cos(yaw) * surfaces[:, 0] + math.sin(yaw) * surfaces[:, 1]
    v = -math.sin(yaw) * surfaces[:, 0] + math.cos(yaw) * surfaces[:, 1]
    inwards = -np.sign(v) * (-math.sin(yaw) * surfaces[:, 2] + math.cos(yaw) * surfaces[:, 3])
    of_walls = (np.abs(u) < 9.0) & (np.abs(v) > 1.0)
    assert (inwards[of_walls] > 0.0).mean() > 0.99
    assert of_walls.sum() > 2 * 18.0 / SPEC.resolution, "each step of both walls has its face"


def test_floor_between_things_that_stand_close_is_no_face_and_a_niche_is() -> None:
    cells = np.zeros((60, 60), np.int8)
    cells[20:40, 20:30] = cells[20:40, 32:42] = 100  # two boxes, a gap of 0.1 m between them
    cells[5:12, 0:25] = 100
    cells[8:12, 10:14] = 0  # a niche of 0.2 m, 0.2 m deep
    free = without_slivers(cells, 50, 3)
    assert (free[24:36, 30:32] == -1).all()
    assert (free[8:12, 10:14] == 0).all()
