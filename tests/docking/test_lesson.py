"""A lesson: what is constant is taken out, single mistakes are not, and what cannot be meant is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.docking.covariance import difference
from ambler.docking.lesson import DockLesson, LessonConfig

SEEN = SE2(0.003, -0.004, math.radians(0.4))


def lesson(seen: SE2, count: int = 60, outliers: int = 0) -> DockLesson:
    rng, out = np.random.default_rng(2), DockLesson()
    for k in range(count):
        noise = SE2(*(rng.normal(0.0, [0.002, 0.003, math.radians(0.3)])))
        out.add(seen @ (SE2(0.2, 0.1, 0.1) if k < outliers else noise))
    return out


@pytest.mark.parametrize("outliers", [0, 6])
def test_what_is_seen_with_the_offset_is_where_the_robot_stands(outliers: int) -> None:
    left = difference(SE2(), SEEN @ lesson(SEEN, 60, outliers).offset())
    assert math.hypot(left[0], left[1]) < 0.0015
    assert abs(left[2]) < math.radians(0.12)


def test_a_lesson_is_full_refused_or_too_short() -> None:
    config = LessonConfig()
    assert lesson(SEEN, config.sightings).is_full
    assert not lesson(SEEN, config.sightings - 1).is_full
    with pytest.raises(BadInputError, match=f"seen {config.least - 1} times"):
        lesson(SEEN, config.least - 1).offset()
    lesson(SEEN, config.least).offset()
    for wrong in (SE2(0.06, 0.0, 0.0), SE2(0.0, 0.0, math.radians(4.0))):
        with pytest.raises(BadInputError, match="where it is described"):
            lesson(wrong).offset()
