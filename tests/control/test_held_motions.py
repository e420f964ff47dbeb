"""What the gate has held where the robot stands is not asked for again, and nothing else is blamed for it."""

import pytest

from ambler.control.held_motions import HeldMotions
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2

HERE = SE2(2.0, 1.0, 0.5)
TURN, SLIDE, AHEAD = BodyVelocity(0.0, 0.0, -1.2), BodyVelocity(0.0, 0.2, 0.0), BodyVelocity(0.3, 0.0, -0.5)
PERIOD = 0.05


class Cycles:
    """A controller's cycles, told by their wishes."""

    def __init__(self) -> None:
        self.held, self.seconds = HeldMotions(), 10.0

    def run(self, seconds: float, wanted: BodyVelocity, *, is_held: bool, here: SE2 = HERE) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.seconds += PERIOD
            self.held.update(self.seconds, here, wanted, is_held=is_held)


@pytest.fixture
def cycles() -> Cycles:
    """A robot whose turn has been held for a second."""
    out = Cycles()
    out.run(1.0, TURN, is_held=False)
    out.run(0.4, TURN, is_held=True)
    assert not out.held.refuses(TURN), "for a moment anything may be in the way"
    out.run(0.6, TURN, is_held=True)
    return out


def test_what_is_held_is_refused_and_nothing_else(cycles: Cycles) -> None:
    assert cycles.held.refuses(TURN)
    assert cycles.held.refuses(BodyVelocity(0.0, 0.0, -0.4)), "slower it is the same motion"
    for other in (SLIDE, AHEAD, BodyVelocity(0.0, 0.0, 1.2), BodyVelocity(-0.2, 0.0, 0.0), BodyVelocity()):
        assert not cycles.held.refuses(other)


def test_a_stop_that_lasts_does_not_blame_what_is_wanted_next_at_once(cycles: Cycles) -> None:
    cycles.run(2.2, SLIDE, is_held=True)
    assert not cycles.held.refuses(SLIDE), "the gate holds everything for two seconds"
    cycles.run(1.2, SLIDE, is_held=True)
    assert cycles.held.refuses(SLIDE)


def test_stops_that_come_and_go_add_up() -> None:
    cycles = Cycles()
    for _ in range(10):
        cycles.run(0.1, TURN, is_held=False)
        cycles.run(0.1, TURN, is_held=True)
    assert cycles.held.refuses(TURN)


@pytest.mark.parametrize("there", [SE2(2.2, 1.0, 0.5), SE2(2.0, 1.0, 0.8)])
def test_elsewhere_it_is_asked_for_again(cycles: Cycles, there: SE2) -> None:
    cycles.run(PERIOD, TURN, is_held=False, here=SE2(2.1, 1.0, 0.6))
    assert cycles.held.refuses(TURN), "as good as the same place"
    cycles.run(PERIOD, TURN, is_held=False, here=there)
    assert not cycles.held.refuses(TURN)


def test_after_half_a_minute_it_is_asked_for_again(cycles: Cycles) -> None:
    cycles.run(29.0, BodyVelocity(), is_held=False)
    assert cycles.held.refuses(TURN)
    cycles.run(2.0, BodyVelocity(), is_held=False)
    assert not cycles.held.refuses(TURN)


def test_a_robot_that_wants_nothing_is_blamed_for_nothing() -> None:
    cycles = Cycles()
    cycles.run(10.0, BodyVelocity(), is_held=True)
    assert not cycles.held.refuses(BodyVelocity())
