"""The navigator's marks of ways that could not be followed: short where people are about, long where nobody is."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.apps.config import default_config
from ambler.core.messages import Path, PointCloud, Transforms, TransformStamped
from ambler.core.se3 import SE3
from ambler.nodes.navigator import NavigatorNode
from ambler.robots.catalog import robot_model
from ambler.runtime.topics import BLOCKED, MOVERS, TRANSFORMS
from tests.hand_made_context import HandMadeContext


@pytest.mark.parametrize(
    ("movers", "is_held", "most"), [(1, False, 10.0), (0, False, 60.0), (1, True, 10.0), (0, True, 240.0)]
)
def test_a_mark_holds_shorter_where_people_are_about(movers: int, is_held: bool, most: float) -> None:
    context, node = HandMadeContext(), NavigatorNode()
    context.start(node)
    edges = tuple(TransformStamped(0, a, b, SE3()) for a, b in (("map", "odom"), ("odom", "base")))
    context.callbacks[TRANSFORMS.name](Transforms(0, edges))
    nothing = np.zeros(movers, np.float32)
    points = np.full((movers, 3), 2.0, np.float32)
    context.callbacks[MOVERS.name](PointCloud(0, "map", points, nothing, nothing, nothing.astype(np.uint16)))
    path = Path(0, "map", np.column_stack([np.linspace(0.0, 5.0, 50), np.zeros(50), np.zeros(50)]))
    begun_ns = context.now_ns
    attempts = 1 if is_held else 3
    assert [node.mark_blocked(path, is_held=is_held) for _ in range(attempts)] == [False] * (attempts - 1) + [True]
    while len(context.messages(BLOCKED)[-1].poses) and context.now_ns - begun_ns < 300e9:
        context.run(0.5)
    assert (context.now_ns - begun_ns) * 1e-9 == pytest.approx(most, abs=1.0)


def test_an_exploration_waits_for_who_holds_it_up_but_not_as_long_as_a_drive_of_its_own() -> None:
    """Longer than a mark among people holds, and than anybody leans on a robot: else the way is shut when it asks."""
    exploring, driving = (default_config(robot_model("diff"), has_map=has_map).navigation for has_map in (False, True))
    assert exploring.blocked.keep_company + 4.0 < exploring.company_patience < driving.company_patience
