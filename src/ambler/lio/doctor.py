"""Looks at the first turns of a recording and names what is wrong with it, before a filter drifts through it.

The LiDAR alone says how it turned from scan to scan; the gyroscope, rotated by the mount that is told, must say the same: the same size (else its unit
is wrong), at the same time (else a clock is off) and about the same axes (else the mount is).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.start import LioInputError
from ambler.lio.state import log
from ambler.recordings.cloud_scan import CloudScan

F64 = NDArray[np.float64]
TURN_LEAST = 0.08  # rad/s; RMS of the LiDAR's turn rate below which nothing can be said
PAIRS_LEAST = 15
FOLLOWS = 0.8  # of the median share of points on planes: scans of fewer are not followed, and accuse nobody
TURN_S = 0.1  # s over which turns are compared: parts of a turn show other sides of a place, each with an error of its own that comes back every turn
SHIFTS = np.arange(-0.3, 0.301, 0.01)
BATCH, BATCHES_MOST = 60, 5  # scans of a robot that are examined at a time, and how often
SURE = 0.85  # correlation from which on a moderate difference in size counts: a LiDAR alone that follows quick turns in the open badly accuses nobody
SAME_AXES = 0.6  # agreement below which they are others
LIKE_AXES = 0.87  # the same, about all axes, where a rotation makes them agree by more than `ROTATED`: it is one by 30 degrees or more
ROTATED = 0.95
SEEN = 0.1  # share of the greatest variance of the LiDAR's turns from which on it follows turns about an axis at all
CLEARER = 2.0  # how much worse the turns must fit as they are told than when they are shifted: a LiDAR alone follows quick turns late
SHIFT_MOST = 0.06  # half a scan, which the stamps of clouds without times of their points may be off by


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """`troubles` in words, none: nothing was found. `rate_ratio` is the LiDAR's turn rate over the gyroscope's, `shift` the seconds
    that the LiDAR's stamps lag behind more than is known, `agreement` the correlation of the axes; None: it did not turn enough to say."""

    troubles: tuple[str, ...]
    rate_ratio: float | None = None
    shift: float | None = None
    agreement: float | None = None


def examine(scans: Iterable[CloudScan], config: LioConfig, imu_from_lidar: SE3) -> Diagnosis:
    """Examine the first scans of a recording (some tens are enough)."""
    alone = LidarInertialOdometry(replace(config, has_imu=False, imu_from_lidar=None), SE3())
    ends, rotations, shares, is_blind, rows = [], [], [], [], []
    for scan in scans:
        rows += [(1e-9 * s.stamp_ns, *s.angular_velocity) for s in scan.imu if np.isfinite(s.angular_velocity).all()]
        result = alone.update(_frozen(scan))
        if result is not None and not result.health.is_lost:
            ends.append(1e-9 * result.stamp_ns)
            rotations.append(alone.state.rotation)
            shares.append(result.health.inlier_ratio)
            is_blind.append(len(result.health.frozen_rotation) > 0)
    if len(ends) < PAIRS_LEAST or len(rows) < PAIRS_LEAST:
        return Diagnosis(())
    step = max(1, round(TURN_S / float(np.median(np.diff(ends)))))
    ends, rotations = ends[::step], rotations[::step]
    if len(ends) < PAIRS_LEAST:
        return Diagnosis(())
    # In the mean from end to end: parts of a turn see sides of a place with more and with fewer planes.
    spans = [shares[i : i + step + 1] for i in range(0, step * (len(ends) - 1), step)]
    follows = np.mean(spans, axis=1) >= FOLLOWS * np.median(shares)
    # Nor does a plain alone tell how one turned about the vertical: such turns go on as they were.
    follows &= [not any(is_blind[i : i + step + 1]) for i in range(0, step * (len(ends) - 1), step)]
    if np.count_nonzero(follows) < PAIRS_LEAST:
        return Diagnosis(())
    times = np.array(ends)
    turns = np.array([log(a.T @ b) for a, b in pairwise(rotations)]) / np.diff(times)[:, None]
    if float(np.sqrt((turns[follows] ** 2).sum(axis=1).mean())) < TURN_LEAST:
        return Diagnosis(())
    return compare_turns(turns, times, np.array(rows), imu_from_lidar, follows, config.lidar_clock)


def first_seconds(scans: Iterable[CloudScan], seconds: float) -> Iterator[CloudScan]:
    """Yield the scans of the first seconds, however many they are: a driver may send a turn in a hundred parts."""
    last_ns: int | None = None
    for scan in scans:
        last_ns = scan.end_ns + round(seconds * 1e9) if last_ns is None else last_ns
        if scan.end_ns > last_ns:
            return
        yield scan


class StartExamination:
    """Examines a robot's first turns while it drives: `add` gives work for the background once a batch of scans holds some."""

    def __init__(self, config: LioConfig, imu_from_lidar: SE3) -> None:
        self._config, self._mount = config, imu_from_lidar
        self._batch: list[CloudScan] = []
        self._tries = BATCHES_MOST

    def add(self, scan: CloudScan) -> Callable[[], Diagnosis] | None:
        """Take the next scan; returns the examination of a full batch in which the gyroscope turned."""
        if self._tries == 0:
            return None
        self._batch.append(scan)
        if len(self._batch) < BATCH:
            return None
        batch, self._batch = self._batch, []
        rates = np.array([sample.angular_velocity for scan in batch for sample in scan.imu]).reshape(-1, 3)
        rates = rates[np.isfinite(rates).all(axis=1)]
        if len(rates) == 0 or float(np.sqrt((rates**2).sum(axis=1).mean())) < TURN_LEAST:
            return None
        self._tries -= 1
        return partial(examine, batch, self._config, self._mount)

    def take(self, diagnosis: Diagnosis) -> None:
        """Take what the examination found; raises LioInputError for trouble. Once enough was seen, it is over."""
        if diagnosis.troubles:
            raise LioInputError("; ".join(diagnosis.troubles))
        if diagnosis.rate_ratio is not None:
            self._tries, self._batch = 0, []


def _frozen(scan: CloudScan) -> CloudScan:
    """Return the scan as if taken at once in its middle: what is registered so tells where it was there, whatever its rate."""
    cloud = scan.cloud
    middle_ns = cloud.stamp_ns + round(float(np.median(cloud.time)) * 1e9) if len(cloud.time) else cloud.stamp_ns
    return CloudScan(replace(cloud, stamp_ns=middle_ns, time=np.zeros_like(cloud.time)), (), ())


def compare_turns(
    turns: F64,
    times: F64,
    rows: F64,
    imu_from_lidar: SE3,
    follows: NDArray[np.bool_] | None = None,
    lidar_clock: float = 0.0,
) -> Diagnosis:
    """Compare turn rates (N - 1, 3) rad/s of a LiDAR between `times` (N,) s with rows (M, 4) of a gyroscope: seconds and rates. Only those count which the LiDAR `follows`
    (N - 1,), all if nothing is said; its stamps are known to lag `lidar_clock` s behind."""
    times = times + lidar_clock
    follows = np.ones(len(turns), bool) if follows is None else follows
    turns = turns[follows]
    rotation = imu_from_lidar.matrix()[:3, :3]
    sums = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(0.5 * (rows[1:, 1:] + rows[:-1, 1:]) * np.diff(rows[:, :1], axis=0), axis=0)]
    )

    def gyro(shift: float) -> F64:
        at = np.stack([np.interp(times + shift, rows[:, 0], sums[:, j]) for j in range(3)], axis=1)
        return np.asarray((np.diff(at, axis=0) / np.diff(times)[:, None])[follows] @ rotation)

    lidar = np.linalg.norm(turns, axis=1)
    fits = [_correlation(np.linalg.norm(gyro(shift), axis=1), lidar) for shift in SHIFTS]
    shift = float(SHIFTS[int(np.argmax(fits))])
    seen = _axes_seen(turns)
    turned = turns @ seen
    # Sizes of a stride come back with the next one, and a turn that only began fits itself shifted: what agrees as it is told is not accused for a shift that fits by chance.
    told = max(SHIFTS[np.abs(SHIFTS) <= SHIFT_MOST], key=lambda at: fits[int(np.argmin(np.abs(SHIFTS - at)))])
    felt = [gyro(at) for at in (shift, float(told))]
    agreement = max(_agreement(turned, rates @ seen) for rates in felt)
    ratio, ratio_told = (_ratio(turned, rates @ seen) for rates in felt)
    troubles = []
    if max(fits) > 0.5 and 1.0 / 80.0 < ratio < 1.0 / 40.0:
        troubles.append(
            f"the gyroscope tells degrees per second, not rad/s (it turns {1.0 / ratio:.0f} times as fast as the LiDAR)"
        )
    elif max(fits) > 0.5 and 40.0 < ratio < 80.0:
        troubles.append("the gyroscope's rates are too small by a factor of 57: degrees were turned into radians twice")
    elif max(fits) > SURE and agreement >= SAME_AXES and not any(0.7 < r < 1.4 for r in (ratio, ratio_told)):
        troubles.append(
            f"the LiDAR turns {ratio:.2f} times as fast as the gyroscope says: a wrong unit, or other sensors"
        )
    fit_told = fits[int(np.argmin(np.abs(SHIFTS - told)))]
    if max(fits) > 0.8 and 1.0 - fit_told > CLEARER * (1.0 - max(fits)):
        troubles.append(
            f"the clocks differ by {shift:+.2f} s: set lidar_clock={lidar_clock + shift:.2f}, or correct the stamps"
        )
    about_all = max(_agreement(turns, rates) for rates in felt)
    is_rotated = max(fits) > SURE and about_all < LIKE_AXES and _agreement_rotated(turns, felt[0]) > ROTATED
    if is_rotated or (max(fits) > 0.6 and agreement < SAME_AXES):
        agreement = min(agreement, about_all)
        troubles.append(
            f"LiDAR and gyroscope turn about other axes (agreement {agreement:.2f}): the IMU's mount in the LiDAR's frame is wrong"
        )
    return Diagnosis(tuple(troubles), ratio, shift, agreement)


def _axes_seen(turns: F64) -> F64:
    """Return the axes, float64 (3, K) in columns, about which a LiDAR alone says that it turned, by its turn rates (N, 3). In the open few rings hardly
    show how a body rocks, which the gyroscope measures well: about such axes neither accuses the other."""
    variances, axes = np.linalg.eigh(turns.T @ turns)
    return np.asarray(axes[:, variances >= SEEN * variances[-1]])


def _ratio(turned: F64, rates: F64) -> float:
    """Return how many times as fast one series of turn rates (N, K) is as the other."""
    measured = np.linalg.norm(rates, axis=1)
    return float((np.linalg.norm(turned, axis=1) * measured).sum() / max((measured**2).sum(), 1e-12))


def _agreement(turned: F64, rates: F64) -> float:
    """Return the correlation of two series of turn rates (N, K) about the same axes."""
    return float((turned * rates).sum() / np.sqrt((turned**2).sum() * max((rates**2).sum(), 1e-12)))


def _agreement_rotated(turned: F64, rates: F64) -> float:
    """Return the agreement of two series of turn rates (N, 3) when one is rotated so that they agree best (Kabsch 1976)."""
    sides, shares, others = np.linalg.svd(turned.T @ rates)
    shares[2] *= np.sign(np.linalg.det(sides) * np.linalg.det(others))
    return float(shares.sum() / np.sqrt((turned**2).sum() * max((rates**2).sum(), 1e-12)))


def _correlation(a: F64, b: F64) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / max(float(np.sqrt((a**2).sum() * (b**2).sum())), 1e-12))
