"""What the gate remembers of blind zones: kernels against their NumPy twins."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.kernels import blind as kernels

F64 = NDArray[np.float64]
SIDE = 0.04


def columns(points: F64) -> list[tuple[int, int]]:
    return [(math.floor(x / SIDE), math.floor(y / SIDE)) for x, y in points[:, :2]]


@pytest.fixture(params=range(4))
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    return np.random.default_rng(request.param)


def test_places_in_the_columns_of_wanted_points(rng: np.random.Generator) -> None:
    places, points = rng.uniform(-1.0, 1.0, (300, 3)), rng.uniform(-1.0, 1.0, (2000, 3))
    is_wanted, out = rng.uniform(size=2000) < 0.5, np.empty(300, np.bool_)
    kernels.are_in_columns(places, points, is_wanted, SIDE, out)
    wanted = set(columns(points[is_wanted]))
    assert out.tolist() == [c in wanted for c in columns(places)]
    assert 50 < out.sum() < 250


def test_means_of_columns_with_enough_points_and_none_too_near(rng: np.random.Generator) -> None:
    points, ranges = rng.uniform(-0.5, 0.5, (3000, 3)), rng.uniform(0.3, 2.0, 3000)
    is_wanted, out = rng.uniform(size=3000) < 0.7, np.empty((3000, 4))
    found = out[: kernels.column_means(points, ranges, is_wanted, SIDE, 3, 0.5, out)]
    held: dict[tuple[int, int], list[int]] = {}
    for k, column in enumerate(columns(points)):
        if is_wanted[k]:
            held.setdefault(column, []).append(k)
    full = [ks for ks in held.values() if len(ks) >= 3 and ranges[ks].min() >= 0.5]
    expected = [[*points[ks].mean(axis=0), len(ks)] for ks in full]
    assert 50 < len(expected) < len(held) - 50
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_first_of_every_column(rng: np.random.Generator) -> None:
    points, out = rng.uniform(-30.0, 30.0, (4000, 3)), np.empty(4000, np.int64)
    points[2000:] = points[:2000] + rng.uniform(-0.02, 0.02, (2000, 3))
    found = out[: kernels.first_of_columns(points, SIDE, out)]
    seen: dict[tuple[int, int], int] = {}
    for k, column in enumerate(columns(points)):
        seen.setdefault(column, k)
    assert found.tolist() == list(seen.values())
    assert len(seen) < 4000


def test_what_is_looked_through(rng: np.random.Generator) -> None:
    step = math.radians(2.0)
    rays = [
        (rng.uniform(0.2, 2.0, n), rng.uniform(-math.pi, math.pi, n), rng.uniform(-0.06, 0.06, n)) for n in (400, 5000)
    ]
    kept, seen = rays
    seen[0][:] += 0.8
    seen[0][::10] = np.nan  # no ray at all
    out = np.empty(400, np.bool_)
    kernels.look_through(kept, seen, step, 0.1, 0.04, out)
    bins = [np.floor(np.column_stack(r[1:]) / step + 0.5).astype(int) for r in rays]
    for k in range(400):
        around = max(1, math.ceil(math.atan(0.04 / (kept[0][k] * math.cos(kept[2][k]))) / step))
        expected = []
        for turn in range(-around, around + 1):
            is_there = (bins[1][:, 0] - bins[0][k, 0] - turn) % 180 == 0
            behind = seen[0][is_there & (bins[1][:, 1] == bins[0][k, 1])]
            behind = behind[~np.isnan(behind)]
            expected.append(len(behind) > 0 and behind.min() > kept[0][k] + 0.1)
        assert out[k] == all(expected)
    assert 20 < out.sum() < 380


@pytest.mark.parametrize("elevation", [0.0, -0.8, -1.2])
def test_a_thin_post_beside_a_kept_place_is_seen_there_however_steep_the_look(elevation: float) -> None:
    """What is kept is the mean of a column; the post of 5 mm that it came from stands 3.5 cm beside it, 0.3 m away, before a wall that fills the view."""
    level = 0.3 * math.cos(elevation)
    azimuth = np.arange(-math.pi, math.pi, math.radians(0.2))
    on_post = np.abs(azimuth - math.atan2(0.035, level)) < math.asin(0.005 / math.hypot(0.035, level))
    assert on_post.sum() > 5
    for is_there in (True, False):
        seen = (np.where(on_post & is_there, 0.3, 3.0), azimuth, np.full(len(azimuth), elevation))
        out = np.empty(1, np.bool_)
        kept = (np.array([0.3]), np.zeros(1), np.array([elevation]))
        kernels.look_through(kept, seen, math.radians(2.0), 0.1, 0.04, out)
        assert out[0] != is_there


def test_rays_and_sectors(rng: np.random.Generator) -> None:
    points, turn = rng.uniform(-2.0, 2.0, (500, 3)), 0.4
    pose = np.array(
        [[math.cos(turn), -math.sin(turn), 0.0, 0.2], [math.sin(turn), math.cos(turn), 0.0, -0.1], [0, 0, 1.0, 0.5]]
    )
    ranges, azimuth, elevation = (np.empty(500) for _ in range(3))
    kernels.rays_to(pose, points, ranges, azimuth, elevation)
    again = ranges[:, None] * np.column_stack(
        (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    )
    np.testing.assert_allclose(again, points @ pose[:, :3].T + pose[:, 3], atol=1e-12)
    out = np.empty(500, np.bool_)
    kernels.are_inside(ranges, azimuth, elevation, 0.8, (2.5, 4.0), (-0.5, 0.6), out)  # across the seam at pi
    is_turned = (azimuth >= 2.5) | (azimuth <= 4.0 - 2.0 * math.pi)
    assert out.tolist() == ((ranges >= 0.8) & is_turned & (elevation >= -0.5) & (elevation <= 0.6)).tolist()
    assert 20 < out.sum() < 300
