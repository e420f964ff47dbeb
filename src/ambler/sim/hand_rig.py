"""A LiDAR and an IMU on one plate that is carried along a prescribed path: clouds with the time of every point, and inertial measurements.

The hand's pose is that of the IMU. The plate is built with the errors of real ones: the LiDAR sits a little off the mount that is told, and its
clock runs a little late.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Imu, Odometry, PointCloud
from ambler.core.se3 import SE3
from ambler.sim.air import Air
from ambler.sim.hand_path import HandPath
from ambler.sim.imu import ImuSensor
from ambler.sim.lidar import LidarSensor
from ambler.sim.rig_errors import RigErrors, draw_flaw
from ambler.sim.scene import build_scene
from ambler.sim.sensors import MEMS_IMU_200, MID_360, OS_64, VLP_16, ImuSpec, LidarSpec, named_generator
from ambler.sim.solids import WorldSpec

F64 = NDArray[np.float64]
BEGIN_NS = 1_000_000_000
KNOT = 0.001  # seconds between two poses of a sweep
LIDARS: dict[str, LidarSpec] = {"vlp_16": VLP_16, "os_64": OS_64, "mid_360": MID_360}
LIDAR_FRAME, IMU_FRAME = "lidar", "imu"
NOMINAL_MOUNT = SE3.from_rpy((0.03, 0.01, 0.08), 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class RigScan:
    """A cloud, the inertial measurements and wheel odometry since the cloud before and one beyond its end, and the true pose of the IMU in the world at its last point's time.
    `is_false` bool (M,): which points come from what floats in the air."""

    cloud: PointCloud
    imu: tuple[Imu, ...]
    odometry: tuple[Odometry, ...]
    end_ns: int
    world_from_imu: SE3
    is_false: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))


class HandRig:
    """`told_mount` is what whoever uses the data is told of imu_from_lidar; `mount` is what it is."""

    def __init__(
        self,
        world: WorldSpec,
        path: HandPath,
        lidar: LidarSpec,
        seed: int,
        imu: ImuSpec = MEMS_IMU_200,
        errors: RigErrors | None = None,
        wheels: bool = False,
        airs: tuple[Air, ...] = (),
    ) -> None:
        flaw = draw_flaw(seed, errors or RigErrors())
        self.told_mount = NOMINAL_MOUNT
        self.mount = NOMINAL_MOUNT @ flaw.drawn_from_built
        self.clock = flaw.clock
        """Seconds that the LiDAR's stamps lie behind the true times of its points."""
        self.path, self.lidar, self.airs = path, lidar, airs
        self.scene = build_scene(world)
        self._sensor = LidarSensor(lidar, LIDAR_FRAME, self.scene, seed)
        self._imu_spec, self._seed = imu, seed
        self._wheels = named_generator(seed, "wheels") if wheels else None
        self._wheel_scale = 1.0 + 0.005 * flaw.rest

    def pose_at(self, stamp_ns: int) -> SE3:
        """Return the true pose of the IMU in the world."""
        return self.path.pose(1e-9 * (stamp_ns - BEGIN_NS))

    def scans(self) -> Iterator[RigScan]:
        """Yield all scans of the path in the order of time."""
        period = self.lidar.period
        measured = self._inertial()
        ahead: Imu | None = next(measured)
        for number in range(int(self.path.seconds / period) - 1):
            first = number * period
            cloud = self._cloud(first)
            end_ns = cloud.stamp_ns + (round(float(cloud.time[-1]) * 1e9) if len(cloud.time) else 0)
            imu = []
            while ahead is not None:
                imu.append(ahead)
                taken = ahead.stamp_ns
                ahead = next(measured, None)
                if taken >= end_ns:
                    break
            is_false = self._sensor.is_false
            yield RigScan(cloud, tuple(imu), self._odometry(end_ns), end_ns, self.pose_at(end_ns), is_false)

    def _cloud(self, first: float) -> PointCloud:
        """Cast the sweep that truly begins `clock` seconds after what its stamp says."""
        begin = first + self.clock
        knots = np.arange(0.0, self.lidar.sweep_time + 2.0 * KNOT, KNOT)
        positions, quaternions = self.path.poses(begin + knots)
        mounted, turned = _mounted(positions, quaternions, self.mount)
        self._sensor.sweep(knots, mounted, turned, first=first, airs=self.airs)
        return self._sensor.to_cloud(BEGIN_NS + round(first * 1e9))

    def _inertial(self) -> Iterator[Imu]:
        """Yield the inertial measurements of the whole path; the mean over a period is stamped in its middle."""
        period = 1.0 / self._imu_spec.rate_hz
        sensor = ImuSensor(self._imu_spec, IMU_FRAME, self._seed)
        count = int((self.path.seconds + 0.2) / period)
        for begin in range(0, count, 4096):
            times = np.arange(begin, min(begin + 4096, count), dtype=np.float64) * period
            positions, quaternions = self.path.poses(times)
            velocities = self.path.velocities(times)
            rows = zip(times.tolist(), positions.tolist(), quaternions.tolist(), velocities.tolist(), strict=True)
            for t, (x, y, z), (qw, qx, qy, qz), (vx, vy, vz) in rows:
                stamp_ns = BEGIN_NS + round((t - 0.5 * period) * 1e9)
                sample = sensor.update(SE3((x, y, z), (qw, qx, qy, qz)), (vx, vy, vz), stamp_ns)
                if sample is not None:
                    yield sample

    def _odometry(self, stamp_ns: int) -> tuple[Odometry, ...]:
        """The speed of the wheels under the IMU, with a scale error and noise; none unless asked for."""
        if self._wheels is None:
            return ()
        t = 1e-9 * (stamp_ns - BEGIN_NS)
        pose = self.pose_at(stamp_ns)
        x, y, z = self.path.velocities(np.array([t]))[0].tolist()
        ahead, _, _ = replace(pose.inverse(), translation=(0.0, 0.0, 0.0)).rotate((x, y, z))
        speed = ahead * self._wheel_scale + 0.005 * float(self._wheels.standard_normal())
        zero = np.zeros((6, 6))
        return (Odometry(stamp_ns, "odom", "base", SE3(), (speed, 0.0, 0.0), (0.0, 0.0, 0.0), zero, zero),)


def _mounted(positions: F64, quaternions: F64, mount: SE3) -> tuple[F64, F64]:
    """Return the poses of the LiDAR of poses of the IMU."""
    w, x, y, z = quaternions.T
    t = np.array(mount.translation)
    u = quaternions[:, 1:]
    cross = 2.0 * np.cross(u, t)
    moved = positions + t + w[:, None] * cross + np.cross(u, cross)
    bw, bx, by, bz = mount.rotation
    turned = np.stack(
        [
            w * bw - x * bx - y * by - z * bz,
            w * bx + x * bw + y * bz - z * by,
            w * by - x * bz + y * bw + z * bx,
            w * bz + x * by - y * bx + z * bw,
        ],
        axis=1,
    )
    return np.ascontiguousarray(moved), np.ascontiguousarray(turned)
