"""The terrain node: what it tells is what the analysis says, in the frame of the odometry; clouds without odometry are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import Number, Odometry, PointCloud
from ambler.core.se3 import SE3
from ambler.nodes.terrain import TerrainNode
from ambler.perception.terrain import TerrainAnalysis
from ambler.perception.terrain_config import TerrainConfig
from ambler.robots.spatial_robots import mecanum
from ambler.runtime.topics import (
    CLOUD_CLEARING,
    MAP_CLEARING,
    ODOMETRY,
    REGISTERED_CLOUD,
    TERRAIN_CLEARING,
    TERRAIN_MAP,
    TERRAIN_MAP_EXT,
    Topic,
)
from ambler.sim.solids import Solid
from ambler.studies.made_ground import LEVEL, Rover, made, slab
from tests.hand_made_context import HandMadeContext

ROBOT = mecanum().model
BEGIN_NS = 1_000_000_000


FLOOR, BOX = slab(-20.0, 20.0, -20.0, 20.0), slab(4.0, 4.5, -1.0, 1.0, top=0.4)


def told(scans: int, *solids: Solid, has_odometry: bool = True) -> HandMadeContext:
    rover = Rover(made(*(solids or (FLOOR, BOX))), ROBOT, 1)
    context = HandMadeContext()
    near = replace(TerrainConfig().for_robot(ROBOT), columns=TerrainConfig().columns)
    context.start(TerrainNode(ROBOT, near))
    for k in range(scans):
        points, stamp_ns, base, _ = rover.scan(SE3((0.05 * k, 0.0, LEVEL)))
        stamp_ns += BEGIN_NS
        if has_odometry:
            zero = (0.0, 0.0, 0.0)
            for at in (stamp_ns - 50_000_000, stamp_ns, stamp_ns + 5_000_000):
                none = np.zeros((6, 6))
                context.callbacks[ODOMETRY.name](Odometry(at, "odom", "base", base, zero, zero, none, none))
        flat = np.zeros(len(points), np.float32)
        cloud = PointCloud(stamp_ns, "odom", points, flat, flat, np.zeros(len(points), np.uint16))
        context.callbacks[REGISTERED_CLOUD.name](cloud)
    return context


def test_both_terrains_are_told_with_heights_above_the_ground() -> None:
    context = told(12)
    near, wide = context.messages(TERRAIN_MAP), context.messages(TERRAIN_MAP_EXT)
    assert (len(near), len(wide)) == (6, 2)
    box = near[-1].points[near[-1].intensity > 0.08]
    assert near[-1].frame == "odom"
    ground = near[-1].points[near[-1].ring == 1]
    assert len(ground) > 500
    assert np.abs(np.median(ground[:, 2])) < 0.02
    assert np.allclose(np.median(box[:, 0]), 4.0, atol=0.3)
    assert float(box[:, 2].max()) < 0.45
    assert np.ptp(wide[-1].points[:, 0]) > np.ptp(near[-1].points[:, 0])
    assert set(np.unique(near[-1].ring)) <= {0, 1, 2, 3, 4, 5}


def test_what_hangs_over_the_robot_is_judged_from_the_base_and_seen_from_the_sensor() -> None:
    for bottom, is_obstacle in ((0.5, True), (0.85, False)):
        terrain = told(12, FLOOR, slab(3.0, 3.4, -1.0, 1.0, top=bottom + 0.06, bottom=bottom)).messages(TERRAIN_MAP)[-1]
        blocked = terrain.points[terrain.intensity > 0.08]
        about = (blocked[:, 0] > 2.8) & (blocked[:, 0] < 3.6) & (np.abs(blocked[:, 1]) < 1.5)
        assert (about.sum() > 10) == is_obstacle


@pytest.mark.parametrize(
    ("topic", "is_wide"), [(MAP_CLEARING, False), (TERRAIN_CLEARING, False), (CLOUD_CLEARING, True)]
)
def test_the_near_and_the_wide_terrain_are_forgotten_each_by_its_own_order(
    topic: Topic[Number], is_wide: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    context, asked = told(12), []
    monkeypatch.setattr(TerrainAnalysis, "forget", lambda self, *circle: asked.append((self.config.voxel, *circle)))
    for radius in (3.0, 0.0, -1.0):
        context.callbacks[topic.name](Number(0, radius))
    ((voxel, x, y, radius),) = asked
    assert (voxel, radius) == (0.2 if is_wide else 0.1, 3.0)
    assert (x, y) == pytest.approx((0.55, 0.0), abs=0.02)


def test_clouds_of_moments_without_odometry_are_left_out() -> None:
    assert told(4, has_odometry=False).published == []


def test_a_robot_without_clouds_is_refused() -> None:
    with pytest.raises(BadInputError, match="clouds"):
        TerrainNode(replace(ROBOT, sensors=()), TerrainConfig())
