"""Clouds of stations against the world: every number moves when what it tells of is worse."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.station_quality import StationQuality, judge_stations
from ambler.sim.scene import build_scene
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.wire.station_files import StationCloud

WALLS = tuple(
    Solid("wall", Shape.BOX, SE2(x, y, 0.0), sx, sy, 0.0, 3.0)
    for x, y, sx, sy in ((0.0, -5.1, 20.4, 0.2), (0.0, 5.1, 20.4, 0.2), (-10.1, 0.0, 0.2, 10.0), (10.1, 0.0, 0.2, 10.0))
)
SCENE = build_scene(WorldSpec("room", WALLS, SE2()))
WORLD_FROM_MAP = SE3.from_rpy((1.0, -2.0, 0.0), 0.0, 0.0, 0.4)
STAMPS = np.arange(100, dtype=np.int64) * 100_000_000


def station(number: int, noise: float = 0.0, off: float = 0.0, stray: int = 0, density: float = 30.0) -> StationCloud:
    """A cloud of the long walls from a place in the middle, `noise` metres thick, which the map has `off` metres beside."""
    rng = np.random.default_rng(number)
    world = np.column_stack([rng.uniform(-8.0, 8.0, 4000), np.repeat([-5.0, 5.0], 2000), rng.uniform(0.8, 2.2, 4000)])
    world[:, 1] += rng.normal(0.0, noise, 4000) if noise else 0.0
    world[:stray, 1] = 0.0
    true = SE3.from_rpy((0.2 * number, 0.5, 0.3), 0.01, 0.02, 1.0)
    told = WORLD_FROM_MAP.inverse() @ SE3((0.0, off, 0.0)) @ true
    points = np.asarray(true.inverse().transform(world), np.float32)
    return StationCloud(number, int(STAMPS[10 * number]), 0, told, 5.0, 50, density, points, np.zeros(4000, np.float32))


def judged(*stations: StationCloud) -> StationQuality:
    poses = [SE3.from_rpy((0.2 * (k // 10), 0.5, 0.3), 0.01, 0.02, 1.0) for k in range(100)]
    return judge_stations(stations, WORLD_FROM_MAP, (STAMPS, poses), SCENE)


def test_what_lies_on_the_walls_is_exact() -> None:
    quality = judged(station(1, density=20.0), station(2, density=40.0))
    assert (quality.count, quality.points, quality.seconds, quality.density) == (2, 4000, 5.0, 30.0)
    for distance in (quality.median, quality.p95, quality.true_median, quality.true_p95):
        assert distance == pytest.approx(0.0, abs=1e-4)
    assert quality.stray == 0.0


def test_a_thick_wall_is_told_at_both_places() -> None:
    quality = judged(station(1, noise=0.03))
    assert quality.median == pytest.approx(0.674 * 0.03, rel=0.1)
    assert quality.p95 == pytest.approx(1.96 * 0.03, rel=0.1)
    assert quality.true_median == pytest.approx(quality.median)


def test_a_station_that_the_map_has_elsewhere_is_exact_at_its_true_place_only() -> None:
    quality = judged(station(1, off=0.06))
    assert quality.median == pytest.approx(0.06, abs=1e-3)
    assert quality.true_median == pytest.approx(0.0, abs=1e-4)


def test_what_floats_in_the_room_is_stray() -> None:
    quality = judged(station(1, stray=400))
    assert quality.stray == pytest.approx(0.1)
    assert quality.median == pytest.approx(0.0, abs=1e-4)
    assert quality.p95 is not None
    assert quality.p95 > 0.5


def test_without_a_station_nothing_is_known() -> None:
    fields = judged().fields()
    assert fields.pop("stations") == 0
    assert set(fields.values()) == {None}
