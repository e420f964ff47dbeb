"""Clouds to planar scans: nothing is lost in silence, and moving clouds come out straight."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels.bearing import turn_of, turn_of_single
from ambler.perception.cloud_to_scan import CloudScan, CloudToScan, CloudToScanConfig
from ambler.perception.self_mask import SelfMask


def cloud_of(points: np.ndarray, times: np.ndarray | None = None) -> PointCloud:
    n = len(points)
    time = np.zeros(n) if times is None else times
    return PointCloud(
        7, "lidar", points.astype(np.float32), np.zeros(n, np.float32), time.astype(np.float32), np.zeros(n, np.uint16)
    )


def flatten(points: list[list[float]], **changes: object) -> CloudScan:
    config = CloudToScanConfig(**{"bins": 360, **changes})  # type: ignore[arg-type]
    return CloudToScan(config, SE3()).update(cloud_of(np.array(points)))


def test_points_at_and_below_zero_are_kept_by_default() -> None:
    result = flatten([[1.0, 0.0, 0.0], [0.0, 2.0, -0.5], [-3.0, 0.0, 1.7]])
    assert result.used == 3
    assert result.warning is None
    assert result.scan.ranges[180] == pytest.approx(1.0)
    assert result.scan.ranges[270] == pytest.approx(2.0)
    assert result.scan.ranges[0] == pytest.approx(3.0)
    assert np.isnan(result.scan.ranges).sum() == 357
    assert result.scan.time_increment == 0.0
    assert result.scan.stamp_ns == 7


def test_a_band_that_rejects_most_points_warns_with_its_reasons() -> None:
    points = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.5], [3.0, 1.0, -0.1], [0.01, 0.0, 0.5]]
    result = flatten(points, z_min=0.1)
    assert (result.used, result.outside_band, result.out_of_range) == (1, 2, 1)
    assert result.warning is not None
    assert "75% of the cloud's points are not used" in result.warning
    assert "50% outside of the height band 0.1 … inf m" in result.warning
    assert flatten(points, z_min=-1.0).warning is None


def test_the_nearest_point_of_a_bin_is_kept() -> None:
    result = flatten([[3.0, 0.0, 0.2], [1.5, 0.0, 0.4], [2.0, 0.0, 0.1]])
    assert result.scan.ranges[180] == pytest.approx(1.5)


def test_bins_seen_only_outside_of_the_band_are_unknown_or_free_as_told() -> None:
    ground = [[4.0, 0.0, -0.3]]
    unknown = flatten(ground, z_min=0.0, origin_z=0.3)
    assert math.isnan(unknown.scan.ranges[180])
    assert unknown.reach[180] == pytest.approx(2.0)  # the ray leaves the band halfway down
    assert flatten(ground, z_min=0.0, empty_is_free=True).scan.ranges[180] == math.inf
    far = flatten([[40.0, 0.0, 0.2]], range_max=30.0)
    assert far.scan.ranges[180] == math.inf


def test_points_that_are_not_finite_or_on_the_robot_are_counted() -> None:
    mask = (np.array([[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3]]),)
    result = flatten([[0.3, 0.0, 0.2], [math.nan, 0.0, 0.0], [math.inf, 1.0, 0.0], [2.0, 0.0, 0.2]], self_mask=mask)
    assert (result.used, result.on_robot, result.invalid) == (1, 1, 2)
    assert result.scan.ranges[180] == pytest.approx(2.0)


@pytest.mark.parametrize("turn", [math.pi / 2, 8.0])
def test_every_point_is_moved_to_the_stamp(turn: float) -> None:
    """A wall at x = 3 seen by a robot that drives and turns lies at x = 3 again, at slow and at very fast turns."""
    twist = np.array([1.0, 0.3, turn])
    times = np.linspace(0.0, 0.1, 200)
    y = np.linspace(-2.0, 2.0, 200)
    seen = [SE2.exp(twist * t).inverse().transform(np.array([[3.0, v]]))[0] for t, v in zip(times, y, strict=True)]
    mount = SE3.from_rpy((0.2, -0.1, 0.5), 0.02, -0.03, 0.7)
    in_sensor = mount.inverse().transform(np.column_stack([np.array(seen), np.full(200, 0.4)]))
    config = CloudToScanConfig(bins=7200, base_from_origin=SE2(0.1, 0.2, 0.3))
    scan = CloudToScan(config, mount).update(cloud_of(in_sensor, times), twist).scan
    hit = np.isfinite(scan.ranges)
    angles = scan.angle_min + np.arange(7200) * scan.angle_increment
    ends = scan.ranges[hit, None] * np.column_stack([np.cos(angles[hit]), np.sin(angles[hit])])
    assert hit.sum() > 190
    assert np.abs(SE2(0.1, 0.2, 0.3).transform(ends)[:, 0] - 3.0).max() < 3.0 * math.pi / 7200


def test_the_fast_angle_is_exact() -> None:
    angles = np.concatenate([np.linspace(-math.pi, math.pi, 20001), [0.0, math.pi / 2, -math.pi / 2, math.pi / 4]])
    turns = np.array([turn_of(3.0 * math.sin(a), 3.0 * math.cos(a)) for a in angles])
    error = (turns - angles / (2.0 * math.pi) + 0.5) % 1.0 - 0.5
    assert np.abs(error).max() < 3e-9
    assert turn_of(0.0, 0.0) == 0.0
    single = np.float32(3.0)
    turns = np.array(
        [turn_of_single(single * np.float32(math.sin(a)), single * np.float32(math.cos(a))) for a in angles]
    )
    error = (turns - angles / (2.0 * math.pi) + 0.5) % 1.0 - 0.5
    assert np.abs(error).max() < 2e-7
    assert turn_of_single(np.float32(0.0), np.float32(0.0)) == 0.0


def test_self_mask_takes_any_simple_polygons() -> None:
    horseshoe = np.array([[-1, -1], [1, -1], [1, 1], [0.5, 1], [0.5, -0.5], [-0.5, -0.5], [-0.5, 1], [-1, 1]])
    mask = SelfMask((horseshoe, np.array([[3.0, 0.0], [4.0, 0.0], [3.5, 1.0]])))
    points = np.array([[0.0, -0.8], [0.0, 0.3], [0.8, 0.9], [3.5, 0.5], [3.5, 1.1], [-1.2, 0.0]])
    assert mask.contains(points).tolist() == [True, False, True, True, False, False]
    assert mask.reach == pytest.approx(4.0)
    assert not SelfMask().contains(points).any()


def test_wrong_configurations_are_refused() -> None:
    with pytest.raises(BadInputError, match="holds nothing"):
        CloudToScanConfig(z_min=1.0, z_max=0.5)
    with pytest.raises(BadInputError, match="range_min < range_max"):
        CloudToScanConfig(range_max=0.01)
