"""Reversals: a robot that turns round is counted once, one that drives a curve is not."""

import itertools

import numpy as np

from ambler.evaluation.reversals import count_reversals


def line(*corners: tuple[float, float]) -> np.ndarray:
    """Return points 5 cm apart along corners (x, y)."""
    parts = []
    for a, b in itertools.pairwise(corners):
        n = max(2, int(np.hypot(b[0] - a[0], b[1] - a[1]) / 0.05))
        parts.append(np.linspace(a, b, n))
    return np.vstack(parts)


def test_coming_back_counts_once_and_corners_and_curves_do_not() -> None:
    assert count_reversals(line((0, 0), (10, 0))) == 0
    assert count_reversals(line((0, 0), (5, 0), (5, 5), (0, 5))) == 0
    assert count_reversals(line((0, 0), (5, 0), (0, 0.2))) == 1
    assert count_reversals(line((0, 0), (5, 0), (1, 0), (6, 0))) == 2
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    assert count_reversals(3.0 * np.stack([np.cos(angle), np.sin(angle)], 1)) == 0


def test_standing_still_and_short_ways_count_nothing() -> None:
    assert count_reversals(np.zeros((50, 2))) == 0
    assert count_reversals(line((0, 0), (0.6, 0), (0, 0))) == 0
    shaking = line((0, 0), (5, 0)) + np.random.default_rng(0).normal(0.0, 0.003, (100, 2))
    assert count_reversals(shaking) == 0
