"""Clouds of a straight corridor without end, in which a scan is the same wherever along it one is, and inertial measurements of who is driven through it."""

from __future__ import annotations

import numpy as np

from ambler.core.messages import Imu, PointCloud
from ambler.recordings.cloud_scan import CloudScan

PERIOD = 0.1
COLUMNS = 240
RINGS = np.radians(np.linspace(-25.0, 25.0, 24))
HALF_WIDTH, BELOW, ABOVE, RANGE = 3.0, 1.2, 2.0, 40.0


def corridor_scans(
    count: int, speed: float, sway: float, begin: float = 0.0, walls: tuple[float, ...] = ()
) -> list[CloudScan]:
    """Scans at 10 Hz of who is driven along x at `speed` m/s, from `begin` m on, while a `sway` (m/s², 1.3 Hz) is felt upwards; `walls` stand half across at such x."""
    rng = np.random.default_rng(5)
    around = np.linspace(0.0, 2.0 * np.pi, COLUMNS, endpoint=False)
    yaw, ring = np.meshgrid(around, RINGS, indexing="ij")
    rays = np.stack([np.cos(ring) * np.cos(yaw), np.cos(ring) * np.sin(yaw), np.sin(ring)], axis=2).reshape(-1, 3)
    time = np.repeat(np.linspace(0.0, PERIOD, COLUMNS, endpoint=False), len(RINGS))
    out = []
    for k in range(count):
        x = begin + speed * (k * PERIOD + time)
        with np.errstate(divide="ignore"):
            ranges = np.minimum(
                HALF_WIDTH / np.abs(rays[:, 1]), np.where(rays[:, 2] < 0.0, BELOW, ABOVE) / np.abs(rays[:, 2])
            )
            for wall in walls:
                to_wall = (wall - x) / rays[:, 0]
                is_met = (to_wall > 0.0) & (to_wall * rays[:, 1] > 0.0)
                ranges = np.where(is_met, np.minimum(ranges, to_wall), ranges)
        ranges += rng.normal(0.0, 0.01, len(ranges))
        kept = (ranges < RANGE) & (ranges > 0.6)
        points = np.asarray(rays[kept] * ranges[kept, None], np.float32)
        rest = np.zeros(len(points), np.float32), np.asarray(time[kept], np.float32), np.zeros(len(points), np.uint16)
        cloud = PointCloud(round(k * PERIOD * 1e9), "lidar", points, *rest)
        at = np.arange(k * PERIOD + 0.005, (k + 1) * PERIOD + 0.004, 0.005)
        felt = rng.normal(0.0, 0.02, (len(at), 3)) + np.column_stack(
            [0.0 * at, 0.0 * at, 9.80665 + sway * np.sin(8.2 * at)]
        )
        turned = rng.normal(0.0, 0.001, (len(at), 3))
        imu = tuple(
            Imu(round(1e9 * t), "imu", tuple(w), tuple(f))
            for t, w, f in zip(at, turned.tolist(), felt.tolist(), strict=True)
        )
        out.append(CloudScan(cloud, imu, ()))
    return out
