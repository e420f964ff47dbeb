"""Maps of sites against the truth: each number moves when the map lacks what it counts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.site_quality import SiteRecord, judge_site
from ambler.evaluation.site_tour import cover, known_tour_length, round_length
from ambler.sim.reachable_ground import GroundRules, ReachableGround, VisibleSurface, reachable_ground, visible_surface
from ambler.sim.solids import Shape, Solid, WorldSpec

WALLS = tuple(
    Solid("wall", Shape.BOX, SE2(x, y, 0.0), sx, sy, 0.0, 2.0)
    for x, y, sx, sy in ((0.0, -5.1, 20.4, 0.2), (0.0, 5.1, 20.4, 0.2), (-10.1, 0.0, 0.2, 10.0), (10.1, 0.0, 0.2, 10.0))
)
WORLD = WorldSpec("room", WALLS, SE2(1.0, 0.0, 0.3))


@pytest.fixture(scope="module")
def truth() -> tuple[ReachableGround, VisibleSurface]:
    ground = reachable_ground(WORLD, WORLD.start, GroundRules(0.3, 0.8))
    return ground, visible_surface(ground, 0.5, 15.0, spacing=3.0)


def record(surface: VisibleSurface, bend: float = 0.0) -> SiteRecord:
    """A run that saw everything; its map begins at the start pose, and its way is bent by `bend` metres in the middle."""
    world_from_map = SE3.from_se2(WORLD.start)
    stamps = np.arange(40) * 100_000_000
    angles = np.linspace(0.0, 2.0 * math.pi, 40)
    true = [SE3.from_se2(SE2(1.0 + 3.0 * math.sin(a), 3.0 - 3.0 * math.cos(a), 0.3 + a)) for a in angles]
    back = world_from_map.inverse()
    off = [SE3((bend * math.sin(0.5 * a), 0.0, 0.0)) for a in angles]
    poses = [shift @ back @ pose for shift, pose in zip(off, true, strict=True)]
    return SiteRecord(stamps, poses, stamps, true, np.asarray(back.transform(surface.points)))


def level(free_to: float = 9.9, height: float = 0.0, beyond: float = 0.0):
    """A map of the room in the frame of the start; ground up to x = `free_to` in the world, and `beyond` metres of it behind the wall."""
    spec = GridSpec(0.1, 280, 280, -14.0, -14.0)
    iy, ix = np.mgrid[0:280, 0:280]
    xy = WORLD.start.transform(spec.centers_of(np.column_stack((iy.ravel(), ix.ravel())))).reshape(280, 280, 2)
    inside = (np.abs(xy[..., 1]) < 4.9) & (xy[..., 0] > -9.9) & (xy[..., 0] < free_to + beyond)
    occupancy = np.where(inside, 0, -1).astype(np.int8)
    return spec, occupancy, np.where(inside, height, np.nan).astype(np.float32)


def test_a_whole_map_is_whole(truth):
    quality = judge_site(record(truth[1]), [level()], truth[0], truth[1].points)
    assert quality.ground_coverage > 0.999
    assert quality.surface_coverage == 1.0
    assert quality.false_ground < 0.001
    assert quality.error.ate_rms_m < 1e-6
    assert quality.reachable_m2 == pytest.approx(19.4 * 9.4, rel=0.05)


def test_what_is_missing_counts(truth):
    ground, surface = truth
    seen = record(surface)
    half = SiteRecord(
        seen.stamps_ns, seen.poses, seen.true_ns, seen.true_poses, seen.points[::2][: len(seen.points) // 4]
    )
    quality = judge_site(half, [level(0.0)], ground, surface.points)
    assert quality.ground_coverage == pytest.approx(0.5, abs=0.03)
    assert quality.surface_coverage < 0.8
    assert len(quality.missed) == pytest.approx((1.0 - quality.ground_coverage) * len(ground.places()), abs=1)


def test_ground_of_another_level_and_ground_behind_walls_do_not_count(truth):
    ground, surface = truth
    assert judge_site(record(surface), [level(height=2.0)], ground, surface.points).ground_coverage == 0.0
    quality = judge_site(record(surface), [level(beyond=3.0)], ground, surface.points)
    assert quality.false_ground == pytest.approx(2.7 / 22.8, rel=0.25)


def test_a_bent_way_is_told(truth):
    quality = judge_site(record(truth[1], 0.4), [level()], truth[0], truth[1].points)
    assert 0.1 < quality.error.start_rms_m < 0.5


def test_the_round_of_who_knows_the_site(truth):
    ground, surface = truth
    chosen = cover(surface)
    seen = np.unique(np.concatenate([surface.seen[k] for k in chosen]))
    assert len(seen) >= 0.98 * len(surface.points)
    assert len(chosen) < 0.7 * len(surface.eyes)
    length = known_tour_length(ground, surface, np.array([1.0, 0.0, 0.0]))
    assert 10.0 < length < 80.0


def test_a_round_is_as_short_as_the_best_of_all_orders():
    from itertools import permutations

    rng = np.random.default_rng(3)
    places = rng.uniform(0.0, 10.0, (7, 2))
    legs = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    best = min(sum(legs[a, b] for a, b in zip((0, *p), (*p, 0), strict=True)) for p in permutations(range(1, 7)))
    assert best <= round_length(legs) <= 1.05 * best
    assert round_length(legs[:1, :1]) == 0.0
