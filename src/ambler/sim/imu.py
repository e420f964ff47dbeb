"""An integrating IMU: rate and specific force averaged over each sampling period, with bias, noise and scale errors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Imu
from ambler.core.se3 import SE3, Quaternion, quaternion_multiply
from ambler.sim.sensors import ImuSpec, named_generator

GRAVITY = 9.80665


class ImuSensor:
    """Turns the sensor's true poses, one per sampling period, into measurements."""

    def __init__(self, spec: ImuSpec, frame: str, seed: int) -> None:
        self._spec, self._frame = spec, frame
        rng = self._rng = named_generator(seed, frame)
        self._period = 1.0 / spec.rate_hz
        sigma = np.array([spec.gyro_bias_sigma] * 3 + [spec.accel_bias_sigma] * 3)
        self._keep = math.exp(-self._period / spec.bias_time)
        self._drive = sigma * math.sqrt(1.0 - self._keep**2)
        self._bias = sigma * rng.standard_normal(6)
        self._scale = 1.0 + spec.scale_sigma * rng.standard_normal(6)
        densities = np.array([spec.gyro_density] * 3 + [spec.accel_density] * 3)
        self._white = densities * math.sqrt(spec.rate_hz)
        self._limit = np.array([spec.gyro_limit] * 3 + [spec.accel_limit] * 3)
        self._more = ImuForm(spec, frame, seed) if _has_form(spec) else None
        self._world_from_imu: SE3 | None = None
        self._velocity = (0.0, 0.0, 0.0)

    def update(self, world_from_imu: SE3, velocity: tuple[float, float, float], stamp_ns: int) -> Imu | None:
        """Take the pose and the velocity in the world at the end of a period; returns its measurement (None the first time).

        `stamp_ns` should be the middle of the period: rate and force are means over it, so that their sums over time are
        exactly the rotation and the change of velocity.
        """
        last, self._world_from_imu = self._world_from_imu, world_from_imu
        before, self._velocity = self._velocity, velocity
        if last is None:
            return None
        dt = self._period
        ax, ay, az = ((v - u) / dt for u, v in zip(before, velocity, strict=True))
        middle = last.interpolate(world_from_imu, 0.5)
        force = SE3(rotation=_conjugate(middle.rotation)).rotate((ax, ay, az + GRAVITY))
        values = np.array([*_rate(last.rotation, world_from_imu.rotation, dt), *force])
        if self._more is None:
            values = self._corrupt(values)
        else:
            values = self._more.counted(self._corrupt(self._more.felt(values, math.hypot(*velocity))))
        w = values.tolist()
        return Imu(stamp_ns, self._frame, (w[0], w[1], w[2]), (w[3], w[4], w[5]))

    def _corrupt(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        chance = self._rng.standard_normal(12)
        self._bias = self._keep * self._bias + self._drive * chance[:6]
        measured = self._scale * values + self._bias + self._white * chance[6:]
        np.maximum(measured, -self._limit, out=measured)
        return np.asarray(np.minimum(measured, self._limit, out=measured))


class ImuForm:
    """What a real unit does beside bias, noise and scale: axes that lean, the shaking of its mount, and whole counts."""

    def __init__(self, spec: ImuSpec, frame: str, seed: int) -> None:
        self._rng = named_generator(seed, f"{frame}-form")
        lean = spec.misalignment * self._rng.standard_normal((2, 3, 3))
        lean[:, [0, 1, 2], [0, 1, 2]] = 1.0
        self._axes = lean
        self._shaking = spec.vibration * np.array([0.1] * 3 + [1.0] * 3)
        self._step = np.array([spec.gyro_step] * 3 + [spec.accel_step] * 3)

    def felt(self, values: NDArray[np.float64], speed: float) -> NDArray[np.float64]:
        """Return what the axes feel of rate and force (6,) of a mount that moves at `speed` m/s."""
        shaken = values + speed * self._shaking * self._rng.standard_normal(6)
        return np.concatenate([self._axes[0] @ shaken[:3], self._axes[1] @ shaken[3:]])

    def counted(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values in whole counts of the converter, those without a step as they are."""
        step = np.where(self._step > 0.0, self._step, 1.0)
        return np.asarray(np.where(self._step > 0.0, np.round(values / step) * step, values))


def _has_form(spec: ImuSpec) -> bool:
    return any((spec.misalignment, spec.gyro_step, spec.accel_step, spec.vibration))


def _conjugate(q: Quaternion) -> Quaternion:
    return (q[0], -q[1], -q[2], -q[3])


def _rate(a: Quaternion, b: Quaternion, dt: float) -> tuple[float, float, float]:
    """Mean angular velocity in the body frame that turns a into b within dt."""
    w, x, y, z = quaternion_multiply(_conjugate(a), b)
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    k = 2.0 / dt if sine < 1e-9 else 2.0 * math.atan2(sine, w) / (sine * dt)
    return (k * x, k * y, k * z)
