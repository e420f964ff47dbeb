"""Scanners: exact ray casting from the moving sensor, then noise and losses; a planar scan or a cloud comes out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan, PointCloud
from ambler.kernels import raycast
from ambler.sim.air import Air, SpoiledSweep, false_in_order
from ambler.sim.rosette import rosette
from ambler.sim.scene import RayScene
from ambler.sim.sensors import LidarSpec, named_generator

F64 = NDArray[np.float64]
Knots = tuple[F64, F64, F64]  # seconds (K,), positions (K, 3), quaternions (K, 4)
NO_KNOTS = (np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))  # where nothing floats
Movers = raycast.MovingSolids
NO_MOVERS = Movers(np.zeros((0, 15)), np.zeros(0, np.uint8), np.zeros((0, 2)))


class LidarSensor:
    """One scanner. Buffers are its own and used again for every turn."""

    def __init__(self, spec: LidarSpec, frame: str, scene: RayScene, seed: int) -> None:
        self.spec, self.frame = spec, frame
        self._scene = scene
        self._rng = named_generator(seed, frame)
        self._directions = spec.directions()
        self._times = spec.column_times
        shape = self._directions.shape[:2]
        self._noise = raycast.RangeNoise(
            *(spec.sigma_0, spec.sigma_1, spec.dropout, spec.grazing_cosine, spec.grazing_dropout),
            *(spec.mixed, spec.mixed_min, spec.mixed_max, spec.range_min, spec.range_max),
        )
        self._spoiled = SpoiledSweep(seed, frame)
        self._is_false = np.zeros(shape, np.bool_)
        self._distance, self._cosine, self._intensity, self._measured, self._normals, self._uniforms = (
            np.zeros(shape, np.float32) for _ in range(6)
        )

    def sweep(
        self,
        times: F64,
        positions: F64,
        quaternions: F64,
        movers: Movers = NO_MOVERS,
        first: float = 0.0,
        airs: Sequence[Air] = (),
    ) -> None:
        """Cast one turn; the sensor's poses in the world at `times` (seconds after the first column) are its knots, `movers` are
        where they are at the first column. `first`: seconds from the switching on to the first column, which a pattern that does not
        repeat depends on; `airs`: what floats."""
        self.begin(first)
        self.cast(0.0, math.inf, (times, positions, quaternions), movers)
        self.finish((times, positions, quaternions), airs)

    def begin(self, first: float) -> None:
        """Begin a turn, `first` seconds after the switching on; `cast` its parts, one after the other, and `finish` it."""
        if self.spec.wanders:
            self._directions = rosette(first, self.spec)

    def cast(self, begin: float, end: float, knots: Knots, movers: Movers = NO_MOVERS) -> None:
        """Cast the columns of the times from `begin` until before `end` (seconds after the first column). `knots` are the sensor's poses and times after `begin`,
        `movers` where they are at `begin`."""
        columns = slice(*np.searchsorted(self._times, (begin, end)))
        if columns.start == columns.stop:
            return
        raycast.sweep(
            *(self._scene.solids, movers, raycast.Track(*knots)),
            *(self._times[columns] - begin, self._directions[columns], self.spec.range_max + 1.0),
            raycast.Returns(self._distance[columns], self._cosine[columns], self._intensity[columns]),
        )

    def finish(self, knots: Knots, airs: Sequence[Air] = ()) -> None:
        """Make measurements of what was cast: noise, losses, and what floats, for which `knots` are the sensor's poses in all of the turn."""
        self._rng.standard_normal(out=self._normals, dtype=np.float32)
        self._rng.random(out=self._uniforms, dtype=np.float32)
        raycast.corrupt_ranges(self._distance, self._cosine, self._normals, self._uniforms, self._noise, self._measured)
        self._is_false[:] = False
        for air in airs:
            self._is_false |= self._spoiled.spoil(
                *(air, (self._distance, self._measured, self._intensity), (self._times, self._directions)),
                *(knots, self.spec.range_min),
            )

    @property
    def is_false(self) -> NDArray[np.bool_]:
        """Which points of the last cloud come from what floats, bool (M,)."""
        return false_in_order(self._measured, self._is_false)

    def to_scan(self, stamp_ns: int) -> LaserScan:
        """Return the last turn of a single-ring scanner."""
        spec = self.spec
        return LaserScan(
            stamp_ns,
            self.frame,
            spec.azimuth_start,
            spec.azimuth_increment,
            spec.time_increment,
            spec.period,
            spec.range_min,
            spec.range_max,
            self._measured[:, 0].copy(),
            self._intensity[:, 0].copy(),
        )

    def to_cloud(self, stamp_ns: int) -> PointCloud:
        """Return the last turn as points in the sensor frame at each point's own time."""
        n = self._measured.size
        points, intensity = np.empty((n, 3), np.float32), np.empty(n, np.float32)
        time, ring = np.empty(n, np.float32), np.empty(n, np.uint16)
        m = raycast.gather_points(
            self._measured, self._intensity, self._times, self._directions, points, intensity, time, ring
        )
        return PointCloud(stamp_ns, self.frame, points[:m], intensity[:m], time[:m], ring[:m])
