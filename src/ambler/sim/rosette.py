"""A LiDAR whose pattern does not repeat, of the class of the Livox Mid-360: 360° by 59°, 200 000 points per second, 10 clouds per second.

A mirror turns about the vertical while a prism nods the beams up and down; the two periods have no common multiple, so that every turn
draws other lines and the gaps fill within a second. Numbers of the data sheet: 40 m at 10 % reflectivity, blind below 0.1 m, elevations
-7° to 52°, noise 2 cm at 10 m.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.sim.sensors import MID_360, LidarSpec

LINES = len(MID_360.elevations)
ELEVATION = (MID_360.elevations[0], MID_360.elevations[-1])
TURNS_HZ = 11.3
NODS_HZ = 293.7


def rosette(first: float, spec: LidarSpec = MID_360) -> NDArray[np.float64]:
    """Return the unit vectors of a cloud that begins `first` seconds after the sensor was switched on, float64 (columns, lines, 3)."""
    t = first + spec.column_times[:, None]
    line = np.arange(LINES)[None, :] / LINES
    azimuth = 2.0 * math.pi * (TURNS_HZ * t) + 0.02 * line
    phase = NODS_HZ * t + line
    share = np.abs(2.0 * (phase - np.floor(phase)) - 1.0)
    low, high = ELEVATION
    elevation = low + (high - low) * share
    return np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], axis=2
    )
