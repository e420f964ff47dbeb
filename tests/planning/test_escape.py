"""The way out of forbidden cells, where a planner would not show it."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.errors import StartOccupiedError
from ambler.core.grid import COST_INSCRIBED, COST_LETHAL
from ambler.planning.escape import find_escape

RADIUS, REACH = 12.0, 80.0


def test_no_way_out_cuts_through_a_wall_that_runs_across_the_cells() -> None:
    """One cell thick, each touching the next at a corner; what is free lies behind it only."""
    iy, ix = np.indices((160, 160))
    costs = np.full((160, 160), COST_INSCRIBED, np.uint8)
    costs[iy + ix == 181] = COST_LETHAL
    costs[iy + ix > 185] = 0
    with pytest.raises(StartOccupiedError):
        find_escape(costs, costs < COST_INSCRIBED, (60, 90), RADIUS, REACH)
    costs[90, 91] = COST_INSCRIBED  # a gap in it
    way = find_escape(costs, costs < COST_INSCRIBED, (60, 90), RADIUS, REACH)
    assert (90, 91) in way
    assert costs[way[-1]] == 0
