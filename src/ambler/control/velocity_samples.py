"""Which velocities a local planner tries: all that the base can ever reach (Trajectory Rollout), or only those it can reach within one
control period (the dynamic window of Fox, Burgard and Thrun 1997)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.control.config import RolloutConfig
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits

F64 = NDArray[np.float64]


def velocity_samples(config: RolloutConfig, robot: RobotModel, top: float) -> F64:
    """Return the grid of wanted velocities (N, 3) up to the speed `top`; yaw rates lie denser around straight ahead."""
    lim = robot.limits
    slowest = min(config.speed_min, top)
    forward = np.linspace(slowest, top, config.vx_samples)
    half = np.linspace(0.0, 1.0, config.wz_samples // 2 + 1)[1:] ** 1.7 * lim.wz_max
    turn = np.concatenate((-half[::-1], [0.0], half))
    side = np.zeros(1)
    if robot.drive is DriveKind.OMNI and lim.vy_max > 0.0:
        forward = np.concatenate(([0.0], forward[1::2]))
        half_side = np.linspace(0.0, 1.0, config.vy_samples // 2 + 1)[1:] * min(lim.vy_max, top)
        side = np.concatenate((-half_side[::-1], [0.0], half_side))
        turn = np.concatenate((turn[: len(half) : 2], [0.0], turn[len(half) + 2 :: 2]))
    grid = np.stack(np.meshgrid(forward, side, turn, indexing="ij"), axis=-1).reshape(-1, 3)
    speed = np.hypot(grid[:, 0], grid[:, 1])
    return np.ascontiguousarray(grid[(speed >= slowest) & (speed <= top + 1e-9)])


def gliding_samples(config: RolloutConfig, limits: VelocityLimits) -> F64:
    """Return slow velocities (N, 3) in all directions, with a little turning, of a base that moves in all directions."""
    angle = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    speed = np.array([0.5, 1.0]) * config.escape_speed
    turn = np.array([-0.4, -0.15, 0.0, 0.15, 0.4]) * limits.wz_max
    v, a, w = (grid.ravel() for grid in np.meshgrid(speed, angle, turn, indexing="ij"))
    samples = np.stack((v * np.cos(a), v * np.sin(a), w), axis=1)
    is_possible = (samples[:, 0] >= limits.vx_min) & (samples[:, 0] <= limits.vx_max)
    is_possible &= np.abs(samples[:, 1]) <= limits.vy_max
    return np.ascontiguousarray(samples[is_possible])


def dynamic_window(velocity: BodyVelocity, limits: VelocityLimits, period: float) -> F64:
    """Return the velocities that the base can reach within `period` seconds: float64 (3, 2) of (lowest, highest) per axis."""
    axes = (
        (velocity.vx, limits.ax_max, limits.ax_brake, limits.vx_min, limits.vx_max),
        (velocity.vy, limits.ay_max, limits.ay_brake, -limits.vy_max, limits.vy_max),
        (velocity.wz, limits.az_max, limits.az_max, -limits.wz_max, limits.wz_max),
    )
    return np.array([_reach(*axis, period) for axis in axes])


def _reach(
    value: float, acceleration: float, braking: float, least: float, most: float, period: float
) -> tuple[float, float]:
    low = value - (braking if value > 0.0 else acceleration) * period
    high = value + (braking if value < 0.0 else acceleration) * period
    return min(max(low, least), most), max(min(high, most), least)


def window_samples(config: RolloutConfig, robot: RobotModel, velocity: BodyVelocity, top: float) -> F64:
    """Return wanted velocities (N, 3) within the dynamic window, forward and at most as fast as `top`, or as slow as braking makes it.

    Zero is among the sideways and the yaw velocities wherever the window holds it.
    """
    (x0, x1), (y0, y1), (w0, w1) = dynamic_window(velocity, robot.limits, config.control_period)
    is_omni = robot.drive is DriveKind.OMNI and robot.limits.vy_max > 0.0
    x1 = max(0.0, x1)
    slowest = min(config.speed_min, x1, top)
    x0 = max(0.0 if is_omni else slowest, x0)
    forward = np.linspace(x0, max(x0, min(x1, top)), max(2, config.vx_samples // 4))
    side = _with_zero(np.linspace(y0, y1, config.vy_samples)) if is_omni else np.zeros(1)
    turn = _with_zero(np.linspace(w0, w1, config.wz_samples))
    grid = np.stack(np.meshgrid(forward, side, turn, indexing="ij"), axis=-1).reshape(-1, 3)
    speed = np.hypot(grid[:, 0], grid[:, 1])
    is_kept = (speed >= slowest - 1e-9) & (speed <= max(top, float(speed.min())) + 1e-9)
    if not is_kept.any():
        is_kept[np.argmin(np.abs(speed - top))] = True
    return np.ascontiguousarray(grid[is_kept])


def _with_zero(values: F64) -> F64:
    """Return the values with 0 among them, if it lies between them."""
    is_between = values[0] <= 0.0 <= values[-1]
    return np.unique(np.append(values, 0.0)) if is_between else values
