"""Random sequences of everything that can be fed, against costmaps that draw every layer whole and inflate cell by cell: bit-equal."""

import math

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.costmap.glass_layer import GlassLayer
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.inflation import Inflation, InflationConfig
from ambler.costmap.layer import Moment
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.costmap.obstacle_layer import ObstacleConfig, ObstacleLayer, SensorRays
from ambler.costmap.range_layer import RangeCone, RangeConfig, RangeLayer
from ambler.costmap.static_layer import StaticConfig, occupancy_table
from tests.costmap.slow_costmaps import SlowCostmap, SlowLight, SlowSound

FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
ROBOT = RobotModel("test", DriveKind.DIFFERENTIAL, FOOTPRINT, VelocityLimits())
LIGHT = ObstacleConfig(obstacle_range=1.5, raytrace_range=2.0)


def rays(rng: np.random.Generator, at: np.ndarray) -> SensorRays:
    hits, free = at + rng.uniform(-2, 2, (int(rng.integers(1, 30)), 2)), at + rng.uniform(-3, 3, (10, 2))
    if rng.random() < 0.2:
        hits[0] = math.nan
    return SensorRays((float(at[0]), float(at[1])), hits, free)


def cones(rng: np.random.Generator, at: np.ndarray) -> list[RangeCone]:
    said = []
    for _ in range(int(rng.integers(0, 5))):
        (x, y), yaw = at + rng.uniform(-0.3, 0.3, 2), float(rng.uniform(-3, 3))
        echo = float(rng.choice([math.inf, rng.uniform(0.2, 1.5)]))
        said += [RangeCone(float(x), float(y), yaw, 0.26, min(echo, 1.5), echo)] * 2
    return said


def glass(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-2, 2, (int(rng.integers(0, 4)), 4))


@pytest.mark.parametrize("seed", range(6))
def test_the_local_costmap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inflation = InflationConfig(radius=(0.01, 0.3)[seed % 2])
    config = LocalCostmapConfig(3.0, 0.1, seed % 3 == 0, LIGHT, inflation, RangeConfig(decay=1.0))
    costmap = LocalCostmap(config, ROBOT)
    costmap.update(SE2())
    light, sound, panes = costmap.layer(ObstacleLayer), costmap.layer(RangeLayer), costmap.layer(GlassLayer)
    slow = SlowCostmap(
        Inflation(inflation, ROBOT, 0.1), SlowLight(LIGHT), SlowSound(config.ranges), costmap.spec, seed % 3 == 0
    )
    slow.light.see(costmap.spec, [])
    slow.stand(FOOTPRINT)
    at, now = np.zeros(2), 0.0
    for _ in range(30):
        now += float(rng.uniform(0.0, 0.3))
        event = rng.random()
        if event < 0.35:
            said = cones(rng, at)
            sound.add(said, now)
            slow.sound.hear(slow.spec, said, now)
        elif event < 0.45:
            segments = glass(rng)
            panes.set_segments(segments)
            slow.glass = segments
        elif event < 0.5:
            costmap.clear()
            assert (costmap.costs == (255 if config.tracks_unknown else 0)).all()
            slow.light, slow.sound = SlowLight(LIGHT), SlowSound(config.ranges)
        else:
            at = at + rng.normal(0.0, 0.2, 2)
            pose = SE2(float(at[0]), float(at[1]), float(rng.uniform(-3, 3)))
            seen = [rays(rng, at) for _ in range(int(rng.integers(0, 3)))]
            light.add(seen)
            costs = costmap.update(pose, SE2())
            slow.move_to(costmap.spec)
            slow.light.see(slow.spec, seen)
            slow.stand(pose.transform(FOOTPRINT))
            np.testing.assert_array_equal(costs, slow.costs())


@pytest.mark.parametrize("seed", range(6))
def test_the_global_costmap(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    inflation, ranges = InflationConfig(radius=0.5), RangeConfig(decay=(math.inf, 1.0)[seed % 2])
    costmap = GlobalCostmap(GlobalCostmapConfig(StaticConfig(), LIGHT, inflation, ranges), ROBOT)
    light, sound, panes = costmap.layer(ObstacleLayer), costmap.layer(RangeLayer), costmap.layer(GlassLayer)
    spec = GridSpec(0.1, 40, 34, -2.0, -1.7)
    kinds, chances = np.array([-1, 0, 40, 100], np.int8), [0.2, 0.75, 0.03, 0.02]
    cells = rng.choice(kinds, spec.shape, p=chances)
    costmap.set_map(spec, cells)
    slow = SlowCostmap(Inflation(inflation, ROBOT, 0.1), SlowLight(LIGHT), SlowSound(ranges), spec)
    slow.table, slow.occupancy = occupancy_table(StaticConfig()), cells
    now = 0.0
    for _ in range(40):
        now += 0.2
        event, at = rng.random(), rng.uniform(-1, 1, 2)
        if event < 0.2:
            said = cones(rng, at)
            sound.add(said, now)
            costmap.update()
            slow.sound.hear(spec, said, now)
        elif event < 0.3:
            slow.glass = glass(rng)
            panes.set_segments(slow.glass)
            costmap.update()
        elif event < 0.35:
            costmap.clear()
            slow.light, slow.sound = SlowLight(LIGHT), SlowSound(ranges)
        elif event < 0.6:
            cells = cells.copy()
            y, x = int(rng.integers(0, 30)), int(rng.integers(0, 35))
            cells[y : y + 5, x : x + 5] = rng.choice(kinds, cells[y : y + 5, x : x + 5].shape, p=chances)
            slow.occupancy = cells
            costmap.set_map(spec, cells)
        elif event < 0.65:
            grown = GridSpec(0.1, spec.width + 3, spec.height + 2, spec.origin_x - 0.2, spec.origin_y - 0.1)
            larger = np.full(grown.shape, -1, np.int8)
            larger[1:-1, 2:-1] = cells
            spec, cells = grown, larger
            costmap.set_map(spec, cells)
            slow.move_to(spec)
            slow.occupancy = cells
        else:
            seen = [rays(rng, at)]
            light.add(seen)
            slow.light.see(spec, seen)
            footprint = SE2(float(at[0]), float(at[1]), now).transform(FOOTPRINT) if event < 0.8 else None
            costmap.update(Moment(footprint=footprint))
            if footprint is not None:
                slow.stand(footprint)
        np.testing.assert_array_equal(costmap.costs, slow.costs())
