"""The gate's points of a cloud whose sensor leans while it turns: floor is no obstacle, and what stands on it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.messages import PointCloud
from ambler.core.se3 import SE3
from ambler.safety.points import points_of_cloud

MOUNT = SE3((0.0, 0.0, 0.7))
BAND = (0.15, 0.9)
PARTS = 11


def lean(share: float) -> SE3:
    return SE3.from_rpy((0.0, 0.0, 0.0), 0.0, math.radians(6.0) * share, 0.0)


def swept(height: float) -> PointCloud:
    """Points 3 m ahead at one height, each seen while the body goes down on its nose."""
    n = 200
    share = np.linspace(0.0, 1.0, n)
    points = [(lean(float(s)) @ MOUNT).inverse().transform(np.array([[3.0, 0.0, height]]))[0] for s in share]
    zeros = np.zeros(n, np.float32)
    times = (0.1 * share).astype(np.float32)
    return PointCloud(0, "lidar", np.array(points, np.float32), zeros, times, np.zeros(n, np.uint16))


SWEEP = [lean(k / (PARTS - 1)) @ MOUNT for k in range(PARTS)]


def test_floor_is_no_obstacle_while_the_body_leans_within_one_turn() -> None:
    assert len(points_of_cloud(swept(0.0), SWEEP, np.zeros(3), 4.0, BAND)) == 0
    assert len(points_of_cloud(swept(0.0), SWEEP[-1:], np.zeros(3), 4.0, BAND)) == 0  # beams that were held for lower
    assert (
        len(points_of_cloud(swept(0.0), [lean(-1.0) @ MOUNT], np.zeros(3), 4.0, BAND)) > 100
    )  # a wrong lean makes walls


def test_an_obstacle_stays_one_where_it_is() -> None:
    points = points_of_cloud(swept(0.3), SWEEP, np.zeros(3), 4.0, BAND)
    assert len(points) == 200
    assert points[:, 2] == pytest.approx(0.3, abs=0.02)
    assert points[:, 0] == pytest.approx(3.0, abs=0.02)
    with_one_lean = points_of_cloud(swept(0.3), SWEEP[-1:], np.zeros(3), 4.0, BAND)
    assert len(with_one_lean) < 150  # one lean for the whole turn loses it
