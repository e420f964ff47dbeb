"""Calibrated scanners in a robot's profile: where each one sits, what its clock is ahead, and how sure that is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel, SensorMount
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.core.units import Radians


class Estimate(Protocol):
    """What a calibration found of one scanner: `sigma` float64 (4,), the standard deviations of x, y (m), yaw (rad), offset (s)."""

    @property
    def frame(self) -> str: ...

    @property
    def base_from_scanner(self) -> SE2: ...

    @property
    def clock_offset(self) -> float: ...

    @property
    def sigma(self) -> NDArray[np.float64]: ...


@dataclass(frozen=True, slots=True)
class ScannerCalibration:
    """One scanner in the base frame: metres and radians, the clock's lead in seconds, and their standard deviations. Height, roll and
    pitch stay those of the robot's model."""

    x: float
    y: float
    yaw: Radians
    clock_offset: float = 0.0
    sigma_x: float = 0.0
    sigma_y: float = 0.0
    sigma_yaw: Radians = 0.0
    sigma_clock_offset: float = 0.0

    @classmethod
    def from_estimate(cls, estimate: Estimate) -> ScannerCalibration:
        """Take over an estimate."""
        mount = estimate.base_from_scanner
        return cls(mount.x, mount.y, mount.yaw, estimate.clock_offset, *(float(s) for s in estimate.sigma))

    def applied_to(self, base_from_sensor: SE3) -> SE3:
        """Return a mount with the calibrated x, y and yaw, and its own height, roll and pitch."""
        z = base_from_sensor.translation[2]
        tilt = SE3.from_se2(base_from_sensor.to_se2(), z).inverse() @ base_from_sensor
        return SE3.from_se2(SE2(self.x, self.y, self.yaw), z) @ tilt


ScannerCalibrations = Mapping[str, ScannerCalibration]


def scanner_calibrations(estimates: Iterable[Estimate]) -> dict[str, ScannerCalibration]:
    """Return the section `scanners` of a profile."""
    return {estimate.frame: ScannerCalibration.from_estimate(estimate) for estimate in estimates}


def calibrated_robot(robot: RobotModel, calibrations: ScannerCalibrations) -> RobotModel:
    """Return the robot with its scanners where they really sit, and with what their clocks are ahead; raises BadInputError for a scanner that it does not have."""
    own = {mount.frame for mount in robot.scanners}
    for frame in calibrations:
        if frame not in own:
            raise BadInputError(f"robot {robot.name} has no scanner {frame!r} to calibrate, only {sorted(own)}")
    return replace(robot, sensors=tuple(_calibrated(mount, calibrations) for mount in robot.sensors))


def _calibrated(mount: SensorMount, calibrations: ScannerCalibrations) -> SensorMount:
    found = calibrations.get(mount.frame)
    if found is None:
        return mount
    return replace(mount, base_from_sensor=found.applied_to(mount.base_from_sensor), clock_offset=found.clock_offset)
