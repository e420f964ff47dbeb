"""Goals as words: a pose, and the level on which it lies."""

from __future__ import annotations

import math

import pytest

from ambler.apps.programs import steps_from_values, steps_to_values
from ambler.cli.run_options import parse_goal
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.nodes.steps import NavigateStep


def test_a_goal_may_say_its_level() -> None:
    assert parse_goal("1,-2.5", "goal") == NavigateStep(SE2(1.0, -2.5, 0.0))
    assert parse_goal("1,2,90@0", "goal") == NavigateStep(SE2(1.0, 2.0, math.pi / 2), level=0)
    assert parse_goal(" 1,2 @ 12 ", "goal").level == 12


@pytest.mark.parametrize("text", ["1,2@", "1,2@-1", "1,2@1.5", "1,2@up", "1,2@1@2", "1@2", "@1"])
def test_words_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(BadInputError, match="goal"):
        parse_goal(text, "goal")


def test_the_level_is_kept_with_the_program_of_a_run() -> None:
    steps = (NavigateStep(SE2(1.0, 2.0, 0.5), level=2), NavigateStep(SE2()))
    assert steps_from_values(steps_to_values(steps)) == steps
