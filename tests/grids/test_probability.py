"""The numbers of a cell: a linear code of probabilities, and tables that multiply odds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ambler.grids.probability import P_MAX, P_MIN, VALUE_MAX, log_odds_table, to_probability, to_value, update_table

VALUES = np.arange(1, VALUE_MAX + 1, dtype=np.uint16)
STEP = (P_MAX - P_MIN) / (VALUE_MAX - 1)


def odds(p: np.ndarray | float) -> np.ndarray:
    return np.asarray(p) / (1.0 - np.asarray(p))


def test_every_value_survives_the_round_trip() -> None:
    assert np.array_equal(to_value(to_probability(VALUES)), VALUES)
    assert to_probability(VALUES[[0, -1]]) == pytest.approx([P_MIN, P_MAX])
    assert to_probability(np.zeros(1, np.uint16))[0] == P_MIN


@given(st.floats(0.0, 1.0))
def test_a_probability_is_coded_to_half_a_step_and_clamped(p: float) -> None:
    back = float(to_probability(to_value(np.array([p])))[0])
    assert abs(back - min(max(p, P_MIN), P_MAX)) <= 0.5 * STEP * 1.0001
    assert 1 <= int(to_value(p)) <= VALUE_MAX


@given(st.floats(0.15, 0.85))
def test_an_observation_multiplies_the_odds(p: float) -> None:
    table = update_table(p)
    assert table[0] == to_value(p)
    new = odds(p) * odds(to_probability(VALUES))
    expected = np.clip(new / (1.0 + new), P_MIN, P_MAX)
    assert np.abs(to_probability(table[1:]) - expected).max() <= 0.5 * STEP * 1.001


@given(st.floats(0.15, 0.85))
def test_tables_keep_order_and_push_to_their_side(p: float) -> None:
    table = update_table(p)[1:].astype(int)
    assert (np.diff(table) >= 0).all()
    if p > 0.5:
        assert (table >= VALUES).all()
    if p < 0.5:
        assert (table <= VALUES).all()
    assert table.min() >= 1
    assert table.max() <= VALUE_MAX


def test_an_uncertain_observation_changes_no_known_cell() -> None:
    assert np.array_equal(update_table(0.5)[1:], VALUES)


def test_opposite_observations_cancel_away_from_the_clamps() -> None:
    hit, miss = update_table(0.6), update_table(0.4)
    middle = VALUES[(to_probability(VALUES) > 0.2) & (to_probability(VALUES) < 0.8)]
    assert np.abs(miss[hit[middle]].astype(int) - middle).max() <= 2


def test_log_odds_add_where_odds_multiply() -> None:
    table = log_odds_table()
    assert table[0] == 0.0
    assert table[1:] == pytest.approx(np.log(odds(to_probability(VALUES))), abs=1e-6)
    hit = update_table(0.55)
    middle = VALUES[to_probability(VALUES) < 0.85]
    assert table[hit[middle]] - table[middle] == pytest.approx(np.full(len(middle), np.log(0.55 / 0.45)), abs=2e-4)
