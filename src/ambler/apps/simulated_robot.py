"""The nodes of a simulated robot's devices, in the place where a real robot has those of its drivers."""

from __future__ import annotations

from collections.abc import Callable

from ambler.core.camera import CameraModel
from ambler.core.devices import RobotDevices
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.nodes.devices.table import device_nodes
from ambler.nodes.devices.truth import TruthNode
from ambler.runtime.node import Node
from ambler.sim.ground_truth import GroundTruth
from ambler.sim.robot_devices import robot_devices
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import WorldSpec
from ambler.sim.world import BodySpec, SimulationConfig, World


def simulated_nodes(
    world: World,
    name: str,
    calibration: CameraModel | None = None,
    replaced: Callable[[RobotDevices], RobotDevices] | None = None,
    described: RobotModel | None = None,
    *,
    has_map: bool = True,
) -> list[Node]:
    """Return the nodes of one robot of a running world: its devices and its ground truth. `calibration` replaces what its camera says,
    `replaced` puts other devices in the place of simulated ones; `described`: the robot as its drawing has it (None: as it is);
    `has_map`: the true map of the plane is told."""
    devices = robot_devices(world, name)
    devices = devices if replaced is None else replaced(devices)
    model = world.body(name).robot.model if described is None else described
    nodes = device_nodes(model, devices, calibration=calibration)
    return [*nodes, TruthNode(GroundTruth(world, world.body(name)), has_map=has_map)]


def lone_robot_nodes(
    spec: WorldSpec,
    robot: SimRobot,
    config: SimulationConfig,
    start: SE2 | None = None,
    calibration: CameraModel | None = None,
) -> list[Node]:
    """Return the nodes of a robot that is alone in a world; `start` in the world's frame (None: the world's start)."""
    return simulated_nodes(World(spec, [BodySpec("robot", robot, start)], config), "robot", calibration)
