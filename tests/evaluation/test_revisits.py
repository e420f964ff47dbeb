"""Errors where a way comes back to a place, against ways whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.evaluation.revisits import revisit_errors


def _laps(turns: float = 2.0, steps: int = 400) -> np.ndarray:
    """Return poses on a circle of 10 m radius."""
    a = np.linspace(0.0, turns * 2.0 * np.pi, steps)
    return np.column_stack((10.0 * np.cos(a), 10.0 * np.sin(a), a + 0.5 * np.pi))


def test_a_turned_and_shifted_way_has_no_error() -> None:
    laps = _laps()
    c, s = np.cos(0.7), np.sin(0.7)
    moved = np.column_stack(
        (3.0 + c * laps[:, 0] - s * laps[:, 1], s * laps[:, 0] + c * laps[:, 1] - 1.0, laps[:, 2] + 0.7)
    )
    errors = revisit_errors(moved, laps)
    assert len(errors.errors) > 1000
    assert errors.errors.max() < 1e-9


def test_a_second_lap_that_lies_beside_the_first_is_as_wrong_as_it_lies_beside() -> None:
    laps = _laps()
    wrong = laps.copy()
    wrong[200:, 0] += 0.4
    fields = revisit_errors(wrong, laps).fields()
    assert fields["revisit_error_median_m"] == pytest.approx(0.4)
    assert fields["revisit_error_worst_m"] == pytest.approx(0.4)


def test_one_lap_knows_no_revisit() -> None:
    fields = revisit_errors(_laps(0.5), _laps(0.5)).fields()
    assert fields == {"revisits": 0, "revisit_error_median_m": None, "revisit_error_worst_m": None}
