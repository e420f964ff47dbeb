"""From the last registered scan to now: the filter's state carried on by the inertial measurements that came since."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Imu
from ambler.kernels import inertial as k
from ambler.lio.config import ImuConfig
from ambler.lio.inertial_buffer import InertialBuffer
from ambler.lio.state import FilterState

F64 = NDArray[np.float64]
KEPT = 10.0  # s of measurements that are kept to walk through them again; registration is never that late


@dataclass(frozen=True, slots=True, eq=False)
class FilterEstimate:
    """The filter after a scan: its `state` and `covariance` (N, N) at `stamp_ns` of the IMU's clock, and the factor that makes forces m/s²."""

    stamp_ns: int
    state: FilterState
    covariance: F64
    force_scale: float


class CarriedState:
    """`state`, `covariance` and turn `rate` (3,) in the IMU at the newest inertial measurement; they say nothing before the first `restart`."""

    def __init__(self, config: ImuConfig) -> None:
        densities = (config.gyro_density, config.accel_density, config.gyro_walk, config.accel_walk)
        self._densities = np.square(densities)
        self._buffer = InertialBuffer()
        self._time = 0.0
        self._has_begun = False
        self.state = FilterState()
        self.covariance = np.zeros((k.EXTRA, k.EXTRA))
        self.rate = np.zeros(3)

    def add(self, sample: Imu) -> bool:
        """Take a measurement; tells whether the state moved to its time (not before a restart, nor for samples that are refused)."""
        refused = self._buffer.refused
        self._buffer.add((sample,))
        self._buffer.forget(self._buffer.last - KEPT)
        return self._buffer.refused == refused and self._move()

    def __len__(self) -> int:
        """How many measurements are kept."""
        return len(self._buffer)

    def restart(self, estimate: FilterEstimate) -> None:
        """Begin at what the filter found, and walk again through the measurements since."""
        self._has_begun = True
        self.state, self.covariance = estimate.state.copy(), estimate.covariance.copy()
        self._buffer.scale = estimate.force_scale
        self._time = self._buffer.seconds(estimate.stamp_ns)
        self._buffer.forget(self._time)
        self._move()

    def _move(self) -> bool:
        newest = self._buffer.last
        if not self._has_begun or newest <= self._time:
            return False
        state = self.state
        samples = self._buffer.between(self._time, newest)
        knots = np.empty((len(samples), k.KNOT))
        k.propagate(
            *(samples, state.position, state.rotation, state.velocity, state.gyro_bias, state.accel_bias),
            *(state.gravity, self.covariance, self._densities, knots),
        )
        self._time, self.rate = newest, knots[-1, k.W : k.W + 3].copy()
        return True
