"""How long LiDAR-inertial odometry takes for a scan of 20 000 and of 65 000 points, beside kiss-icp on the same scans, one thread, processor time.

The walk begins in a hall as in the reference measurements, so that nearly all beams return.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import replace
from itertools import islice

from ambler.lio.config import LioConfig
from ambler.lio.odometry import LidarInertialOdometry
from ambler.perception.air_filter import AirFilter
from ambler.recordings.cloud_scan import CloudScan
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import HandRig
from ambler.sim.sensors import OS_64, VLP_16
from ambler.sim.site import draw_hall
from ambler.studies.lio_peer import KissIcp, is_installed

LENGTH = 90.0
FIRST = 40  # scans that do not count: rest, and the first map
# 16 rings of 1250 columns are the 20 000 points of the published anchor.
SCANNERS = {"20k": replace(VLP_16, columns=1250), "65k": OS_64}
BAR_HZ = {"20k": 200.0, "65k": 100.0}
BAR_RATIO = 0.4


def measure(seed: int, scans: int, *, peer: bool = True) -> dict[str, float | None]:
    """Return medians for `scans` scans of each scanner after the first ones: `<size>_hz`, `_ms`, `_p95_ms`, `_points`, and the peer's."""
    fields: dict[str, float | None] = {}
    site = draw_hall(seed, LENGTH)
    for name, spec in SCANNERS.items():
        rig = HandRig(site.world, HandPath(site.way), spec, seed)
        odometry = LidarInertialOdometry(LioConfig(), rig.told_mount, None, AirFilter())
        kiss = KissIcp(0.5, spec.range_max) if peer and is_installed() else None
        ours, points = [], []
        for scan in islice(rig.scans(), FIRST + scans):
            begin = time.process_time()
            odometry.update(CloudScan(scan.cloud, scan.imu, ()))
            ours.append(1e3 * (time.process_time() - begin))
            points.append(len(scan.cloud.points))
            if kiss is not None:
                kiss.update(scan.cloud)
        counted = sorted(ours[FIRST:])
        median = statistics.median(counted)
        fields |= {
            f"{name}_points": statistics.median(points[FIRST:]),
            f"{name}_ms": median,
            f"{name}_p95_ms": counted[int(0.95 * (len(counted) - 1))],
            f"{name}_hz": 1e3 / median,
        }
        if kiss is not None:
            theirs = statistics.median(kiss.ms[FIRST:])
            fields |= {f"peer_kiss_{name}_ms": theirs, f"ratio_vs_kiss_{name}": median / theirs}
    return fields


def meets_bars(fields: dict[str, float | None]) -> bool:
    """Whether both are quick enough, also beside the peer where it was measured."""
    for name, bar in BAR_HZ.items():
        hz, ratio = fields[f"{name}_hz"], fields.get(f"ratio_vs_kiss_{name}")
        if hz is None or hz < bar or (ratio is not None and ratio > BAR_RATIO):
            return False
    return True
