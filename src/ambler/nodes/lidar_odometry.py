"""Odometry on the bus, out of clouds and inertial measurements: `odometry` and odom -> base at the IMU's rate, the registered cloud at the scan's."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Imu, Odometry, Path, PointCloud, Status, Transforms, TransformStamped
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se3 import SE3
from ambler.lio.base_odometry import BaseOdometry, Registered
from ambler.lio.config import LioConfig
from ambler.lio.doctor import StartExamination
from ambler.lio.health import LioResult
from ambler.lio.keyframes import Keyframe
from ambler.lio.loop_closure import LoopClosure, laid_points
from ambler.lio.state import to_se3
from ambler.lio.thin_cloud import thinned
from ambler.perception.air_filter import AirFilter, AirFilterConfig, CloudLooks
from ambler.recordings.cloud_scan import CloudScan
from ambler.runtime.node import Node, Offers, Topics, WorkKind
from ambler.runtime.tasks import SAVE_CLOUD, Nothing, SaveMapRequest
from ambler.runtime.topics import (
    CLOUD,
    IMU,
    MAP_CORRECTIONS,
    ODOMETRY,
    REGISTERED_CLOUD,
    REGISTERED_VIEW,
    STATUS,
    TRAJECTORY,
    TRANSFORMS,
    WHEEL_ODOMETRY,
)
from ambler.wire.cloud_files import CLOUD_SUFFIX, write_cloud

REGISTRATION = 0.02  # simulated seconds that a scan takes in the background
EXAMINATION = 1.0
EDGE_BEAMS = 4.0  # of the cloud that is told: a kerb's edge is met by few beams and must not come and go like dust
CLOSING = 0.2  # simulated seconds in which a keyframe is matched and the graph solved
MAP_PERIOD = 10  # scans between two tellings of where odom lies in the map


@dataclass(frozen=True, slots=True, eq=False)
class _Closed:
    """What loop closure said after a scan: the correction in the filter's map, how many closures there are, and the keyframes with their poses (4, 4) as
    they are now."""

    corrected_from_map: SE3
    closures: int
    keyframes: tuple[Keyframe, ...]
    poses: tuple[NDArray[np.float64], ...]

    @property
    def places(self) -> NDArray[np.float64]:
        """Where the keyframes are, (K, 3)."""
        return np.array(self.poses)[:, :3, 3]

    @property
    def corrections(self) -> list[SE3]:
        """The correction in the filter's map at each keyframe."""
        moved = [m @ np.linalg.inv(f.odom_from_keyframe) for f, m in zip(self.keyframes, self.poses, strict=True)]
        return [to_se3(m[:3, 3], m[:3, :3]) for m in moved]


class LidarOdometryNode(Node):
    """Runs `BaseOdometry` with the robot's first LiDAR and first IMU, at their places on the robot.

    While nothing can be told (before the start, without scans that fit, or without an IMU) nothing is published, odometry grows stale, and the gate stops the
    robot. Measurements that contradict one another end the node with their reason. With `closes_loops` it also tells map -> odom, for robots that nothing else
    localizes, the corrected trajectory, and where odom lay in the map at each keyframe, as loop closures have it now, and serves SAVE_CLOUD: what its keyframes saw, in the map, to be localized in later.
    """

    name = "odometry"
    inputs = (CLOUD, IMU)
    optional_inputs: Topics = (WHEEL_ODOMETRY,)
    outputs: Topics = (ODOMETRY, TRANSFORMS, REGISTERED_CLOUD, REGISTERED_VIEW, STATUS)
    latency = 5e-4

    def __init__(
        self,
        robot: RobotModel,
        config: LioConfig | None = None,
        air: AirFilterConfig | None = None,
        *,
        closes_loops: bool = False,
    ) -> None:
        config = config or LioConfig()
        self._loops = LoopClosure(config) if closes_loops and config.loops.is_used else None
        self._map_from_odom = SE3()
        self._scans = self._closures = self._clouds = 0
        self._closed_last: _Closed | None = None
        self.serves: Offers = ()
        if self._loops is not None:
            self.outputs = (*type(self).outputs, TRAJECTORY, MAP_CORRECTIONS)
            self.serves = (SAVE_CLOUD,)
        mounts = {mount.kind: mount for mount in reversed(robot.sensors)}
        if SensorKind.CLOUD not in mounts or SensorKind.IMU not in mounts:
            raise BadInputError(f"{robot.name}: LiDAR-inertial odometry needs a LiDAR that gives clouds, and an IMU")
        self._lidar, self._imu = mounts[SensorKind.CLOUD], mounts[SensorKind.IMU]
        imu_from_base = self._imu.base_from_sensor.inverse()
        imu_from_lidar = imu_from_base @ self._lidar.base_from_sensor
        air = air or AirFilterConfig()
        looks = CloudLooks(air)
        airs = AirFilter(air, looks), AirFilter(replace(air, beams=max(air.beams, EDGE_BEAMS)), looks)
        self._odometry = BaseOdometry(config, imu_from_lidar, imu_from_base, airs)
        self._view = config.view
        self._examination = StartExamination(config, imu_from_lidar)
        self._is_registering = self._is_examining = False
        self._state = ""

    def start(self) -> None:
        """Subscribe to LiDAR, IMU and wheels."""
        self.ctx.subscribe(CLOUD, self._on_cloud)
        self.ctx.subscribe(IMU, self._on_imu)
        self.ctx.subscribe(WHEEL_ODOMETRY, self._on_wheels)
        if self._loops is not None:
            self.ctx.serve(SAVE_CLOUD, self._save_cloud)

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
            self._close_loops(registered.result)
        elif self._odometry.is_astray:
            self._say("ASTRAY", {})
        self._go_on()

    def _close_loops(self, result: LioResult) -> None:
        if self._loops is None:
            return
        self.ctx.background(partial(_close, self._loops, result), CLOSING, self._closed, WorkKind.MAPPING)
        if self._scans % MAP_PERIOD == 0:
            edge = TransformStamped(result.stamp_ns, "map", "odom", self._map_from_odom)
            self.ctx.publish(TRANSFORMS, Transforms(result.stamp_ns, (edge,)))
        self._scans += 1

    def _closed(self, closed: _Closed | None) -> None:
        """Take what a new keyframe changed."""
        if closed is None:
            return
        self._closed_last = closed
        self._map_from_odom = self._odometry.between_odoms(closed.corrected_from_map)
        places = self._odometry.in_odom(closed.places)
        ahead = np.diff(places[:, :2], axis=0, append=places[-1:, :2])
        poses = np.column_stack([places[:, :2], np.arctan2(ahead[:, 1], ahead[:, 0])]).astype(np.float64)
        self.ctx.publish(TRAJECTORY, Path(self.ctx.now_ns, "map", poses))
        if closed.closures > self._closures or len(closed.keyframes) <= 2:  # else the new keyframe is as the last one
            self._tell_corrections(closed)
        if closed.closures > self._closures:
            self.ctx.log("LIO_LOOP_CLOSED", f"{closed.closures} loop closures", closures=closed.closures)
        self._closures = closed.closures

    def _tell_corrections(self, closed: _Closed) -> None:
        edges = tuple(
            TransformStamped(frame.stamp_ns, "map", "odom", self._odometry.between_odoms(correction))
            for frame, correction in zip(closed.keyframes, closed.corrections, strict=True)
        )
        self.ctx.publish(MAP_CORRECTIONS, Transforms(self.ctx.now_ns, edges))

    def _save_cloud(self, request: SaveMapRequest) -> Nothing:
        """Write what the keyframes saw, `<stem>.cloud.pcd` in the map's frame; what was seen since the last one is left out."""
        closed = self._closed_last
        if closed is None:
            raise BadInputError("there is no keyframe yet, so no cloud to save")
        points = self._odometry.in_odom(laid_points(closed.keyframes, closed.poses))
        stem = FilePath(request.stem)
        write_cloud(stem.with_name(stem.name + CLOUD_SUFFIX), points)
        return Nothing()

    def _tell_cloud(self, registered: Registered) -> None:
        """Publish the whole cloud for the robot's own nodes, and now and then a thin one for recordings and people."""
        scan, numbers = registered.scan, registered.numbers
        points, cloud = self._odometry.in_odom(registered.points), scan.cloud
        late = np.zeros(len(points), np.float32)
        whole = PointCloud(scan.end_ns, "odom", points, cloud.intensity[numbers], late, cloud.ring[numbers])
        self.ctx.publish(REGISTERED_CLOUD, whole)
        if self._clouds % max(1, self._view.every) == 0:
            self.ctx.publish(REGISTERED_VIEW, thinned(whole, self._view.cell))
        self._clouds += 1

    def _tell_state(self, registered: Registered) -> None:
        """Say how a scan fits, with its numbers."""
        health = registered.result.health
        state = "LOST" if health.is_lost else "DEGENERATE" if health.is_degenerate else "GOOD"
        fields = {"inlier_ratio": health.inlier_ratio, "residual_m": health.residual_m, "weakest": health.weakest}
        self._say(state, fields)

    def _say(self, state: str, fields: dict[str, float | None]) -> None:
        """Tell people and the log a state once, when it begins."""
        if state == self._state:
            return
        self._state = state
        text = {
            "LOST": "the scan fits nothing in the map: odometry coasts",
            "ASTRAY": "nothing was measured for a while: where it is is looked for in the map, and no odometry is told",
            "DEGENERATE": "a direction is left to IMU and wheels: the place says too little",
            "GOOD": "scans fit the map",
        }[state]
        self.ctx.log(f"LIO_{state}", text, **fields)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, f"LIO_{state}", text, json.dumps(fields)))

    def _examine(self, scan: CloudScan) -> None:
        """Look in the background at the first turns, whether LiDAR and IMU agree."""
        work = self._examination.add(scan)
        if work is not None:
            self.ctx.background(work, EXAMINATION, self._examination.take, WorkKind.MAPPING)


def _close(loops: LoopClosure, result: LioResult) -> _Closed | None:
    """Work of the background: None where no keyframe was completed."""
    before = len(loops.keyframes)
    loops.add(result)
    if len(loops.keyframes) == before:
        return None
    poses = tuple(pose.copy() for pose in loops.map_from_keyframes)
    return _Closed(loops.map_from_odom, len(loops.closures), tuple(loops.keyframes), poses)
