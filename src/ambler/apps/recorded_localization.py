"""Localizes a recorded drive in a known map, from a given pose or from nothing, and says how well map and scans agree."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.grid import OCC_OCCUPIED, GridSpec
from ambler.core.se2 import SE2
from ambler.localization.localizer import INITIAL_COVARIANCE, Estimate, Localizer, Observation
from ambler.localization.relocalizer import Relocalizer, RelocalizerConfig
from ambler.localization.supervisor import LocalizationState, Supervisor, SupervisorConfig
from ambler.localization.surface_map import SurfaceMap
from ambler.recordings.log_scans import LogScan
from ambler.slam2d.offline import points_on_walls

BELIEVED = (LocalizationState.TRACKING, LocalizationState.DEGRADED)


TRIED_NS = 10_000_000_000  # after which a pose that was told, and believed all the time, counts as right


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLocalization:
    """`stamps_ns` int64 (N,) and `poses` float64 (N, 3), map_from_base, of the scans whose pose was believed, of `scans` in all. `found_after`
    is the time of the first (s after the first scan; None: never); `times_lost` how often a believed pose was given up;
    `points_on_walls_ratio` the share of returns within one cell of the map's walls; `corrections` float64 (N,) the steps (m) away from
    what odometry says, 0 where there was no pose before; `first_ns` the stamp of the first scan."""

    scans: int
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    found_after: float | None
    times_lost: int
    points_on_walls_ratio: float
    corrections: NDArray[np.float64]
    first_ns: int
    is_found_at_the_end: bool

    @property
    def largest_correction(self) -> float:
        """The longest step away from what odometry says, m."""
        return float(self.corrections.max(initial=0.0))


def localize_recording(
    scans: Iterable[LogScan],
    spec: GridSpec,
    occupancy: NDArray[np.int8],
    make_localizer: Callable[[SurfaceMap], Localizer],
    map_from_start: SE2 | None = None,
    *,
    is_supervised: bool = True,
) -> RecordedLocalization:
    """Localize every scan in the map `occupancy` int8 [iy, ix], from a pose or from nothing. Without supervision, which needs a pose, it
    is believed to the end: for maps so old that they contradict every scan. A pose that is given up within its first
    ten seconds was only told: nothing that followed from it is kept. Raises BadInputError without odometry."""
    surfaces = SurfaceMap.from_occupancy(occupancy, spec)
    localizer = make_localizer(surfaces)
    supervisor: Supervisor | None = None
    odometry = BaseMotion(span=5.0, max_extrapolation=0.5)
    believed: list[tuple[int, SE2, SE2]] = []
    planar = []
    count = times_lost = 0
    first_ns, was_believed, corrections = 0, False, list[float]()
    is_only_told = map_from_start is not None
    for scan in scans:
        count += 1
        for stamp_ns, odom_from_base in scan.odometry:
            odometry.add_pose(stamp_ns, odom_from_base)
        try:
            odom_from_base = odometry.planar_at(scan.stamp_ns)
        except StaleInputError:
            continue
        if supervisor is None:
            first_ns = scan.stamp_ns
            if map_from_start is not None:
                localizer.set_pose(scan.stamp_ns, odom_from_base, map_from_start, INITIAL_COVARIANCE)
            relocalizer = Relocalizer(surfaces, RelocalizerConfig())
            supervisor = Supervisor(surfaces, localizer, relocalizer, SupervisorConfig())
        points = scan.to_planar(odometry.sweep(scan.stamp_ns, scan.duration, odometry.twist()))
        observation = Observation(scan.stamp_ns, odom_from_base, points.points)
        estimate = _supervised(supervisor, observation) if is_supervised else localizer.update(observation)
        if estimate is not None:
            pose, correction = estimate.map_from_base, 0.0
            if was_believed:
                _, map_from_last, odom_from_last = believed[-1]
                expected = map_from_last @ odom_from_last.inverse() @ odom_from_base
                correction = pose.distance_to(expected)
            corrections.append(correction)
            believed.append((scan.stamp_ns, pose, odom_from_base))
            planar.append(points)
        elif is_only_told:
            is_only_told = False
            if scan.stamp_ns - first_ns < TRIED_NS:
                for kept in (believed, planar, corrections):
                    kept.clear()
        times_lost += was_believed and estimate is None
        was_believed = estimate is not None
    if supervisor is None:
        raise BadInputError("there is no odometry for any scan of the recording: a robot is localized by both")
    poses = np.array([pose.as_array() for _, pose, _ in believed]).reshape(-1, 3)
    walls = np.where(occupancy > OCC_OCCUPIED // 2, OCC_OCCUPIED, 0).astype(np.int8)
    return RecordedLocalization(
        count,
        np.array([stamp for stamp, _, _ in believed], np.int64),
        poses,
        (believed[0][0] - first_ns) * 1e-9 if believed else None,
        times_lost,
        points_on_walls(planar, poses, spec, walls),
        np.array(corrections),
        first_ns,
        was_believed,
    )


def _supervised(supervisor: Supervisor, observation: Observation) -> Estimate | None:
    """Return the estimate when it may be believed."""
    seen = supervisor.update(observation)
    return seen.estimate if seen.state in BELIEVED else None
