"""What floats in the air and sends beams back before they reach a surface: dust around the scanner, columns of smoke, rain.

A beam meets something after an exponentially distributed optical depth (Beer and Lambert): after s metres with 1 - exp(-density * s). Returns are
dim (a few counts of 255 in real clouds), blurred in range, and clumped, because dust hangs in swaths. The surface behind is lost to that beam.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.sim.sensors import named_generator

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
DUST_RANGE, RAIN_RANGE = 6.0, 12.0  # metres from which a scanner still hears so little light
SMOKE_RADIUS, SMOKE_HEIGHT, SMOKE_DENSITY = 1.2, 3.0, 1.5  # metres, metres, 1/m: half is sent back within half a metre
SHARES = (0.01, 0.6)  # of the returns that are false
SWATH = 1.5  # metres: half a wave of the density of dust
DIM, DIM_SPREAD = 0.012, 0.6  # median of intensities (1: white paint met squarely), and of their logarithm
BLUR = 0.03  # metres
HALVINGS = 24


class Airborne(enum.Enum):
    """What floats."""

    DUST = "dust"
    SMOKE = "smoke"
    RAIN = "rain"


@dataclass(frozen=True, slots=True)
class Air:
    """Dust and rain go along with the scanner and make `share` of its returns; columns of smoke stand at (x, y) of the world, on the ground at `base`."""

    kind: Airborne
    share: float = 0.3
    columns: tuple[tuple[float, float], ...] = ()
    base: float = 0.0

    def __post_init__(self) -> None:
        if not SHARES[0] <= self.share <= SHARES[1]:
            raise BadInputError(
                f"{self.kind.value}: {100.0 * self.share:g} % of the returns; between {100 * SHARES[0]:g} and {100 * SHARES[1]:g} %"
            )


class SpoiledSweep:
    """Puts what floats into the sweeps of one scanner; chance of its own, so that clear air draws what it drew without it."""

    def __init__(self, seed: int, frame: str) -> None:
        self._rng = named_generator(seed, f"air:{frame}")
        self._phases = self._rng.uniform(0.0, 2.0 * math.pi, 6)

    def spoil(
        self,
        air: Air,
        sweep: tuple[F32, F32, F32],
        rays: tuple[F64, F64],
        knots: tuple[F64, F64, F64],
        range_min: float,
    ) -> NDArray[np.bool_]:
        """Change measured ranges and intensities of a sweep in place; returns which are false now, bool (C, R).

        `sweep`: exact distances, measured ranges, intensities, float32 (C, R); `rays`: times (C,) and directions (C, R, 3) in the sensor's frame; `knots`: times (K,),
        positions (K, 3) and quaternions (K, 4, wxyz) of the sensor in the world.
        """
        exact, measured, intensity = sweep
        eyes, ahead = _in_world(rays, knots)
        depth = self._rng.exponential(size=exact.shape)
        lies = np.isfinite(measured)
        if air.kind is Airborne.SMOKE:
            met = _in_columns(air, eyes, ahead, depth)
            meets = (met < exact) & (met > range_min)
        else:
            reach = DUST_RANGE if air.kind is Airborne.DUST else RAIN_RANGE
            rare = depth / self._thickness(eyes, ahead) if air.kind is Airborne.DUST else _falling_off(depth)
            most = np.minimum(exact, reach)
            met = range_min + rare / _density(rare, most - range_min, lies, air.share)
            meets = met < most
        blurred = met + BLUR * self._rng.standard_normal(exact.shape)
        dim = DIM * np.exp(DIM_SPREAD * self._rng.standard_normal(exact.shape))
        measured[meets] = np.maximum(blurred[meets], range_min)
        intensity[meets] = np.minimum(dim[meets], 0.2)
        return np.asarray(meets)

    def _thickness(self, eyes: F64, ahead: F64) -> F64:
        """Return the density of the dust that each beam passes, about 1: waves through the world, seen 1.5 m ahead of the scanner."""
        place = (eyes[:, None, :] + SWATH * ahead) * (math.pi / SWATH)
        a = self._phases
        waves = np.sin(place[..., 0] + a[0]) * np.sin(place[..., 1] + a[1]) + 0.7 * np.sin(
            1.7 * place[..., 2] + 0.6 * place[..., 0] + a[2]
        )
        return np.asarray(np.exp(waves))


def _in_world(rays: tuple[F64, F64], knots: tuple[F64, F64, F64]) -> tuple[F64, F64]:
    """Return where each column's beams begin (C, 3) and where they go (C, R, 3) in the world, by the nearest knot."""
    (column_times, directions), (times, positions, quaternions) = rays, knots
    near = np.clip(np.searchsorted(times, column_times), 0, len(times) - 1)
    w, u = quaternions[near, 0], quaternions[near, 1:]
    cross = 2.0 * np.cross(u[:, None, :], directions)
    turned = directions + w[:, None, None] * cross + np.cross(np.broadcast_to(u[:, None, :], cross.shape), cross)
    return positions[near], turned


def _falling_off(depth: F64) -> F64:
    """Return the depths at which drops are met whose echoes fade with distance: far drops are missed more and more often."""
    return np.asarray(np.expm1(np.minimum(depth, 30.0)))


def _density(rare: F64, most: F64 | F32, lies: NDArray[np.bool_], share: float) -> float:
    """Return the density with which `share` of all returns are false: beams that meet something within `most` metres."""
    low, high = 1e-5, 1e3
    for _ in range(HALVINGS):
        density = math.sqrt(low * high)
        false = rare / density < most
        count = int(false.sum())
        if count < share * (count + int((lies & ~false).sum())):
            low = density
        else:
            high = density
    return math.sqrt(low * high)


def _in_columns(air: Air, eyes: F64, ahead: F64, depth: F64) -> F64:
    """Return where each beam (C, R) meets smoke, inf: nowhere. A column is an upright cylinder of even density."""
    met = np.full(depth.shape, np.inf)
    flat = np.maximum(np.hypot(ahead[..., 0], ahead[..., 1]), 1e-9)
    for x, y in air.columns:
        off = np.array([x, y]) - eyes[:, :2]
        along = (off[:, None, 0] * ahead[..., 0] + off[:, None, 1] * ahead[..., 1]) / flat
        aside = (off[:, None, 0] * ahead[..., 1] - off[:, None, 1] * ahead[..., 0]) / flat
        half = np.sqrt(np.maximum(SMOKE_RADIUS**2 - aside**2, 0.0))
        enters, leaves = np.maximum(along - half, 0.0) / flat, (along + half) / flat
        at = enters + depth / SMOKE_DENSITY
        height = eyes[:, None, 2] + at * ahead[..., 2] - air.base
        is_met = (half > 0.0) & (at < leaves) & (height > 0.0) & (height < SMOKE_HEIGHT)
        met = np.where(is_met & (at < met), at, met)
    return met


def false_in_order(measured: F32, is_false: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which returns of a cloud are false (M,), in the order in which `raycast.gather_points` lists them."""
    return np.asarray(is_false[np.isfinite(measured)])
