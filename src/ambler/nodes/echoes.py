"""Ultrasonic echoes are judged once, here, for everybody but the gate, which trusts nobody and judges for itself."""

from __future__ import annotations

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError
from ambler.core.messages import JudgedEcho, LaserScan, Odometry, PointCloud, Range
from ambler.core.robot import RobotModel
from ambler.core.se3 import SE3
from ambler.nodes.range_view import RangeView
from ambler.perception.level_mount import level_mount
from ambler.perception.planar import PlanarConfig, cloud_to_points, default_planar, scan_duration
from ambler.runtime.node import Node, Topics
from ambler.runtime.topics import CLOUD, ECHOES, ODOMETRY, RANGES, SCAN, SCANNERS


class EchoNode(Node):
    """Publishes ECHOES: of every measurement in RANGES what it says beside what all scanners see, as soon as something confirms it.

    `planar` is the band of a cloud that counts.
    """

    name = "echoes"
    outputs: Topics = (ECHOES,)
    latency = 0.002

    def __init__(self, robot: RobotModel, planar: PlanarConfig | None = None) -> None:
        self._robot = robot
        self._mounts = {m.frame: m.base_from_sensor for m in robot.sensors}
        self._planar = planar if planar is not None else default_planar(robot)
        self._view = RangeView(robot)
        self._motion = BaseMotion()
        has_cloud = any(m.kind == "cloud" for m in robot.sensors)
        scans = () if not robot.scanners else (SCAN,) if len(robot.scanners) == 1 else (SCANNERS,)
        self._scanners: Topics = (*scans, *((CLOUD,) if has_cloud else ()))
        self.inputs = (RANGES, ODOMETRY, *self._scanners)

    def start(self) -> None:
        """Subscribe."""
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(RANGES, self._on_range)
        for topic in self._scanners:
            self.ctx.subscribe(topic, self._on_cloud if topic is CLOUD else self._on_scan)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._view.add_odometry(odometry)
        self._motion.add(odometry)

    def _on_scan(self, scan: LaserScan) -> None:
        self._view.add_scan(self._robot.timed(scan))

    def _on_cloud(self, cloud: PointCloud) -> None:
        mount = level_mount(self._mounts[cloud.frame], self._motion, cloud.stamp_ns, scan_duration(cloud))
        sweep = self._motion.sweep(cloud.stamp_ns, scan_duration(cloud), self._view.twist)
        seen = cloud_to_points(cloud, mount, sweep, self._planar)
        try:
            odom_from_base = self._view.pose_at(seen.stamp_ns)
        except StaleInputError:
            return  # without a pose the cloud explains nothing, so echoes count
        self._view.add_points(cloud.frame, odom_from_base.transform(seen.points))

    def _on_range(self, measured: Range) -> None:
        placed = self._view.judge(measured)
        if placed is None:
            return
        echo = placed.echo
        pose = SE3.from_se2(placed.odom_from_base @ echo.base_from_sensor)
        said = JudgedEcho(
            *(echo.stamp_ns, "odom", echo.frame, pose),
            *(echo.half_angle, echo.distance, echo.free, echo.is_unexplained),
        )
        self.ctx.publish(ECHOES, said)
