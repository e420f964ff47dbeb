"""LiDAR-inertial odometry: per scan one propagation, one iterated Kalman update with point-to-plane residuals, and one insertion into the map.

After FAST-LIO2 (Xu, Cai, He, Lin and Zhang 2022), sections IV and V, with a voxel hash in the place of its tree. Where this differs: the map
is levelled, the error state's position comes first, weak directions are left alone, and the map does not grow at rest.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import PointCloud
from ambler.core.protocols import CloudFilter
from ambler.core.se3 import SE3
from ambler.kernels import inertial as k
from ambler.kernels import voxel_map as voxel_kernels
from ambler.lio.alone import at_one_instant, turned_states
from ambler.lio.beginning import begun_covariance, levelled, since_start_jacobian, start_from_map
from ambler.lio.config import LioConfig
from ambler.lio.degeneracy import Degeneracy, find_degeneracy
from ambler.lio.drift import Drift
from ambler.lio.health import Health, LioResult
from ambler.lio.hole import Hole, PlaceSearch, Whereabouts, whereabouts
from ambler.lio.inertial_buffer import InertialBuffer
from ambler.lio.measurements import Measurement, height_and_tilt, skew, standstill, wheel_velocity
from ambler.lio.start import LioInputError, Start, find_start, in_motion, level_rotation
from ambler.lio.state import FilterState, gravity_basis, log, right_jacobian, to_se3
from ambler.lio.voxel_map import VoxelMap
from ambler.recordings.cloud_scan import CloudScan

F64 = NDArray[np.float64]
CLOCKS_APART = 0.5  # s between a cloud and the nearest inertial measurement from which on they are of two clocks
OUTAGE = 0.5  # s without scans from which on the state is walked on in steps of `STEP` s, short enough to notice that it stands
STEP = 0.1
SCAN_LEAST = 0.05  # s; what parts of a turn differ by is their noise
BEFORE_START = 10.0  # s of inertial measurements that are kept while no cloud has come
CLEAR = 0.5  # of the points on planes: as many say that a LiDAR alone follows its motion
POOR = 0.8  # of the usual share of points on planes: below, a LiDAR alone looks for its place more widely
USUAL = 0.1  # what a scan says of that share
START_INSERTS = 10  # scans that build the first map even at rest: the rings of a single one are too far apart


class LidarInertialOdometry:
    """Give it scans with the inertial measurements since the one before; it returns where the IMU is in a level map that begins there.

    `imu_from_lidar` is the LiDAR's mount unless the configuration names one; `imu_from_base` is needed for wheel odometry only. `air` takes out what floats.
    """

    def __init__(
        self,
        config: LioConfig | None = None,
        imu_from_lidar: SE3 | None = None,
        imu_from_base: SE3 | None = None,
        air: CloudFilter | None = None,
    ) -> None:
        self.config = config or LioConfig()
        if self.config.imu_from_lidar is not None:
            x, y, z, *angles = self.config.imu_from_lidar
            imu_from_lidar = SE3.from_rpy((x, y, z), *angles)
        self.state = FilterState(clock=self.config.lidar_clock)
        self.state.imu_from_lidar = np.ascontiguousarray((imu_from_lidar or SE3()).matrix()[:3])
        self.covariance = np.zeros((k.EXTRA + self.config.extras,) * 2)
        self.map = VoxelMap(self.config.map)
        self.start: Start | None = None
        self._imu_from_base, self._air = imu_from_base if self.config.wheels.is_used else None, air
        self._false_ratio = 0.0
        self._imu = InertialBuffer()
        self.left_out = 0
        """How many messages were left out before they came here, for their stamps."""
        self._time = 0.0
        self._voxel = self.config.scan.voxel
        self._knots = np.zeros((2, k.KNOT))
        self._scratch = np.empty(0, np.int64)
        self._before_start: deque[CloudScan] = deque(maxlen=self.config.start.rehearsed)
        self._inserted_at: FilterState | None = None
        self._inserts = 0
        self._usual = 0.0
        self._stands = False
        self._is_unmoved = True
        # After a time without scans until one fits: elsewhere than thought, a map would begin anew.
        self._is_adrift = False
        self.holes: list[Hole] = []
        """What nothing was measured in, and whether the place was found again after it."""
        self._heard = 0.0
        self._follower: LidarInertialOdometry | None = None
        self._search: PlaceSearch | None = None
        self._origin = FilterState()
        imu = self.config.imu
        alone = self.config.alone
        self._rate, self._gap = np.zeros(3), 0.0
        self._drift = Drift(self.config.drift)
        self._densities = np.square(
            [imu.gyro_density, imu.accel_density, imu.gyro_walk, imu.accel_walk]
            if self.config.has_imu
            else [alone.rate_density, alone.acceleration_density, 0.0, 0.0]
        )

    def update(self, scan: CloudScan) -> LioResult | None:
        """Take a scan; returns the pose at its last point, or None while the filter waits for its start or the scan says nothing.

        Raises LioInputError when the measurements cannot be what they are said to be.
        """
        c = self.config
        self._take(scan)
        end = self._imu.seconds(scan.end_ns) + self.state.clock
        is_empty = len(scan.cloud.points) == 0
        if self.start is None and is_empty:
            self._imu.forget(self._imu.last - BEFORE_START)
            return None
        if self.start is None and not self._begin(scan):
            return None
        beginning = end if is_empty else self._beginning(scan.cloud)
        if self._is_astray(beginning):
            self._look_for_place(scan)
            self._heard = max(self._heard, end)
            return None
        came_from = self.state.position
        self._walk_on(beginning)
        self._heard = max(self._heard, end, self._time)
        if end <= self._time or is_empty:
            return None
        samples = self._samples(end)
        before = self.covariance.copy()
        prior = self._propagate(samples)  # eqs. (5)-(8)
        self._is_unmoved = self._is_unmoved and self._standstill(prior, samples) is not None
        if self._is_unmoved:  # as far as the IMU notices
            self.covariance[:6, :6] += np.diag(np.repeat(np.square([c.rest.way_most, c.rest.turn_most]), 3))
        points, ranges, times = self._thin_out(scan.cloud, prior)
        points_imu = self._compensate(points, times)  # eq. (9)
        state, weak, sums, iterations = self._update_from(prior, points_imu, ranges, end - self._time)  # eqs. (12)-(18)
        self._is_unmoved = self._is_unmoved and self._is_at_origin(state)
        if self._is_unmoved:  # its scans only build the map: they are of one place, and lean alike
            state, self.covariance = self.state.copy(), before
        health = self._health(prior, state, weak, sums, len(points), iterations)
        self._rate = log(self.state.rotation.T @ state.rotation) / (end - self._time)
        self._drift.move(state.position - came_from, weak.translation)
        self._drift.leave(float(np.linalg.norm(state.position - self._origin.position)))
        points_imu = _remounted(points_imu, self.state, state) if self.config.extras else points_imu
        health = replace(health, is_contradicted=self._is_contradicted(health, end - self._time))
        self.state, self._time = state, end
        health = self._update_other(health, samples, scan)
        self._is_adrift = self._is_adrift and health.is_lost
        if not self._is_adrift:
            self._insert(points_imu)
        self._imu.forget(self._time)
        up, up_sigma = self._up() if self.config.has_imu else (None, 0.0)
        begin = start_from_map(self._origin, self.state)
        return LioResult(
            scan.end_ns,
            self.state.map_from_imu,
            self.state.velocity.copy(),
            self._told_covariance(begin),
            points_imu,
            health,
            up,
            up_sigma,
            to_se3(self.state.imu_from_lidar[:, 3], self.state.imu_from_lidar[:, :3]),
            begin,
        )

    def _told_covariance(self, begin: SE3) -> F64:
        """Return the covariance (6, 6) of the pose since the start: what the filter knows of it, and what the map has drifted."""
        jacobian = since_start_jacobian(self._origin, self.state, begin, len(self.covariance))
        rotation = begin.matrix()[:3, :3] @ self.state.rotation
        return np.asarray(jacobian @ self.covariance @ jacobian.T) + self._drift.covariance(rotation)

    @property
    def refused_text(self) -> str:
        """How much was left out, in words; empty for nothing."""
        text = ""
        if self.left_out:
            text += f", {self.left_out} messages have stamps that are out of order"
        if self._imu.refused:
            text += f", {self._imu.refused} inertial measurements were refused (not finite, or not in order)"
        return text

    def registered(self, cloud: PointCloud) -> NDArray[np.float32]:
        """Return all points of the scan that was taken last in the map, each from where the LiDAR was at its time, float32 (N, 3)."""
        points_imu = self._compensate(cloud.points, self._times(cloud, np.arange(len(cloud.points))))
        return np.asarray(self._place(points_imu), np.float32)

    def _up(self) -> tuple[F64, float]:
        """Return the direction against gravity in the IMU's frame (3,), and how uncertain it is (rad)."""
        gravity = self.state.gravity
        back = self.state.rotation.T / np.linalg.norm(gravity)
        up = -back @ gravity
        jacobian = np.zeros((3, len(self.covariance)))
        jacobian[:, k.ROTATION : k.VELOCITY] = skew(up)
        jacobian[:, k.GRAVITY : k.EXTRA] = back @ skew(gravity) @ gravity_basis(gravity)
        return up, float(np.sqrt(np.linalg.eigvalsh(jacobian @ self.covariance @ jacobian.T)[-1]))

    def _beginning(self, cloud: PointCloud) -> float:
        """Return when the first point was taken."""
        first = float(np.min(cloud.time, initial=0.0, where=np.isfinite(cloud.time)))
        return self._imu.seconds(cloud.stamp_ns) + first + self.state.clock

    def _walk_on(self, until: float) -> None:
        """Carry the state through a time without scans by the inertial measurements alone, which tell where it stands meanwhile."""
        if not self.config.has_imu or until - self._time <= OUTAGE:
            return
        while self._time + STEP < min(until, self._imu.last):
            samples, before = self._samples(self._time + STEP), self.covariance.copy()
            prior = self._propagate(samples)
            rest = self._standstill(prior, samples)
            self._is_unmoved = self._is_unmoved and rest is not None
            if self._is_unmoved:
                self.covariance = before
            else:
                self.state = prior
                if rest is not None:
                    self._measure(rest)
            self._time, self._is_adrift = self._time + STEP, True
            self._imu.forget(self._time)

    def _take(self, scan: CloudScan) -> None:
        self.left_out += scan.left_out
        if self.config.has_imu:
            self._imu.add(scan.imu)
        elif self._imu.origin_ns is None:
            self._imu.origin_ns = scan.cloud.stamp_ns

    def _samples(self, end: float) -> F64:
        """Return the inertial samples of the scan; without an IMU those of a motion that goes on as it was."""
        if self.config.has_imu:
            return self._imu.between(self._time, end)
        force = -self.state.rotation.T @ self.state.gravity
        rows = np.tile(np.concatenate([[0.0], self._rate, force]), (2, 1))
        rows[:, 0] = self._time, end
        return rows

    def _begin(self, scan: CloudScan) -> bool:
        """Look for the start; at rest it makes the first map of the scan in which it was found."""
        if not self.config.has_imu:
            return self._begin_alone(scan)
        if len(scan.imu) == 0 and len(self._imu) == 0:
            raise LioInputError(
                "no inertial measurements came with the first scan; LiDAR-inertial odometry needs an IMU"
            )
        if len(self._imu) == 0:
            return False  # all were refused so far
        self._check_clocks(scan)
        self.start = find_start(self._imu.rows(), self.config.start)
        if self.start is None:
            self._before_start.append(scan)
            return False
        if self.start.is_rest and self._is_carried():
            self.start = in_motion(self.start)
        self._imu.scale = self.start.scale
        self._begin_at(self._imu.seconds(scan.cloud.stamp_ns) + self.state.clock, self.start)
        if not self.start.is_rest:
            self._rehearse(self.start)
        self._before_start.clear()
        return True

    def _begin_at(self, time: float, start: Start, speed_sigma: float = math.inf) -> None:
        """Begin with what the start says of the IMU."""
        begun = replace(start.state, imu_from_lidar=self.state.imu_from_lidar, clock=self.state.clock)
        speed_sigma = min(speed_sigma, self.config.start.speed_sigma)
        self.state, self._origin, self._time, self._heard = begun, begun.copy(), time, time
        self.covariance = begun_covariance(begun, self.config, start.is_rest, speed_sigma)

    def _rehearse(self, start: Start) -> bool:
        """Learn the velocity, and what is up, by following the scans before the start with a filter that is given away: who begins in motion and takes himself to stand
        bends the first scan, in which all others find their place, and may find none. Returns whether it was learned."""
        scans = [scan for scan in self._before_start if len(scan.cloud.points)]
        if not scans:
            return False
        c = self.config
        config = replace(c, estimates_mount=False, estimates_clock=False, iterations_most=c.alone.iterations_most)
        other = LidarInertialOdometry(config)
        other.state = self.state.copy()
        other._imu, other.start = self._imu.copy(), start
        velocity, sigma = self._speed_alone(scans)
        moving = replace(start, state=replace(start.state, velocity=start.state.rotation @ velocity))
        other._begin_at(self._imu.seconds(scans[0].cloud.stamp_ns) + self.state.clock, moving, sigma)
        results = [other.update(replace(scan, imu=(), odometry=())) for scan in scans]
        if results[-1] is None or results[-1].health.is_lost or results[-1].health.inliers < c.inliers_least:
            return False
        if other._time < self._time:
            other.state, other._time = other._propagate(other._samples(self._time)), self._time
        begun = replace(start, state=levelled(other.state))
        self._begin_at(other._time, begun, c.start.rehearsed_sigma)
        return True

    def _speed_alone(self, scans: list[CloudScan]) -> tuple[F64, float]:
        """Return how fast the LiDAR alone says that it is after some scans (m/s, in the IMU's axes then, float64 (3,)), and how sure that is. Each scan counts as of
        one instant: those of a steady motion are bent alike, and fit each other, while to straighten them its speed must be known."""
        c = self.config
        alone = LidarInertialOdometry(replace(c, has_imu=False, estimates_mount=False, estimates_clock=False))
        alone.state.imu_from_lidar = self.state.imu_from_lidar
        results = [alone.update(CloudScan(at_one_instant(scan.cloud), (), ())) for scan in scans]
        last = results[-1] if results else None
        if last is None or last.health.is_degenerate or last.health.inlier_ratio < CLEAR:
            return np.zeros(3), math.inf
        return alone.state.rotation.T @ alone.state.velocity, c.start.speed_alone_sigma

    def _is_carried(self) -> bool:
        """Say whether who feels nothing moves all the same: a steady motion is no rest, and only scans tell the one from the other."""
        velocity, _ = self._speed_alone([scan for scan in self._before_start if len(scan.cloud.points)])
        return float(np.linalg.norm(velocity)) > self.config.start.rest_speed_most

    def _is_astray(self, beginning: float) -> bool:
        """Say whether nobody knows where it is when a scan begins: nothing was measured for too long before it, or since then its place was not found."""
        if not self.config.has_imu:
            return False
        length = self._imu.longest_hole(self._heard, beginning)
        if length > self.config.hole.bridged:
            if not self.holes or self.holes[-1].is_regained:
                self.holes.append(Hole(self._time, beginning))
            self.holes[-1].end = beginning  # later, if nothing was measured again before it was found
            self._before_start.clear()
            self._follower = self._search = None
        return bool(self.holes) and not self.holes[-1].is_regained

    def _look_for_place(self, scan: CloudScan) -> None:
        """Follow the scans since the hole with a filter of its own, and go on where what it sees is in the map, once that is clear."""
        hole = self.holes[-1]
        hole.scans += 1
        if self._follower is None:
            self._before_start.append(scan)
            if len(self._before_start) == self._before_start.maxlen:
                self._follower = self._following()
            self._imu.forget(self._imu.last - BEFORE_START)
            return
        result = self._follower.update(scan)
        self._imu.forget(self._imu.last - BEFORE_START)
        if result is None:
            return
        if result.health.is_lost:  # what it lays together is none
            self._follower = self._search = None
            self._before_start.clear()
            return
        if self._search is None:
            about = self._whereabouts(self._follower.state, self._follower._time)
            self._search = PlaceSearch(self.map.points(), about, self.config)
        map_from_its = self._search.update(result)
        hole.text = self._search.state.value
        if map_from_its is not None:
            self._go_on(self._follower, map_from_its)
            hole.is_regained, self._follower, self._search = True, None, None
            self._before_start.clear()

    def _following(self) -> LidarInertialOdometry | None:
        """Return a filter that has learned from the last scans how fast it moves and what is up; None: they do not tell."""
        assert self.start is not None
        first = self._imu.seconds(self._before_start[0].cloud.stamp_ns) + self.state.clock
        rows = self._imu.rows()
        forces = rows[rows[:, 0] >= first, 4:7] - self.state.accel_bias
        if len(forces) < self.config.start.samples_least:
            return None
        state = replace(self.state.copy(), position=np.zeros(3), velocity=np.zeros(3))
        state.rotation, state.gravity = level_rotation(forces.mean(axis=0)), FilterState().gravity
        config = replace(self.config, estimates_mount=False, estimates_clock=False)
        other = LidarInertialOdometry(config, None, None, self._air)
        other.state, other._imu, other._before_start = state.copy(), self._imu.copy(), self._before_start.copy()
        other.start = replace(self.start, state=state, is_rest=False)
        return other if other._rehearse(other.start) else None

    def _whereabouts(self, since: FilterState, time: float) -> Whereabouts:
        """Return where it may be at a time after the hole, by what was measured since then and how it moves now."""
        hole = self.holes[-1]
        rows = self._imu.rows()
        rows = rows[(rows[:, 0] > hole.end) & (rows[:, 0] <= time)]
        up = rows[:, 4:7].mean(axis=0)
        rates = (rows[:, 1:4] - self.state.gyro_bias) @ (up / np.linalg.norm(up))
        rate = float((self.state.rotation @ self._rate)[2])
        turned = float(rates.mean()) * (time - hole.end)
        return whereabouts(self.state, rate, hole.end - hole.begin, since, time - hole.end, turned, self.config)

    def _go_on(self, other: LidarInertialOdometry, map_from_its: SE3) -> None:
        """Go on in the own map from where another filter is, by where its map lies in the own one."""
        c, turn = self.config, map_from_its.matrix()[:3, :3]
        self.state = self.state.copy()
        self.state.position = np.array(map_from_its.transform(other.state.position[None])[0])
        self.state.rotation = _orthonormal(turn @ other.state.rotation)
        self.state.velocity = turn @ other.state.velocity
        sigmas = np.repeat([c.hole.place_sigma, c.hole.turn_sigma, c.start.rehearsed_sigma], 3)
        known = slice(0, k.GYRO_BIAS)
        self.covariance = self.covariance.copy()
        self.covariance[known, :] = self.covariance[:, known] = 0.0
        self.covariance[known, known] = np.diag(sigmas**2)
        self._time, self._imu = other._time, other._imu
        self._is_adrift, self._is_unmoved, self._stands = True, False, False

    def _check_clocks(self, scan: CloudScan) -> None:
        """Refuse clouds that no inertial measurement was taken near."""
        times = self._imu.rows()[[0, -1], 0]
        begin, end = (self._imu.seconds(at) + self.state.clock for at in (scan.cloud.stamp_ns, scan.end_ns))
        if end < times[0] - CLOCKS_APART or begin > times[1] + CLOCKS_APART:
            raise LioInputError(
                f"a cloud lies {max(times[0] - end, begin - times[1]):.1f} s beside all inertial measurements: the clocks differ"
            )

    def _begin_alone(self, scan: CloudScan) -> bool:
        """Without an IMU the map begins as the LiDAR stands."""
        self.start = Start(self.state, 1.0, np.zeros(3), np.zeros(3), False, "began without inertial measurements")
        sigmas = np.full(k.EXTRA + self.config.extras, 1e-6)
        sigmas[k.VELOCITY : k.GYRO_BIAS] = self.config.alone.speed_sigma
        self.covariance = np.diag(sigmas**2)
        self._time = self._imu.seconds(scan.cloud.stamp_ns) - 1e-3
        self._origin = self.state.copy()
        return True

    def _propagate(self, samples: F64) -> FilterState:
        """Predict the state at the end of the scan; the way there is kept for motion compensation."""
        prior = self.state.copy()
        if len(self._knots) != len(samples):
            self._knots = np.zeros((len(samples), k.KNOT))
        # Between samples far apart the motion is unknown: the noise grows with the square of the gap.
        self._gap = self._imu.longest_gap(samples[0, 0], samples[-1, 0]) if self.config.has_imu else 0.0
        factor = max(1.0, self._gap / self.config.imu.gap_most) ** 2
        k.propagate(
            *(samples, prior.position, prior.rotation, prior.velocity, prior.gyro_bias, prior.accel_bias),
            *(prior.gravity, self.covariance, self._densities * factor, self._knots),
        )
        return prior

    def _thin_out(self, cloud: PointCloud, prior: FilterState) -> tuple[NDArray[np.float32], F64, F64]:
        """Return one point per cell (M, 3), their ranges and times, without what floats in the air; the cell adapts to the number that is wanted."""
        c = self.config.scan
        squares = np.einsum("ij,ij->i", cloud.points, cloud.points)
        inside = (squares > c.range_min**2) & (squares < c.range_max**2) & np.isfinite(cloud.time)
        numbers = np.flatnonzero(inside)[:: c.decimation]
        size = 1 << max(4, (2 * len(numbers)).bit_length())
        if len(self._scratch) < size:
            self._scratch = np.empty(size, np.int64)
        chosen = np.empty(len(numbers), np.int64)
        points = np.ascontiguousarray(cloud.points[numbers])
        count = voxel_kernels.thin_out(points, self._voxel, self._scratch[:size], chosen)
        numbers = self._without_air(cloud, numbers[chosen[:count]], prior)
        if len(numbers):
            self._voxel = float(
                np.clip(self._voxel * np.sqrt(len(numbers) / c.points_wanted), c.voxel_min, c.voxel_max)
            )
        return cloud.points[numbers], np.sqrt(squares[numbers].astype(np.float64)), self._times(cloud, numbers)

    def _without_air(self, cloud: PointCloud, numbers: NDArray[np.int64], prior: FilterState) -> NDArray[np.int64]:
        """Return those of the chosen points that do not float in the air; where they were before is known by the prediction."""
        if self._air is None:
            return numbers

        def place(wanted: NDArray[np.int64]) -> F64:
            points_imu = self._compensate(cloud.points[wanted], self._times(cloud, wanted))
            out = np.empty_like(points_imu)
            k.place_points(points_imu, prior.rotation, prior.position, out)
            return out

        kept = numbers[self._air.keep(cloud, numbers, place)]
        self._false_ratio = 1.0 - len(kept) / max(len(numbers), 1)
        return kept

    def _times(self, cloud: PointCloud, numbers: NDArray[np.int64]) -> F64:
        return self._imu.seconds(cloud.stamp_ns) + cloud.time[numbers].astype(np.float64) + self.state.clock

    def _compensate(self, points: NDArray[np.float32], times: F64) -> F64:
        """Return points in the IMU's frame at the end of the scan, each moved by what was between."""
        out = np.empty((len(points), 3))
        k.compensate(np.ascontiguousarray(points), times, self._knots, self.state.imu_from_lidar, out)
        return out

    def _update_from(
        self, prior: FilterState, points_imu: F64, ranges: F64, seconds: float
    ) -> tuple[FilterState, Degeneracy, F64, int]:
        """Iterate the update. A LiDAR alone of which clearly fewer points than usual lie on planes begins it at turned places around the last one and the predicted
        one, too, as far as one turns in so many `seconds`, and takes the state at which most do."""
        before, count = self.covariance, max(len(points_imu), 1)
        found = self._update_iterated(prior, points_imu, ranges)
        if not self.config.has_imu and self._inserts > 1 and found[2][0] < POOR * self._usual * count:
            best = found, self.covariance
            for begin in turned_states(self.state, prior, seconds):
                self.covariance = before
                other = self._update_iterated(prior, points_imu, ranges, begin)
                if other[2][0] > best[0][2][0]:
                    best = other, self.covariance
            found, self.covariance = best
        share = float(found[2][0]) / count
        self._usual += (USUAL if self._usual > 0.0 else 1.0) * (share - self._usual)
        return found

    def _update_iterated(
        self, prior: FilterState, points_imu: F64, ranges: F64, begin: FilterState | None = None
    ) -> tuple[FilterState, Degeneracy, F64, int]:
        """Iterate the update, from `begin` on or else from the prior; returns the state, its weak directions, the moments of the residuals and how often it went round.

        The covariance that the gain needs is that of the prior, carried to the tangent space of the iterate.
        """
        c, state = self.config, begin or prior
        width, noise = 6 + c.extras, (c.noise * self._noise_factor()) ** 2
        part = np.r_[0:6, k.EXTRA : k.EXTRA + c.extras]
        information, gradient, moments = np.empty((width, width)), np.empty(width), np.empty(4)
        queries = np.empty_like(points_imu)
        weak, searches, iteration, covariance = None, True, 0, self.covariance
        most = c.iterations_most if c.has_imu else c.alone.iterations_most
        for iteration in range(1, most + 1):
            if searches:
                k.place_points(points_imu, state.rotation, state.position, queries)
                planes, is_plane = self.map.fit_planes(queries)
            motion = np.concatenate([state.velocity, self._knots[-1, k.W : k.W + 3]])
            k.sum_residuals(
                *(points_imu, planes, is_plane, ranges, state.rotation, state.position, state.imu_from_lidar),
                *(motion, width, c.outlier_scale, information, gradient, moments),
            )
            if moments[0] < c.inliers_least:
                break
            if weak is None:
                weak = find_degeneracy(information, float(moments[1]), c.degeneracy)
            h, g = weak.frozen(information / noise, gradient / noise)
            moved = state.minus(prior, len(self.covariance))
            covariance = _carried(self.covariance, moved)
            cross, inner = covariance[:, part], covariance[np.ix_(part, part)]
            gain = h @ np.linalg.inv(np.eye(width) + inner @ h)
            gain = 0.5 * (gain + gain.T)
            delta = cross @ (gain @ (inner @ g + moved[part]) - g) - moved
            state = state.plus(delta)
            covariance = covariance - cross @ gain @ cross.T
            is_converged = bool(np.abs(delta[:3]).max() < c.converged_m and np.abs(delta[3:6]).max() < c.converged_rad)
            if is_converged:
                break
            # Planes are looked for again where the first step was large, and once more at the end of a long way.
            searches = not c.has_imu or float(np.abs(delta[:3]).max()) > 0.02 or iteration == most - 2
        if weak is None:
            return prior, Degeneracy.none(), moments, iteration
        if c.extras:
            state, covariance = self._learned_slowly(prior, state, covariance)
        self.covariance = 0.5 * (covariance + covariance.T)
        state.rotation = _orthonormal(state.rotation)
        return state, weak, moments, iteration

    def _is_contradicted(self, health: Health, seconds: float) -> bool:
        """Say whether the scan, which came `seconds` after the one before, fits badly and elsewhere than the IMU led."""
        c = self.config
        speed = health.innovation_m / max(seconds, SCAN_LEAST)
        return c.has_imu and speed > c.contradiction_speed and health.inlier_ratio < c.contradiction_ratio

    def _standstill(self, state: FilterState, samples: F64) -> Measurement | None:
        assert self.start is not None
        c = self.config
        return standstill(state, samples, self.start, c.rest) if c.rest.is_used and c.has_imu else None

    def _is_at_origin(self, state: FilterState) -> bool:
        """Say whether a state that a scan found is where the map began, as near as planes through the rings of one place can tell."""
        o, c = self._origin, self.config.rest
        way, turn = np.linalg.norm(state.position - o.position), np.linalg.norm(log(o.rotation.T @ state.rotation))
        return bool(way < c.way_most and turn < c.turn_most)

    def _noise_factor(self) -> float:
        """Return how many times noisier than later a return counts: what planes through the rings of one place say as it leaves it, the gyroscope knows better.

        While it stands there, every scan is the same, and holds it.
        """
        is_leaving = self.start is not None and self.start.is_rest and not self._stands
        return 1.0 + (self.config.drift.begin_noise * self._drift.begin_left if is_leaving else 0.0)

    def _learned_slowly(self, prior: FilterState, state: FilterState, covariance: F64) -> tuple[FilterState, F64]:
        """Return an update of which mount and clock took a share only (Brink 2017, the partial-update Schmidt-Kalman filter).

        What scans are off by comes back with every stride. It averages out in the pose; what is learned over a thousand scans it would pull along.
        """
        share, n = self.config.learned_share, len(covariance)
        moved = state.minus(prior, n)
        moved[k.EXTRA :] *= share
        gained = _carried(self.covariance, moved) - covariance
        covariance = covariance.copy()
        covariance[k.EXTRA :, k.EXTRA :] += (1.0 - share) ** 2 * gained[k.EXTRA :, k.EXTRA :]
        return prior.plus(moved), covariance

    def _update_other(self, health: Health, samples: F64, scan: CloudScan) -> Health:
        """Use what else is known: stillness, the wheels, the level ground."""
        c = self.config
        rest = self._standstill(self.state, samples)
        self._stands = rest is not None
        if rest is not None:
            self._measure(rest)
        if self._imu_from_base is not None:
            told = [message for message in scan.odometry if all(map(math.isfinite, message.linear))]
            for message in told[-1:]:
                rate = self._knots[-1, k.W : k.W + 3]
                velocity = wheel_velocity(self.state, rate, message, self._imu_from_base, c.wheels)
                self._measure(velocity, doubted_from=c.wheels.slip)
        if c.planar.is_used:
            self._measure(height_and_tilt(self.state, self._origin, c.planar))
        limits = c.imu
        is_biased = bool(
            np.abs(self.state.gyro_bias).max() > limits.gyro_bias_most
            or np.abs(self.state.accel_bias).max() > limits.accel_bias_most
        )
        self.state.gyro_bias = np.clip(self.state.gyro_bias, -limits.gyro_bias_most, limits.gyro_bias_most)
        self.state.accel_bias = np.clip(self.state.accel_bias, -limits.accel_bias_most, limits.accel_bias_most)
        return replace(health, is_at_rest=rest is not None, is_biased=is_biased)

    def _measure(self, measured: Measurement, doubted_from: float = math.inf) -> None:
        """Update with a linear measurement of few rows; one that is off by more than `doubted_from` standard deviations has its variances raised by how many times more, squared."""
        n = len(self.covariance)
        h = np.zeros((len(measured.residual), n))
        h[:, : k.EXTRA] = measured.jacobian
        cross = self.covariance @ h.T
        expected, noise = h @ cross, np.diag(measured.variances)
        off = float(measured.residual @ np.linalg.solve(expected + noise, measured.residual))
        gain = cross @ np.linalg.inv(expected + noise * max(1.0, off / doubted_from**2))
        self.state = self.state.plus(gain @ measured.residual)
        covariance = self.covariance - gain @ cross.T
        self.covariance = 0.5 * (covariance + covariance.T)

    def _insert(self, points_imu: F64) -> None:
        """Add the scan to the map when it was taken from elsewhere than the one before."""
        c, last = self.config, self._inserted_at
        if last is not None and self._inserts >= START_INSERTS:
            step = float(np.linalg.norm(self.state.position - last.position))
            turn = float(np.linalg.norm(log(last.rotation.T @ self.state.rotation)))
            if step < c.insert_m and turn < c.insert_rad:
                return
        self._inserted_at = self.state.copy()
        self._inserts += 1
        self.map.keep_near(self.state.position)
        self.map.insert(self._place(points_imu))

    def _place(self, points_imu: F64) -> F64:
        out = np.empty_like(points_imu)
        k.place_points(points_imu, self.state.rotation, self.state.position, out)
        return out

    def _health(
        self,
        prior: FilterState,
        state: FilterState,
        weak: Degeneracy,
        sums: F64,
        points: int,
        iterations: int,
    ) -> Health:
        inliers = int(sums[0])
        moved = state.minus(prior)
        return Health(
            points=points,
            inliers=inliers,
            residual_m=float(np.sqrt(sums[3] / sums[1])) if sums[1] > 0.0 else None,
            innovation_m=float(np.linalg.norm(moved[:3])),
            innovation_rad=float(np.linalg.norm(moved[3:6])),
            weakest=weak.weakest,
            frozen_translation=weak.translation,
            frozen_rotation=weak.rotation,
            iterations=iterations,
            imu_gap=self._gap,
            is_lost=inliers < self.config.inliers_least and self._inserts >= START_INSERTS,
            false_ratio=self._false_ratio,
        )


def _carried(covariance: F64, moved: F64) -> F64:
    """Return a covariance (N, N) about the prior in the tangent space `moved` (N,) away from it: J P J^T, J the right Jacobian of the rotation."""
    out = covariance.copy()
    jacobian = right_jacobian(moved[k.ROTATION : k.VELOCITY])
    rows = slice(k.ROTATION, k.VELOCITY)
    out[rows] = jacobian @ out[rows]
    out[:, rows] = out[:, rows] @ jacobian.T
    return out


def _remounted(points_imu: F64, before: FilterState, after: FilterState) -> F64:
    """Return points (M, 3) in the IMU's frame that the LiDAR's mount before an update put there, where the mount after it puts them."""
    a, b = before.imu_from_lidar, after.imu_from_lidar
    turn = b[:, :3] @ a[:, :3].T
    return np.asarray(points_imu @ turn.T + (b[:, 3] - turn @ a[:, 3]))


def _orthonormal(rotation: F64) -> F64:
    """Return the nearest rotation (one step of Newton's method, enough for what rounding does to a scan)."""
    return np.ascontiguousarray(rotation @ (1.5 * np.eye(3) - 0.5 * rotation.T @ rotation))
