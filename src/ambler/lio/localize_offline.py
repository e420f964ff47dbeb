"""Localizes a whole recording in a saved cloud: a pose in the map for every scan from the moment on at which the place was found."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.protocols import CloudFilter
from ambler.core.se3 import SE3
from ambler.lio.cloud_localizer import CloudLocalizer, CloudPose
from ambler.lio.cloud_map import CloudMap
from ambler.lio.cloud_relocalizer import CloudState
from ambler.lio.config import LioConfig
from ambler.lio.odometry import LidarInertialOdometry
from ambler.recordings.cloud_scan import CloudScan


@dataclass(frozen=True, slots=True, eq=False)
class LocalizedLio:
    """`poses` are map_from_imu at `stamps_ns` int64 (N,), as they were told then. `found_after` s of the recording after the odometry's first pose, with `found_cpu` s
    of computing; None: never. `state` is the last one, `qualities` float64 (M,) those of all registrations, `lost` how often the place was lost,
    `update_ms` float64 (K,) the processor time of localization at each scan, `cut` why the recording could not be read to its end,
    `left_out` how many messages had stamps out of order."""

    stamps_ns: NDArray[np.int64]
    poses: tuple[SE3, ...]
    state: CloudState
    found_after: float | None
    found_cpu: float
    lost: int
    scans: int
    odometry_poses: int
    qualities: NDArray[np.float64]
    update_ms: NDArray[np.float64]
    note: str
    cut: str = ""
    left_out: int = 0

    @property
    def is_success(self) -> bool:
        """Whether the place was found and is still followed at the end."""
        return self.found_after is not None and self.state in (CloudState.FOUND, CloudState.TRACKING)

    def warnings(self) -> list[str]:
        """Return what whoever uses the trajectory should know, in words."""
        out = [f"the recording ends early, what came before is localized: {self.cut}"] if self.cut else []
        if self.left_out:
            out.append(f"{self.left_out} messages were left out: their stamps are out of order")
        if self.found_after is None:
            out.append(f"the place was not found: {self.state.value}")
        if self.lost:
            out.append(f"the place was lost {self.lost} times")
        return out


def localize_offline(
    scans: Iterable[CloudScan],
    cloud_map: CloudMap,
    config: LioConfig,
    imu_from_lidar: SE3 | None = None,
    imu_from_base: SE3 | None = None,
    *,
    guess: SE3 | None = None,
    on_scan: Callable[[], None] | None = None,
    air: CloudFilter | None = None,
) -> LocalizedLio:
    """Localize all scans; `guess` is map_from_imu at the first pose. Raises as `run_offline` does."""
    odometry = LidarInertialOdometry(config, imu_from_lidar, imu_from_base, air)
    localizer = CloudLocalizer(cloud_map, config.localize, guess)
    told: list[tuple[CloudPose, float]] = []
    count, cut = 0, ""
    try:
        for scan in scans:
            count += 1
            result = odometry.update(scan)
            if result is not None:
                begin = time.process_time()
                told.append((localizer.update(result), time.process_time() - begin))
            if on_scan is not None:
                on_scan()
    except BadInputError as error:
        if not told:
            raise
        cut = str(error)
    if not told or odometry.start is None:
        raise BadInputError(
            f"nothing could be localized: of {count} scans the filter made no pose{odometry.refused_text}"
        )
    found = next((k for k, (pose, _) in enumerate(told) if pose.map_from_imu is not None), None)
    placed = [(pose.stamp_ns, pose.map_from_imu) for pose, _ in told if pose.map_from_imu is not None]
    states = [pose.state for pose, _ in told]
    return LocalizedLio(
        stamps_ns=np.array([stamp for stamp, _ in placed], np.int64),
        poses=tuple(pose for _, pose in placed),
        state=states[-1],
        found_after=None if found is None else 1e-9 * (told[found][0].stamp_ns - told[0][0].stamp_ns),
        found_cpu=sum(seconds for _, seconds in told[: len(told) if found is None else found + 1]),
        lost=sum(a is CloudState.TRACKING and b is CloudState.LOST for a, b in pairwise(states)),
        scans=count,
        odometry_poses=len(told),
        qualities=np.array([pose.match.quality for pose, _ in told if pose.match is not None]),
        update_ms=np.array([1e3 * seconds for _, seconds in told]),
        note=odometry.start.note,
        cut=cut,
        left_out=odometry.left_out,
    )
