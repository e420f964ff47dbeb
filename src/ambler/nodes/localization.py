"""Localization in a known map on the bus: map, scans and odometry in; map -> odom and the pose with its covariance out."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import STILL, BaseMotion
from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.messages import (
    LaserScan,
    OccupancyGrid,
    Odometry,
    PointCloud,
    PoseStamped,
    Status,
    Transforms,
    TransformStamped,
)
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.localization.localizer import Estimate, Localizer, Observation
from ambler.localization.relocalizer import Relocalizer, RelocalizerConfig
from ambler.localization.supervisor import LocalizationState, SearchResult, Supervision, Supervisor, SupervisorConfig
from ambler.localization.surface_map import SurfaceMap
from ambler.perception.level_mount import Mount, level_mount
from ambler.perception.planar import PlanarConfig, cloud_to_points, scan_duration, scan_to_points
from ambler.runtime.node import Node, Topics
from ambler.runtime.tasks import RELOCALIZE, Nothing
from ambler.runtime.topics import (
    CLOUD,
    LOCALIZED_POSE,
    MAP,
    MERGED_CLOUD,
    ODOMETRY,
    SCAN,
    SET_POSE,
    STATUS,
    TRANSFORMS,
)

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Source = Literal["scan", "cloud", "both", "points"]
_PLANE = [0, 1, 5]
_MOST_WAITING = 20


@dataclass(frozen=True, slots=True)
class LocalizationNodeConfig:
    """`source`: the merged scan, the merged cloud, both (the cloud of the same instant joins the scan), or the `points` of a scanner of
    many rings in the height band of `planar`. `initial_pose`:
    where the robot is switched on, None to search the whole map. `covariance` is that of poses set by people (x, y, yaw).
    `map_bend` (m along each axis, rad): how far the map is bent, which is told on top of what the matching tells; a map that SLAM saved says it, for
    a plan it is nothing. `search_duration`, `map_duration`: simulated seconds that a search of the whole map, and the preparation of a map, take in the background."""

    source: Source = "scan"
    initial_pose: SE2 | None = None
    covariance: tuple[float, float, float] = (0.25, 0.25, 0.07)
    map_bend: tuple[float, float] = (0.0, 0.0)
    search_duration: float = 0.25
    map_duration: float = 0.5
    planar: PlanarConfig = field(default_factory=PlanarConfig)
    relocalizer: RelocalizerConfig = field(default_factory=RelocalizerConfig)
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)


class LocalizationNode(Node):
    """Runs any `Localizer` under a `Supervisor`. `make_localizer` builds it for each new map.

    While the robot is lost nothing is published but `status`, so the last transform grows stale and the consumers stop.
    """

    name = "localization"
    inputs: Topics = (MAP, ODOMETRY)
    optional_inputs = (SET_POSE,)
    outputs = (TRANSFORMS, LOCALIZED_POSE, STATUS)
    serves = (RELOCALIZE,)
    latency = 0.005

    def __init__(
        self,
        robot: RobotModel,
        make_localizer: Callable[[SurfaceMap], Localizer],
        config: LocalizationNodeConfig | None = None,
    ) -> None:
        self._robot = robot
        self._make_localizer = make_localizer
        self._config = config or LocalizationNodeConfig()
        wanted: dict[Source, Topics] = {
            "scan": (SCAN,),
            "cloud": (MERGED_CLOUD,),
            "both": (SCAN, MERGED_CLOUD),
            "points": (CLOUD,),
        }
        self.inputs = (MAP, ODOMETRY, *wanted[self._config.source])
        self._motion = BaseMotion()
        self._odometry: Odometry | None = None
        self._map: OccupancyGrid | None = None
        self._is_searching = False
        self._given: tuple[int, SE2] | None = None
        self._waiting: deque[LaserScan | PointCloud] = deque()
        self._cloud: PointCloud | None = None
        self._newest_ns = -1
        self._state: LocalizationState | None = None
        self.supervisor: Supervisor | None = None

    def start(self) -> None:
        """Subscribe to the map, the sensors and poses set by people."""
        self.ctx.subscribe(MAP, self._on_map)
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        for topic in self.inputs[2:]:
            self.ctx.subscribe(topic, self._on_cloud if topic is MERGED_CLOUD else self._wait)
        self.ctx.subscribe(SET_POSE, self._on_set_pose)
        self.ctx.serve(RELOCALIZE, self._relocalize)

    def _on_map(self, message: OccupancyGrid) -> None:
        """Prepare a map in the background; the newest one counts."""
        self._map = message
        config = self._config

        def prepare() -> tuple[SurfaceMap, Localizer, Relocalizer]:
            surfaces = SurfaceMap.from_occupancy(message.data, message.spec)
            return surfaces, self._make_localizer(surfaces), Relocalizer(surfaces, config.relocalizer)

        self.ctx.background(prepare, config.map_duration, partial(self._use_map, message))

    def _use_map(self, message: OccupancyGrid, parts: tuple[SurfaceMap, Localizer, Relocalizer]) -> None:
        """Localize in a prepared map; the pose believed in the last one is kept."""
        if message is not self._map:
            return
        before, (surfaces, localizer, relocalizer) = self.supervisor, parts
        if before is not None and before.localizer.estimate is not None:
            known = before.localizer.estimate
            localizer.set_pose(known.stamp_ns, self._odometry_of(known), known.map_from_base, known.covariance)
        self.supervisor = Supervisor(surfaces, localizer, relocalizer, self._config.supervisor)
        if self._config.initial_pose is not None and localizer.estimate is None:
            self._set_pose(self.supervisor, message.stamp_ns, self._config.initial_pose)

    def _odometry_of(self, known: Estimate) -> SE2:
        """The odometry of an estimate's instant, or the newest."""
        if self._motion.covers(known.stamp_ns, known.stamp_ns):
            return self._motion.planar_at(known.stamp_ns)
        return self._motion.newest or SE2()

    def _set_pose(self, supervisor: Supervisor, stamp_ns: int, map_from_base: SE2) -> None:
        """Believe a pose that a person gave; before the first odometry it waits for it, because where odometry begins is not known."""
        odom_from_base = self._motion.newest
        if odom_from_base is None:
            self._given = (stamp_ns, map_from_base)
            return
        self._given = None
        supervisor.localizer.set_pose(stamp_ns, odom_from_base, map_from_base, np.diag(self._config.covariance))
        supervisor.trust()

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry = message
        self._motion.add(message)
        if self._given is not None and self.supervisor is not None:
            self._set_pose(self.supervisor, *self._given)
        self._use_waiting()

    def _on_cloud(self, message: PointCloud) -> None:
        self._cloud = message
        if self._config.source == "cloud":
            self._wait(message)
        else:
            self._use_waiting()

    def _on_set_pose(self, message: PoseStamped) -> None:
        if self.supervisor is None:
            self._tell("NO_MAP", "a pose was set before there is a map", {})
            return
        self._set_pose(self.supervisor, message.stamp_ns, message.pose.to_se2())

    def _relocalize(self, _: Nothing) -> Nothing:
        """Search the whole map, whatever is believed now."""
        if self.supervisor is None:
            raise BadInputError("there is no map to search")
        self.supervisor.distrust("a search of the whole map was asked for")
        return Nothing()

    def _wait(self, message: LaserScan | PointCloud) -> None:
        """Keep a scan until odometry has reached its instant."""
        self._waiting.append(self._robot.timed(message))
        if len(self._waiting) > _MOST_WAITING:
            self._waiting.popleft()
            self.ctx.log("ODOMETRY_MISSING", "a scan is left out: odometry does not reach its instant")
        self._use_waiting()

    def _use_waiting(self) -> None:
        newest = self._motion.newest_ns
        while self._waiting and newest is not None and self._waiting[0].stamp_ns <= newest:
            if self._config.source == "both" and len(self._waiting) == 1 and not self._has_cloud_of(self._waiting[0]):
                return  # the cloud follows its scan; when it is late, the next scan ends the wait
            message = self._waiting.popleft()
            if message.stamp_ns <= self._newest_ns:
                self.ctx.log("SCAN_OUT_OF_ORDER", "a scan is older than the last one and is left out")
                continue
            self._newest_ns = message.stamp_ns
            if self.supervisor is not None:
                self._update(self.supervisor, message)

    def _update(self, supervisor: Supervisor, message: LaserScan | PointCloud) -> None:
        stamp = message.stamp_ns
        try:
            odom_from_base = self._motion.planar_at(stamp)
        except StaleInputError as error:
            self.ctx.log("ODOMETRY_MISSING", str(error))
            return
        points, intensities = self._points_of(message)
        self._tell_result(supervisor.step(Observation(stamp, odom_from_base, points, intensities)))
        if not self._is_searching:
            work = supervisor.take_search()
            if work is not None:
                self._is_searching = True
                self.ctx.background(work, self._config.search_duration, partial(self._searched, supervisor))

    def _searched(self, supervisor: Supervisor, found: SearchResult) -> None:
        """Take what a search in the background found, unless there is another map by now."""
        self._is_searching = False
        result = supervisor.commit(found) if supervisor is self.supervisor else None
        if result is not None:
            self._tell_result(result)

    def _tell_result(self, result: Supervision) -> None:
        self._tell_state(result)
        is_believed = result.state in (LocalizationState.TRACKING, LocalizationState.DEGRADED)
        if is_believed and result.estimate is not None and self._motion.covers(result.stamp_ns, result.stamp_ns):
            self._publish(result.estimate, self._motion.planar_at(result.stamp_ns))

    def _has_cloud_of(self, scan: LaserScan | PointCloud) -> bool:
        return self._cloud is not None and self._cloud.stamp_ns >= scan.stamp_ns

    def _points_of(self, message: LaserScan | PointCloud) -> tuple[F32, F32 | None]:
        """Points (N, 2) in the base frame and their intensities, of the scan, of the cloud, or of both."""
        if isinstance(message, PointCloud):
            if self._config.source == "points":
                return self._points_in_band(message), None
            return np.array(message.points[:, :2], np.float32), np.array(message.intensity, np.float32)
        mount = SE3() if message.frame == "base" else self._mount(message)
        scan = scan_to_points(message, mount, self._sweep(message), self._config.planar)
        cloud = self._cloud
        if cloud is not None and cloud.stamp_ns == message.stamp_ns:
            return np.concatenate([scan.points, cloud.points[:, :2]]), None
        return scan.points, scan.intensities

    def _points_in_band(self, message: PointCloud) -> F32:
        """What a scanner of many rings saw in the height band, float32 (N, 2) in the base frame, levelled as the body leans."""
        scan = cloud_to_points(message, self._mount(message), self._sweep(message), self._config.planar)
        return scan.points.astype(np.float32)

    def _mount(self, message: LaserScan | PointCloud) -> Mount:
        """Where the sensor was during the sweep, level however the body leaned."""
        mount = self._robot.sensor(message.frame).base_from_sensor
        return level_mount(mount, self._motion, message.stamp_ns, scan_duration(message))

    def _sweep(self, message: LaserScan | PointCloud) -> F64:
        """How the base moved during the sweep; not at all when odometry does not reach there."""
        return self._motion.sweep(message.stamp_ns, scan_duration(message), STILL)

    def _publish(self, estimate: Estimate, odom_from_base: SE2) -> None:
        stamp = estimate.stamp_ns
        map_from_odom = estimate.map_from_base @ odom_from_base.inverse()
        edge = TransformStamped(stamp, "map", "odom", SE3.from_se2(map_from_odom))
        self.ctx.publish(TRANSFORMS, Transforms(stamp, (edge,)))
        pose_covariance = twist_covariance = np.diag([1e-6] * 6)
        position, yaw = self._config.map_bend
        bend = np.diag([position**2, position**2, yaw**2])
        pose_covariance[np.ix_(_PLANE, _PLANE)] = estimate.covariance + bend
        linear, angular = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if self._odometry is not None:
            linear, angular, twist_covariance = (
                self._odometry.linear,
                self._odometry.angular,
                self._odometry.twist_covariance,
            )
        self.ctx.publish(
            LOCALIZED_POSE,
            Odometry(
                stamp,
                "map",
                "base",
                SE3.from_se2(estimate.map_from_base),
                linear,
                angular,
                pose_covariance,
                twist_covariance,
            ),
        )

    def _tell_state(self, result: Supervision) -> None:
        if result.state is self._state:
            return
        self._state = result.state
        fields = {"explained": round(result.explained, 3), "through": round(result.through, 3)}
        if result.relocalization is not None:
            fields["possible"] = len(result.relocalization.hypotheses)
        self._tell(f"LOCALIZATION_{result.state.name}", f"{result.state.value}: {result.text}", fields)

    def _tell(self, code: str, text: str, fields: dict[str, float]) -> None:
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text, json.dumps(fields)))
