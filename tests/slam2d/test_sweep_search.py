"""The order of beams that explains best what each hypothesis leaves beside the walls."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ambler.recordings.sweep import Sweep
from ambler.slam2d.sweep_search import most_likely

STEPS = {Sweep.FORWARD: 0, Sweep.NONE: 1, Sweep.BACKWARD: 2}
NOISE = st.floats(-0.25, 0.25)


@given(st.sampled_from(list(STEPS)), st.floats(0.0, 0.2), st.floats(0.01, 0.1), st.lists(NOISE, min_size=3, max_size=3))
def test_the_right_order_is_found_beside_returns_that_no_order_lays_on_walls(
    truth: Sweep, floor: float, slope: float, noise: list[float]
) -> None:
    on_walls = {
        sweep: 1.0 - floor - slope * ((step - STEPS[truth]) ** 2 + off)
        for (sweep, step), off in zip(STEPS.items(), noise, strict=True)
    }
    assert most_likely(on_walls) is truth


def test_what_is_best_by_chance_is_not_believed() -> None:
    """Of a scanner that turns backward: without any order a little more returns lay on walls, but forward would then be as wrong as backward."""
    assert most_likely({Sweep.FORWARD: 0.91658, Sweep.NONE: 0.94866, Sweep.BACKWARD: 0.94679}) is Sweep.BACKWARD


@pytest.mark.parametrize("share", [0.0, 0.9, 1.0])
def test_where_nothing_tells_forward_is_believed(share: float) -> None:
    assert most_likely(dict.fromkeys(STEPS, share)) is Sweep.FORWARD
