"""What the gate takes from a cloud: kernels against their NumPy twins, and what the twins do not say."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.messages import PointCloud
from ambler.core.se3 import SE3
from ambler.safety.points import (
    ABOVE_LOWEST,
    PATCH,
    PATCHES_BEHIND,
    STANDING,
    carried_to_stamp,
    patch_means,
    points_of_cloud,
)

F64 = NDArray[np.float64]
BAND, REACH, LOWEST = (0.1, 0.7), 4.0, math.radians(-20.0)


def cloud_of(rng: np.random.Generator, n: int, duration: float = 0.1) -> PointCloud:
    points = rng.uniform((-6.0, -6.0, -1.0), (6.0, 6.0, 1.5), (n, 3)).astype(np.float32)
    times = np.sort(rng.uniform(0.0, duration, n)).astype(np.float32)
    return PointCloud(0, "lidar", points, np.zeros(n, np.float32), times, np.zeros(n, np.uint16))


def slow_points_of_cloud(cloud: PointCloud, sweep: list[SE3], twist: F64, lowest: float) -> F64:
    found = []
    for point, time in zip(cloud.points.astype(np.float64), cloud.time, strict=True):
        if math.hypot(point[0], point[1]) > REACH:
            continue
        part = round(float(time / cloud.time.max()) * (len(sweep) - 1)) if cloud.time.max() > 0.0 else 0
        level = sweep[part].transform(point[None])[0]
        is_lowest = point[2] <= math.sin(lowest + ABOVE_LOWEST) * np.linalg.norm(point)
        if BAND[0] <= level[2] <= BAND[1] or (is_lowest and BAND[1] < level[2] <= STANDING):
            found.append(carried_to_stamp(level[None], np.array([time], np.float64), twist)[0])
    return np.array(found).reshape(-1, 3)


@pytest.mark.parametrize("seed", range(5))
def test_points_of_a_cloud_are_those_of_the_slow_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cloud = cloud_of(rng, 2000, duration=0.1 if seed else 0.0)
    sweep = [SE3.from_rpy((0.1, 0.0, 0.6), *rng.normal(0.0, 0.05, 2), 0.3) for _ in range(4)]
    twist = np.array([0.8, -0.3, 1.2])
    fast = points_of_cloud(cloud, sweep, twist, REACH, BAND, None, LOWEST)
    slow = slow_points_of_cloud(cloud, sweep, twist, LOWEST)
    assert len(fast) > 100
    np.testing.assert_allclose(fast, slow, atol=1e-6)


def test_without_a_lowest_beam_the_band_alone_counts() -> None:
    cloud = cloud_of(np.random.default_rng(3), 2000)
    tilted = SE3.from_rpy((0.0, 0.0, 0.9), 0.0, 0.5, 0.0)
    with_lowest, without = (points_of_cloud(cloud, [tilted], np.zeros(3), REACH, BAND, None, x) for x in (LOWEST, -2.0))
    assert without[:, 2].max() <= BAND[1] < with_lowest[:, 2].max() <= STANDING


def test_points_and_times_that_are_no_numbers_leave_nothing_behind() -> None:
    sound = cloud_of(np.random.default_rng(4), 2000)
    points, times = sound.points.copy(), sound.time.copy()
    points[::3] = np.nan
    points[1::3, 2] = np.nan
    times[2::7] = np.nan
    cloud = replace(sound, points=points, time=times)
    found = points_of_cloud(cloud, [SE3((0.0, 0.0, 0.5))] * 3, np.zeros(3), REACH, BAND)
    assert 20 < len(found[np.isfinite(found).all(axis=1)]) < 100
    assert np.isfinite(found[:, 2]).all()


def slow_patch_means(points: F64, origin: tuple[float, float]) -> F64:
    sectors = round(2.0 * math.pi / PATCH[0])
    patches: dict[tuple[int, int], list[F64]] = {}
    for point in points:
        dx, dy = point[0] - origin[0], point[1] - origin[1]
        sector = math.floor((math.atan2(dy, dx) + math.pi) / PATCH[0]) % sectors
        patches.setdefault((sector, math.floor(math.hypot(dx, dy) / PATCH[1])), []).append(point)
    surfaces = {place for place, held in patches.items() if len(held) > 1}
    return np.array(
        [
            np.mean(held, axis=0)
            for (sector, step), held in patches.items()
            if len(held) > 1
            or not any(
                ((sector + beside) % sectors, step + behind) in surfaces
                for beside in (-1, 0, 1)
                for behind in range(1, PATCHES_BEHIND + 1)
            )
        ]
    )


@pytest.mark.parametrize("seed", range(5))
def test_patch_means_are_those_of_the_slow_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall = np.column_stack((rng.normal(-1.5, 0.02, 3000), rng.uniform(-2.0, 2.0, 3000), rng.uniform(0.1, 0.6, 3000)))
    points = np.concatenate((wall, rng.uniform(-3.0, 3.0, (200, 3))))
    fast, slow = patch_means(points, (0.1, -0.2)), slow_patch_means(points, (0.1, -0.2))
    assert 100 < len(fast) < len(points) / 2
    np.testing.assert_allclose(fast, slow, atol=1e-12)


def test_a_surface_behind_the_seam_of_azimuths_tells_its_noise_as_elsewhere() -> None:
    """Straight behind the scanner, directions jump from pi to -pi."""
    surface = np.column_stack((np.full(10, -2.06), np.linspace(0.001, 0.01, 10), np.full(10, 0.3)))
    lone = np.array([[-2.0, -0.002, 0.3]])
    for turn in (0.0, 1.0, math.pi / 2):
        cos, sin = math.cos(turn), math.sin(turn)
        turned = np.concatenate((surface, lone)) @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        assert len(patch_means(turned, (0.0, 0.0))) == len(patch_means(turned[:-1], (0.0, 0.0)))


def test_of_no_points_there_are_no_means() -> None:
    assert patch_means(np.empty((0, 3)), (0.0, 0.0)).shape == (0, 3)
