"""The Dynamic Window Approach (Fox, Burgard and Thrun 1997; navigation reference 4.4) beside Trajectory Rollout.

The difference is what is tried: only velocities that the base reaches within one control period, kept over the horizon. Such a
planner never asks for what the base cannot do at once; in return it must see early that it is too fast. When no arc is free over
the whole horizon, shorter ones are tried as long as the robot can stop within them (the admissible velocities of the paper); when
none is, a moving robot brakes. A resting one sees too little through so small a window; it looks for a way with the samples of the
rollout, whose first period lies in the window by construction.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.control.config import RolloutConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.control.velocity_samples import dynamic_window, window_samples
from ambler.core.errors import NoValidControlError
from ambler.core.grid import GridSpec
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


class DynamicWindow(TrajectoryRollout):
    """A local planner (core.protocols.LocalPlanner). The base has every command within `control_period` of the velocity it has when
    the command reaches it: the measured one, moved towards the last command for `reaction_time`."""

    def __init__(self, config: RolloutConfig, robot: RobotModel) -> None:
        super().__init__(config, robot)
        self._last = BodyVelocity()
        self._is_wide = False

    def reset(self) -> None:
        """Forget the path, the last command and everything remembered about them."""
        super().reset()
        self._last = BodyVelocity()

    def compute_command(
        self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity
    ) -> BodyVelocity:
        """Return the wanted velocity of the base, within its dynamic window; raises NoValidControlError when it stands and every
        motion worth driving collides."""
        expected = self._within(self._last, velocity, self._config.reaction_time)
        try:
            wanted = super().compute_command(costs, spec, odom_from_base, expected)
        except NoValidControlError:
            if self._is_resting(expected):
                self._last = BodyVelocity()
                raise
            wanted = BodyVelocity()
        self._last = self._within(wanted, expected, self._config.control_period)
        return self._last

    def _best_command(self, start: SE2, velocity: BodyVelocity, left: float) -> BodyVelocity | None:
        self._is_wide = False
        command = super()._best_command(start, velocity, left)
        if command is not None:
            return command
        if not self._is_resting(velocity):
            return BodyVelocity()
        self._is_wide = True
        return super()._best_command(start, velocity, left)

    def _samples(self, velocity: BodyVelocity, left: float) -> F64:
        if self._is_wide:
            return super()._samples(velocity, left)
        return window_samples(self._config, self._robot, velocity, self._top_speed(left))

    def _horizons(self, samples: F64) -> tuple[float, ...]:
        """The horizon, and for a moving robot its parts in which the slowest sample can still stop."""
        c = self._config
        slowest = float(np.hypot(samples[:, 0], samples[:, 1]).min())
        if self._is_wide or slowest < c.speed_min:
            return (c.horizon,)
        to_stop = slowest / (c.brake_share * self._limits.ax_brake) + c.reaction_time
        return (c.horizon, *(h for h in (0.5 * c.horizon, 0.25 * c.horizon) if h >= to_stop))

    def _turn_start(self) -> float:
        """Around an obstacle the robot must look away from its path for longer than the window lets it plan: no turning back there."""
        return math.pi if self._is_blocked(self._path_ahead()) else self._config.turn_start

    def _is_resting(self, velocity: BodyVelocity) -> bool:
        return math.hypot(velocity.vx, velocity.vy) < self._config.speed_min

    def _within(self, wanted: BodyVelocity, velocity: BodyVelocity, seconds: float) -> BodyVelocity:
        """Return what the base makes of a wanted velocity in so many seconds."""
        low, high = dynamic_window(velocity, self._limits, seconds).T
        vx, vy, wz = np.clip([wanted.vx, wanted.vy, wanted.wz], low, high)
        return BodyVelocity(float(vx), float(vy), float(wz))
