"""Limits of a velocity: speeds (the arc is kept) and accelerations per axis, braking with the deceleration limit."""

from __future__ import annotations

import math

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits

STILL = BodyVelocity()


def is_finite(velocity: BodyVelocity) -> bool:
    """Say whether every component is a number."""
    return math.isfinite(velocity.vx) and math.isfinite(velocity.vy) and math.isfinite(velocity.wz)


def is_still(velocity: BodyVelocity) -> bool:
    """Say whether nothing moves."""
    return velocity.vx == 0.0 and velocity.vy == 0.0 and velocity.wz == 0.0


def scaled(velocity: BodyVelocity, scale: float) -> BodyVelocity:
    """Return the same arc at another speed."""
    return BodyVelocity(velocity.vx * scale, velocity.vy * scale, velocity.wz * scale)


def limit_speed(velocity: BodyVelocity, limits: VelocityLimits) -> BodyVelocity:
    """Scale a velocity down until every axis is within its limit, so that the robot stays on the same arc.

    An axis that the base does not have (limit zero) is left out. Together vx and vy stay below the larger of their limits.
    """
    vx_limit = limits.vx_max if velocity.vx > 0.0 else -limits.vx_min
    axes = ((velocity.vx, vx_limit), (velocity.vy, limits.vy_max), (velocity.wz, limits.wz_max))
    vx, vy, wz = (value if limit > 0.0 else 0.0 for value, limit in axes)
    planar = (math.hypot(vx, vy), max(vx_limit, limits.vy_max))
    scale = min([1.0, *(limit / abs(value) for value, limit in (*axes, planar) if abs(value) > limit > 0.0)])
    return BodyVelocity(vx * scale, vy * scale, wz * scale)


def approach(value: float, target: float, acceleration: float, braking: float, dt: float) -> float:
    """Move `value` towards `target` for `dt` seconds: speeding up with `acceleration`, slowing down with `braking`.

    A change of sign first brakes to zero and accelerates in what is left of the time.
    """
    if value * target < 0.0 or abs(target) < abs(value):
        end = target if value * target > 0.0 else 0.0
        time_to_end = abs(value - end) / braking
        if time_to_end >= dt:
            return value + math.copysign(braking * dt, end - value)
        value, dt = end, dt - time_to_end
    change = acceleration * dt
    return target if abs(target - value) <= change else value + math.copysign(change, target - value)


def limit_acceleration(current: BodyVelocity, target: BodyVelocity, limits: VelocityLimits, dt: float) -> BodyVelocity:
    """Return the velocity that the base may have `dt` seconds after `current` on the way to `target`.

    Meanwhile vx and vy together are never faster than both ends: while one axis still slows down, the other one gains no more than that.
    """
    vx = approach(current.vx, target.vx, limits.ax_max, limits.ax_brake, dt)
    vy = approach(current.vy, target.vy, limits.ay_max, limits.ay_brake, dt)
    most = max(math.hypot(current.vx, current.vy), math.hypot(target.vx, target.vy))
    if math.hypot(vx, vy) > most and abs(vx) > abs(current.vx):
        vx = math.copysign(math.sqrt(max(0.0, most**2 - vy**2)), vx)
    elif math.hypot(vx, vy) > most and abs(vy) > abs(current.vy):
        vy = math.copysign(math.sqrt(max(0.0, most**2 - vx**2)), vy)
    return BodyVelocity(vx, vy, approach(current.wz, target.wz, limits.az_max, limits.az_max, dt))
