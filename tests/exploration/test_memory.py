"""What the explorer remembers of frontiers: however they overlap, looks in vain come to an end."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, FrontierState, OccupancyGrid
from ambler.exploration.memory import FrontierMemory, MemoryConfig

MAP = OccupancyGrid(0, "map", GridSpec(0.05, 200, 200, 0.0, 0.0), np.zeros((200, 200), np.int8))


def line(x0: float, y0: float, x1: float, y1: float) -> Frontier:
    """A frontier along a line, a cell every 5 cm, with its goal half a metre before its middle."""
    n = max(2, round(float(np.hypot(x1 - x0, y1 - y0)) / 0.05))
    cells = np.column_stack((np.linspace(x0, x1, n), np.linspace(y0, y1, n))).astype(np.float32)
    middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
    return Frontier(cells, middle, (middle[0], middle[1] - 0.5, 0.0), 0.3, FrontierState.OPEN, "")


def looks_until_all_are_left(frontiers: list[Frontier], most: int) -> int:
    """Go to frontiers as long as one may be tried, look at each in vain, and return how many looks that takes."""
    memory = FrontierMemory(MemoryConfig(), 50)
    for count in range(most):
        wanted = None
        for frontier in frontiers:
            assert frontier.goal is not None
            places = memory.places_in_vain(frontier)
            is_elsewhere = bool(places) and all(np.hypot(*np.subtract(frontier.goal[:2], p)) > 1.0 for p in places)
            if not memory.reason_against(frontier, MAP, is_elsewhere=is_elsewhere):
                wanted = frontier
                break
        if wanted is None:
            return count
        assert wanted.goal is not None
        memory.refuse(wanted, "nothing changed", MAP, has_looked=True, place=wanted.goal[:2])
    return most


def test_a_frontier_and_a_part_of_it_do_not_take_turns() -> None:
    """In a drawn office a robot had looked a thousand times in turns at two of them, from where it stood."""
    whole, part = line(2.0, 5.0, 4.0, 5.0), line(2.2, 5.2, 2.8, 5.2)
    assert looks_until_all_are_left([whole, part], 40) <= 8
    assert looks_until_all_are_left([part, whole], 40) <= 8


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 100_000), st.integers(2, 6))
def test_looks_at_frontiers_that_overlap_come_to_an_end(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    frontiers = []
    for _ in range(count):
        x, y = rng.uniform(3.0, 5.0, 2)
        turn, size = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 3.0)
        frontiers.append(line(x, y, x + size * np.cos(turn), y + size * np.sin(turn)))
    assert looks_until_all_are_left(frontiers, 200) <= 6 * count


def test_what_lies_elsewhere_is_not_refused_with_it() -> None:
    memory = FrontierMemory(MemoryConfig(), 50)
    for frontier in (line(2.0, 5.0, 4.0, 5.0), line(2.2, 5.2, 2.8, 5.2)):
        for _ in range(3):
            memory.refuse(frontier, "nothing changed", MAP, has_looked=True)
    assert memory.reason_against(line(2.0, 5.1, 3.0, 5.1), MAP)
    assert not memory.reason_against(line(2.0, 6.0, 4.0, 6.0), MAP)
