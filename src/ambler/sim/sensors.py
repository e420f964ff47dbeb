"""Every number of every simulated sensor, in one place; `perfect` variants have no noise, no losses and no drift.

Sources: simulation.md §6 (SICK and Velodyne data sheets, InvenSense and MTi IMUs, usual wheel encoders). Every random number
comes from `named_generator(seed, sensor)`, so that adding a sensor never changes another sensor's noise.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.robots.sensors import (
    DEPTH_CAMERAS,
    SCANNERS,
    TRANSDUCERS,
    DepthGeometry,
    ScannerGeometry,
    TransducerGeometry,
)


def named_generator(seed: int, name: str) -> np.random.Generator:
    """Return the generator that belongs to a seed and a name."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, zlib.crc32(name.encode())])))


@dataclass(frozen=True, slots=True)
class LidarSpec(ScannerGeometry):
    """A scanner as it is: it sends a scan every `period` seconds, `phase` seconds after the others, and needs `turn` seconds for a full
    turn (0: the period); a scan is on its way for `latency` seconds.

    Noise: sigma_0 + sigma_1 * range; `dropout` loses any beam, `grazing_*` beams that meet a surface at a flat angle; `mixed`
    is the probability that a beam at an edge of `mixed_min`..`mixed_max` metres falls between the two surfaces. `wanders`: 1 when the
    pattern does not repeat (`sim.rosette`). `clock`: seconds that its stamps lie behind the true times of its points.
    """

    period: float
    sigma_0: float
    sigma_1: float
    dropout: float
    grazing_cosine: float
    grazing_dropout: float
    mixed: float
    mixed_min: float
    mixed_max: float
    latency: float
    turn: float = 0.0
    phase: float = 0.0
    wanders: int = 0
    clock: float = 0.0

    @property
    def time_increment(self) -> float:
        """Seconds from one column to the next."""
        turn = self.turn if self.turn > 0 else self.period
        return turn / self.columns if self.is_full_turn else turn * self.azimuth_increment / (2.0 * math.pi)

    @property
    def sweep_time(self) -> float:
        """Seconds from the scan's stamp to its end."""
        turn = self.turn if self.turn > 0 else self.period
        return turn if self.is_full_turn else turn * self.span / (2.0 * math.pi)

    @property
    def column_times(self) -> NDArray[np.float64]:
        """Firing times of the columns after the scan's stamp, seconds."""
        return np.arange(self.columns, dtype=np.float64) * self.time_increment

    def perfect(self) -> LidarSpec:
        """The same scanner without noise and losses; it still turns while the robot moves."""
        return replace(self, sigma_0=0.0, sigma_1=0.0, dropout=0.0, grazing_dropout=0.0, mixed=0.0, clock=0.0)


@dataclass(frozen=True, slots=True)
class UltrasonicSpec(TransducerGeometry):
    """A transducer as it is: it fires every `period` seconds, `phase` seconds after the others of its ring. Smooth surfaces that are met
    flatter than `incidence_max` (rad) throw the sound away: walls along the way, and the floor. Noise is `sigma`; an echo is lost with
    probability `dropout`, and a neighbour's echo is taken for an own one with probability `crosstalk`.
    """

    period: float
    sigma: float
    dropout: float
    crosstalk: float
    incidence_max: float
    latency: float
    phase: float = 0.0

    def directions(self) -> NDArray[np.float64]:
        """Return unit vectors of rays that fill the cone in rings 2.5° apart, float64 (N, 3), the axis first."""
        rows = [(0.0, 0.0)]
        half = 0.5 * self.field_of_view
        rings = max(1, math.ceil(half / math.radians(2.5)))
        for k in range(1, rings + 1):
            around = np.arange(6 * k) * (2.0 * math.pi / (6 * k))
            rows += [(half * k / rings, float(a)) for a in around]
        off, around = np.array(rows).T
        return np.stack([np.cos(off), np.sin(off) * np.cos(around), np.sin(off) * np.sin(around)], axis=1)

    def perfect(self) -> UltrasonicSpec:
        """The same transducer without noise, losses and crosstalk."""
        return replace(self, sigma=0.0, dropout=0.0, crosstalk=0.0)


@dataclass(frozen=True, slots=True)
class DepthCameraSpec(DepthGeometry):
    """A stereo depth camera as it is: a picture every `period` seconds, `phase` after the others, `latency` seconds on its way. Noise along the
    axis is `sigma` times the distance squared. An element has no depth beyond `reach` (m), with probability `dropout`, in a patch of
    `patch` elements' side with probability `patches`, on surfaces met flatter than `grazing_cosine`, and with probability `shadow` right
    beside an edge in depth of more than `edge` metres, where one eye sees what the other does not; with probability `flying` it lies there
    anywhere between the two surfaces."""

    period: float
    sigma: float
    reach: float
    dropout: float
    patch: int
    patches: float
    grazing_cosine: float
    edge: float
    shadow: float
    flying: float
    latency: float
    phase: float = 0.0

    def perfect(self) -> DepthCameraSpec:
        """The same camera without noise and losses."""
        return replace(self, sigma=0.0, dropout=0.0, patches=0.0, grazing_cosine=0.0, shadow=0.0, flying=0.0)


@dataclass(frozen=True, slots=True)
class ImuSpec:
    """An IMU: white noise densities (rad/s/√Hz, m/s²/√Hz), bias as a first-order Gauss-Markov process that starts at its
    stationary sigma (the turn-on bias), scale errors and limits beyond which it says no more. `misalignment` (rad): standard deviation
    of the small angles by which each axis leans towards each other one; `gyro_step`, `accel_step`: one count of its converter;
    `vibration`: white acceleration of what it is mounted on, m/s² for each m/s of speed, a tenth of it as rad/s."""

    rate_hz: float
    gyro_density: float
    accel_density: float
    gyro_bias_sigma: float
    accel_bias_sigma: float
    bias_time: float
    scale_sigma: float
    gyro_limit: float
    accel_limit: float
    misalignment: float = 0.0
    gyro_step: float = 0.0
    accel_step: float = 0.0
    vibration: float = 0.0

    def perfect(self) -> ImuSpec:
        """The same IMU without noise, bias and scale errors, its axes square, its counts endlessly fine."""
        errors = ("gyro_density", "accel_density", "gyro_bias_sigma", "accel_bias_sigma", "scale_sigma")
        form = ("misalignment", "gyro_step", "accel_step", "vibration")
        return replace(self, **dict.fromkeys((*errors, *form), 0.0))


@dataclass(frozen=True, slots=True)
class OdometrySpec:
    """Dead reckoning of the base. Constant errors drawn once per run: `radius_sigma` (each wheel, or the step length),
    `track_sigma` (turning). `slip_sigma` is a slowly changing error (time constant `slip_time`) of each wheel's travel, as a
    share of it. Encoders count `ticks` per turn (0: not quantised). `tilt_sigma` (rad) is noise of roll and pitch."""

    rate_hz: float
    radius_sigma: float
    track_sigma: float
    slip_sigma: float
    slip_time: float
    ticks: int
    tilt_sigma: float

    def perfect(self) -> OdometrySpec:
        """Odometry that repeats the true motion of the wheels exactly."""
        return replace(self, radius_sigma=0.0, track_sigma=0.0, slip_sigma=0.0, ticks=0, tilt_sigma=0.0)


# A 360° safety-class scanner: 0.5° steps, 10 Hz, 20 m; noise and losses of the nanoScan3.
SCANNER_360 = LidarSpec(
    **asdict(SCANNERS["scanner_360"]),
    period=0.1,
    sigma_0=0.008,
    sigma_1=0.0005,
    dropout=0.005,
    grazing_cosine=0.08,
    grazing_dropout=0.7,
    mixed=0.15,
    mixed_min=0.25,
    mixed_max=3.0,
    latency=0.005,
)

# A 270° safety scanner of the microScan3 class: it turns in 40 ms and sends every second turn; 0.375° steps, 40 m.
SAFETY_270 = LidarSpec(
    **asdict(SCANNERS["safety_270"]),
    period=0.08,
    sigma_0=0.008,
    sigma_1=0.0005,
    dropout=0.005,
    grazing_cosine=0.08,
    grazing_dropout=0.7,
    mixed=0.15,
    mixed_min=0.25,
    mixed_max=3.0,
    latency=0.005,
    turn=0.04,
)

# What scanners of many rings have in common here: 10 clouds per second, losses and mixed pixels.
_MANY_RINGS: dict[str, Any] = {
    "period": 0.1,
    "dropout": 0.01,
    "grazing_cosine": 0.08,
    "grazing_dropout": 0.7,
    "mixed": 0.15,
    "mixed_min": 0.25,
    "mixed_max": 3.0,
    "latency": 0.01,
}

# Velodyne VLP-16 at 10 Hz: 16 rings of 2°, 0.2° steps, 28 800 rays per turn, 100 m, blind below 0.4 m.
VLP_16 = LidarSpec(**asdict(SCANNERS["vlp_16"]), **_MANY_RINGS, sigma_0=0.012, sigma_1=0.0004)

# A scanner of 64 rings at 10 Hz: 65 536 rays per turn; noise of Ouster's sheet (1 to 2 cm within 50 m).
OS_64 = LidarSpec(**asdict(SCANNERS["os_64"]), **_MANY_RINGS, sigma_0=0.01, sigma_1=0.0003)

# Livox Mid-360: 20 000 rays in 0.1 s along a pattern that does not repeat, 40 m at 10 % reflectivity, 2 cm at 10 m.
MID_360 = LidarSpec(**asdict(SCANNERS["mid_360"]), **_MANY_RINGS, sigma_0=0.015, sigma_1=0.0005, wanders=1)

# A 40 kHz parking transducer: a cone of 30°, 3 m, noise of 1 cm; four groups of a ring take turns, so each fires at 12.5 Hz.
TRANSDUCER_30 = UltrasonicSpec(
    **asdict(TRANSDUCERS["transducer_30"]),
    period=0.08,
    sigma=0.01,
    dropout=0.01,
    crosstalk=0.002,
    incidence_max=math.radians(65.0),
    latency=0.02,
)

# RealSense D430 module, ten pictures a second. Noise of stereo: distance² · error of the match / (focal length · baseline), with 0.06 elements of
# error after binning, 447 elements and 50 mm (Intel's tuning guide); it says more than the 4 m that are used.
D430 = DepthCameraSpec(
    **asdict(DEPTH_CAMERAS["d430"]),
    period=0.1,
    sigma=0.0027,
    reach=10.0,
    dropout=0.02,
    patch=6,
    patches=0.01,
    grazing_cosine=0.05,
    edge=0.15,
    shadow=0.3,
    flying=0.3,
    latency=0.03,
)

# A generic MEMS unit of the MTi-1 class; turn-on biases are those that remain after the usual stand-still calibration.
MEMS_IMU = ImuSpec(
    rate_hz=100.0,
    gyro_density=1.22e-4,
    accel_density=1.18e-3,
    gyro_bias_sigma=5e-4,
    accel_bias_sigma=0.02,
    bias_time=500.0,
    scale_sigma=0.002,
    gyro_limit=35.0,
    accel_limit=150.0,
)

# The same unit at 200 Hz.
MEMS_IMU_200 = replace(MEMS_IMU, rate_hz=200.0)

# The unit inside a Livox Mid-360 (ICM-40609-D class): densities of its sheet, 16 bits over 2000 °/s and 16 g, axes true to 0.1°.
# Of wheels and steps so much shaking arrives as a plate on rubber lets through.
ICM_40609 = ImuSpec(
    rate_hz=200.0,
    gyro_density=6.63e-5,
    accel_density=6.87e-4,
    gyro_bias_sigma=5e-4,
    accel_bias_sigma=0.02,
    bias_time=500.0,
    scale_sigma=0.002,
    gyro_limit=math.radians(2000.0),
    accel_limit=16.0 * 9.80665,
    misalignment=math.radians(0.1),
    gyro_step=math.radians(2000.0) / 2**15,
    accel_step=16.0 * 9.80665 / 2**15,
    vibration=0.3,
)

# Driven wheels with 2^12 ticks per turn.
WHEEL_ODOMETRY = OdometrySpec(
    rate_hz=50.0,
    radius_sigma=0.005,
    track_sigma=0.01,
    slip_sigma=0.01,
    slip_time=2.0,
    ticks=4096,
    tilt_sigma=0.0,
)

# Legs: step length and turning known to 1 %, more slip than wheels, roll and pitch from the body's own IMU.
LEG_ODOMETRY = OdometrySpec(
    rate_hz=50.0,
    radius_sigma=0.01,
    track_sigma=0.01,
    slip_sigma=0.03,
    slip_time=1.0,
    ticks=0,
    tilt_sigma=math.radians(0.1),
)


@dataclass(frozen=True, slots=True)
class GaitSpec:
    """Sway of a legged body while it walks: amplitudes at full speed of heave and sway (m), roll, pitch, yaw (rad). `upright`: the share of
    the ground's tilt that the legs take back; `crouch`: how much lower (m) it sits than it stands."""

    frequency_hz: float = 2.5
    heave: float = 0.012
    sway: float = 0.012
    roll: float = math.radians(1.5)
    pitch: float = math.radians(1.0)
    yaw: float = math.radians(0.7)
    full_speed: float = 0.4
    time_constant: float = 0.3
    upright: float = 0.0
    crouch: float = 0.25


# A small dog's trot, and the walk of somebody on two legs, who keeps his trunk upright where the ground is not.
TROT = GaitSpec(3.0, 0.010, 0.008, math.radians(1.5), math.radians(1.5), math.radians(0.8), 0.6, 0.3, crouch=0.18)
HUMANOID = GaitSpec(
    1.8, 0.015, 0.020, math.radians(2.0), math.radians(1.5), math.radians(2.0), 0.5, 0.3, 1.0, crouch=0.35
)
