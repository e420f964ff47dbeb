"""Odometry on the bus, out of clouds and inertial measurements: `odometry` and odom -> base at the IMU's rate, the registered cloud at the scan's."""

from __future__ import annotations

import json
from functools import partial

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.messages import Imu, Odometry, PointCloud, Status, Transforms, TransformStamped
from ambler.core.robot import RobotModel, SensorKind
from ambler.lio.base_odometry import BaseOdometry, Registered
from ambler.lio.config import LioConfig
from ambler.lio.doctor import StartExamination
from ambler.recordings.cloud_scan import CloudScan
from ambler.runtime.node import Node, Topics, WorkKind
from ambler.runtime.topics import CLOUD, IMU, ODOMETRY, REGISTERED_CLOUD, STATUS, TRANSFORMS, WHEEL_ODOMETRY

REGISTRATION = 0.02  # simulated seconds that a scan takes in the background
EXAMINATION = 1.0


class LidarOdometryNode(Node):
    """Runs `BaseOdometry` with the robot's first LiDAR and first IMU, at their places on the robot.

    While nothing can be told (before the start, without scans that fit, or without an IMU) nothing is published, odometry grows stale, and the gate stops the
    robot. Measurements that contradict one another end the node with their reason.
    """

    name = "odometry"
    inputs = (CLOUD, IMU)
    optional_inputs: Topics = (WHEEL_ODOMETRY,)
    outputs = (ODOMETRY, TRANSFORMS, REGISTERED_CLOUD, STATUS)
    latency = 5e-4

    def __init__(self, robot: RobotModel, config: LioConfig | None = None) -> None:
        config = config or LioConfig()
        mounts = {mount.kind: mount for mount in reversed(robot.sensors)}
        if SensorKind.CLOUD not in mounts or SensorKind.IMU not in mounts:
            raise BadInputError(f"{robot.name}: LiDAR-inertial odometry needs a LiDAR that gives clouds, and an IMU")
        self._lidar, self._imu = mounts[SensorKind.CLOUD], mounts[SensorKind.IMU]
        imu_from_base = self._imu.base_from_sensor.inverse()
        imu_from_lidar = imu_from_base @ self._lidar.base_from_sensor
        self._odometry = BaseOdometry(config, imu_from_lidar, imu_from_base)
        self._examination = StartExamination(config, imu_from_lidar)
        self._is_registering = self._is_examining = False
        self._state = ""

    def start(self) -> None:
        """Subscribe to LiDAR, IMU and wheels."""
        self.ctx.subscribe(CLOUD, self._on_cloud)
        self.ctx.subscribe(IMU, self._on_imu)
        self.ctx.subscribe(WHEEL_ODOMETRY, self._on_wheels)

    def _on_cloud(self, cloud: PointCloud) -> None:
        if cloud.frame == self._lidar.frame:
            self._odometry.add(cloud)

    def _on_wheels(self, wheels: Odometry) -> None:
        self._odometry.add(wheels)

    def _on_imu(self, sample: Imu) -> None:
        if sample.frame != self._imu.frame:
            return
        odometry = self._odometry.add(sample)
        if odometry is not None:
            self.ctx.publish(ODOMETRY, odometry)
            edge = TransformStamped(odometry.stamp_ns, odometry.frame, odometry.child, odometry.pose)
            self.ctx.publish(TRANSFORMS, Transforms(odometry.stamp_ns, (edge,)))
        self._go_on()

    def _go_on(self) -> None:
        """Register the next scan, unless one is being registered."""
        if self._is_registering:
            return
        scan = next(self._odometry.scans(), None)
        if scan is None:
            return
        self._is_registering = True
        self.ctx.background(partial(self._odometry.register, scan), REGISTRATION, self._registered, WorkKind.PERCEPTION)
        self._examine(scan)

    def _registered(self, registered: Registered | None) -> None:
        self._is_registering = False
        if registered is not None:
            self._odometry.take(registered)
            self._tell_cloud(registered)
            self._tell_state(registered)
        self._go_on()

    def _tell_cloud(self, registered: Registered) -> None:
        scan = registered.scan
        points = self._odometry.in_odom(registered.points)
        late = np.zeros(len(points), np.float32)
        cloud = scan.cloud
        self.ctx.publish(REGISTERED_CLOUD, PointCloud(scan.end_ns, "odom", points, cloud.intensity, late, cloud.ring))

    def _tell_state(self, registered: Registered) -> None:
        """Say once what has changed, with the numbers of the scan that changed it."""
        health = registered.result.health
        state = "LOST" if health.is_lost else "DEGENERATE" if health.is_degenerate else "GOOD"
        if state == self._state:
            return
        self._state = state
        text = {
            "LOST": "the scan fits nothing in the map: odometry coasts",
            "DEGENERATE": "a direction is left to IMU and wheels: the place says too little",
            "GOOD": "scans fit the map",
        }[state]
        fields = {"inlier_ratio": health.inlier_ratio, "residual_m": health.residual_m, "weakest": health.weakest}
        self.ctx.log(f"LIO_{state}", text, **fields)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, f"LIO_{state}", text, json.dumps(fields)))

    def _examine(self, scan: CloudScan) -> None:
        """Look in the background at the first turns, whether LiDAR and IMU agree."""
        work = self._examination.add(scan)
        if work is not None:
            self.ctx.background(work, EXAMINATION, self._examination.take, WorkKind.MAPPING)
