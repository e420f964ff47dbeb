"""The filter's manifold: plus and minus undo each other, and rotations are those of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ambler.kernels import inertial as k
from ambler.lio.state import FilterState, exp, gravity_basis, log, quaternion_of, right_jacobian

vectors = st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3).map(np.array)


def drawn_state(seed: int) -> FilterState:
    rng = np.random.default_rng(seed)
    mount = np.column_stack([exp(rng.normal(0.0, 0.5, 3)), rng.normal(0.0, 0.1, 3)])
    return FilterState(
        *(rng.normal(0.0, 5.0, 3), exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 1.0, 3)),
        *(rng.normal(0.0, 0.01, 3), rng.normal(0.0, 0.1, 3), exp(rng.normal(0.0, 0.2, 3)) @ [0.0, 0.0, -9.8]),
        *(np.ascontiguousarray(mount), float(rng.normal(0.0, 0.01))),
    )


@given(vectors)
def test_exponential_and_logarithm_are_those_of_scipy(vector: np.ndarray) -> None:
    np.testing.assert_allclose(exp(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(log(exp(vector)), vector, atol=1e-9)


@given(vectors)
def test_the_quaternion_of_a_matrix_is_that_of_scipy(vector: np.ndarray) -> None:
    x, y, z, w = Rotation.from_rotvec(2.0 * vector).as_quat()
    ours = np.array(quaternion_of(exp(2.0 * vector)))
    assert abs(float(ours @ [w, x, y, z])) == pytest.approx(1.0, abs=1e-12)


@given(vectors)
def test_the_right_jacobian_is_the_derivative_of_the_exponential(vector: np.ndarray) -> None:
    h = 1e-6
    columns = [(log(exp(vector).T @ exp(vector + h * e)) - log(exp(vector).T @ exp(vector - h * e))) / (2 * h) for e in np.eye(3)]  # fmt: skip
    np.testing.assert_allclose(right_jacobian(vector), np.stack(columns, axis=1), atol=1e-7)


@pytest.mark.parametrize("size", [17, 23, 24])
def test_minus_undoes_plus(size: int) -> None:
    state = drawn_state(1)
    delta = np.random.default_rng(2).normal(0.0, 0.2, size)
    np.testing.assert_allclose(state.plus(delta).minus(state, size), delta, atol=1e-9)


def test_gravity_keeps_its_length_and_its_basis_is_normal_to_it() -> None:
    state = drawn_state(3)
    moved = state.plus(np.full(17, 0.3))
    assert np.linalg.norm(moved.gravity) == pytest.approx(np.linalg.norm(state.gravity), rel=1e-12)
    basis = gravity_basis(state.gravity)
    np.testing.assert_allclose(basis.T @ state.gravity, 0.0, atol=1e-12)
    np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-12)
    assert k.EXTRA == 17
