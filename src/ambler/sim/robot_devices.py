"""All devices of one robot of a world, as its sensors and its drive ask for."""

from __future__ import annotations

from ambler.core.devices import RobotDevices
from ambler.sim.devices import (
    SimulatedBase,
    SimulatedBattery,
    SimulatedCamera,
    SimulatedDepthCamera,
    SimulatedImu,
    SimulatedLegs,
    SimulatedLidar,
    SimulatedRange,
)
from ambler.sim.world import World


def robot_devices(world: World, name: str) -> RobotDevices:
    """Return the devices of a robot, none of them open; raises KeyError when the world has no such robot."""
    body = world.body(name)
    robot = body.robot
    return RobotDevices(
        base=SimulatedBase(world, body),
        lidars=tuple(SimulatedLidar(world, body, frame, spec) for frame, spec in robot.lidars.items()),
        imus=tuple(SimulatedImu(world, body, frame, spec) for frame, spec in robot.imus.items()),
        ranges=tuple(SimulatedRange(world, body, frame, spec) for frame, spec in robot.ultrasonics.items()),
        cameras=tuple(SimulatedCamera(world, body, frame, spec) for frame, spec in robot.cameras.items()),
        depth_cameras=tuple(SimulatedDepthCamera(world, body, f, spec) for f, spec in robot.depth_cameras.items()),
        battery=SimulatedBattery(world, body),
        legs=SimulatedLegs(world, body) if robot.gait is not None else None,
    )
