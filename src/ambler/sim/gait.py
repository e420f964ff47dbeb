"""The sway of a legged body about its carriage: harmonic heave, sway, roll, pitch and yaw that grow with speed; and how it sits down."""

from __future__ import annotations

import math

from ambler.core.protocols import BodyVelocity
from ambler.core.se3 import SE3
from ambler.sim.sensors import GaitSpec

RISING = 1.5  # seconds from sitting to standing


class Posture:
    """How far up a body is on its legs: `is_up` says where it shall be. Sitting, it is `crouch` metres lower."""

    def __init__(self, crouch: float) -> None:
        self.is_up = True
        self._crouch = crouch
        self._share = 1.0

    @property
    def is_standing(self) -> bool:
        """Whether it can walk."""
        return self.is_up and self._share == 1.0

    def update(self, dt: float) -> float:
        """Advance by `dt`; returns how much lower (m) than standing the body is."""
        step = dt / RISING if self.is_up else -dt / RISING
        self._share = min(max(self._share + step, 0.0), 1.0)
        return self._crouch * (1.0 - self._share * self._share * (3.0 - 2.0 * self._share))


class Gait:
    """Holds the phase and the smoothed amplitude. The body turns about a point `height` above the base frame."""

    def __init__(self, spec: GaitSpec, height: float) -> None:
        self._spec = spec
        self._height = height
        self._phase = 0.0
        self._amplitude = 0.0
        self._smooth = 0.0

    def update(self, velocity: BodyVelocity, dt: float) -> SE3:
        """Advance by `dt` and return carriage_from_base."""
        g = self._spec
        speed = math.hypot(velocity.vx, velocity.vy) + 0.4 * abs(velocity.wz)
        wanted = min(speed / g.full_speed, 1.0)
        gain = dt / (g.time_constant + dt)
        self._smooth += gain * (wanted - self._smooth)
        self._amplitude += gain * (self._smooth - self._amplitude)
        self._phase = (self._phase + 2.0 * math.pi * g.frequency_hz * dt) % (4.0 * math.pi)
        a, p = self._amplitude, self._phase
        if a < 1e-4:
            return SE3()
        roll, yaw = a * g.roll * math.sin(0.5 * p), a * g.yaw * math.sin(0.5 * p + 1.0)
        pitch = a * g.pitch * math.sin(p + 0.7)
        lift, sway = a * g.heave * math.sin(p), a * g.sway * math.sin(0.5 * p + 0.4)
        about_center = SE3.from_rpy((0.0, sway, self._height + lift), roll, pitch, yaw)
        return about_center @ SE3((0.0, 0.0, -self._height))
