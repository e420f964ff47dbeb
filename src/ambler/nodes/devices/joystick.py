"""A joystick on the bus: what a person holds, and the velocity that it asks for while a dead-man button is pressed: by hand, or around obstacles."""

from __future__ import annotations

from dataclasses import dataclass

from ambler.core.devices import Joystick
from ambler.core.messages import JoystickState, VelocityCommand
from ambler.core.robot import VelocityLimits
from ambler.nodes.devices.node import DeviceNode
from ambler.runtime.topics import JOYSTICK, STATUS, STEER_REQUEST, TELEOP_REQUEST, Topic


@dataclass(frozen=True, slots=True)
class JoystickConfig:
    """Numbers of the axes (forward, left and counter-clockwise are positive) and of the dead-man buttons: of driving by hand (manual mode) and of
    steering, where the local planner avoids what is in the way (smart joystick); `share` of the robot's limits at full deflection; deflections below
    `dead_zone` count as none."""

    forward: int = 1
    left: int = 0
    turn: int = 3
    dead_man: int = 4
    steer: int = 5
    share: float = 0.5
    dead_zone: float = 0.08


class JoystickNode(DeviceNode):
    """Publishes every state of the joystick. While a dead-man button is pressed it asks for a velocity; when the button is let go
    it asks for a stop once and then for nothing. Of a joystick that tells nothing any more the last request grows stale. With both buttons pressed the person
    drives by hand."""

    outputs = (JOYSTICK, TELEOP_REQUEST, STEER_REQUEST, STATUS)

    def __init__(self, joystick: Joystick, limits: VelocityLimits, config: JoystickConfig | None = None) -> None:
        super().__init__("joystick", (joystick,))
        self._joystick, self._limits = joystick, limits
        self._config = config if config is not None else JoystickConfig()
        self._driven: Topic[VelocityCommand] | None = None

    def poll(self) -> None:
        for state in self._joystick.read(self.ctx.now_ns):
            self.ctx.publish(JOYSTICK, state)
            self._drive(state)

    def _drive(self, state: JoystickState) -> None:
        wanted = self._wanted_topic(state)
        if self._driven is not None and self._driven is not wanted:
            self.ctx.publish(self._driven, VelocityCommand(state.stamp_ns))
        if wanted is not None:
            self.ctx.publish(wanted, self._velocity(state) if wanted is TELEOP_REQUEST else self._direction(state))
        self._driven = wanted

    def _wanted_topic(self, state: JoystickState) -> Topic[VelocityCommand] | None:
        for number, topic in ((self._config.dead_man, TELEOP_REQUEST), (self._config.steer, STEER_REQUEST)):
            if len(state.buttons) > number and state.buttons[number] == 1:
                return topic
        return None

    def _velocity(self, state: JoystickState) -> VelocityCommand:
        config, lim, share = self._config, self._limits, self._config.share
        forward, left, turn = (self._axis(state, k) for k in (config.forward, config.left, config.turn))
        vx = forward * (lim.vx_max if forward >= 0.0 else -lim.vx_min)
        return VelocityCommand(state.stamp_ns, share * vx, share * left * lim.vy_max, share * turn * lim.wz_max)

    def _direction(self, state: JoystickState) -> VelocityCommand:
        """Where the stick points and how far, for any base: the local planner turns to it, or slides."""
        config, lim, share = self._config, self._limits, self._config.share
        forward, left, turn = (self._axis(state, k) for k in (config.forward, config.left, config.turn))
        top = share * lim.vx_max
        return VelocityCommand(state.stamp_ns, top * forward, top * left, share * turn * lim.wz_max)

    def _axis(self, state: JoystickState, number: int) -> float:
        value = float(state.axes[number]) if number < len(state.axes) else 0.0
        return value if abs(value) > self._config.dead_zone else 0.0
