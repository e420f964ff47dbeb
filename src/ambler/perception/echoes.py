"""What an ultrasonic echo adds to what the laser knows.

A transducer tells how far the nearest surface of its cone is, not where. Two checks make that useful:
- an echo is confirmed when the transducer's echo before agrees with it: crosstalk and a lost echo do not repeat themselves;
- a confirmed echo is explained when the laser sees something in the cone at that distance. The laser knows better where, so an explained
  echo proves only free space. What is left is what light does not see: glass, or things below and above the laser's plane.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Range
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2, wrap_angle

F64 = NDArray[np.float64]
TURN_SLACK = 0.5  # metres that an echo may change per radian that the robot turns


@dataclass(frozen=True, slots=True)
class EchoConfig:
    """`agreement`: metres between two echoes that confirm each other, plus the robot's own motion. `explained`: metres by which a return of
    the laser may lie before or behind the echo, `widening`: radians by which it may lie beside the cone. `max_gap`: seconds between two
    echoes that still confirm each other. `unsure_max`: so many unconfirmed measurements in a row count all the same: something is there
    whose distance jumps. `arc_step`: metres between the points of an arc."""

    agreement: float = 0.08
    explained: float = 0.12
    widening: float = math.radians(3.0)
    max_gap: float = 0.3
    unsure_max: int = 3
    arc_step: float = 0.04


@dataclass(frozen=True, slots=True)
class Echo:
    """One judged measurement, seen from the base at `stamp_ns`. `distance` is metres from the transducer (inf: nothing within range); the
    cone is proved free up to `free`. `is_unexplained`: confirmed, and the laser sees nothing there."""

    stamp_ns: int
    frame: str
    base_from_sensor: SE2
    half_angle: float
    distance: float
    free: float
    is_unexplained: bool

    def arc(self, step: float) -> F64:
        """Return points of the arc on which the surface lies, in the base frame, at least three, float64 (N, 2)."""
        count = max(3, math.ceil(2.0 * self.half_angle * self.distance / step) + 1)
        angles = np.linspace(-self.half_angle, self.half_angle, count)
        return self.base_from_sensor.transform(self.distance * np.column_stack((np.cos(angles), np.sin(angles))))


def link(arc: F64, other: F64, step: float, reach: float) -> F64:
    """Return points between the nearest ends of the arcs of two neighbouring transducers, float64 (N, 2); none farther apart than `reach`.

    A flat surface that crosses both cones also stands between them, where neither of them looks: before a corner of the robot.
    """
    ends = [(a, b) for a in (arc[0], arc[-1]) for b in (other[0], other[-1])]
    a, b = min(ends, key=lambda pair: float(np.hypot(*(pair[1] - pair[0]))))
    length = float(np.hypot(*(b - a)))
    if length > reach:
        return np.empty((0, 2))
    t = np.linspace(0.0, 1.0, math.ceil(length / step) + 1)[1:-1, None]
    return np.asarray(a + t * (b - a))


class EchoFilter:
    """Judges every measurement of a ring."""

    def __init__(self, robot: RobotModel, config: EchoConfig | None = None) -> None:
        self.config = config if config is not None else EchoConfig()
        self._mounts = {mount.frame: mount for mount in robot.rangers}
        self._unsure: dict[str, int] = {}
        self._recent: dict[str, deque[tuple[int, float, SE2]]] = {}

    def update(self, measured: Range, odom_from_base: SE2, laser_base: Iterable[F64]) -> Echo | None:
        """Judge a measurement with the base's pose at its stamp and the laser's returns (each (N, 2)) in the base frame of that
        moment. Returns None for no measurement at all, and for what nothing confirms yet."""
        if math.isnan(measured.range):
            return None
        distance = measured.range_min if measured.range == -math.inf else float(measured.range)
        mount = self._mounts[measured.frame].base_from_sensor.to_se2()
        half = 0.5 * measured.field_of_view
        is_explained = any(self._explains(points, mount, half, distance) for points in laser_base)
        is_confirmed = self._is_confirmed(measured, distance, odom_from_base)
        unsure = 0 if is_explained or is_confirmed else self._unsure.get(measured.frame, 0) + 1
        self._unsure[measured.frame] = unsure
        if 0 < unsure < self.config.unsure_max:
            return None
        is_echo = distance <= measured.range_max
        return Echo(
            measured.stamp_ns,
            measured.frame,
            mount,
            half,
            distance if is_echo else math.inf,
            distance if is_echo else measured.range_max,
            is_echo and not is_explained,
        )

    def _is_confirmed(self, measured: Range, distance: float, odom_from_base: SE2) -> bool:
        """Compare with the last two measurements: one that was lost between two echoes does not matter."""
        recent = self._recent.setdefault(measured.frame, deque(maxlen=2))
        is_confirmed = any(self._agree(measured, distance, odom_from_base, *old) for old in recent)
        recent.append((measured.stamp_ns, distance, odom_from_base))
        return is_confirmed

    def _agree(
        self, measured: Range, distance: float, odom_from_base: SE2, old_ns: int, old: float, odom_from_old: SE2
    ) -> bool:
        if (measured.stamp_ns - old_ns) * 1e-9 > self.config.max_gap:
            return False
        if distance > measured.range_max or old > measured.range_max:
            return distance > measured.range_max and old > measured.range_max
        turn = abs(wrap_angle(odom_from_base.yaw - odom_from_old.yaw))
        moved = odom_from_base.distance_to(odom_from_old) + TURN_SLACK * turn
        return abs(distance - old) <= self.config.agreement + moved

    def _explains(self, points_base: F64, base_from_sensor: SE2, half: float, distance: float) -> bool:
        points = base_from_sensor.inverse().transform(points_base)
        r = np.hypot(points[:, 0], points[:, 1])
        off = np.abs(np.arctan2(points[:, 1], points[:, 0]))
        # Within a hand's breadth the cone is narrower than the noise of the laser.
        width = half + self.config.widening + np.minimum(0.5, 0.03 / np.maximum(r, 1e-6))
        return bool(((np.abs(r - distance) <= self.config.explained) & (off <= width)).any())
