"""Intervals of shares: values of the Wilson interval that are printed in textbooks, and its limits."""

import pytest

from ambler.evaluation.proportions import wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(100, 100, 0.9630, 1.0), (0, 200, 0.0, 0.0188), (81, 263, 0.2553, 0.3662), (0, 0, 0.0, 1.0)],
)
def test_interval(successes: int, trials: int, low: float, high: float) -> None:
    """81 of 263 is Newcombe's example (1998)."""
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=2e-4)
