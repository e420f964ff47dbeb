"""The glass mapper between a simulated robot and a map: what it tells is where the pane stands, and it saves it beside the map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.core import messages as m
from ambler.core.grid import GridSpec
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.glass_quality import compare_glass
from ambler.nodes.echoes import EchoNode
from ambler.nodes.glass_mapper import GlassMapperNode
from ambler.runtime.node import Node
from ambler.runtime.tasks import SaveMapRequest
from ambler.runtime.topics import ECHOES, Topic
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.wire.glass_files import load_glass

PANE = Solid("pane", Shape.BOX, SE2(2.0, 1.5, 0.0), 5.0, 0.02, 0.0, 2.2, is_glass=True)
WALLS = (
    Solid("left", Shape.BOX, SE2(2.0, 4.0, 0.0), 9.0, 0.2, 0.0, 2.5),
    Solid("right", Shape.BOX, SE2(2.0, -1.2, 0.0), 9.0, 0.2, 0.0, 2.5),
    Solid("end", Shape.BOX, SE2(6.5, 1.4, 0.0), 0.2, 5.4, 0.0, 2.5),
    Solid("back", Shape.BOX, SE2(-2.5, 1.4, 0.0), 0.2, 5.4, 0.0, 2.5),
)


class Context:
    """A node's world by hand: time, what it hears and what it says. Echoes are judged by a node of their own on the way."""

    def __init__(self, node: Node, judge: EchoNode | None = None) -> None:
        self.now_ns = 0
        self.callbacks: dict[str, Callable[[Any], Any]] = {}
        self.glass: list[m.GlassWalls] = []
        self.echoes: list[m.JudgedEcho] = []
        node.ctx = self  # type: ignore[assignment]
        node.start()
        self._judge = Context(judge) if judge is not None else None

    def hear(self, topic: str, message: m.Message) -> None:
        """Deliver a message to whoever has subscribed to it."""
        if self._judge is not None and topic in self._judge.callbacks:
            self._judge.callbacks[topic](message)
            while self._judge.echoes:
                self.hear("echoes", self._judge.echoes.pop(0))
        if topic in self.callbacks:
            self.callbacks[topic](message)

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def serve(self, service: Any, callback: Callable[[Any], Any]) -> None:
        self.callbacks[service.name] = callback

    def timer(self, period: float, callback: Callable[[], None]) -> None:
        self.tell = callback

    def publish(self, topic: Topic[Any], message: Any) -> None:
        (self.echoes if topic is ECHOES else self.glass).append(message)

    def log(self, code: str, text: str, **fields: Any) -> None:
        pass


def drive(robot: str) -> Context:
    """Drive 4 m along the pane with perfect odometry."""
    model = robot_named(robot)
    context = Context(GlassMapperNode(model.model), EchoNode(model.model) if model.model.rangers else None)
    simulation = Simulation(WorldSpec("w", (PANE, *WALLS), SE2()), model, SimulationConfig(4, physics="kinematic"))
    edge = m.TransformStamped(0, "map", "odom", SE3())
    context.callbacks["transforms"](m.Transforms(0, (edge,)))
    scans = "scanners" if len(model.model.scanners) > 1 else "scan"
    for k in range(110):
        simulation.command(BodyVelocity(0.4, 0.0, 0.0))
        out = simulation.step((k + 1) * 100_000_000)
        for pose in out.true_poses:
            still = np.zeros((6, 6))
            odometry = m.Odometry(pose.stamp_ns, "odom", "base", pose.pose, pose.linear, pose.angular, still, still)
            context.hear("odometry", odometry)
        for scan in out.scans:
            context.hear(scans, scan)
        for cloud in out.clouds:
            context.hear("cloud", cloud)
        for measured in out.ranges:
            context.hear("ranges", measured)
        if k % 5 == 4:
            context.tell()
    return context


@pytest.mark.parametrize("robot", ["diff", "diff+ultrasonic", "amr_omni+ultrasonic", "spot", "mecanum"])
def test_the_pane_is_told_where_it_stands(robot: str, tmp_path: Path) -> None:
    context = drive(robot)
    last = context.glass[-1]
    quality = compare_glass(last.segments, (PANE, *WALLS), SE2(), near=0.06)
    assert quality.found_ratio > 0.9
    assert quality.invented_m <= 0.2
    assert (last.confidence > 0.6).all()
    spec = GridSpec(0.05, 200, 120, -3.0, -1.5)
    occupancy = np.full(spec.shape, 100, np.int8)
    x, y = np.meshgrid(*(spec.centers_of(np.array([[0, k] for k in range(200)]))[:, 0], np.arange(120) * 0.05 - 1.475))
    inside = (x > -0.6) & (x < 4.6) & (y > -1.1) & (y < 3.9)
    occupancy[inside] = 0
    context.callbacks["map"](m.OccupancyGrid(0, "map", spec, occupancy))
    context.callbacks["save_glass"](SaveMapRequest(str(tmp_path / "map")))
    saved = load_glass(tmp_path / "map.glass.geojson")
    assert compare_glass(saved.segments, (PANE, *WALLS), SE2(), near=0.06).found_ratio > 0.9
    assert saved.seen_through_m2 == pytest.approx(5.2 * 2.4, rel=0.1)


@pytest.mark.parametrize("robot", ["diff+ultrasonic", "spot", "go2"])
def test_without_glass_nothing_is_told(robot: str) -> None:
    model = robot_named(robot)
    context = Context(GlassMapperNode(model.model), EchoNode(model.model) if model.model.rangers else None)
    simulation = Simulation(WorldSpec("w", WALLS, SE2()), model, SimulationConfig(4, physics="kinematic"))
    context.callbacks["transforms"](m.Transforms(0, (m.TransformStamped(0, "map", "odom", SE3()),)))
    for k in range(40):
        simulation.command(BodyVelocity(0.4, 0.0, 0.3))
        out = simulation.step((k + 1) * 100_000_000)
        for odometry in out.odometry:
            context.hear("odometry", odometry)
        for scan in out.scans:
            context.hear("scan", scan)
        for cloud in out.clouds:
            context.hear("cloud", cloud)
        for measured in out.ranges:
            context.hear("ranges", measured)
        context.tell()
    assert context.glass == []
