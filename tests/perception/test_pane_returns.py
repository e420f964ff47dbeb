"""What walks along a pane beside a robot is its light, and nobody."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import LaserScan, Odometry
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.nodes.local_view import LocalView
from ambler.perception.pane_returns import PaneReturns
from ambler.robots.catalog import robot_model
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec
from tests.perception.test_near_panes import scan_at

HERE = SE2(3.0, -2.0, 0.7)


def everywhere(along: np.ndarray) -> np.ndarray:
    return np.full(along.shape, True)


def points_of(scan: LaserScan) -> np.ndarray:
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    return HERE.transform(scan.ranges[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))


@pytest.mark.parametrize("distance", [0.4, 1.5, 3.5])
def test_it_includes_what_shines_and_nothing_else(distance: float) -> None:
    scan = scan_at(0.0, everywhere, pane=distance)
    panes = PaneReturns()
    panes.look(scan, lambda stamp_ns: HERE)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    shines = np.abs(angles) < math.radians(12.01)
    found = panes.include(points_of(scan), scan.stamp_ns)
    assert found[shines].all()
    assert not found[~shines].any()


def test_of_a_scan_long_ago_nothing_is_left() -> None:
    scan = scan_at(0.0, everywhere)
    panes = PaneReturns()
    panes.look(scan, lambda stamp_ns: HERE)
    assert not panes.include(points_of(scan), scan.stamp_ns + 1_000_000_000).any()


def test_what_shines_beside_a_wall_counts_though_nothing_is_seen_behind_it() -> None:
    """From afar all that the beams beside the light of a pane meet is the wall that it stands in."""
    flush = scan_at(0.0, everywhere, pane=3.99)
    panes = PaneReturns()
    panes.look(flush, lambda stamp_ns: HERE)
    assert panes.include(points_of(flush), flush.stamp_ns).any()


def walkers_beside(*, tells_intensities: bool, ahead_ns: int = 0) -> int:
    """Drive 3 m along a pane at 0.5 m/s; in how many scans the controller's view of `diff` knows somebody who walks there. `ahead_ns`: of the scanner's
    stamps, which is known."""
    model, nothing, met = robot_model("diff"), np.zeros((6, 6)), 0
    model = replace(model, sensors=tuple(replace(m, clock_offset=ahead_ns * 1e-9) for m in model.sensors))
    view, rng = LocalView(model, LocalCostmap(LocalCostmapConfig(), model)), np.random.default_rng(3)
    mount = model.scanners[0].base_from_sensor.to_se2()
    for k in range(72):
        stamp_ns, y = round(k / 12 * 1e9), 0.5 * k / 12
        pose = SE3.from_se2(SE2(0.0, y, 0.0) @ mount.inverse())
        view.add_odometry(Odometry(stamp_ns, "odom", "base", pose, (0.0, 0.5, 0.0), (0.0,) * 3, nothing, nothing))
        scan = replace(scan_at(y, everywhere, pane=1.2), stamp_ns=stamp_ns + ahead_ns, frame=model.scanners[0].frame)
        scan = replace(scan, ranges=scan.ranges + rng.normal(0.0, 1e-3, len(scan.ranges)).astype(np.float32))
        view.add_scan(scan if tells_intensities else replace(scan, intensities=np.zeros(0, np.float32)))
        met += len(view.tracked) > 0
    return met


def test_the_light_of_a_pane_that_keeps_step_with_the_robot_is_nobody() -> None:
    assert walkers_beside(tells_intensities=False) > 20
    assert walkers_beside(tells_intensities=True) == 0


@pytest.mark.parametrize("ahead_ns", [400_000_000, -300_000_000])
def test_a_scanner_whose_stamps_are_off_is_understood_once_that_is_known(ahead_ns: int) -> None:
    assert walkers_beside(tells_intensities=True, ahead_ns=ahead_ns) == 0
    with_light = walkers_beside(tells_intensities=False, ahead_ns=ahead_ns)
    assert with_light == walkers_beside(tells_intensities=False)


def walkers_beside_of_cloud(*, tells_intensities: bool) -> int:
    """Drive `spot` 3 m along a pane at 0.5 m/s; in how many clouds the controller's view knows somebody who walks there."""
    robot, met = robot_named("spot"), 0
    pane = Solid("pane", Shape.BOX, SE2(2.0, 1.2, 0.0), 9.0, 0.02, 0.0, 2.2, is_glass=True)
    walls = tuple(Solid(f"wall_{y}", Shape.BOX, SE2(2.0, y, 0.0), 12.0, 0.2, 0.0, 2.5) for y in (-2.0, 4.0))
    simulation = Simulation(WorldSpec("w", (pane, *walls), SE2()), robot, SimulationConfig(4, physics="kinematic"))
    view = LocalView(robot.model, LocalCostmap(LocalCostmapConfig(), robot.model))
    for k in range(60):
        simulation.command(BodyVelocity(0.5, 0.0, 0.0))
        out = simulation.step((k + 1) * 100_000_000)
        for odometry in out.odometry:
            view.add_odometry(odometry)
        for cloud in out.clouds:
            told = cloud if tells_intensities else replace(cloud, intensity=np.full_like(cloud.intensity, 0.5))
            view.add_cloud(told)
            met += len(view.tracked) > 0
    return met


def test_nor_is_that_of_a_pane_that_a_scanner_of_many_rings_sees() -> None:
    assert walkers_beside_of_cloud(tells_intensities=False) > 20
    assert walkers_beside_of_cloud(tells_intensities=True) == 0
