"""Cones and glass in both costmaps: what they mark is lethal over anything, what they clear changes nothing that light has seen."""

import math

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.costmap.glass_layer import GlassLayer
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.inflation import InflationConfig
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.costmap.obstacle_layer import ObstacleLayer, SensorRays
from ambler.costmap.range_layer import RangeCone, RangeLayer

FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
ROBOT = RobotModel("test", DriveKind.DIFFERENTIAL, FOOTPRINT, VelocityLimits())
SPEC = GridSpec(0.05, 80, 60, -1.0, -1.5)
ECHO = RangeCone(0.3, 0.0, 0.0, math.radians(15), 1.0, 1.02)
FREE = RangeCone(0.3, 0.0, 0.0, math.radians(15), 3.0, math.inf)
THROUGH = SensorRays((0.0, 0.0), free_ends=np.array([[3.0, 0.02 * k] for k in range(-20, 20)]))


def local_costmap() -> tuple[LocalCostmap, ObstacleLayer, RangeLayer]:
    costmap = LocalCostmap(LocalCostmapConfig(), ROBOT)
    return costmap, costmap.layer(ObstacleLayer), costmap.layer(RangeLayer)


def test_the_local_costmap_keeps_glass_that_light_goes_through() -> None:
    costmap, light, sound = local_costmap()
    for k in range(3):
        sound.add([ECHO], 0.1 * k)
        light.add([THROUGH])
        costmap.update(SE2())
    assert costmap.costs[costmap.spec.cell_of(1.32, 0.0)] == 254
    light.add([THROUGH])
    costs = costmap.update(SE2(0.2, 0.1, 0.0))
    assert costs[costmap.spec.cell_of(1.32, 0.0)] == 254, "the window has moved, the glass has not"
    for k in range(8):
        sound.add([FREE], 1.0 + 0.1 * k)
    assert costmap.update(SE2())[costmap.spec.cell_of(1.32, 0.0)] == 0
    sound.add([ECHO] * 4, 3.0)
    assert costmap.update(SE2())[costmap.spec.cell_of(1.32, 0.0)] == 254
    sound.add([], 20.0)
    assert not (costmap.update(SE2()) == 254).any(), "after 15 s without a word it is forgotten"


def test_free_cones_do_not_clear_what_light_has_seen() -> None:
    costmap, light, sound = local_costmap()
    for k in range(10):
        sound.add([FREE], 0.1 * k)
    light.add([SensorRays((0.0, 0.0), np.array([[1.3, 0.0]]))])
    assert costmap.update(SE2())[costmap.spec.cell_of(1.3, 0.0)] == 254
    costmap.clear()
    assert not (costmap.costs == 254).any()
    assert not (costmap.update(SE2()) == 254).any()


def test_the_robot_does_not_stand_in_glass() -> None:
    costmap, _, sound = local_costmap()
    for k in range(3):
        sound.add([ECHO], 0.1 * k)
    costs = costmap.update(SE2(1.3, 0.0, 0.0))
    assert costs[costmap.spec.cell_of(1.32, 0.0)] < 253


def test_glass_of_the_map_is_lethal_in_the_local_costmap_too() -> None:
    costmap, light, _ = local_costmap()
    glass = costmap.layer(GlassLayer)
    glass.set_segments(np.array([[1.02, -1.0, 1.02, 1.0]]))
    assert not (costmap.update(SE2()) == 254).any(), "nobody knows yet where the map lies"
    light.add([THROUGH])
    odom_from_map = SE2(0.5, 0.0, 0.0)
    costs = costmap.update(SE2(), odom_from_map)
    for y in np.linspace(-0.95, 0.95, 20):
        assert costs[costmap.spec.cell_of(1.52, float(y))] == 254
    glass.set_segments(np.zeros((0, 4)))
    assert not (costmap.update(SE2(), odom_from_map) == 254).any()


def global_costmap() -> tuple[GlobalCostmap, RangeLayer, GlassLayer]:
    costmap = GlobalCostmap(GlobalCostmapConfig(inflation=InflationConfig(radius=0.3)), ROBOT)
    occupancy = np.zeros(SPEC.shape, np.int8)
    occupancy[:, 60:] = -1
    costmap.set_map(SPEC, occupancy)
    return costmap, costmap.layer(RangeLayer), costmap.layer(GlassLayer)


def test_the_global_costmap_shows_cones_and_never_frees_the_unknown() -> None:
    costmap, sound, _ = global_costmap()
    before = costmap.costs
    sound.add([ECHO], 0.0)
    assert costmap.update() is before, "one echo is not believed: nothing new"
    sound.add([ECHO], 0.1)
    costs = costmap.update()
    assert costs is not before
    assert costs[SPEC.cell_of(1.32, 0.0)] == 254
    assert costs[SPEC.cell_of(1.2, 0.0)] == 253, "inflated as any obstacle"
    for k in range(10):
        sound.add([FREE], 0.2 + 0.1 * k)
    assert costmap.update()[SPEC.cell_of(1.32, 0.0)] == 0
    assert costmap.costs[SPEC.cell_of(2.2, 0.0)] == 255, "sound does not explore"


def test_glass_is_lethal_moves_with_the_map_and_is_replaced_as_a_whole() -> None:
    costmap, _, glass = global_costmap()
    glass.set_segments(np.array([[1.02, -1.0, 1.02, 1.0]], np.float32))
    costs = costmap.update()
    column = SPEC.cell_of(1.02, 0.0)[1]
    assert (costs[SPEC.cell_of(0.0, -0.9)[0] : SPEC.cell_of(0.0, 0.9)[0], column] == 254).all()
    grown = GridSpec(0.05, 100, 80, -1.5, -2.0)
    costmap.set_map(grown, np.zeros(grown.shape, np.int8))
    assert costmap.costs[grown.cell_of(1.02, 0.5)] == 254
    costmap.clear()
    assert costmap.costs[grown.cell_of(1.02, 0.5)] == 254, "glass is a part of the map"
    glass.set_segments(np.zeros((0, 4)))
    assert (costmap.update() == 0).all()


@pytest.mark.parametrize("moves", [(0.5, -0.25), (-1.0, 0.0)])
def test_marks_keep_their_place_when_the_map_grows(moves: tuple[float, float]) -> None:
    costmap, sound, _ = global_costmap()
    sound.add([ECHO] * 3, 0.0)
    costmap.update()
    grown = GridSpec(0.05, 140, 120, -1.0 - abs(moves[0]), -1.5 - abs(moves[1]))
    costmap.set_map(grown, np.zeros(grown.shape, np.int8))
    assert costmap.costs[grown.cell_of(1.32, 0.0)] == 254
