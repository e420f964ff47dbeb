"""The base on the bus: velocity commands in, its own dead reckoning out."""

from __future__ import annotations

from ambler.core import messages as m
from ambler.core.devices import Base
from ambler.core.protocols import BodyVelocity
from ambler.nodes.devices.node import DeviceNode
from ambler.runtime.node import Topics
from ambler.runtime.topics import STATUS, VELOCITY_COMMAND, WHEEL_ODOMETRY


class BaseNode(DeviceNode):
    """Hands every velocity command to the base, and publishes what its wheels (or legs) say of the way."""

    name = "base"
    inputs = (VELOCITY_COMMAND,)
    outputs: Topics = (WHEEL_ODOMETRY, STATUS)
    commands = True

    def __init__(self, base: Base) -> None:
        super().__init__("base", (base,))
        self._base = base

    def prepare(self) -> None:
        self.ctx.subscribe(VELOCITY_COMMAND, self._on_command)

    def poll(self) -> None:
        for odometry in self._base.read(self.ctx.now_ns):
            self.ctx.publish(WHEEL_ODOMETRY, odometry)

    def _on_command(self, command: m.VelocityCommand) -> None:
        self._base.command(BodyVelocity(command.vx, command.vy, command.wz))
