"""The beginning: a second of stillness gives the direction of gravity, the gyroscope's bias, and whether forces are told in g or m/s².

A body that stands is shaken by its motor at ten hertz and more, which leaves means over a fifth of a second alone; steps, strides and roads move them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import AmblerError
from ambler.lio.config import STANDARD_GRAVITY, StartConfig
from ambler.lio.state import FilterState

F64 = NDArray[np.float64]
RADIANS_PER_DEGREE = np.pi / 180.0


class LioInputError(AmblerError):
    """The measurements cannot be those of a LiDAR and an IMU as they are described; the text names what is wrong."""

    code = "LIO_INPUT"


@dataclass(frozen=True, slots=True)
class Start:
    """What the beginning gave: the state, the factor that makes forces m/s², the standard deviations of rate and force at rest (3,) each,
    and in words what was found. `is_rest` False: it began in motion. `is_shaken`: a running motor shook it at rest."""

    state: FilterState
    scale: float
    gyro_sigma: F64
    accel_sigma: F64
    is_rest: bool
    note: str
    is_shaken: bool = False


def find_start(rows: F64, config: StartConfig) -> Start | None:
    """Look at the inertial samples so far, float64 (K, 7) as they were measured; None: wait for more.

    The newest `rest` seconds must be still; when they are not within `patience` seconds, their mean force is taken for gravity all the
    same. Raises LioInputError for forces at rest that are neither 1 g nor 9.81 m/s².
    """
    if len(rows) < config.samples_least:
        return None
    window = rows[rows[:, 0] >= rows[-1, 0] - config.rest - 1e-6]
    waited = rows[-1, 0] - rows[0, 0]
    if waited < 0.95 * config.rest or len(window) < config.samples_least:
        return None
    rates, forces = window[:, 1:4], window[:, 4:7]
    mean = forces.mean(axis=0)
    length = float(np.linalg.norm(mean))
    gyro_sigma, accel_sigma = rates.std(axis=0), forces.std(axis=0)
    scale, unit = _scale_of(length, config.gravity_window)
    is_rest = is_shaken = False
    if scale is not None and np.linalg.norm(rates.mean(axis=0)) < 3.0 * config.rest_gyro_sigma:
        is_rest = _varies_less(window, scale, config.rest_gyro_sigma, config.rest_accel_sigma)
        if not is_rest:
            is_rest = is_shaken = _varies_less(
                smoothed(window, config.shaken_period), scale, config.shaken_gyro_sigma, config.shaken_accel_sigma
            )
    if not is_rest and waited < config.patience:
        return None
    if not is_rest:
        scale, unit = _scale_of(length, config.motion_window)
    if scale is None:
        raise LioInputError(
            f"the mean specific force of the first {waited:.1f} s is {length:.2f}: neither 1 (g) nor 9.81 (m/s²), "
            "so its unit is unknown, or the sensor accelerates"
        )
    state = FilterState(rotation=level_rotation(mean))
    if not is_rest:
        scale = STANDARD_GRAVITY if unit == "g" else 1.0  # the force's length is gravity's at rest only
    if is_rest:
        state.gyro_bias = rates.mean(axis=0)
    words = "at rest" if is_rest else f"in motion (no {config.rest:g} s of stillness in {waited:.1f} s)"
    note = f"began {words}; forces in {unit}, at rest {length:.4g}"
    if is_shaken:
        note += f", shaken by {np.linalg.norm(accel_sigma) * scale:.2g} m/s²"
    return Start(state, scale, gyro_sigma, accel_sigma * scale, is_rest, note, is_shaken)


def in_motion(start: Start) -> Start:
    """Return a start at rest as one of a steady motion: its mean rate may be a turn, and nothing is known of its speed."""
    state = replace(start.state, gyro_bias=np.zeros(3))
    return replace(start, state=state, is_rest=False, note=start.note.replace("at rest;", "in a steady motion;"))


def smoothed(rows: F64, period: float) -> F64:
    """Return means of inertial samples (K, 7) over a raised cosine `period` s long about each sample but those at the ends, float64 (M, 7)."""
    spacing = (rows[-1, 0] - rows[0, 0]) / (len(rows) - 1)
    weights = np.hanning(min(max(1, round(period / spacing)), len(rows)) + 2)[1:-1]
    weights /= weights.sum()
    return np.stack([np.convolve(column, weights, "valid") for column in rows.T], axis=1)


def level_rotation(force: F64) -> F64:
    """Return the rotation (3, 3) that turns a specific force at rest (3,) upwards and keeps the heading."""
    z = force / np.linalg.norm(force)
    ahead = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = ahead - (ahead @ z) * z
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])  # rows: the map's axes in the IMU
    if abs(z[0]) < 0.9:
        return np.ascontiguousarray(rotation)
    return np.ascontiguousarray(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ rotation)


def _scale_of(length: float, window: float) -> tuple[float | None, str]:
    """Return the factor to m/s² and the unit's name, by the length of the force at rest."""
    if abs(length - 1.0) <= window:
        return STANDARD_GRAVITY / length, "g"
    if abs(length / STANDARD_GRAVITY - 1.0) <= window:
        return STANDARD_GRAVITY / length, "m/s²"
    return None, ""


def _varies_less(rows: F64, scale: float, gyro_sigma: float, accel_sigma: float) -> bool:
    """Say whether rates and forces (K, 7), the latter times `scale`, vary by less than so much."""
    sigmas = rows[:, 1:].std(axis=0)
    return bool(np.linalg.norm(sigmas[:3]) < gyro_sigma and np.linalg.norm(sigmas[3:]) * scale < accel_sigma)
