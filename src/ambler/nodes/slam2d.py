"""2-D SLAM on the bus: scans or clouds in; map, map -> odom, pose and health out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED
from ambler.core.messages import (
    LaserScan,
    OccupancyGrid,
    Odometry,
    PointCloud,
    PoseStamped,
    SlamHealth,
    Status,
    Transforms,
    TransformStamped,
)
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.localization.map_bend import measure_bend
from ambler.localization.map_trust import MapTrust, MapTrustConfig, MapTrustJudge
from ambler.nodes.merged_rays import MergedRays
from ambler.perception.level_mount import Mount, level_mount
from ambler.perception.planar import PlanarConfig, cloud_to_points, scan_duration, scan_to_points
from ambler.registration.planar_scan import PlanarScan
from ambler.runtime.node import GoalHandle, Node, Topics
from ambler.runtime.tasks import FINISH_MAP, SAVE_MAP, Nothing, SaveMapRequest
from ambler.runtime.topics import (
    CLOUD,
    MAP,
    MATCHED_SCAN,
    MERGED_CLOUD,
    MERGED_FREE,
    MOVERS,
    ODOMETRY,
    SCAN,
    SLAM_HEALTH,
    SLAM_POSE,
    STATUS,
    TRANSFORMS,
)
from ambler.safety.stuck_scan import StuckScan
from ambler.slam2d.back_end import JobResult
from ambler.slam2d.config import Slam2dConfig
from ambler.slam2d.slam import Slam2d, Slam2dResult
from ambler.wire.map_files import save_map

Finishing = GoalHandle[Nothing, Nothing, Nothing]
MOVERS_AGE_NS = 500_000_000
PERSON = 0.5  # metres from the middle of whoever moves within which all returns are his
BEND_KEYFRAMES = 400  # that are matched to the finished map, 0.1 ms to 1 ms each
OWN_RAYS = 180


@dataclass(frozen=True, slots=True)
class Slam2dNodeConfig:
    """`uses_cloud` chooses CLOUD instead of SCAN. `map_period` is how often a changed map is published, `background_duration` the
    simulated time of one background job."""

    uses_cloud: bool = False
    planar: PlanarConfig = field(default_factory=PlanarConfig)
    slam: Slam2dConfig = field(default_factory=Slam2dConfig)
    trust: MapTrustConfig = field(default_factory=MapTrustConfig)
    map_period: float = 1.0
    background_duration: float = 1.0
    publishes_matched_scan: bool = False


class Slam2dNode(Node):
    """Runs `Slam2d` on the robot's scanner, or on the points of its merged scanners, each ray from where it was measured.

    Returns from whoever moves (MOVERS) are no part of the room. While the pose is in doubt (`MapTrustJudge`) nothing is drawn into the map, and STATUS says SLAM_DEGRADED or SLAM_LOST.
    """

    name = "slam2d"
    inputs: Topics = (SCAN, ODOMETRY)
    optional_inputs: Topics = (MOVERS,)
    outputs = (MAP, TRANSFORMS, SLAM_POSE, SLAM_HEALTH, MATCHED_SCAN, STATUS)
    serves = (SAVE_MAP, FINISH_MAP)
    latency = 0.01

    def __init__(self, robot: RobotModel, config: Slam2dNodeConfig | None = None) -> None:
        self._robot = robot
        self._config = config or Slam2dNodeConfig()
        self._rays: MergedRays | None = None
        self._motion = BaseMotion()
        if self._config.uses_cloud:
            self.inputs = (CLOUD, ODOMETRY)
        elif len(robot.scanners) > 1:
            self._rays = MergedRays(robot, self._config.planar)
            self.inputs = (MERGED_FREE, MERGED_CLOUD, ODOMETRY)
        self.slam = Slam2d(self._config.slam)
        self._trust = MapTrustJudge(self._config.trust)
        self._told_trust = MapTrust.GOOD
        self._published_version = 0
        self._newest_ns = -1
        self._repeats = StuckScan()
        self._odom_from_base = SE2()
        self._movers: PointCloud | None = None
        self._has_job = False
        self._finishing: Finishing | None = None
        self._final_work: Iterator[Callable[[], JobResult]] = iter(())

    def start(self) -> None:
        """Subscribe to the sensors and publish the map when it has changed."""
        if self._config.uses_cloud:
            self.ctx.subscribe(CLOUD, self._on_cloud)
        elif self._rays is not None:
            self.ctx.subscribe(MERGED_FREE, self._rays.add_free)
            self.ctx.subscribe(MERGED_CLOUD, self._on_merged)
        else:
            self.ctx.subscribe(SCAN, self._on_scan)
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(MOVERS, self._on_movers)
        self.ctx.serve(SAVE_MAP, self._save_map)
        self.ctx.serve_task(FINISH_MAP, self._on_finish, self._on_finish_cancelled)
        self.ctx.timer(self._config.map_period, self._publish_map)

    def _on_odometry(self, message: Odometry) -> None:
        self._odom_from_base = message.pose.to_se2()
        self.slam.add_odometry(message.stamp_ns, self._odom_from_base)
        self._motion.add(message)
        self.slam.add_heading(message.stamp_ns, self._odom_from_base.yaw)

    def _on_movers(self, message: PointCloud) -> None:
        self._movers = message

    def _on_scan(self, message: LaserScan) -> None:
        if self._repeats.update(message.ranges, self._odom_from_base):
            return  # not a measurement; the gate says so and stops the robot
        message = self._robot.timed(message)
        self._update(scan_to_points(message, self._mount(message), self._sweep(message), self._config.planar))

    def _on_cloud(self, message: PointCloud) -> None:
        if self._repeats.update(message.points, self._odom_from_base):
            return
        self._update(cloud_to_points(message, self._mount(message), self._sweep(message), self._config.planar))

    def _sweep(self, message: LaserScan | PointCloud) -> NDArray[np.float64]:
        """How the base moved during the sweep."""
        seconds = scan_duration(message)
        return self._motion.sweep(message.stamp_ns, seconds, self.slam.twist(message.stamp_ns, seconds))

    def _mount(self, message: LaserScan | PointCloud) -> Mount:
        """Where the sensor was during the sweep, level however the body leaned."""
        mount = self._robot.sensor(message.frame).base_from_sensor
        return level_mount(mount, self._motion, message.stamp_ns, scan_duration(message))

    def _on_merged(self, message: PointCloud) -> None:
        assert self._rays is not None
        self._update(with_own_floor(self._rays.to_planar(message, self._motion), self._robot.footprint))

    def _update(self, scan: PlanarScan) -> None:
        if scan.stamp_ns <= self._newest_ns:
            self.ctx.log(
                "SCAN_OUT_OF_ORDER", "a scan is older than the last one and is left out", scan_stamp_ns=scan.stamp_ns
            )
            return
        self._newest_ns = scan.stamp_ns
        scan = self._without_movers(scan)
        is_telling = self._trust.may_match(scan.points)
        taken = scan if is_telling else replace(scan, points=scan.points[:0], intensities=None, starts=None)
        result = self.slam.update(taken, may_insert=self._trust.may_map)
        self._trust.update(
            scan.stamp_ns, result.odom_from_base, result.map_from_base.transform(scan.points), result.score
        )
        self._tell_trust()
        self._publish_result(result)
        if self._config.publishes_matched_scan:
            self._publish_scan(scan, result)
        if self._published_version == 0:
            self._publish_map()
        if not self._has_job:
            self._work(self.slam.take_background_work())

    def _without_movers(self, scan: PlanarScan) -> PlanarScan:
        """Return the scan without what was seen of people and whatever else moves: it would stay in the map where they have been, and shut ways."""
        movers = self._movers
        if movers is None or len(movers.points) == 0 or scan.stamp_ns - movers.stamp_ns > MOVERS_AGE_NS:
            return scan
        try:
            base_from_odom = self._motion.planar_at(scan.stamp_ns).inverse()
        except StaleInputError:
            return scan
        places = base_from_odom.transform(movers.points[:, :2])
        gaps = np.hypot(*(scan.points[:, None, :] - places[None, :, :]).transpose(2, 0, 1))
        return scan.of_returns(np.flatnonzero(gaps.min(axis=1) > PERSON))

    def _tell_trust(self) -> None:
        trust = self._trust
        if trust.state is self._told_trust:
            return
        self._told_trust = trust.state
        text = trust.text or "the scans agree with the map again"
        self.ctx.log(f"SLAM_{trust.state.name}", text)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, f"SLAM_{trust.state.name}", text, "{}"))

    def _work(self, job: Callable[[], JobResult] | None) -> None:
        self._has_job = job is not None
        if job is not None:
            self.ctx.background(job, self._config.background_duration, self._worked)

    def _worked(self, result: JobResult) -> None:
        self.slam.commit(result)
        self._has_job = False
        if self._finishing is not None:
            self._go_on_finishing(self._finishing)

    def _on_finish(self, handle: Finishing) -> None:
        self._finishing = handle
        self._final_work = self.slam.final_work()
        if not self._has_job:
            self._go_on_finishing(handle)

    def _on_finish_cancelled(self, handle: Finishing) -> None:
        if self._finishing is handle:
            self._finishing = None

    def _go_on_finishing(self, handle: Finishing) -> None:
        self._work(next(self._final_work, None))
        if not self._has_job:
            self._finishing = None
            self._publish_map()
            handle.succeed(Nothing())

    def _publish_result(self, result: Slam2dResult) -> None:
        stamp = result.stamp_ns
        edge = TransformStamped(stamp, "map", "odom", SE3.from_se2(result.map_from_odom))
        self.ctx.publish(TRANSFORMS, Transforms(stamp, (edge,)))
        self.ctx.publish(SLAM_POSE, PoseStamped(stamp, "map", SE3.from_se2(result.map_from_base)))
        self.ctx.publish(
            SLAM_HEALTH,
            SlamHealth(
                stamp,
                result.score,
                result.inlier_ratio,
                result.degeneracy,
                result.covariance,
                self.slam.submaps,
                self.slam.nodes,
                self.slam.loop_closures,
            ),
        )

    def _publish_scan(self, scan: PlanarScan, result: Slam2dResult) -> None:
        n = len(scan.points)
        points = np.zeros((n, 3), np.float32)
        points[:, :2] = result.map_from_base.transform(scan.points)
        zeros = np.zeros(n, np.float32)
        self.ctx.publish(
            MATCHED_SCAN, PointCloud(scan.stamp_ns, "map", points, zeros, zeros.copy(), np.zeros(n, np.uint16))
        )

    def _publish_map(self) -> None:
        if self.slam.map_version == self._published_version:
            return
        self._published_version = self.slam.map_version
        spec, occupancy = self.slam.render_map()
        self._trust.set_map(spec, occupancy)
        self.ctx.publish(MAP, OccupancyGrid(self._newest_ns, "map", spec, occupancy))

    def _save_map(self, request: SaveMapRequest) -> Nothing:
        save_slam_map(Path(request.stem), self.slam)
        return Nothing()


def save_slam_map(stem: Path, slam: Slam2d) -> Path:
    """Save a map with how far it is bent, as a sample of its keyframes tells; returns the file that describes it."""
    spec, occupancy = slam.render_map()
    bend = None
    if (occupancy == OCC_OCCUPIED).any() and (occupancy == OCC_FREE).any():
        chosen = range(0, slam.nodes, max(1, math.ceil(slam.nodes / BEND_KEYFRAMES)))
        scans = [(slam.points_of_node(k), slam.map_from_node(k)) for k in chosen]
        bend = measure_bend(occupancy, spec, scans)
    _, description = save_map(stem, spec, occupancy, None if bend is None else (bend.position, bend.yaw))
    return description


def with_own_floor(scan: PlanarScan, footprint: NDArray[np.float64]) -> PlanarScan:
    """Return the scan with rays from the middle of the base to its outline, `footprint` (N, 2) counter-clockwise around it: it stands on free floor.

    Scanners at the corners of a body never see what is under it, and a robot that starts in a narrow corridor would stand on an unknown place.
    """
    angle = np.arange(OWN_RAYS) * (2.0 * np.pi / OWN_RAYS)
    towards = np.column_stack((np.cos(angle), np.sin(angle)))
    edge = np.roll(footprint, -1, axis=0) - footprint
    normals = np.column_stack((edge[:, 1], -edge[:, 0])) / np.hypot(*edge.T)[:, None]
    ahead = towards @ normals.T
    offsets = (normals * footprint).sum(axis=1)
    reach = np.where(ahead > 1e-9, offsets / np.maximum(ahead, 1e-9), np.inf).min(axis=1)
    around = (reach[:, None] * towards).astype(np.float32)
    _, starts = scan.ray_starts()
    if len(starts) != len(scan.free_points):
        starts = np.repeat(starts, len(scan.free_points), axis=0)
    free_starts = np.concatenate((starts, np.zeros_like(around))).astype(np.float32)
    return replace(scan, free_points=np.concatenate((scan.free_points, around)), free_starts=free_starts)


def cloud_config(slam: Slam2dConfig | None = None) -> Slam2dNodeConfig:
    """Return the node's configuration for a robot with a 3-D scanner: 10 m range, obstacles between 0.1 and 0.6 m."""
    planar = PlanarConfig(range_min=0.3, range_max=10.0, free_length=10.0)
    return replace(Slam2dNodeConfig(), uses_cloud=True, planar=planar, slam=slam or Slam2dConfig())
