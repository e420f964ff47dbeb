"""The plate in the hand: its inertial measurements are the derivatives of its path, its points lie on the surfaces of the world."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ambler.core.se3 import SE3
from ambler.sim.hand_path import Burst, HandPath, Sway
from ambler.sim.hand_rig import BEGIN_NS, HandRig
from ambler.sim.rig_errors import EXACT
from ambler.sim.rosette import ELEVATION, rosette
from ambler.sim.scene import build_scene
from ambler.sim.sensors import MEMS_IMU_200, MID_360, VLP_16
from ambler.sim.site import draw_hall, draw_site, draw_tunnel, draw_twins

SPEC = replace(VLP_16.perfect(), columns=90)


def test_rates_and_forces_sum_up_to_the_path() -> None:
    site = draw_hall(1, 25.0)
    path = HandPath(site.way, bursts=(Burst(5.0, 2.0, (0.6, 0.0, 0.8), 10.0, (0.0, 1.0, 0.0), 2.0),))
    rig = HandRig(site.world, path, SPEC, 1, MEMS_IMU_200.perfect(), EXACT)
    rotation, velocity, position = np.eye(3), np.zeros(3), np.array(path.pose(0.0).translation)
    rotation = path.pose(0.0).matrix()[:3, :3]
    for scan in rig.scans():
        for sample in scan.imu:
            w, a = np.array(sample.angular_velocity) / 200.0, np.array(sample.linear_acceleration)
            half = rotation @ _exp(0.5 * w)
            change = (half @ a - [0.0, 0.0, 9.80665]) / 200.0
            position += (velocity + 0.5 * change) / 200.0
            velocity += change
            rotation = rotation @ _exp(w)
            last_ns = sample.stamp_ns
        if last_ns > BEGIN_NS + 8_000_000_000:
            break
    true = rig.pose_at(last_ns + 2_500_000)  # a sample is stamped in the middle of its period
    np.testing.assert_allclose(position, true.translation, atol=0.02)
    np.testing.assert_allclose(rotation, true.matrix()[:3, :3], atol=2e-3)


def test_points_lie_on_surfaces_from_where_the_sensor_was_at_their_time() -> None:
    site = draw_hall(2, 30.0)
    path = HandPath(site.way, bursts=(Burst(4.0, 3.0, (0.0, 0.0, 1.0), 15.0),))
    rig = HandRig(site.world, path, SPEC, 2, errors=EXACT)
    scan = next(s for s in rig.scans() if s.end_ns > BEGIN_NS + 5_500_000_000)
    world = np.array(
        [
            (rig.pose_at(scan.cloud.stamp_ns + round(1e9 * float(t))) @ rig.mount).transform(p[None].astype(float))[0]
            for p, t in zip(scan.cloud.points, scan.cloud.time, strict=True)
        ]
    )
    floor = world[world[:, 2] < 0.005]
    assert len(floor) > 30
    assert np.percentile(np.abs(floor[:, 2]), 95) < 1e-4


def test_the_path_rests_then_walks_at_its_speed_and_closes() -> None:
    site = draw_site(4, 100.0)
    path = HandPath(site.way, speed=1.3, sway=Sway.none())
    times = np.linspace(0.0, path.seconds, 2001)
    speeds = np.linalg.norm(path.velocities(times), axis=1)
    assert speeds[times < 1.9].max() < 1e-6
    middle = (times > 5.0) & (times < path.seconds - 5.0)
    assert speeds[middle].mean() == pytest.approx(1.3, rel=0.01)
    assert path.length == pytest.approx(100.0, rel=0.05)
    begin, end = path.pose(0.0), path.pose(path.seconds)
    assert math.dist(begin.translation, end.translation) < 1e-6


def test_a_burst_turns_as_fast_as_it_says() -> None:
    path = HandPath(draw_hall(1, 40.0).way, sway=Sway.none(), bursts=(Burst(4.0, 3.0, (1.0, 0.0, 0.0), 17.0),))
    times = np.arange(4.0, 7.0, 0.001)
    poses = [path.pose(float(t)) for t in times]
    rates = [_turn(a.inverse() @ b) / 0.001 for a, b in pairwise(poses)]
    assert max(rates) == pytest.approx(17.0, rel=0.03)


def test_the_rosette_fills_its_view_and_never_repeats() -> None:
    first, second = rosette(0.0), rosette(0.1)
    np.testing.assert_allclose(np.linalg.norm(first, axis=2), 1.0, atol=1e-12)
    elevation = np.arcsin(first[..., 2])
    assert elevation.min() == pytest.approx(ELEVATION[0], abs=0.01)
    assert elevation.max() == pytest.approx(ELEVATION[1], abs=0.01)
    assert np.abs(first - second).max() > 0.1
    assert first.shape[0] * first.shape[1] == 20_000
    assert MID_360.sweep_time == pytest.approx(0.1)


def test_errors_of_the_plate_are_drawn_by_the_seed() -> None:
    site = draw_tunnel(1, 60.0)
    path = HandPath(site.way, is_closed=False)
    rigs = [HandRig(site.world, path, SPEC, seed) for seed in (5, 5, 6)]
    assert rigs[0].mount == rigs[1].mount != rigs[2].mount
    assert rigs[0].clock == rigs[1].clock != rigs[2].clock
    off = rigs[0].told_mount.inverse() @ rigs[0].mount
    assert 0.0 < math.dist(off.translation, (0, 0, 0)) < 0.01
    assert HandRig(site.world, path, SPEC, 5, errors=EXACT).mount == HandRig(site.world, path, SPEC, 5).told_mount


def _exp(w: np.ndarray) -> np.ndarray:
    angle = float(np.linalg.norm(w))
    if angle < 1e-12:
        return np.eye(3)
    half = 0.5 * angle
    x, y, z = (math.sin(half) * w / angle).tolist()
    return SE3((0, 0, 0), (math.cos(half), x, y, z)).matrix()[:3, :3]


def _turn(pose: SE3) -> float:
    w, *xyz = pose.rotation
    return 2.0 * math.atan2(math.hypot(*xyz), abs(w))


def test_twin_corridors_look_alike_from_everywhere_and_their_way_is_free() -> None:
    site = draw_twins(4, 120.0)
    scene = build_scene(site.world)
    rng = np.random.default_rng(0)
    angles = rng.uniform(-np.pi, np.pi, 400)
    rays = np.stack([np.cos(angles), np.sin(angles), rng.uniform(-0.5, 0.5, 400)], axis=1)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    for place in site.way[::9]:
        here = scene.cast(np.tile(place, (400, 1)), rays, 60.0)[0]
        there = scene.cast(np.tile(place * [-1.0, -1.0, 1.0], (400, 1)), rays * [-1.0, -1.0, 1.0], 60.0)[0]
        assert np.nanmax(np.abs(here - there)) < 1e-9
        assert np.nanmin(here) > 0.5
    assert HandPath(site.way).length == pytest.approx(120.0, rel=0.03)
