"""Where the robot itself stood a moment ago nothing else stood: who is there now came by himself."""

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.safety.blind_memory import BlindMemory
from ambler.safety.field_of_view import FieldOfView
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


def test_a_hanging_scanner_takes_nobody_for_a_visitor_that_a_standing_one_does_not() -> None:
    """What stands at the robot's left did not come to where its mirror image was seen free."""
    kept = []
    for roll in (0.0, math.pi):
        mount = SE3((0.0, 0.0, 0.3), (math.cos(0.5 * roll), math.sin(0.5 * roll), 0.0, 0.0))
        memory, field, left = BlindMemory(0.3, 12.0), FieldOfView(0.3), 0
        for k in range(160):
            pose = SE2(min(1.0, 0.01 * k), 0.0)
            around = np.linspace(-math.pi, math.pi, 720, endpoint=False)
            place = np.array([1.02, 0.25]) - (pose.x, pose.y)  # a post, that the robot comes to stand beside
            off = np.abs((around - math.atan2(place[1], place[0]) + math.pi) % (2.0 * math.pi) - math.pi)
            ranges = np.where(off < math.atan2(0.06, math.hypot(*place)), math.hypot(*place) - 0.06, 4.0)
            is_seen = ranges >= field.range_min
            points = (ranges[:, None] * np.column_stack((np.cos(around), np.sin(around))))[is_seen]
            level = np.column_stack((points, np.full(len(points), 0.3)))
            left = len(memory.update(level, pose, mount, field, seconds=0.1 * k))
        kept.append(left)
    assert min(kept) > 0
