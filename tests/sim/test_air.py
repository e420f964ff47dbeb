"""What floats in the air: as many returns as told, where it stands, without a change to what clear air draws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import PointCloud
from ambler.core.se2 import SE2
from ambler.sim.air import SMOKE_HEIGHT, SMOKE_RADIUS, Air, Airborne
from ambler.sim.faults import Fault, FaultInjector, FaultKind, air_of
from ambler.sim.hand_rig import LIDARS
from ambler.sim.lidar import LidarSensor
from ambler.sim.scene import build_scene
from ambler.sim.world_file import load_world

WORLD = load_world("lab_empty")
EYE = np.array([WORLD.start.x, WORLD.start.y, 0.8])
KNOTS = np.array([0.0, 0.1]), np.tile(EYE, (2, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))


def swept(airs: tuple[Air, ...], turns: int = 3, name: str = "vlp_16") -> list[tuple[PointCloud, np.ndarray]]:
    sensor = LidarSensor(LIDARS[name], "lidar", build_scene(WORLD), 7)
    out = []
    for turn in range(turns):
        sensor.sweep(*KNOTS, first=0.1 * turn, airs=airs)
        out.append((sensor.to_cloud(0), sensor.is_false))
    return out


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5])
@pytest.mark.parametrize("kind", [Airborne.DUST, Airborne.RAIN])
def test_as_many_returns_are_false_as_was_told_and_they_are_dim_and_near(kind: Airborne, share: float) -> None:
    for cloud, is_false in swept((Air(kind, share),)):
        ranges = np.linalg.norm(cloud.points, axis=1)
        assert is_false.mean() == pytest.approx(share, abs=0.02)
        assert np.median(cloud.intensity[is_false]) < 0.2 * np.median(cloud.intensity[~is_false])
        assert ranges[is_false].max() < 12.2


def test_clear_air_draws_what_it_drew_and_what_is_true_in_dust_is_what_it_was() -> None:
    clear, dusty = swept(()), swept((Air(Airborne.DUST, 0.3),))
    for (before, _), (after, is_false) in zip(clear, dusty, strict=True):
        known = {
            (t, r): p
            for t, r, p in zip(before.time.tolist(), before.ring.tolist(), before.points.tolist(), strict=True)
        }
        rows = zip(
            after.time[~is_false].tolist(),
            after.ring[~is_false].tolist(),
            after.points[~is_false].tolist(),
            strict=True,
        )
        assert all(known[t, r] == p for t, r, p in rows)


def test_dust_hangs_in_swaths() -> None:
    """Beside one another beams are false more often together than by chance."""
    cloud, is_false = swept((Air(Airborne.DUST, 0.3),), 1)[0]
    azimuth = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    sectors = np.array([is_false[(azimuth > a) & (azimuth <= a + 0.1)].mean() for a in np.arange(-math.pi, 3.1, 0.1)])
    chance = math.sqrt(0.3 * 0.7 / (len(is_false) / len(sectors)))
    assert sectors.std() > 3.0 * chance


def test_smoke_stands_where_it_was_put() -> None:
    x, y = EYE[0] + 2.5, EYE[1]
    cloud, is_false = swept((Air(Airborne.SMOKE, columns=((x, y),)),), 1)[0]
    points = cloud.points[is_false] + EYE
    off = np.hypot(points[:, 0] - x, points[:, 1] - y)
    assert is_false.sum() > 300
    assert np.percentile(off, 99) < SMOKE_RADIUS + 0.1
    assert points[:, 2].min() > -0.1
    assert points[:, 2].max() < SMOKE_HEIGHT + 0.1
    assert (np.hypot(points[:, 0] - EYE[0], points[:, 1] - EYE[1]) < 2.0).mean() > 0.5  # half within its first 0.7 m


def test_faults_of_the_air_are_read_and_hold_in_their_time() -> None:
    assert air_of(FaultKind.DUST, "", SE2()).share == 0.3
    assert air_of(FaultKind.RAIN, "15", SE2()).share == pytest.approx(0.15)
    assert air_of(FaultKind.SMOKE, "2,1", SE2(1.0, 0.0, math.pi / 2)).columns[0] == pytest.approx((0.0, 2.0))
    faults = tuple(Fault.parse(text) for text in ("dust@20:5:9", "smoke"))
    injector = FaultInjector(faults, WORLD, ("lidar",))
    assert [a.kind for a in injector.airs(0.0)] == [Airborne.SMOKE]
    assert [a.kind for a in injector.airs(6.0)] == [Airborne.DUST, Airborne.SMOKE]


@pytest.mark.parametrize("text", ["dust@much", "dust@90", "rain@0", "rain@1,2", "smoke@3", "smoke@nan,1"])
def test_air_that_cannot_be_is_refused(text: str) -> None:
    with pytest.raises(BadInputError, match=text.split("@", maxsplit=1)[0]):
        Fault.parse(text)
