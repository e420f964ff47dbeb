"""The numbers in a cell of a probability grid, and the tables that update them (after Cartographer's probability grid).

A cell is a uint16: 0 unknown, 1 ... 32767 maps linearly onto a probability of 0.1 ... 0.9. An observation multiplies the odds:
odds(new) = odds(old) * odds(observation); the first observation of a cell is its probability.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

P_MIN = 0.1
P_MAX = 0.9
VALUE_MAX = 32767


def to_value(probability: NDArray[np.float64] | float) -> NDArray[np.uint16]:
    """Return the uint16 cell value 1 ... 32767 of a probability, clamped to [0.1, 0.9]."""
    p = np.clip(probability, P_MIN, P_MAX)
    return np.asarray(np.rint((p - P_MIN) / (P_MAX - P_MIN) * (VALUE_MAX - 1)) + 1, np.uint16)


def to_probability(values: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Return probabilities float64 of cell values; unknown cells read as 0.1."""
    v = np.maximum(values.astype(np.float64), 1.0)
    return P_MIN + (v - 1.0) * ((P_MAX - P_MIN) / (VALUE_MAX - 1))


def update_table(probability: float) -> NDArray[np.uint16]:
    """Return the uint16 (32768,) table old value -> new value of observing with `probability`."""
    odds = probability / (1.0 - probability)
    p = to_probability(np.arange(VALUE_MAX + 1, dtype=np.uint16))
    new = odds * p / (1.0 - p)
    table = to_value(new / (1.0 + new))
    table[0] = to_value(probability)
    return table


def log_odds_table() -> NDArray[np.float32]:
    """Return the float32 (32768,) table value -> log odds; unknown is 0."""
    p = to_probability(np.arange(VALUE_MAX + 1, dtype=np.uint16))
    table = np.log(p / (1.0 - p)).astype(np.float32)
    table[0] = 0.0
    return table
