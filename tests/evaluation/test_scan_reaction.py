"""The time from a scan to the first command that knows of it."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.evaluation.scan_reaction import KnowingCommand, TakenScan, reaction_times, summary_ms

MS = 1_000_000


def scans(*ends_ms: int, motion: int = 1) -> list[TakenScan]:
    """Scans of 100 ms each that arrive 5 ms after their ends."""
    return [TakenScan((end - 100) * MS, end * MS, (end + 5) * MS, motion) for end in ends_ms]


def commands(*pairs: tuple[int, int], motion: int = 1) -> list[KnowingCommand]:
    """Commands (sent, end of the newest scan that they know of), ms."""
    return [KnowingCommand(sent * MS, (end - 100) * MS, motion) for sent, end in pairs]


def test_it_is_counted_from_the_last_point_to_the_first_command_that_knows() -> None:
    told = commands((110, 0), (130, 100), (150, 100), (232, 200))
    assert reaction_times(scans(100, 200), told, in_motion=True) == pytest.approx([0.030, 0.032])


def test_a_scan_that_is_passed_over_waits_for_a_later_one() -> None:
    every = reaction_times(scans(100, 200, 300), commands((120, 100), (220, 200), (320, 300)), in_motion=True)
    some = reaction_times(scans(100, 200, 300), commands((120, 100), (220, 100), (320, 300)), in_motion=True)
    assert every == pytest.approx([0.02, 0.02, 0.02])
    assert some == pytest.approx([0.02, 0.12, 0.02])


def test_a_command_that_knows_less_than_one_before_makes_nothing_unknown() -> None:
    assert reaction_times(scans(100), commands((120, 100), (140, 0)), in_motion=False) == pytest.approx([0.02])


def test_scans_of_which_no_command_knows_are_left_out() -> None:
    assert reaction_times(scans(100, 200), commands((120, 100)), in_motion=False) == pytest.approx([0.02])
    assert len(reaction_times(scans(100), [], in_motion=False)) == 0


@pytest.mark.parametrize(
    ("of_scan", "of_command", "counts"), [(1, 1, True), (0, 0, False), (1, 2, False), (0, 1, False)]
)
def test_a_motion_must_go_on_from_the_scan_to_the_command(of_scan: int, of_command: int, counts: bool) -> None:
    seen, told = scans(100, motion=of_scan), commands((120, 100), motion=of_command)
    assert len(reaction_times(seen, told, in_motion=True)) == counts
    assert len(reaction_times(seen, told, in_motion=False)) == 1


def test_the_summary_is_in_milliseconds_and_says_what_is_unknown() -> None:
    told = summary_ms("x", np.arange(101) * 1e-3)
    assert told == {
        "x_median_ms": pytest.approx(50.0),
        "x_p95_ms": pytest.approx(95.0),
        "x_p99_ms": pytest.approx(99.0),
    }
    assert set(summary_ms("x", np.empty(0)).values()) == {None}
