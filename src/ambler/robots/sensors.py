"""Where sensors look, without noise, losses and time: the data sheets' geometry, of which mounts are made. `sim.sensors` adds the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel
from ambler.core.robot import SensorKind, SensorMount
from ambler.core.se3 import SE3


@dataclass(frozen=True, slots=True)
class ScannerGeometry:
    """A spinning scanner: `columns` firings of all `elevations` (rad) over `span` (rad), counter-clockwise from `azimuth_start`, between
    two ranges (m). Of a full turn the last firing lies one step before the first; of a sector the last one lies on its limit."""

    columns: int
    elevations: tuple[float, ...]
    azimuth_start: float
    range_min: float
    range_max: float
    span: float = field(default=2.0 * math.pi, kw_only=True)

    @property
    def is_flat(self) -> bool:
        """Whether it has one ring and sends planar scans."""
        return len(self.elevations) == 1

    @property
    def is_full_turn(self) -> bool:
        return self.span >= 2.0 * math.pi - 1e-9

    @property
    def azimuth_increment(self) -> float:
        return 2.0 * math.pi / self.columns if self.is_full_turn else self.span / (self.columns - 1)

    def directions(self) -> NDArray[np.float64]:
        """Return unit vectors in the sensor frame, float64 (columns, rings, 3)."""
        azimuth = self.azimuth_start + np.arange(self.columns)[:, None] * self.azimuth_increment
        elevation = np.array(self.elevations)[None, :]
        out = np.empty((self.columns, len(self.elevations), 3))
        out[..., 0] = np.cos(azimuth) * np.cos(elevation)
        out[..., 1] = np.sin(azimuth) * np.cos(elevation)
        out[..., 2] = np.sin(elevation)
        return out

    def mount(self, frame: str, base_from_sensor: SE3, window: tuple[float, float] | None = None) -> SensorMount:
        """Return the scanner at a place of a robot; `window` (rad) is the part of a planar one that is used (None: all that it sees)."""
        if not self.is_flat:
            ends = (self.elevations[0], self.elevations[-1])
            return SensorMount(frame, SensorKind.CLOUD, base_from_sensor, self.range_min, elevation=ends)
        everything = (-math.pi, math.pi)
        sector = everything if self.is_full_turn else (self.azimuth_start, self.azimuth_start + self.span)
        azimuth = window if window is not None else sector
        return SensorMount(frame, SensorKind.SCAN, base_from_sensor, self.range_min, azimuth=azimuth)


@dataclass(frozen=True, slots=True)
class TransducerGeometry:
    """A transducer: it hears the nearest surface within a cone of `field_of_view` (rad, full angle) about its x axis."""

    field_of_view: float
    range_min: float
    range_max: float

    def mount(self, frame: str, base_from_sensor: SE3) -> SensorMount:
        """Return the transducer at a place of a robot."""
        return SensorMount(frame, SensorKind.RANGE, base_from_sensor, self.range_min)


@dataclass(frozen=True, slots=True)
class DepthGeometry:
    """A depth camera: `width` x `height` picture elements over fields of view (rad, full angles). It measures from `range_min` on; what it says up
    to `range_max` is good enough to mark an obstacle (m, along its axis)."""

    width: int
    height: int
    horizontal: float
    vertical: float
    range_min: float
    range_max: float

    @property
    def model(self) -> CameraModel:
        """How it projects; depth pictures come without distortion."""
        fx, fy = (0.5 * n / math.tan(0.5 * a) for n, a in ((self.width, self.horizontal), (self.height, self.vertical)))
        return CameraModel("depth", self.width, self.height, fx, fy, 0.5 * (self.width - 1), 0.5 * (self.height - 1))

    def mount(self, frame: str, base_from_sensor: SE3) -> SensorMount:
        """Return the camera at a place of a robot."""
        return SensorMount(frame, SensorKind.DEPTH, base_from_sensor, self.range_min, range_max=self.range_max)


SCANNERS: dict[str, ScannerGeometry] = {
    # A 360° safety-class scanner: 0.5° steps, 20 m.
    "scanner_360": ScannerGeometry(720, (0.0,), -math.pi, 0.1, 20.0),
    # A 270° safety scanner of the microScan3 class: 0.375° steps, 40 m.
    "safety_270": ScannerGeometry(721, (0.0,), -0.75 * math.pi, 0.05, 40.0, span=1.5 * math.pi),
    # Velodyne VLP-16 at 10 Hz: 16 rings of 2°, 0.2° steps, 28 800 rays per turn, 100 m, blind below 0.4 m.
    "vlp_16": ScannerGeometry(1800, tuple(math.radians(e) for e in range(-15, 16, 2)), -math.pi, 0.4, 100.0),
    # A scanner of 64 rings over 45°, 0.35° steps: 65 536 rays per turn, 120 m (Ouster OS1-64 in its mode of 1024 columns).
    "os_64": ScannerGeometry(1024, tuple(math.radians(-22.5 + 45.0 * k / 63) for k in range(64)), -math.pi, 0.5, 120.0),
    # Livox Mid-360: 5000 firings of four lines in 0.1 s, -7° to 52°, blind below 0.1 m. Where they look changes from cloud to cloud
    # (`sim.rosette`); the elevations are the limits and what lies evenly between them.
    "mid_360": ScannerGeometry(
        5000, tuple(np.linspace(math.radians(-7.0), math.radians(52.0), 4).tolist()), -math.pi, 0.1, 70.0
    ),
}
TRANSDUCERS: dict[str, TransducerGeometry] = {
    # A 40 kHz parking transducer: a cone of 30°, 3 m.
    "transducer_30": TransducerGeometry(math.radians(30.0), 0.03, 3.0),
}
DEPTH_CAMERAS: dict[str, DepthGeometry] = {
    # A stereo camera of the RealSense D400 class: 87° x 58°, used from 0.3 to 4 m; of its 848 x 480 elements eight by eight are binned, as
    # costmaps of 5 cm do not need more.
    "d430": DepthGeometry(106, 60, math.radians(87.0), math.radians(58.0), 0.3, 4.0),
}
