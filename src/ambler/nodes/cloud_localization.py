"""Localization in a saved cloud on the bus: registered clouds and odometry in; map -> odom and the pose with its covariance out, once the place was found."""

from __future__ import annotations

import json
from collections import deque
from functools import partial

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.messages import Odometry, PointCloud, PoseStamped, Status, Transforms, TransformStamped
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se3 import SE3
from ambler.lio.cloud_localizer import CloudLocalizer, CloudPose
from ambler.lio.cloud_map import CloudMap
from ambler.lio.cloud_relocalizer import CloudState
from ambler.lio.config import CloudLocalizerConfig
from ambler.lio.measurements import skew
from ambler.lio.sight import SeenScan
from ambler.lio.thin_cloud import thinned
from ambler.runtime.node import Node, Topics, WorkKind
from ambler.runtime.topics import LOCALIZED_POSE, MAP_CLOUD, ODOMETRY, REGISTERED_CLOUD, SET_POSE, STATUS, TRANSFORMS

FOLLOWING, SEARCHING = 0.05, 1.0  # simulated seconds that a batch of scans takes in the background
KEPT = 2.0  # seconds of odometry in which a cloud's pose is looked for
WAITING_MOST = 60  # scans that wait for a search: it looks at no more than 40
SHOWN_CELL = 0.4  # metres between the points of the map that viewers get


class CloudLocalizationNode(Node):
    """Looks for the place in `cloud_map` and follows it (`CloudLocalizer`). `guess` is map_from_base at the first cloud; a pose set by people while it runs begins the
    search anew there. Until the place is found, and after it is lost, neither map -> odom nor the pose is told: who needs it waits. `status` says CLOUD_<state> when that changes.

    Clouds wait while a search goes on, which in a large map takes seconds; odometry goes on meanwhile.
    """

    name = "localization"
    inputs = (REGISTERED_CLOUD, ODOMETRY)
    optional_inputs: Topics = (SET_POSE,)
    outputs: Topics = (TRANSFORMS, LOCALIZED_POSE, STATUS, MAP_CLOUD)
    latency = 5e-4

    def __init__(
        self,
        robot: RobotModel,
        cloud_map: CloudMap,
        config: CloudLocalizerConfig | None = None,
        guess: SE3 | None = None,
    ) -> None:
        mounts = robot.of_kind(SensorKind.CLOUD)
        if not mounts:
            raise BadInputError(f"{robot.name}: localization in a cloud needs a LiDAR that gives clouds")
        self._base_from_lidar = mounts[0].base_from_sensor
        self._map = cloud_map
        self._config = config or CloudLocalizerConfig()
        self._localizer = CloudLocalizer(cloud_map, self._config, self._of_lidar(guess))
        self._odometry: deque[Odometry] = deque()
        self._waiting: deque[SeenScan] = deque(maxlen=WAITING_MOST)
        self._is_busy = False
        self._guess: SE3 | None = None
        self._state: CloudState | None = None

    def start(self) -> None:
        """Subscribe, and show the map."""
        self.ctx.subscribe(REGISTERED_CLOUD, self._on_cloud)
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(SET_POSE, self._on_set_pose)
        self.ctx.after(0.0, self._show_map)

    def _show_map(self) -> None:
        points = self._map.points.astype(np.float32)
        n = len(points)
        zeros = np.zeros(n, np.float32)
        cloud = PointCloud(self.ctx.now_ns, "map", points, zeros, zeros.copy(), np.zeros(n, np.uint16))
        self.ctx.publish(MAP_CLOUD, thinned(cloud, SHOWN_CELL))

    def _on_odometry(self, odometry: Odometry) -> None:
        self._odometry.append(odometry)
        while odometry.stamp_ns - self._odometry[0].stamp_ns > KEPT * 1e9:
            self._odometry.popleft()

    def _on_set_pose(self, pose: PoseStamped) -> None:
        """People say where the base is; in the map's frame only."""
        if pose.frame == "map":
            self._guess = self._of_lidar(pose.pose)

    def _on_cloud(self, cloud: PointCloud) -> None:
        odom_from_base = self._pose_at(cloud.stamp_ns)
        if odom_from_base is None:
            return
        odom_from_lidar = odom_from_base @ self._base_from_lidar
        few = thinned(cloud, self._config.match.fine_cell).points
        points = np.asarray(odom_from_lidar.inverse().transform(few), np.float64)
        self._waiting.append(SeenScan(cloud.stamp_ns, odom_from_lidar, points))
        self._go_on()

    def _pose_at(self, stamp_ns: int) -> SE3 | None:
        """Return odom_from_base at the end of a scan, from the odometry around it."""
        after = next((k for k, o in enumerate(self._odometry) if o.stamp_ns >= stamp_ns), None)
        if after is None:
            return self._odometry[-1].pose if self._odometry and self._is_near(stamp_ns) else None
        late = self._odometry[after]
        if after == 0:
            return late.pose if late.stamp_ns == stamp_ns else None
        early = self._odometry[after - 1]
        share = (stamp_ns - early.stamp_ns) / (late.stamp_ns - early.stamp_ns)
        return early.pose.interpolate(late.pose, share)

    def _is_near(self, stamp_ns: int) -> bool:
        return stamp_ns - self._odometry[-1].stamp_ns < 0.05 * 1e9

    def _go_on(self) -> None:
        """Give what waits to the background, unless something is there."""
        if self._is_busy or not self._waiting:
            return
        if self._guess is not None:
            self._localizer.search_again(self._guess)
            self._guess = None
        batch, self._is_busy = tuple(self._waiting), True
        self._waiting.clear()
        duration = FOLLOWING if self._localizer.is_tracking else SEARCHING
        self.ctx.background(partial(_follow, self._localizer, batch), duration, self._followed, WorkKind.MAPPING)

    def _followed(self, poses: tuple[CloudPose, ...]) -> None:
        self._is_busy = False
        for pose in poses:
            self._tell_state(pose)
        if poses[-1].map_from_odom is not None:
            edge = TransformStamped(poses[-1].stamp_ns, "map", "odom", poses[-1].map_from_odom)
            self.ctx.publish(TRANSFORMS, Transforms(poses[-1].stamp_ns, (edge,)))
            self._tell_pose(poses[-1])
        self._go_on()

    def _tell_pose(self, pose: CloudPose) -> None:
        """Say where the base was in the map at the end of a scan."""
        if pose.map_from_imu is None or pose.map_from_odom is None or pose.covariance is None or not self._odometry:
            return
        newest = self._odometry[-1]
        map_from_base = pose.map_from_imu @ self._base_from_lidar.inverse()
        lever = np.subtract(map_from_base.translation, pose.map_from_imu.translation)
        turned = pose.map_from_odom.matrix()[:3, :3]
        carried = np.zeros((6, 6))  # from axes of odom at the LiDAR to axes of the map at the base
        carried[:3, :3] = carried[3:, 3:] = turned
        carried[:3, 3:] = -skew(lever) @ turned
        told = (carried @ pose.covariance @ carried.T, newest.twist_covariance)
        velocity = (newest.linear, newest.angular)
        self.ctx.publish(LOCALIZED_POSE, Odometry(pose.stamp_ns, "map", "base", map_from_base, *velocity, *told))

    def _tell_state(self, pose: CloudPose) -> None:
        """Say once what has changed."""
        if pose.state is self._state:
            return
        self._state = pose.state
        code, text = f"CLOUD_{pose.state.name}", pose.state.value
        fields = {} if pose.match is None else {"quality": pose.match.quality}
        self.ctx.log(code, text, **fields)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text, json.dumps(fields)))

    def _of_lidar(self, map_from_base: SE3 | None) -> SE3 | None:
        return None if map_from_base is None else map_from_base @ self._base_from_lidar


def _follow(localizer: CloudLocalizer, batch: tuple[SeenScan, ...]) -> tuple[CloudPose, ...]:
    """Work of the background."""
    return tuple(localizer.update(scan) for scan in batch)
