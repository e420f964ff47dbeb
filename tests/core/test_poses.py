"""Group laws of SE(2) and SE(3)."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ambler.core.se2 import SE2, wrap_angle
from ambler.core.se3 import SE3

number = st.floats(-50, 50)
angle = st.floats(-math.pi, math.pi)
se2 = st.builds(SE2, number, number, angle)
se3 = st.builds(lambda x, y, z, r, p, w: SE3.from_rpy((x, y, z), r, p, w), number, number, number, angle, angle, angle)


def close2(a: SE2, b: SE2) -> bool:
    return a.distance_to(b) < 1e-9 and abs(wrap_angle(a.yaw - b.yaw)) < 1e-9


@given(se2, se2, se2)
def test_se2_is_a_group(a: SE2, b: SE2, c: SE2) -> None:
    assert close2((a @ b) @ c, a @ (b @ c))
    assert close2(a @ a.inverse(), SE2())
    assert close2(a.inverse() @ (a @ b), b)


@given(se2)
def test_se2_exp_undoes_log(a: SE2) -> None:
    assert close2(SE2.exp(a.log()), SE2(a.x, a.y, wrap_angle(a.yaw)))


@given(se2, se2)
def test_se2_interpolation_ends_at_both_poses(a: SE2, b: SE2) -> None:
    assert close2(a.interpolate(b, 0.0), a)
    assert close2(a.interpolate(b, 1.0), b)
    half = a.interpolate(b, 0.5)
    assert close2(half.interpolate(b, 1.0), b)


def test_se2_interpolation_follows_the_circle() -> None:
    quarter = SE2.exp(np.array([math.pi / 2, 0.0, math.pi / 2]))
    assert close2(quarter, SE2(1.0, 1.0, math.pi / 2))
    mid = SE2().interpolate(quarter, 0.5)
    assert math.hypot(mid.x, mid.y - 1.0) == pytest.approx(1.0)


@given(se2, st.lists(st.tuples(number, number), min_size=1, max_size=5))
def test_se2_moves_points_as_it_composes(a: SE2, points: list[tuple[float, float]]) -> None:
    moved = a.transform(np.array(points))
    for (x, y), got in zip(points, moved, strict=True):
        expected = a @ SE2(x, y, 0.0)
        assert np.allclose(got, (expected.x, expected.y))


@given(se3, se3)
def test_se3_equals_matrices(a: SE3, b: SE3) -> None:
    assert np.allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-8)
    assert np.allclose(a.inverse().matrix() @ a.matrix(), np.eye(4), atol=1e-8)


@given(se2)
def test_se3_lifts_and_projects(a: SE2) -> None:
    assert close2(SE3.from_se2(a).to_se2(), a)


@given(se3, se3)
def test_se3_interpolation_ends_at_both_poses(a: SE3, b: SE3) -> None:
    assert np.allclose(a.interpolate(b, 0.0).matrix(), a.matrix(), atol=1e-6)
    assert np.allclose(a.interpolate(b, 1.0).matrix(), b.matrix(), atol=1e-6)


@pytest.mark.parametrize("w", [1e-10, 2e-9, 1e-8, 1e-7, 1e-5, -3e-8])
def test_se2_exp_loses_nothing_at_small_turns(w: float) -> None:
    a = SE2(40.0, -30.0, w)
    assert close2(SE2.exp(a.log()), a)
