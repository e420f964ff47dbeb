"""Errors of trajectories in space, against errors that were put in."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import best_motion, spatial_error

STAMPS = np.arange(0, 400, dtype=np.int64) * 100_000_000
WORLD_FROM_MAP = SE3.from_rpy((3.0, -2.0, 1.0), 0.1, -0.2, 1.3)


def way(scale: float = 1.0, turn: float = 0.0) -> list[SE3]:
    """A straight way of 0.25 m a step, which is drawn too long by `scale` and turned by `turn` rad per metre."""
    return [SE3.from_rpy((0.25 * scale * k, 0.0, 0.0), 0.0, 0.0, turn * 0.25 * k) for k in range(400)]


def test_another_frame_is_no_error() -> None:
    error = spatial_error(STAMPS, way(), STAMPS, [WORLD_FROM_MAP @ p for p in way()])
    assert error.start_rms_m == pytest.approx(0.0, abs=1e-9)
    assert error.ate_rms_m == pytest.approx(0.0, abs=1e-9)
    assert error.rotation_rms_deg == pytest.approx(0.0, abs=1e-5)
    assert error.path_length_m == pytest.approx(99.75)


def test_a_scale_error_is_a_drift_of_as_many_per_cent() -> None:
    error = spatial_error(STAMPS, way(1.01), STAMPS, way())
    assert error.rpe_trans_pct == pytest.approx(1.0, abs=0.01)
    assert error.end_m == pytest.approx(0.9975, abs=1e-6)
    assert error.start_rms_m == pytest.approx(0.9975 / math.sqrt(3.0), rel=0.01)
    assert error.ate_rms_m == pytest.approx(0.9975 / math.sqrt(12.0), rel=0.01)
    assert error.start_max_m == pytest.approx(0.9975)


def test_a_turn_is_told_in_degrees_per_metre() -> None:
    error = spatial_error(STAMPS, way(1.0, 0.001), STAMPS, way())
    assert error.rpe_rot_deg_per_m == pytest.approx(math.degrees(0.001), rel=0.02)
    assert error.rotation_rms_deg == pytest.approx(math.degrees(0.09975) / math.sqrt(3.0), rel=0.01)


def test_truth_is_interpolated_and_gaps_are_left_out() -> None:
    late = STAMPS[:-1] + 50_000_000
    between = [a.interpolate(b, 0.5) for a, b in zip(way(), way()[1:], strict=False)]
    assert spatial_error(late, between, STAMPS, way()).start_max_m == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(BadInputError, match="only 0 of 399 poses"):
        spatial_error(late, between, STAMPS[::5], way()[::5], max_gap=0.1)


def test_the_best_motion_is_the_one_that_was_made() -> None:
    points = np.random.default_rng(0).normal(0.0, 3.0, (30, 3))
    rotation, shift = best_motion(points, WORLD_FROM_MAP.transform(points))
    np.testing.assert_allclose(rotation, WORLD_FROM_MAP.matrix()[:3, :3], atol=1e-9)
    np.testing.assert_allclose(shift, WORLD_FROM_MAP.translation, atol=1e-9)


def test_attitudes_that_are_others_are_told() -> None:
    """A reference whose quaternions are read in another order has its places by a rigid motion, and none of its attitudes."""
    drawn = [p @ SE3((0.0, 0.001 * (k % 2), 0.0)) for k, p in enumerate(way())]
    turned = [p @ SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, 1.0) for p in way()]
    (told,) = spatial_error(STAMPS, drawn, STAMPS, turned).warnings()
    assert "the attitudes of the reference may be others" in told
    assert spatial_error(STAMPS, drawn, STAMPS, way()).warnings() == []
    assert spatial_error(STAMPS, way(scale=1.05), STAMPS, way()).warnings() == [], "a bad way is not a bad reference"
    short = slice(0, 3)
    assert spatial_error(STAMPS[short], drawn[short], STAMPS[short], turned[short]).warnings() == [], "below a metre"
