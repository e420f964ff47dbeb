"""Dead reckoning as the base does it: from what its encoders count, with the geometry that it believes in."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.drive import drive_of
from ambler.sim.sensors import OdometrySpec, named_generator
from ambler.sim.sim_robot import SimRobot

F64 = NDArray[np.float64]


class DeadReckoning:
    """Integrates encoder (or leg) travel into `odom_from_base`; errors as named in `OdometrySpec`."""

    def __init__(self, robot: SimRobot, spec: OdometrySpec, seed: int) -> None:
        self._drive, self._spec = drive_of(robot), spec
        self._rng = named_generator(seed, "odometry")
        parts = self._drive.parts
        self._scales = 1.0 + spec.radius_sigma * self._rng.standard_normal(parts)
        self._turn_scale = 1.0 + spec.track_sigma * float(self._rng.standard_normal())
        self._slip = spec.slip_sigma * self._rng.standard_normal(parts)
        self._counted = np.zeros(parts)
        self._last = np.zeros(parts)
        self._odom_from_base = SE2()
        self._path, self._turned = 0.0, 0.0

    def update(self, travel: tuple[float, ...], carriage_from_base: SE3, stamp_ns: int) -> Odometry:
        """Take the travel counted so far; returns the odometry message of this instant."""
        period = 1.0 / self._spec.rate_hz
        steps = self._steps(np.array(travel), period)
        motion = self._drive.motion(steps * self._scales, self._turn_scale)
        self._odom_from_base = self._odom_from_base @ SE2.exp(motion)
        self._path += math.hypot(motion[0], motion[1])
        self._turned += abs(motion[2])
        velocity = motion / period
        return Odometry(
            stamp_ns,
            "odom",
            "base",
            SE3.from_se2(self._odom_from_base) @ self._sensed_lean(carriage_from_base),
            (float(velocity[0]), float(velocity[1]), 0.0),
            (0.0, 0.0, float(velocity[2])),
            self._pose_covariance(),
            np.diag([1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 1e-3]),
        )

    def _steps(self, travel: F64, period: float) -> F64:
        """Advance the counters with slip and quantisation; returns what they counted since the last call."""
        spec, true_step = self._spec, travel - self._last
        self._last = travel
        keep = math.exp(-period / spec.slip_time)
        noise = spec.slip_sigma * math.sqrt(1.0 - keep * keep)
        self._slip = keep * self._slip + noise * self._rng.standard_normal(len(travel))
        before = self._read()
        self._counted = self._counted + true_step * (1.0 + self._slip)
        return self._read() - before

    def _read(self) -> F64:
        if self._spec.ticks == 0:
            return self._counted
        tick = 2.0 * math.pi / self._spec.ticks
        return np.asarray(np.floor(self._counted / tick) * tick)

    def _sensed_lean(self, carriage_from_base: SE3) -> SE3:
        """The body's sway as its own kinematics and IMU report it."""
        sigma = self._spec.tilt_sigma
        if sigma == 0.0:
            return carriage_from_base
        roll, pitch = sigma * self._rng.standard_normal(2)
        return carriage_from_base @ SE3.from_rpy((0.0, 0.0, 0.0), float(roll), float(pitch), 0.0)

    def _pose_covariance(self) -> F64:
        """Growth with the way gone: 2 % of the path and of the turning, as variances."""
        along = (0.02 * self._path) ** 2 + 1e-6
        turn = (0.02 * self._turned) ** 2 + (0.01 * self._path) ** 2 + 1e-6
        covariance = np.zeros((6, 6))
        covariance.flat[::7] = (along, along, 1e-6, 1e-6, 1e-6, turn)
        return covariance
