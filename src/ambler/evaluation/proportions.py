"""Shares of successes with their intervals (Wilson 1927): 100 of 100 is not 100 %."""

from __future__ import annotations

import math

QUANTILE_95 = 1.959964


def wilson_interval(successes: int, trials: int, quantile: float = QUANTILE_95) -> tuple[float, float]:
    """Return the 95 % interval of a share; (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    share, z2 = successes / trials, quantile * quantile
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = quantile * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials * trials)) / (1 + z2 / trials)
    return max(0.0, centre - half), min(1.0, centre + half)
