"""Dust, smoke and rain go; thin poles, wires, leaves and a floor far away stay."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.messages import PointCloud
from ambler.perception.air_filter import AirFilter, AirFilterConfig, CloudLooks
from ambler.sim.air import Air, Airborne
from ambler.sim.hand_rig import LIDARS, LidarSpec
from ambler.sim.lidar import LidarSensor
from ambler.sim.rosette import rosette
from ambler.sim.scene import build_scene
from ambler.sim.world_file import load_world

F64 = NDArray[np.float64]
HEIGHT = 0.6  # metres of the scanner above the floor
NOISE = 0.015
PAPER = 0.5  # intensity of what is bright


def beams(scan: int) -> F64:
    """The beams of a Mid-360 in one of its clouds, (N, 3)."""
    return rosette(0.1 * scan).reshape(-1, 3)


def cloud_of(ranges: F64, intensity: F64, ahead: F64) -> PointCloud:
    met = np.isfinite(ranges)
    points = (ranges[:, None] * ahead)[met].astype(np.float32)
    n = len(points)
    return PointCloud(
        0, "lidar", points, intensity[met].astype(np.float32), np.zeros(n, np.float32), np.zeros(n, np.uint16)
    )


def floor_ranges(ahead: F64) -> F64:
    down = -ahead[:, 2]
    return np.where(down > 0.01, HEIGHT / np.maximum(down, 0.01), np.inf)


def kept(filter_: AirFilter, cloud: PointCloud) -> NDArray[np.bool_]:
    return filter_.keep(cloud, np.arange(len(cloud.points)), lambda numbers: cloud.points[numbers])


def hall(ahead: F64, rng: np.random.Generator) -> tuple[F64, F64]:
    """Ranges and intensities in a round hall of 10 m radius: its wall, and its floor, which is dim where it is met flatly."""
    floor, wall = floor_ranges(ahead), 10.0 / np.hypot(ahead[:, 0], ahead[:, 1])
    ranges = np.minimum(floor, wall)
    intensity = np.where(floor < wall, 0.3 * -ahead[:, 2], PAPER * np.hypot(ahead[:, 0], ahead[:, 1]))
    return ranges + NOISE * rng.standard_normal(len(ranges)), intensity


def test_clear_air_loses_hardly_anything_and_a_flatly_met_floor_stays() -> None:
    rng, filter_ = np.random.default_rng(1), AirFilter()
    for scan in range(5):
        ahead = beams(scan)
        cloud = cloud_of(*hall(ahead, rng), ahead)
        stays = kept(filter_, cloud)
        is_far_floor = (cloud.points[:, 2] < -HEIGHT + 0.1) & (np.hypot(*cloud.points[:, :2].T) > 6.0)
        assert is_far_floor.sum() > 100
        assert stays.mean() > 0.985
        assert stays[is_far_floor].mean() > 0.9


@pytest.mark.parametrize("radius", [0.02, 0.05])
def test_a_thin_pole_stays_in_the_dust_that_goes(radius: float) -> None:
    rng, filter_ = np.random.default_rng(2), AirFilter()
    gone, stay = [], []
    for scan in range(20):
        ahead = beams(scan)
        ranges, intensity = hall(ahead, rng)
        flat = np.hypot(ahead[:, 0], ahead[:, 1])
        is_pole = (np.abs(ahead[:, 1] / flat) * 4.0 < radius) & (ahead[:, 0] > 0.0) & (4.0 / flat < ranges)
        ranges[is_pole], intensity[is_pole] = (4.0 / flat)[is_pole], 0.3
        dust = rng.uniform(0.3, 6.0, len(ranges))
        is_dust = (rng.random(len(ranges)) < 0.35) & (dust < ranges)
        ranges[is_dust], intensity[is_dust] = dust[is_dust], 0.01 * np.exp(0.5 * rng.standard_normal(is_dust.sum()))
        met = np.isfinite(ranges)
        stays = kept(filter_, cloud_of(ranges, intensity, ahead))
        gone.append(1.0 - stays[is_dust[met]].mean())
        stay += stays[(is_pole & ~is_dust)[met]].tolist()
    assert np.mean(gone) > 0.95
    assert len(stay) > 20
    assert np.mean(stay) > 0.98


def test_a_wire_that_is_dim_is_kept_once_it_was_met_again_at_the_same_place() -> None:
    rng, filter_ = np.random.default_rng(3), AirFilter()
    at = np.array([[5.05, y, 1.55] for y in 0.05 + 0.2 * np.arange(-6, 6)])
    stays = np.zeros(len(at), np.bool_)
    for scan in range(8):
        ahead = beams(scan)
        cloud = cloud_of(*hall(ahead, rng), ahead)
        wire = (at + 0.005 * rng.standard_normal(at.shape)).astype(np.float32)
        blown = rng.uniform((1.0, -3.0, 0.5), (4.0, 3.0, 2.0), (12, 3)).astype(np.float32)
        points = np.concatenate([cloud.points, wire, blown])
        n = len(points)
        dim = np.full(24, 0.02, np.float32)
        both = PointCloud(
            *(0, "lidar", points, np.concatenate([cloud.intensity, dim])),
            *(np.zeros(n, np.float32), np.zeros(n, np.uint16)),
        )
        told = kept(filter_, both)
        stays, blown_stays = told[-24:-12], told[-12:]
        if scan == 0:
            assert stays.mean() < 0.5  # nobody knows yet what it is
    assert stays.mean() > 0.6
    assert blown_stays.mean() < 0.1


def test_an_edge_that_few_beams_meet_is_kept_where_places_are_as_wide_as_beams() -> None:
    """The top of a kerb 7 m away: in every cloud six dim returns anywhere along two metres of it, never twice within 10 cm in a second and a half."""
    rng = np.random.default_rng(5)
    shares, dust = [], []
    for config in (AirFilterConfig(), AirFilterConfig(beams=4.0)):
        filter_, stays, blown_stays = AirFilter(config), [], []
        for scan in range(40):
            ahead = beams(scan)
            cloud = cloud_of(*hall(ahead, rng), ahead)
            edge = np.column_stack((np.full(6, 7.0), rng.uniform(-1.0, 1.0, 6), np.full(6, -0.4)))
            blown = rng.uniform((1.0, -6.0, -0.5), (9.0, 6.0, 2.0), (40, 3))
            points = np.concatenate([cloud.points, edge, blown]).astype(np.float32)
            n = len(points)
            light = np.concatenate([cloud.intensity, np.full(46, 0.02, np.float32)])
            told = kept(filter_, PointCloud(0, "lidar", points, light, np.zeros(n, np.float32), np.zeros(n, np.uint16)))
            stays += told[-46:-40].tolist()
            blown_stays += told[-40:].tolist()
        shares.append(np.mean(stays))
        dust.append(np.mean(blown_stays))
    assert shares[1] > 0.7
    assert shares[0] < 0.5
    assert dust[1] < 0.1


def test_leaves_stay_and_smoke_of_the_same_shape_goes() -> None:
    for brightness, bounds in ((0.4, (0.97, 1.01)), (0.03, (-0.01, 0.25))):
        rng, filter_ = np.random.default_rng(4), AirFilter()
        for scan in range(6):
            ahead = beams(scan)
            ranges, intensity = hall(ahead, rng)
            is_crown = (ahead @ (math.cos(0.4), 0.0, math.sin(0.4)) > math.cos(0.2)) & (ranges > 7.0)
            ranges[is_crown] = 5.0 + rng.uniform(0.0, 1.2, is_crown.sum())
            # Leaves face all ways: some of them send little back.
            intensity[is_crown] = brightness * rng.uniform(0.0, 1.0, is_crown.sum())
            stays = kept(filter_, cloud_of(ranges, intensity, ahead))[is_crown[np.isfinite(ranges)]]
        assert bounds[0] < stays.mean() < bounds[1]


@pytest.mark.parametrize("name", ["mid_360", "vlp_16"])
@pytest.mark.parametrize("kind", [Airborne.DUST, Airborne.RAIN])
def test_of_the_simulators_dust_most_goes_and_of_the_rooms_nothing(name: str, kind: Airborne) -> None:
    spec: LidarSpec = LIDARS[name]
    sensor = LidarSensor(spec, "lidar", build_scene(load_world("office").from_start()), 5)
    knots = np.array([0.0, 0.1]), np.tile([0.0, 0.0, 0.8], (2, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    filter_ = AirFilter()
    caught, lost = [], []
    for scan in range(6):
        sensor.sweep(*knots, first=0.1 * scan, airs=(Air(kind, 0.3),))
        is_false = sensor.is_false
        cloud = sensor.to_cloud(0)
        assert is_false.mean() == pytest.approx(0.3, abs=0.02)
        stays = kept(filter_, cloud)
        caught.append(1.0 - stays[is_false].mean())
        lost.append(1.0 - stays[~is_false].mean())
    assert np.mean(caught) > 0.75
    assert np.mean(lost) < 0.03


def test_without_brightness_it_does_not_eat_surfaces() -> None:
    rng, filter_ = np.random.default_rng(6), AirFilter()
    for scan in range(4):
        ahead = beams(scan)
        ranges, _ = hall(ahead, rng)
        stays = kept(filter_, cloud_of(ranges, np.zeros(len(ranges)), ahead))
        assert stays.mean() > 0.97


def test_an_empty_cloud_and_a_filter_that_is_off() -> None:
    empty = cloud_of(np.zeros(0), np.zeros(0), beams(0)[:0])
    assert len(kept(AirFilter(), empty)) == 0
    ahead = beams(0)
    dusty = cloud_of(np.random.default_rng(0).uniform(0.3, 5.0, len(ahead)), np.full(len(ahead), 0.01), ahead)
    assert kept(AirFilter(AirFilterConfig(is_used=False)), dusty).all()


def test_filters_that_share_their_looks_say_what_each_would_say_alone() -> None:
    rng, looks = np.random.default_rng(3), CloudLooks(AirFilterConfig())
    together, alone = [AirFilter(None, looks) for _ in range(2)], [AirFilter() for _ in range(2)]
    for scan in range(4):
        ahead = beams(scan)
        ranges, intensity = hall(ahead, rng)
        dusty = rng.random(len(ranges)) < 0.05
        cloud = cloud_of(np.where(dusty, 2.0, ranges), np.where(dusty, 0.01, intensity), ahead)
        some, every = np.arange(0, len(cloud.points), 3), np.arange(len(cloud.points))
        for shared, own in zip(together, alone, strict=True):
            asked = some if shared is together[0] else every
            verdict, expected = (f.keep(cloud, asked, lambda n, c=cloud: c.points[n]) for f in (shared, own))  # type: ignore[misc]
            assert np.array_equal(verdict, expected)
            assert not expected.all()
