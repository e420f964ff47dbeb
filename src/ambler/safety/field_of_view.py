"""What a scanner can measure: between which ranges, azimuths and elevations."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import blind as kernels

F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rays = tuple[F64, F64, F64]
"""Range (m), azimuth and elevation (rad) of points in a scanner's frame, each (N,)."""

BIN = math.radians(2.0)  # of the image that tells where the scanner looks through
CUT = 0.04  # metres beyond the blind side within which noise decides what is measured


@dataclass(frozen=True, slots=True)
class FieldOfView:
    """What a scanner can measure in its own frame: ranges from `range_min` (m), azimuth and elevation limits (rad)."""

    range_min: float = 0.0
    azimuth: tuple[float, float] = (-math.pi, math.pi)
    elevation: tuple[float, float] = (-math.pi, math.pi)

    def shrunk(self, distance: float, angle: float) -> FieldOfView:
        """Return the field without a rim of `distance` metres at its blind side and `angle` radians at its other sides."""
        low, high = self.elevation
        left, right = self.azimuth
        if not self.is_round:
            left, right = left + angle, right - angle
        return replace(
            self, range_min=self.range_min + distance, azimuth=(left, right), elevation=(low + angle, high - angle)
        )

    @property
    def is_planar(self) -> bool:
        """Whether its rays lie in a plane, so that nothing is above or below them."""
        return self.elevation[1] - self.elevation[0] >= 2.0 * math.pi

    @property
    def is_round(self) -> bool:
        """Whether it looks into every direction."""
        return self.azimuth[1] - self.azimuth[0] >= 2.0 * math.pi - 2.0 * BIN

    def has_all_beyond(self, distance: float) -> bool:
        """Whether nothing that a planar scanner could hit at `distance` metres or farther is hidden from it."""
        return self.is_round and self.is_planar and self.range_min + CUT <= distance

    def contains(self, rays: Rays) -> Flags:
        """Return bool (N,)."""
        out = np.empty(len(rays[0]), np.bool_)
        kernels.are_inside(*rays, self.range_min, self.azimuth, self.elevation, out)
        return out


def overlap(sector: tuple[float, float], window: tuple[float, float]) -> tuple[float, float]:
    """Return what two arcs (from, to; rad, counter-clockwise, each told in any turn) have in common, in the turn of the first one: all of the window where the
    first goes all around; an empty arc where they have nothing in common."""
    if window[1] - window[0] >= 2.0 * math.pi:
        return sector
    if sector[1] - sector[0] >= 2.0 * math.pi - 2.0 * BIN:
        return window
    shift = 2.0 * math.pi * round((sum(sector) - sum(window)) / (4.0 * math.pi))
    low, high = max(sector[0], window[0] + shift), min(sector[1], window[1] + shift)
    return low, max(low, high)
