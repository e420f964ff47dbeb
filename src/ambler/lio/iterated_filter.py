"""The filter of LiDAR-inertial odometry: per scan one propagation, one iterated Kalman update with point-to-plane residuals, and one insertion into the map.

After FAST-LIO2 (Xu, Cai, He, Lin and Zhang 2022), sections IV and V, with a voxel hash in the place of its tree. Where this differs: the map
is levelled, the error state's position comes first, weak directions are left alone, and the map does not grow at rest.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import PointCloud
from ambler.core.protocols import CloudFilter
from ambler.core.se3 import SE3
from ambler.kernels import inertial as k
from ambler.kernels import voxel_map as voxel_kernels
from ambler.lio.alone import moved_states, turned_states
from ambler.lio.beginning import since_start_jacobian, start_from_map
from ambler.lio.config import LioConfig
from ambler.lio.degeneracy import Degeneracy, find_degeneracy
from ambler.lio.drift import Drift
from ambler.lio.health import Health, LioResult
from ambler.lio.inertial_buffer import InertialBuffer
from ambler.lio.measurements import Measurement, height_and_tilt, skew, standstill, wheel_velocity
from ambler.lio.start import Start
from ambler.lio.state import FilterState, gravity_basis, log, orthonormal, right_jacobian
from ambler.lio.voxel_map import VoxelMap
from ambler.recordings.cloud_scan import CloudScan

F64 = NDArray[np.float64]
SCAN_LEAST = 0.05  # s; what parts of a turn differ by is their noise
CLEAR = 0.5  # of the points on planes: as many say that a LiDAR alone follows its motion
POOR = 0.8  # of the usual share of points on planes: below, a LiDAR alone looks for its place more widely
USUAL = 0.1  # what a scan says of that share
STRAIGHTENED = 2  # times that a scan in a gap of the IMU is straightened by what it was found to have moved
FIRST_TRIES = 3  # times that the first scan is thinned out anew: in a stairwell few of the usual cells hold points, and a map of so few leans
START_INSERTS = 10  # scans that build the first map even at rest: the rings of a single one are too far apart


class IteratedFilter:
    """What `LidarInertialOdometry` knows once it has begun: `step` takes one scan after the other.

    `state` and `covariance` (17 + extras, 17 + extras) are those at the last point of the last scan, `map` is what was seen; `start` is what the beginning gave, None before it.
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
        self._time = 0.0
        self._voxel = self.config.scan.voxel
        self._knots = np.zeros((2, k.KNOT))
        self._scratch = np.empty(0, np.int64)
        self._inserted_at: FilterState | None = None
        self._inserts = 0
        self._usual = 0.0
        self._stands = False
        self._is_unmoved = True
        self._began_still = False
        # After a time without scans until one fits: elsewhere than thought, a map would begin anew.
        self._is_adrift = False
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

    def step(self, scan: CloudScan, end: float, came_from: F64) -> LioResult:
        """Take a scan that ends at `end` (s of the filter's clock), after the present state; `came_from` (3,) is where the scan before was taken. Returns the pose at its last point."""
        c = self.config
        samples = self._samples(end)
        before = self.covariance.copy()
        prior = self._propagate(samples)  # eqs. (5)-(8)
        self._is_unmoved = self._is_unmoved and self._standstill(prior, samples) is not None
        if self._is_unmoved:  # as far as the IMU notices
            self.covariance[:6, :6] += np.diag(np.repeat(np.square([c.rest.way_most, c.rest.turn_most]), 3))
        points, ranges, times = self._thin_out(scan.cloud, prior)
        points_imu = self._compensate(points, times)  # eq. (9)
        predicted = self.covariance
        found = self._update_from(prior, points_imu, ranges, end - self._time)  # eqs. (12)-(18)
        for _ in range(STRAIGHTENED if self._is_in_gap else 0):
            self._move_steadily_to(found[0], end)
            points_imu, self.covariance = self._compensate(points, times), predicted
            found = self._update_from(prior, points_imu, ranges, end - self._time)
        state, weak, sums, iterations = found
        self._is_unmoved = self._is_unmoved and self._is_at_origin(state)
        if self._is_unmoved:  # its scans only build the map: they are of one place, and lean alike
            state, self.covariance = self.state.copy(), before
        health = self._health(prior, state, weak, sums, len(points), iterations)
        self._rate = log(self.state.rotation.T @ state.rotation) / (end - self._time)
        self._drift.move(state.position - came_from, weak.translation)
        is_speed_told = self._stands or self._is_unmoved or (self._imu_from_base is not None and bool(scan.odometry))
        self._drift.coast(end - self._time, weak.translation[: 0 if is_speed_told else 3])
        self._drift.leave(float(np.linalg.norm(state.position - self._origin.position)))
        points_imu = _remounted(points_imu, self.state, state) if self.config.extras else points_imu
        is_faint = not is_speed_told and not len(weak.translation) and weak.weakest < c.degeneracy.share_faint
        health = replace(
            health,
            is_contradicted=self._is_contradicted(health, end - self._time),
            is_faint=is_faint and health.inliers >= c.inliers_least,
        )
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
            self.state.mount,
            begin,
        )

    def _told_covariance(self, begin: SE3) -> F64:
        """Return the covariance (6, 6) of the pose since the start: what the filter knows of it, and what the map has drifted."""
        jacobian = since_start_jacobian(self._origin, self.state, begin, len(self.covariance))
        rotation = begin.matrix()[:3, :3] @ self.state.rotation
        return np.asarray(jacobian @ self.covariance @ jacobian.T) + self._drift.covariance(rotation)

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

    @property
    def _is_alone(self) -> bool:
        """Whether no IMU tells how the LiDAR moves: there is none, or its samples lie too far apart just now."""
        return not self.config.has_imu or self._is_in_gap

    @property
    def _is_in_gap(self) -> bool:
        return self._gap > self.config.hole.bridged

    def _samples(self, end: float) -> F64:
        """Return the inertial samples until `end`, interpolated where they lie apart; without an IMU those of a motion that goes on as it was."""
        if self.config.has_imu:
            self._gap = self._imu.longest_gap(self._time, end)
            return self._imu.between(self._time, end)
        force = -self.state.rotation.T @ self.state.gravity
        rows = np.tile(np.concatenate([[0.0], self._rate, force]), (2, 1))
        rows[:, 0] = self._time, end
        return rows

    def _propagate(self, samples: F64) -> FilterState:
        """Predict the state at the end of the `_samples`; the way there is kept for motion compensation."""
        prior = self.state.copy()
        if len(self._knots) != len(samples):
            self._knots = np.zeros((len(samples), k.KNOT))
        k.propagate(
            *(samples, prior.position, prior.rotation, prior.velocity, prior.gyro_bias, prior.accel_bias),
            *(prior.gravity, self.covariance, self._noise_between(), self._knots),
        )
        return prior

    def _move_steadily_to(self, state: FilterState, end: float) -> None:
        """Let the way of the scan lead from the present state to the one that it was found at, at one speed and one rate: what lies between samples far apart bends the scan more than that."""
        seconds, here = end - self._time, self.state.copy()
        here.velocity = (state.position - here.position) / seconds
        rate, force = log(here.rotation.T @ state.rotation) / seconds, -here.rotation.T @ here.gravity
        rows = np.tile(np.concatenate([[0.0], rate + here.gyro_bias, force + here.accel_bias]), (2, 1))
        rows[:, 0] = self._time, end
        self._knots = np.zeros((2, k.KNOT))
        k.propagate(
            *(rows, here.position, here.rotation, here.velocity, here.gyro_bias, here.accel_bias),
            *(here.gravity, self.covariance.copy(), self._densities, self._knots),
        )

    def _noise_between(self) -> F64:
        """Return the squared noise densities (4,) of the samples: the farther apart they are, the less is known of the motion between, in the end as little as of a LiDAR alone."""
        c, densities = self.config, self._densities.copy()
        if self._gap > c.imu.gap_most:
            share = min(1.0, (self._gap - c.imu.gap_most) / max(c.hole.bridged - c.imu.gap_most, 1e-9)) ** 2
            alone = share * np.array([c.alone.rate_density, c.alone.acceleration_density])
            densities[:2] = np.maximum(densities[:2] * (self._gap / c.imu.gap_most) ** 2, alone**2)
        return densities

    def _thin_out(self, cloud: PointCloud, prior: FilterState) -> tuple[NDArray[np.float32], F64, F64]:
        """Return one point per cell (M, 3), their ranges and times, without what floats in the air; the cell adapts to the number that is wanted."""
        c = self.config.scan
        points, inside = np.ascontiguousarray(cloud.points), np.empty(len(cloud.points), np.int64)
        count = voxel_kernels.choose_between(
            *(points, np.ascontiguousarray(cloud.time), c.range_min, c.range_max, c.decimation, inside)
        )
        chosen = self._one_per_cell(points, inside[:count])
        tries = FIRST_TRIES if self._inserts == 0 else 0  # nothing has told yet how narrow the place is
        while tries and 2 * len(chosen) < c.points_wanted:
            self._adapt_voxel(len(chosen))
            chosen, tries = self._one_per_cell(points, inside[:count]), tries - 1
        numbers = self._without_air(cloud, chosen, prior)
        self._adapt_voxel(len(numbers))
        kept = cloud.points[numbers]
        return kept, np.linalg.norm(kept.astype(np.float64), axis=1), self._times(cloud, numbers)

    def _one_per_cell(self, points: NDArray[np.float32], numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return those of `numbers` whose points (N, 3) are the first in their cells."""
        size = 1 << max(4, (2 * len(numbers)).bit_length())
        if len(self._scratch) < size:
            self._scratch = np.empty(size, np.int64)
        chosen = np.empty_like(numbers)
        return chosen[: voxel_kernels.thin_out(points, numbers, self._voxel, self._scratch[:size], chosen)]

    def _adapt_voxel(self, count: int) -> None:
        """Choose the edge of the next cells so that as many points remain as are wanted, where `count` did with the last."""
        c = self.config.scan
        if count:
            self._voxel = float(np.clip(self._voxel * np.sqrt(count / c.points_wanted), c.voxel_min, c.voxel_max))

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
        # Of a LiDAR alone nothing has told yet how fast it is, nor how many points fit.
        is_second = self._inserts == 1 and not self.config.has_imu
        if self._is_alone and found[2][0] < (CLEAR if is_second else POOR * self._usual) * count:
            best = found, self.covariance
            begins = moved_states(prior, seconds) if is_second else turned_states(self.state, prior, seconds)
            for begin in begins:
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
        most = c.alone.iterations_most if self._is_alone else c.iterations_most
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
            searches = self._is_alone or float(np.abs(delta[:3]).max()) > 0.02 or iteration == most - 2
        if weak is None:
            return prior, Degeneracy.none(), moments, iteration
        if c.extras:
            state, covariance = self._learned_slowly(prior, state, covariance)
        self.covariance = 0.5 * (covariance + covariance.T)
        state.rotation = orthonormal(state.rotation)
        return state, weak, moments, iteration

    def _is_contradicted(self, health: Health, seconds: float) -> bool:
        """Say whether the scan, which came `seconds` after the one before, fits badly and elsewhere than the IMU led."""
        c = self.config
        speed = health.innovation_m / max(seconds, SCAN_LEAST)
        return not self._is_alone and speed > c.contradiction_speed and health.inlier_ratio < c.contradiction_ratio

    def _standstill(self, state: FilterState, samples: F64) -> Measurement | None:
        assert self.start is not None
        c = self.config
        return standstill(state, samples, self.start, c.rest) if c.rest.is_used and c.has_imu else None

    def _is_at_origin(self, state: FilterState) -> bool:
        """Say whether a state that a scan found is where the map began, as near as planes through the rings of one place can tell."""
        o, c = self._origin, self.config.rest
        factor = c.begin_factor if self._inserts < START_INSERTS else 1.0
        way, turn = np.linalg.norm(state.position - o.position), np.linalg.norm(log(o.rotation.T @ state.rotation))
        return bool(way < factor * c.way_most and turn < factor * c.turn_most)

    def _noise_factor(self) -> float:
        """Return how many times noisier than later a return counts: what planes through the rings of one place say as it leaves it, the gyroscope knows better.

        While it stands there, every scan is the same, and holds it.
        """
        is_leaving = self._began_still and not self._stands
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
            ground = height_and_tilt(self.state, self._origin, c.planar)
            if ground is not None:
                self._measure(ground)
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
