"""A short walk with a small scanner through a hall, simulated once for all tests."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ambler.bridges.recorder import Recorder
from ambler.core.messages import Transforms, TransformStamped
from ambler.recordings.cloud_scan import CloudScan
from ambler.runtime.topics import CLOUD, IMU, TRANSFORMS
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import BEGIN_NS, HandRig, RigScan
from ambler.sim.sensors import VLP_16
from ambler.sim.site import draw_hall
from ambler.wire.cloud_files import write_cloud
from ambler.wire.trajectory_files import write_tum_3d

SMALL = replace(VLP_16, columns=360)


@functools.cache
def walk() -> tuple[HandRig, tuple[RigScan, ...]]:
    """A loop of 25 metres, two seconds of rest at both ends."""
    site = draw_hall(3, 25.0)
    rig = HandRig(site.world, HandPath(site.way), SMALL, 3)
    return rig, tuple(rig.scans())


def save_recording(path: Path, truth: Path) -> None:
    """Write the walk as a bag, and the true poses of its IMU as a TUM file."""
    rig, scans = walk()
    recorder = Recorder(path)
    edge = TransformStamped(BEGIN_NS, "imu", "lidar", rig.told_mount)
    recorder.on_message(TRANSFORMS, Transforms(BEGIN_NS, (edge,)), BEGIN_NS)
    for scan in scans:
        for sample in scan.imu:
            recorder.on_message(IMU, sample, sample.stamp_ns)
        recorder.on_message(CLOUD, scan.cloud, scan.end_ns)
    recorder.close()
    write_tum_3d(truth, [s.end_ns for s in scans], [s.world_from_imu for s in scans])


def save_clouds(folder: Path, scans: Sequence[RigScan]) -> None:
    """Write scans as a folder of clouds with their times."""
    folder.mkdir()
    for k, scan in enumerate(scans):
        write_cloud(folder / f"{k}.pcd", scan.cloud.points)
    (folder / "times.txt").write_text("\n".join(f"{1e-9 * s.cloud.stamp_ns:.9f}" for s in scans))


def scans_of(recorded: tuple[RigScan, ...]) -> list[CloudScan]:
    """What the filter is given of them."""
    return [CloudScan(s.cloud, s.imu, s.odometry) for s in recorded]


def distance(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Metres between two places."""
    return math.dist(a, b)
