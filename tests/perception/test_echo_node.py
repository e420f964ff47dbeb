"""Echoes are judged once: what the node tells stands where the thing is, and is unexplained where only sound sees it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ambler.core import messages as m
from ambler.core.errors import TransformError
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.costmap.range_layer import RangeLayer
from ambler.nodes.echoes import EchoNode
from ambler.nodes.layer_inputs import cone_of, usual_inputs
from ambler.nodes.local_view import LocalView
from ambler.nodes.map_frames import MapFrames
from ambler.runtime.topics import (
    ADDED_OBSTACLES,
    BLOCKED,
    BOUNDARY,
    CLOUD,
    ECHOES,
    GLASS,
    ODOMETRY,
    RANGES,
    SCAN,
    SCANNERS,
    Topic,
)
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec

WALL = Solid("wall", Shape.BOX, SE2(2.0, 0.0, 0.0), 0.02, 5.0, 0.0, 2.2)
PANE = Solid("pane", Shape.BOX, SE2(1.6, 0.0, 0.3), 0.02, 5.0, 0.0, 2.2, is_glass=True)


class Context:
    """The node's world by hand."""

    def __init__(self, node: EchoNode) -> None:
        self.hear: dict[str, Callable[[Any], None]] = {}
        self.said: list[m.JudgedEcho] = []
        node.ctx = self  # type: ignore[assignment]
        node.start()

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self.hear[topic.name] = callback

    def publish(self, topic: Topic[Any], message: m.JudgedEcho) -> None:
        assert topic is ECHOES
        self.said.append(message)


def drive(robot: str, solid: Solid, seconds: float = 3.0, **changes: Any) -> list[m.JudgedEcho]:
    """Turn slowly before something that stands 1.5 to 2 m ahead, with perfect odometry."""
    model = robot_named(robot)
    context = Context(EchoNode(model.model, **changes))
    simulation = Simulation(WorldSpec("w", (solid,), SE2()), model, SimulationConfig(4, physics="kinematic"))
    scans = SCANNERS if len(model.model.scanners) > 1 else SCAN
    for k in range(round(seconds * 10)):
        simulation.command(BodyVelocity(0.0, 0.0, 0.3))
        out = simulation.step((k + 1) * 100_000_000)
        still = np.zeros((6, 6))
        for pose in out.true_poses:
            context.hear["odometry"](
                m.Odometry(pose.stamp_ns, "odom", "base", pose.pose, pose.linear, pose.angular, still, still)
            )
        for scan in out.scans:
            context.hear[scans.name](scan)
        for cloud in out.clouds:
            context.hear["cloud"](cloud)
        for measured in out.ranges:
            context.hear["ranges"](measured)
    return context.said


def gap(echo: m.JudgedEcho, solid: Solid) -> float:
    """How far the nearest point of the echo's arc lies from the solid's middle plane, metres."""
    angles = np.linspace(-echo.half_angle, echo.half_angle, 61)
    arc = echo.pose.to_se2().transform(echo.distance * np.column_stack((np.cos(angles), np.sin(angles))))
    return float(np.abs(solid.world_from_solid.inverse().transform(arc)[:, 0]).min())


@pytest.mark.parametrize("robot", ["diff+ultrasonic", "amr_omni+ultrasonic", "spot+ultrasonic"])
def test_an_echo_from_a_wall_is_explained_and_stands_at_the_wall(robot: str) -> None:
    said = [echo for echo in drive(robot, WALL) if math.isfinite(echo.distance)]
    assert len(said) > 20
    assert np.mean([echo.is_unexplained for echo in said]) < 0.1
    assert np.median([gap(echo, WALL) for echo in said]) < 0.05
    assert {echo.frame for echo in said} == {"odom"}


@pytest.mark.parametrize("robot", ["diff+ultrasonic", "amr_omni+ultrasonic"])
def test_an_echo_from_a_pane_is_unexplained_and_stands_at_the_pane(robot: str) -> None:
    said = [echo for echo in drive(robot, PANE) if math.isfinite(echo.distance)]
    assert np.mean([echo.is_unexplained for echo in said]) > 0.9
    assert np.median([gap(echo, PANE) for echo in said]) < 0.05
    rings = {mount.frame for mount in robot_named(robot).model.rangers}
    assert {echo.sensor for echo in said} <= rings


def test_it_listens_to_every_scanner_that_the_robot_has() -> None:
    def inputs(robot: str) -> set[str]:
        return {topic.name for topic in EchoNode(robot_named(robot).model).inputs}

    sound = {RANGES.name, ODOMETRY.name}
    assert inputs("diff+ultrasonic") == sound | {SCAN.name}
    assert inputs("amr_omni+ultrasonic") == sound | {SCANNERS.name}
    assert inputs("spot+ultrasonic") == sound | {CLOUD.name}


def test_the_clock_of_a_scanner_is_put_right() -> None:
    """A clock that is 1 s ahead puts the scan where no odometry reaches yet: nothing would be explained."""
    model = robot_named("diff+ultrasonic").model
    (laser,) = model.scanners
    ring, zero = model.rangers[0], np.zeros((6, 6))
    at = ring.base_from_sensor.to_se2() @ SE2(1.0, 0.0, 0.0)
    seen = laser.base_from_sensor.to_se2().inverse().transform(np.array([[at.x, at.y]]))[0]
    yaw, away = math.atan2(seen[1], seen[0]), math.hypot(*seen)

    def judged(clock_offset: float) -> bool:
        sensors = tuple(replace(x, clock_offset=clock_offset) if x is laser else x for x in model.sensors)
        context = Context(EchoNode(replace(model, sensors=sensors)))
        for k in range(3):
            ns = 80_000_000 * k
            context.hear["odometry"](
                m.Odometry(ns, "odom", "base", SE3(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), zero, zero)
            )
            beams = np.full(3, away, np.float32)
            nothing = np.zeros(0, np.float32)
            context.hear["scan"](
                m.LaserScan(ns + 1_000_000_000, laser.frame, yaw - 0.01, 0.01, 0.0, 0.1, 0.05, 10.0, beams, nothing)
            )
            context.hear["ranges"](m.Range(ns, ring.frame, 0.5, 0.03, 3.0, 1.0))
        return context.said[-1].is_unexplained

    assert judged(0.0)
    assert not judged(1.0)


def told(sensor_x: float, distance: float, *, unexplained: bool = True) -> m.JudgedEcho:
    pose = SE3.from_se2(SE2(sensor_x, 0.0, 0.0))
    return m.JudgedEcho(0, "odom", "sonar", pose, 0.26, distance, min(distance, 3.0), unexplained)


def test_cones_of_echoes() -> None:
    cone = cone_of(told(0.5, 1.0), SE2(2.0, 1.0, 0.5))
    assert (cone.x, cone.y, cone.yaw, cone.echo) == (2.0, 1.0, 0.5, 1.0)
    assert cone.free == pytest.approx(0.95)
    assert cone_of(told(0.5, 1.0, unexplained=False), SE2()).echo == math.inf


def edges(map_from_odom: SE2, odom_from_base: SE2) -> m.Transforms:
    named = (("map", "odom", map_from_odom), ("odom", "base", odom_from_base))
    return m.Transforms(0, tuple(m.TransformStamped(0, a, b, SE3.from_se2(pose)) for a, b, pose in named))


def test_the_same_echo_lands_at_the_same_place_in_both_costmaps() -> None:
    """The map lies turned and shifted in odometry, so that a mix-up of frames cannot go unnoticed."""
    model: RobotModel = robot_named("diff+ultrasonic").model
    map_from_odom, odom_from_base = SE2(3.0, -1.0, 0.7), SE2(-1.0, 0.5, 0.3)
    local, whole = LocalCostmap(LocalCostmapConfig(), model), GlobalCostmap(GlobalCostmapConfig(), model)
    view, frames = LocalView(model, local), MapFrames()
    frames.add(edges(map_from_odom, odom_from_base))
    view.add_transforms(edges(map_from_odom, odom_from_base))
    for costmap, where in ((local, view), (whole, frames)):
        by_topic = {wanted.topic: wanted for wanted in usual_inputs(costmap.layers)}
        assert set(by_topic) - {BLOCKED, ADDED_OBSTACLES, BOUNDARY} == {ECHOES, GLASS}
        for _ in range(3):
            by_topic[ECHOES].feed(told(0.2, 1.3), where)
        by_topic[GLASS].feed(m.GlassWalls(0, "map", np.zeros((0, 4), np.float32), np.zeros(0, np.float32)), where)
    costs = local.update(odom_from_base, map_from_odom.inverse())
    assert costs[local.spec.cell_of(1.5, 0.0)] == 254
    spec = local.spec
    moved = type(spec)(spec.resolution, 240, 240, -3.0, -7.0)
    costs = whole.set_map(moved, np.zeros(moved.shape, np.int8))
    at = map_from_odom.transform(np.array([[1.5, 0.0]]))[0]
    assert costs[moved.cell_of(*at)] == 254
    assert local.layer(RangeLayer).cells is not None


def test_frames_of_both_costmaps_agree_on_where_things_are() -> None:
    model = robot_named("diff").model
    map_from_odom, odom_from_base = SE2(3.0, -1.0, 0.7), SE2(-1.0, 0.5, 0.3)
    view, frames = LocalView(model, LocalCostmap(LocalCostmapConfig(), model)), MapFrames()
    for where in (view, frames):
        with pytest.raises(TransformError):
            where.costmap_from("map" if where is view else "odom", 0)
    frames.add(edges(map_from_odom, odom_from_base))
    mounts = [m.TransformStamped(0, "base", k.frame, k.base_from_sensor) for k in model.sensors]
    frames.add_static(m.Transforms(0, tuple(mounts)))
    view.add_transforms(edges(map_from_odom, odom_from_base))
    zero = np.zeros((6, 6))
    view.add_odometry(m.Odometry(0, "odom", "base", SE3.from_se2(odom_from_base), (0.0,) * 3, (0.0,) * 3, zero, zero))
    for frame in ("map", "odom", "base", model.scanners[0].frame):
        there = frames.costmap_from(frame, 0)
        here = map_from_odom @ view.costmap_from(frame, 0)
        np.testing.assert_allclose(here.as_array(), there.as_array(), atol=1e-9)
    mount = model.scanners[0].base_from_sensor.to_se2()
    scanner = view.costmap_from(model.scanners[0].frame, 0)
    np.testing.assert_allclose(scanner.as_array(), (odom_from_base @ mount).as_array(), atol=1e-9)
