"""Where the robot itself stood a moment ago nothing else stood: who is there now came by himself."""

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.safety.visitors import AGE, DRIVEN, INSIDE, Visitors

FOOTPRINT = np.array([[0.6, -0.4], [0.6, 0.4], [-0.6, 0.4], [-0.6, -0.4]])
NOBODY = np.zeros((0, 2))
PLACES = np.array([[-0.5, 0.0], [-0.6 + 0.5 * INSIDE, 0.0], [-0.7, 0.0], [0.0, -0.45]])


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_what_was_under_the_robot_came(yaw: float) -> None:
    visitors, pose = Visitors(FOOTPRINT), SE2(2.0, 1.0, yaw)
    visitors.stand(1.0, 0.0, pose)
    visitors.stand(1.6, 0.3, pose @ SE2(0.3, 0.0))
    places = pose.transform(PLACES)
    assert visitors.came(places, NOBODY, 2.0, 0.3).tolist() == [True, False, False, False], (
        "beside it, anything may stand"
    )
    assert not visitors.came(places, NOBODY, 1.0 + 0.5 * AGE, 0.3).any(), "at once nobody can tell"
    assert not visitors.came(places, NOBODY, 9.0, 0.3 + 1.1 * DRIVEN).any(), "odometry has drifted"


def test_without_a_footprint_nothing_is_told() -> None:
    visitors = Visitors()
    visitors.stand(1.0, 0.0, SE2())
    assert not visitors.came(PLACES, NOBODY, 2.0, 0.3).any()
