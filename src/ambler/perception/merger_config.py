"""What the scan merger must know of each scanner, and how the virtual scanner is made."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.robot import MERGED_FRAME, RobotModel, SensorKind, SensorMount
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3

ANGLE_SLACK = 1e-5  # rad: angles of a scan are float32, and their steps add up


@dataclass(frozen=True, slots=True)
class AngleWindow:
    """An arc of beam angles in the sensor frame, counter-clockwise from `start` to `end` (rad); `inverse` keeps the outside."""

    start: float
    end: float
    inverse: bool = False

    def keeps(self, angles: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """Return bool (N,): which beam angles are kept. An arc of a full turn or more holds every angle."""
        width = self.end - self.start
        if not math.isfinite(width):
            raise BadInputError(f"angle window {self.start} … {self.end} is not finite")
        if abs(width) >= 2.0 * math.pi - 1e-9:
            inside = np.ones(len(angles), np.bool_)
        else:
            inside = (angles - self.start + ANGLE_SLACK) % (2.0 * math.pi) <= width % (2.0 * math.pi) + 2 * ANGLE_SLACK
        return ~inside if self.inverse else inside


@dataclass(frozen=True, slots=True)
class ScannerConfig:
    """One scanner: the frame of its scans, its mounting, the kept windows (all must keep a beam), and its clock.

    A scanner mounted upside down has a roll of pi in `base_from_sensor`. `clock_offset` is what its clock is ahead of the
    robot's, seconds: a beam stamped t was measured at t - clock_offset.
    """

    frame: str
    base_from_sensor: SE3
    windows: tuple[AngleWindow, ...] = ()
    clock_offset: float = 0.0

    @classmethod
    def planar(
        cls,
        frame: str,
        pose: SE2,
        z: float = 0.0,
        *,
        upside_down: bool = False,
        windows: tuple[AngleWindow, ...] = (),
        clock_offset: float = 0.0,
    ) -> ScannerConfig:
        """Build a level scanner; `upside_down` turns it over about its x axis, so that its beams run clockwise."""
        roll = math.pi if upside_down else 0.0
        mount = SE3.from_rpy((pose.x, pose.y, z), roll, 0.0, pose.yaw)
        return cls(frame, mount, windows, clock_offset)


@dataclass(frozen=True, slots=True)
class MergerConfig:
    """The virtual scanner `frame` at `base_from_origin`: `bins` beams over the full turn, bin 0 looks backwards.

    `range_max` None: the smallest of the scanners'. A source whose newest scan is older than `max_age` seconds is dropped.
    `join_tolerance` (m) is how far neighbouring returns may lie off one straight surface to be joined: about three times the
    range noise; `join_gap` (m) is how far apart they may lie. `self_mask` are polygons of the robot's body in the base frame.
    """

    scanners: tuple[ScannerConfig, ...]
    frame: str = MERGED_FRAME
    base_frame: str = "base"
    base_from_origin: SE2 = field(default_factory=SE2)
    bins: int = 1440
    range_min: float = 0.05
    range_max: float | None = None
    max_age: float = 0.3
    join_tolerance: float = 0.03
    join_gap: float = 0.4
    self_mask: tuple[NDArray[np.float64], ...] = field(default=())

    def __post_init__(self) -> None:
        frames = [s.frame for s in self.scanners]
        if not frames:
            raise BadInputError("the scan merger needs at least one scanner")
        if len(set(frames)) != len(frames):
            raise BadInputError(f"two scanners of the merger share a frame: {frames}")
        if self.bins < 8 or self.max_age <= 0 or self.range_min < 0 or min(self.join_tolerance, self.join_gap) <= 0:
            raise BadInputError(
                "the scan merger needs bins >= 8, max_age > 0, range_min >= 0, join_tolerance > 0, join_gap > 0"
            )
        if self.range_max is not None and self.range_max <= self.range_min:
            raise BadInputError(
                f"range_max {self.range_max} of the merged scan is not beyond range_min {self.range_min}"
            )

    @classmethod
    def from_robot(cls, robot: RobotModel, **changes: Any) -> MergerConfig:
        """Build from a robot's mounts of kind `scan`; the footprint is the self-mask. `changes` override fields."""
        frame = changes.get("frame", MERGED_FRAME)
        mounts = [m for m in robot.sensors if m.kind is SensorKind.SCAN and m.frame != frame]
        scanners = tuple(
            ScannerConfig(m.frame, m.base_from_sensor, (AngleWindow(*m.azimuth),), m.clock_offset) for m in mounts
        )
        return cls(**{"scanners": scanners, "self_mask": (robot.footprint,), **changes})

    @property
    def mount(self) -> SensorMount:
        """The virtual scanner as a sensor of the robot, at the mean height of the real ones."""
        z = float(np.mean([s.base_from_sensor.translation[2] for s in self.scanners]))
        return SensorMount(self.frame, SensorKind.SCAN, SE3.from_se2(self.base_from_origin, z))
