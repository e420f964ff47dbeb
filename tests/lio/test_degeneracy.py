"""Directions of which planes say nothing are found and left alone."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.lio.config import DegeneracyConfig
from ambler.lio.degeneracy import find_degeneracy


def test_a_direction_that_no_plane_faces_is_left_alone() -> None:
    rng = np.random.default_rng(1)
    normals = np.concatenate([np.tile([0.0, 1.0, 0.0], (300, 1)), np.tile([0.0, 0.0, 1.0], (300, 1))])
    normals += rng.normal(0.0, 0.02, normals.shape)
    points = rng.uniform(-10.0, 10.0, (600, 3))
    rows = np.column_stack([normals, np.cross(points, normals)])
    weak = find_degeneracy(rows.T @ rows, 600.0, DegeneracyConfig())
    assert weak.is_degenerate
    np.testing.assert_allclose(np.abs(weak.translation), [[1.0, 0.0, 0.0]], atol=0.05)
    information, gradient = weak.frozen(rows.T @ rows, np.ones(6))
    along = np.concatenate([weak.translation[0], np.zeros(3)])
    np.testing.assert_allclose(information @ along, 0.0, atol=1e-9)
    assert float(gradient @ along) == pytest.approx(0.0, abs=1e-9)
    whole = np.concatenate([normals, np.tile([1.0, 0.0, 0.0], (100, 1))])
    more = np.concatenate([points, rng.uniform(-10.0, 10.0, (100, 3))])
    rows = np.column_stack([whole, np.cross(more, whole)])
    assert not find_degeneracy(rows.T @ rows, 700.0, DegeneracyConfig()).is_degenerate
