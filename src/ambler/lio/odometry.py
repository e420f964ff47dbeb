"""LiDAR-inertial odometry: where the filter begins, what it does in times without scans, and after times without anything.

The filter itself is in `lio.iterated_filter`. Who begins in motion learns how fast by following his first scans with a filter that is given away; after a hole in all
measurements the place is looked for in the own map (`lio.hole`).
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
from ambler.lio.alone import at_one_instant
from ambler.lio.beginning import begun_covariance, levelled
from ambler.lio.config import DegeneracyConfig, LioConfig
from ambler.lio.degeneracy import is_along, often_frozen
from ambler.lio.health import LioResult
from ambler.lio.hole import Hole, PlaceSearch, Whereabouts, whereabouts
from ambler.lio.iterated_filter import CLEAR, IteratedFilter
from ambler.lio.start import LioInputError, Start, find_start, in_motion, level_rotation
from ambler.lio.state import FilterState, orthonormal
from ambler.lio.voxel_map import VoxelMap
from ambler.recordings.cloud_scan import HELD_MB, CloudScan

F64 = NDArray[np.float64]
CLOCKS_APART = 0.5  # s between a cloud and the nearest inertial measurement from which on they are of two clocks
OUTAGE = 0.5  # s without scans from which on the state is walked on in steps of `STEP` s, short enough to notice that it stands
STEP = 0.1
CLEAR_OF_TWO = 0.2  # of the points on planes: single scans have gaps between their rings
CONFIRMED = (
    0.1  # of a speed that the LiDAR alone may tell it otherwise: it compares scans that were taken at one instant
)
BEFORE_START = 10.0  # s of inertial measurements that are kept while no cloud has come


class LidarInertialOdometry(IteratedFilter):
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
        super().__init__(config, imu_from_lidar, imu_from_base, air)
        self.left_out = 0
        """How many messages were left out before they came here, for their stamps."""
        self._before_start: deque[CloudScan] = deque(maxlen=self.config.start.rehearsed)
        self.holes: list[Hole] = []
        """What nothing was measured in, and whether the place was found again after it."""
        self.unknown_speed = np.zeros((0, 3))
        """Unit vectors in the map, float64 (K, 3), along which nobody knows how fast it began, nor has learned it since."""
        self._telling: list[tuple[CloudScan, LioResult]] = []
        self._heard = 0.0
        self._follower: LidarInertialOdometry | None = None
        self._search: PlaceSearch | None = None

    def update(self, scan: CloudScan) -> LioResult | None:
        """Take a scan; returns the pose at its last point, or None while the filter waits for its start or the scan says nothing.

        Raises LioInputError when the measurements cannot be what they are said to be.
        """
        self._take(scan)
        end = self._imu.seconds(scan.end_ns) + self.state.clock
        is_empty = len(scan.cloud.points) == 0
        if self.start is None and is_empty:
            self._imu.forget(self._imu.last - BEFORE_START)
            return None
        if self.start is None and not self._begin(scan):
            return None
        beginning = end if is_empty else self._beginning(scan.cloud)
        if self._has_gone_astray(beginning):
            self._look_for_place(scan)
            self._heard = max(self._heard, end)
            return None
        if not self.config.has_imu and self._before_start and self._inserts and not is_empty:
            self._straighten(self._before_start.pop(), scan)
        came_from = self.state.position
        self._walk_on(beginning)
        self._heard = max(self._heard, end, self._time)
        if end <= self._time or is_empty:
            return None
        result = self.step(scan, end, came_from)
        self._learn_speed(scan, result)
        return result

    @property
    def is_astray(self) -> bool:
        """Whether a hole in all measurements has been met and its place not found again since."""
        return bool(self.holes) and not self.holes[-1].is_regained

    @property
    def refused_text(self) -> str:
        """How much was left out, in words; empty for nothing."""
        text = ""
        if self.left_out:
            text += f", {self.left_out} messages have stamps that are out of order"
        if self._imu.refused:
            text += f", {self._imu.refused} inertial measurements were refused (not finite, or not in order)"
        return text

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

    def _begin(self, scan: CloudScan) -> bool:
        """Look for the start; at rest it makes the first map of the scan in which it was found."""
        if not self.config.has_imu:
            return self._begin_alone(scan)
        if len(scan.imu) == 0 and len(self._imu) == 0:
            if scan.is_overdue:
                raise LioInputError(
                    f"no inertial measurements came with the first {HELD_MB:.0f} MB of clouds: they begin later, or lie too far behind the clouds in the file (sort it by its stamps)"
                )
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
        """Begin with what the start says of the IMU; who is in motion knows his velocity to `speed_sigma` m/s."""
        begun = replace(start.state, imu_from_lidar=self.state.imu_from_lidar, clock=self.state.clock)
        speed_sigma = min(speed_sigma, self.config.start.speed_sigma)
        self.state, self._origin, self._time, self._heard = begun, begun.copy(), time, time
        self.covariance = begun_covariance(begun, self.config, start.is_rest, speed_sigma)
        self._began_still = start.is_rest

    def _rehearse(self, start: Start) -> bool:
        """Learn the velocity, and what is up, by following the scans before the start with a filter that is given away: who begins in motion and takes himself to stand
        bends the first scan, in which all others find their place, and may find none. Returns whether it was learned."""
        scans = [scan for scan in self._before_start if len(scan.cloud.points)]
        if not scans:
            return False
        c = self.config
        config = replace(c, estimates_mount=False, estimates_clock=False, iterations_most=c.alone.iterations_most)
        config = replace(config, degeneracy=self._speed_told)
        other = LidarInertialOdometry(config)
        other.state = self.state.copy()
        other._imu, other.start = self._imu.copy(), start
        velocity, sigma = self._speed_alone(scans, degeneracy=self._speed_told)
        moving = replace(start, state=replace(start.state, velocity=start.state.rotation @ velocity))
        other._begin_at(self._imu.seconds(scans[0].cloud.stamp_ns) + self.state.clock, moving, sigma)
        results = [other.update(replace(scan, imu=(), odometry=())) for scan in scans]
        if results[-1] is None or results[-1].health.is_lost or results[-1].health.inliers < c.inliers_least:
            return False
        if other._time < self._time:
            other.state, other._time = other._propagate(other._samples(self._time)), self._time
        begun = replace(start, state=levelled(other.state))
        self._begin_at(other._time, begun, c.start.rehearsed_sigma)
        frozen = often_frozen([result for result in results if result is not None])
        frozen = frozen @ other.state.rotation @ begun.state.rotation.T
        known = slice(k.VELOCITY, k.GYRO_BIAS)
        wide = min(sigma, c.start.speed_sigma) ** 2 - c.start.rehearsed_sigma**2
        self.covariance[known, known] += max(wide, 0.0) * frozen.T @ frozen
        self.unknown_speed = frozen if math.isinf(sigma) else frozen[:0]
        speed = float(np.linalg.norm(begun.state.velocity))
        self._began_still = len(frozen) == 0 and speed < c.start.rest_speed_most
        return True

    def _learn_speed(self, scan: CloudScan, result: LioResult) -> None:
        """Note whether a speed that was unknown at the start has been learned: wheels tell it, or as many scans in a row as are rehearsed, from which the LiDAR alone says the same as
        the filter. The filter's map alone is no witness: laid with a wrong speed, it keeps that speed."""
        c, along = self.config, self.unknown_speed
        if len(along) == 0:
            return
        has_wheels = self._imu_from_base is not None and len(scan.odometry) > 0
        is_told = not result.health.is_lost and not is_along(result.health.frozen_translation, along)
        self._telling = [*self._telling, (scan, result)] if is_told else []
        if has_wheels or (len(self._telling) == c.start.rehearsed and self._is_confirmed(self._telling)):
            self.unknown_speed = along[:0]
        if len(self._telling) == c.start.rehearsed:
            self._telling = []

    def _is_confirmed(self, told: list[tuple[CloudScan, LioResult]]) -> bool:
        """Say whether the LiDAR alone finds that it went as the filter says over some scans."""
        velocity, sigma = self._speed_alone([scan for scan, _ in told], degeneracy=self._speed_told)
        first, last = told[0][1], told[-1][1]
        way = np.array((first.map_from_imu.inverse() @ last.map_from_imu).translation)
        off = float(np.linalg.norm(velocity - way / (1e-9 * (last.stamp_ns - first.stamp_ns))))
        most = self.config.start.rest_speed_most + CONFIRMED * float(np.linalg.norm(velocity))
        return not math.isinf(sigma) and off < most

    @property
    def _speed_told(self) -> DegeneracyConfig:
        """What says nothing of a speed that nothing else tells: edges along a corridor look like planes across it."""
        return replace(self.config.degeneracy, share_least=self.config.start.share_least)

    def _speed_alone(
        self, scans: list[CloudScan], least: float = CLEAR, degeneracy: DegeneracyConfig | None = None
    ) -> tuple[F64, float]:
        """Return how fast the LiDAR alone says that it was over some scans (m/s, in the IMU's axes at the first, float64 (3,)), and how sure that is; infinity where fewer than the `least` share of points
        lie on planes, or they say too little (`degeneracy`, if it is not that of the filter). Each scan counts as of one instant: those of a steady motion are bent alike, and fit each other, while to straighten them its speed must be known."""
        c = self.config
        config = replace(c, has_imu=False, estimates_mount=False, estimates_clock=False)
        alone = LidarInertialOdometry(replace(config, degeneracy=degeneracy or c.degeneracy))
        alone.state.imu_from_lidar = self.state.imu_from_lidar
        told = [alone.update(CloudScan(at_one_instant(scan.cloud), (), ())) for scan in scans]
        results = [result for result in told if result is not None]
        if len(results) < 2 or results[-1].health.is_degenerate or results[-1].health.inlier_ratio < least:
            return np.zeros(3), math.inf
        first, last = results[0], results[-1]
        way = np.subtract(last.map_from_imu.translation, first.map_from_imu.translation)
        return way / (1e-9 * (last.stamp_ns - first.stamp_ns)), c.start.speed_alone_sigma

    def _is_carried(self) -> bool:
        """Say whether who feels nothing moves all the same: a steady motion is no rest, and only scans tell the one from the other."""
        velocity, _ = self._speed_alone([scan for scan in self._before_start if len(scan.cloud.points)])
        return float(np.linalg.norm(velocity)) > self.config.start.rest_speed_most

    def _has_gone_astray(self, beginning: float) -> bool:
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
        return self.is_astray

    def _look_for_place(self, scan: CloudScan) -> None:
        """Follow the scans since the hole with a filter of its own, and go on where what it sees is in the map, once that is clear."""
        hole = self.holes[-1]
        hole.scans += 1
        if self._follower is None:
            self._before_start.append(scan)
            if len(self._before_start) == self._before_start.maxlen:
                self._follower = self._following()
                self._before_start.clear()  # where they tell nothing, the next ten may
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
        self.state.rotation = orthonormal(turn @ other.state.rotation)
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
        if np.ptp(scan.cloud.time) > 0.0:
            self._before_start.append(scan)
        return True

    def _straighten(self, first: CloudScan, second: CloudScan) -> None:
        """Map the first scan of a LiDAR alone once more, as fast as the first two say that it began, where its points were not taken at one instant."""
        velocity, sigma = self._speed_alone([first, second], CLEAR_OF_TWO)
        if math.isinf(sigma):
            return
        cloud, known = first.cloud, slice(k.VELOCITY, k.GYRO_BIAS)
        last = cloud.time.max()
        moved = np.outer(cloud.time - last, self.state.imu_from_lidar[:, :3].T @ velocity)
        straight = replace(
            cloud, points=np.asarray(cloud.points + moved, np.float32), time=np.full_like(cloud.time, last)
        )
        self.map, self._inserted_at, self._inserts = VoxelMap(self.config.map), None, 0
        points, _, times = self._thin_out(straight, self.state)
        self._insert(self._compensate(points, times))
        self.state.velocity = self.state.rotation @ velocity
        self.covariance[known, :] = self.covariance[:, known] = 0.0
        self.covariance[known, known] = sigma**2 * np.eye(3)
