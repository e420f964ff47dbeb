"""Ultrasonic ranges in the gate: it stops before glass that light passes, lets pass what light explains, and misses silent transducers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ambler.core.messages import Contact, VelocityCommand
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.nodes.gate import GateNode
from ambler.runtime.tasks import GateRequest
from ambler.runtime.topics import RANGES, Topic
from ambler.sim.faults import Fault
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec

FAR = Solid("far", Shape.BOX, SE2(12.0, 0.0, 0.0), 0.5, 60.0, 0.0, 2.5)


def pane(x: float, turn_deg: float, length: float = 12.0) -> Solid:
    """A pane whose middle lies at (x, 0), turned away from the robot's way."""
    return Solid("pane", Shape.BOX, SE2(x, 0.0, math.radians(turn_deg)), 0.02, length, 0.0, 2.2, is_glass=True)


class Drive:
    """A simulated robot with only a gate between a source that never slows down and the base."""

    def __init__(self, robot: str, solids: tuple[Solid, ...], faults: tuple[str, ...] = ()) -> None:
        model = robot_named(robot)
        config = SimulationConfig(3, physics="kinematic", faults=tuple(Fault.parse(f) for f in faults))
        self.simulation = Simulation(WorldSpec("w", (*solids, FAR), SE2()), model, config)
        self.now_ns = 0
        self.codes: list[str] = []
        self.contacts: list[Contact] = []
        self.callbacks: dict[str, Callable[[Any], Any]] = {}
        self.command = VelocityCommand(0)
        self.node = GateNode(model.model)
        self.node.ctx = self  # type: ignore[assignment]
        self.node.start()
        self.topic = "scanners" if len(model.model.scanners) > 1 else "scan"

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def serve(self, service: Any, callback: Callable[[Any], Any]) -> None:
        self.callbacks[service.name] = callback

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        callback()

    def timer(self, period: float, callback: Callable[[], None]) -> None:
        self.step = callback

    def publish(self, topic: Topic[Any], message: Any) -> None:
        if isinstance(message, VelocityCommand):
            self.command = message

    def log(self, code: str, text: str, **fields: Any) -> None:
        self.codes.append(f"{code} {text}")

    def run(self, seconds: float, vx: float = 0.6, vy: float = 0.0, wz: float = 0.0) -> SE2:
        """Drive on for some seconds; returns where the robot is then."""
        if self.now_ns == 0:
            self.callbacks["arm"](GateRequest("test", ""))
        for _ in range(round(seconds / 0.02)):
            out = self.simulation.step(self.now_ns)
            self.contacts += out.contacts
            heard = (("odometry", out.odometry), (self.topic, out.scans), ("cloud", out.clouds), ("ranges", out.ranges))
            for name, messages in heard:
                for message in messages:
                    if name in self.callbacks:
                        self.callbacks[name](message)
            self.callbacks["velocity_request"](VelocityCommand(self.now_ns, vx, vy, wz))
            self.step()
            self.simulation.command(BodyVelocity(self.command.vx, self.command.vy, self.command.wz))
            self.now_ns += 20_000_000
        return self.simulation.world_from_base.to_se2()


@pytest.mark.parametrize("turn_deg", [0, 20, 40, 65])
@pytest.mark.parametrize("robot", ["diff", "amr_omni"])
def test_it_stops_before_glass_at_any_angle(robot: str, turn_deg: int) -> None:
    drive = Drive(f"{robot}+ultrasonic", (pane(2.5, turn_deg),))
    assert RANGES in drive.node.inputs
    end = drive.run(5.0, vx=0.8)
    assert not drive.contacts
    assert 0.8 < end.x < 2.3, "it drove, and it stopped"
    assert abs(drive.command.vx) < 0.02


@pytest.mark.parametrize("speed", [0.3, 0.8])
@pytest.mark.parametrize("turn_deg", [0, 20, 40, 65])
@pytest.mark.parametrize("robot", ["diff", "amr_omni", "spot", "mecanum", "go2"])
def test_without_a_ring_it_stops_before_glass_that_shines_where_it_is_met_squarely(
    robot: str, turn_deg: int, speed: float
) -> None:
    drive = Drive(robot, (pane(2.5, turn_deg),))
    assert RANGES not in drive.node.inputs
    end = drive.run(5.0 / speed, vx=speed)
    assert not drive.contacts
    assert 0.8 < end.x < 2.3
    assert abs(drive.command.vx) < 0.02


def test_of_a_scanner_that_tells_no_intensities_it_touches_glass_that_stands_aslant() -> None:
    drive = Drive("diff", (pane(2.5, 65),))
    take = drive.callbacks["scan"]
    drive.callbacks["scan"] = lambda scan: take(replace(scan, intensities=np.zeros(0, np.float32)))
    drive.run(4.0, vx=0.8)
    assert drive.contacts
    assert drive.contacts[0].other_geom == "pane"


@pytest.mark.parametrize("robot", ["diff", "amr_omni", "spot", "mecanum", "go2"])
def test_a_robot_without_a_ring_turns_beside_glass_without_touching_it(robot: str) -> None:
    """Its corner comes to where no beam returns from."""
    model = robot_named(robot).model
    beside = Solid(
        "pane", Shape.BOX, SE2(0.0, model.circumscribed_radius - 0.03, 0.0), 12.0, 0.02, 0.0, 2.2, is_glass=True
    )
    drive = Drive(robot, (beside,))
    drive.run(1.0, vx=0.0)
    drive.run(12.0, vx=0.0, wz=0.4)
    assert not drive.contacts
    drive.run(4.0, vx=-0.15)
    assert not drive.contacts


@pytest.mark.parametrize(("robot", "width"), [("diff", 0.9), ("amr_omni", 1.3), ("spot", 1.0)])
def test_a_doorway_between_panes_lets_the_robot_pass(robot: str, width: float) -> None:
    panes = [
        Solid(f"pane_{k}", Shape.BOX, SE2(2.5, k * (0.5 * width + 2.1), 0.0), 0.02, 4.0, 0.0, 2.2, is_glass=True)
        for k in (-1, 1)
    ]
    posts = [
        Solid(f"post_{k}", Shape.BOX, SE2(2.5, k * (0.5 * width + 0.05), 0.0), 0.1, 0.1, 0.0, 2.2) for k in (-1, 1)
    ]
    drive = Drive(robot, (*panes, *posts))
    assert drive.run(8.0, vx=0.5).x > 3.3
    assert not drive.contacts


@pytest.mark.parametrize("beside", [0.6, 0.7])
def test_a_doorway_between_panes_without_posts_is_open_to_who_drove_past_it(beside: float) -> None:
    """Each pane would reach across the doorway, and that which shines from its edge across the corridor."""
    panes = [
        Solid(f"pane_{k}", Shape.BOX, SE2(2.5 + k * 2.65, beside, 0.0), 4.0, 0.02, 0.0, 2.2, is_glass=True)
        for k in (-1, 1)
    ]
    drive = Drive("amr_omni", tuple(panes))
    assert drive.run(5.5, vx=0.5).x == pytest.approx(2.28, abs=0.05)
    assert drive.run(5.0, vx=0.0, wz=0.33).yaw > 1.5
    assert drive.run(5.0, vx=0.4).y > 1.0
    assert not drive.contacts


def test_sideways_motion_stops_before_glass_too() -> None:
    beside = Solid("pane", Shape.BOX, SE2(0.0, 1.5, 0.0), 12.0, 0.02, 0.0, 2.2, is_glass=True)
    drive = Drive("amr_omni+ultrasonic", (beside,))
    end = drive.run(5.0, vx=0.0, vy=0.4)
    assert not drive.contacts
    assert 0.5 < end.y < 1.1


@pytest.mark.parametrize(("robot", "width"), [("diff", 0.8), ("amr_omni", 1.2)])
def test_a_doorway_that_light_explains_lets_the_robot_pass(robot: str, width: float) -> None:
    sides = tuple(
        Solid(f"side_{k}", Shape.BOX, SE2(2.5, k * (0.5 * width + 2.0), 0.0), 0.1, 4.0, 0.0, 2.2) for k in (-1, 1)
    )
    drive = Drive(f"{robot}+ultrasonic", sides)
    assert drive.run(8.0, vx=0.5).x > 3.3
    assert not drive.contacts


@pytest.mark.parametrize("frame", ["sonar_0", "sonar_7"])
def test_a_transducer_that_falls_silent_stops_the_robot_until_it_is_back(frame: str) -> None:
    drive = Drive("diff+ultrasonic", (), (f"scanner_dropout@{frame}:2:5",))
    drive.run(1.9)
    assert drive.command.vx > 0.5
    drive.run(2.0)
    assert drive.command.vx == 0.0
    assert any(f"STALE_POINTS: no fresh scan or cloud from {frame}" in c for c in drive.codes)
    drive.run(3.0)
    assert drive.command.vx > 0.3


def test_a_ring_that_never_speaks_is_missed() -> None:
    drive = Drive("diff+ultrasonic", ())
    del drive.callbacks["ranges"]
    assert drive.run(2.0).x == pytest.approx(0.0, abs=1e-3)
    assert any("STALE_POINTS" in c and "sonar_0" in c for c in drive.codes)
