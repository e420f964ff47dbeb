"""Numbers of sides in squares against one large array."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.exploration.side_counts import SQUARE, SideCounts
from ambler.exploration.sides import SIDES

FAR = 3 * SQUARE  # cells of the large array to each side of its middle


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_what_was_put_in_is_read_wherever_the_box_lies(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts, twin = SideCounts(), np.zeros((SIDES, 2 * FAR, 2 * FAR), np.uint8)
    for _ in range(6):
        h, w = (int(v) for v in rng.integers(1, 2 * SQUARE, 2))
        iy, ix = (int(rng.integers(-FAR, FAR - n + 1)) for n in (h, w))
        box = np.s_[:, FAR + iy : FAR + iy + h, FAR + ix : FAR + ix + w]
        numbers = counts.read(iy, ix, h, w)
        assert np.array_equal(numbers, twin[box])
        numbers += (rng.integers(0, 7, numbers.shape) * (rng.random(numbers.shape) < 0.01)).astype(np.uint8)
        assert np.array_equal(counts.read(iy, ix, h, w), twin[box]), "until it is written, it is the reader's own"
        counts.write(iy, ix, numbers)
        twin[box] = numbers
    assert np.array_equal(counts.read(-FAR, -FAR, 2 * FAR, 2 * FAR), twin)


def test_zeros_take_no_room_but_wipe_out_what_was_there() -> None:
    counts, nothing = SideCounts(), np.zeros((SIDES, 300, 300), np.uint8)
    counts.write(-100, 50, nothing)
    assert not counts._squares
    counts.write(0, 60, np.ones((SIDES, 1, 1), np.uint8))
    assert len(counts._squares) == 1
    counts.write(-100, 50, nothing)
    assert not counts.read(0, 60, 1, 1).any()
