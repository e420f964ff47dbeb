"""A joystick on the bus: what a person holds, and the velocity that it asks for while the dead-man button is pressed."""

from __future__ import annotations

from dataclasses import dataclass

from ambler.core.devices import Joystick
from ambler.core.messages import JoystickState, VelocityCommand
from ambler.core.robot import VelocityLimits
from ambler.nodes.devices.node import DeviceNode
from ambler.runtime.topics import JOYSTICK, STATUS, TELEOP_REQUEST


@dataclass(frozen=True, slots=True)
class JoystickConfig:
    """Numbers of the axes (forward, left and counter-clockwise are positive) and of the dead-man button; `share` of the robot's
    limits at full deflection; deflections below `dead_zone` count as none."""

    forward: int = 1
    left: int = 0
    turn: int = 3
    dead_man: int = 4
    share: float = 0.5
    dead_zone: float = 0.08


class JoystickNode(DeviceNode):
    """Publishes every state of the joystick. While its dead-man button is pressed it asks for a velocity; when the button is let go
    it asks for a stop once and then for nothing. Of a joystick that tells nothing any more the last request grows stale."""

    outputs = (JOYSTICK, TELEOP_REQUEST, STATUS)

    def __init__(self, joystick: Joystick, limits: VelocityLimits, config: JoystickConfig | None = None) -> None:
        super().__init__("joystick", (joystick,))
        self._joystick, self._limits = joystick, limits
        self._config = config if config is not None else JoystickConfig()
        self._is_driving = False

    def poll(self) -> None:
        for state in self._joystick.read(self.ctx.now_ns):
            self.ctx.publish(JOYSTICK, state)
            self._drive(state)

    def _drive(self, state: JoystickState) -> None:
        config = self._config
        is_held = len(state.buttons) > config.dead_man and state.buttons[config.dead_man] == 1
        if is_held:
            self.ctx.publish(TELEOP_REQUEST, self._velocity(state))
        elif self._is_driving:
            self.ctx.publish(TELEOP_REQUEST, VelocityCommand(state.stamp_ns))
        self._is_driving = is_held

    def _velocity(self, state: JoystickState) -> VelocityCommand:
        config, lim, share = self._config, self._limits, self._config.share
        forward, left, turn = (self._axis(state, k) for k in (config.forward, config.left, config.turn))
        vx = forward * (lim.vx_max if forward >= 0.0 else -lim.vx_min)
        return VelocityCommand(state.stamp_ns, share * vx, share * left * lim.vy_max, share * turn * lim.wz_max)

    def _axis(self, state: JoystickState, number: int) -> float:
        value = float(state.axes[number]) if number < len(state.axes) else 0.0
        return value if abs(value) > self._config.dead_zone else 0.0
