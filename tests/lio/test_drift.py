"""The drift of the map's frame against many drawn walks."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.lio.config import DriftConfig
from ambler.lio.drift import Drift
from ambler.lio.state import exp, log


def test_the_covariance_is_that_of_drawn_walks() -> None:
    config = DriftConfig(position=2e-3, rotation=1e-3)
    angle = np.linspace(0.0, 4.0, 30)
    way = 10.0 * np.stack([np.cos(angle), np.sin(angle), 0.2 * angle], axis=1)
    steps = np.diff(way, axis=0)
    drift = Drift(config)
    for step in steps:
        drift.move(step, np.zeros((0, 3)))
    rng = np.random.default_rng(0)
    errors = []
    last = exp(np.array([0.2, -0.3, 1.0]))
    for _ in range(1500):
        turn, place = np.zeros(3), np.zeros(3)
        for step in steps:
            root = np.sqrt(np.linalg.norm(step))
            place += exp(turn) @ step - step + config.position * root * rng.standard_normal(3)
            turn += config.rotation * root * rng.standard_normal(3)
        errors.append(np.concatenate([place, log(last.T @ exp(turn) @ last)]))
    drawn = np.cov(np.array(errors).T)
    told = drift.covariance(last)
    scale = np.sqrt(np.outer(np.diag(told), np.diag(told)))
    np.testing.assert_allclose(drawn / scale, told / scale, atol=0.12)


def test_what_was_coasted_is_uncertain_by_its_share_along_the_way() -> None:
    drift = Drift(DriftConfig(0.0, 0.0, 0.01))
    for _ in range(100):
        drift.move(np.array([1.0, 0.3, 0.0]), np.array([[1.0, 0.0, 0.0]]))
    expected = np.zeros((6, 6))
    expected[0, 0] = 1.0
    np.testing.assert_allclose(drift.covariance(np.eye(3)), expected, atol=1e-9)


def test_a_lean_accelerates_who_coasts_until_what_he_passes_tells_the_speed() -> None:
    drift = Drift(DriftConfig(0.0, 0.0, 0.0, coasting_acceleration=0.02, seen=0.5))
    ahead = np.array([[1.0, 0.0, 0.0]])
    for _ in range(1000):
        drift.coast(0.01, ahead)
    expected = np.zeros((3, 3))
    expected[0, 0] = (0.5 * 0.02 * 10.0**2) ** 2
    np.testing.assert_allclose(drift.covariance(np.eye(3))[:3, :3], expected, rtol=0.01)
    for _ in range(300):
        drift.coast(0.01, np.zeros((0, 3)))
    seen = drift.covariance(np.eye(3))[0, 0]
    assert seen == pytest.approx((0.5 * 0.02 * 10.0**2 + 0.02 * 10.0 * 0.5) ** 2, rel=0.02)
    for _ in range(300):
        drift.coast(0.01, np.zeros((0, 3)))
    assert drift.covariance(np.eye(3))[0, 0] == pytest.approx(seen, rel=0.01)
