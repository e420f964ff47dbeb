"""Glass on the bus: raw scans, or clouds, and judged echoes in, segments of glass out; saves them beside the map."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError
from ambler.core.messages import GlassWalls, JudgedEcho, LaserScan, OccupancyGrid, Odometry, PointCloud, Transforms
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.nodes.devices.table import topics_of_kind
from ambler.perception.glass import SpecularConfig, SpecularDetector, upright
from ambler.perception.glass_map import GlassMap, GlassMapConfig, seen_through_glass, twist_of_sensor
from ambler.perception.level_ring import level_ring
from ambler.runtime.node import Node, Service, Task
from ambler.runtime.tasks import SAVE_GLASS, Nothing, SaveMapRequest
from ambler.runtime.topics import ECHOES, GLASS, MAP, ODOMETRY, SCAN, TRANSFORMS, Topic
from ambler.wire.glass_files import GlassFile, save_glass

PERIOD = 0.5


class GlassMapperNode(Node):
    """Publishes GLASS when what it believes has changed; serves SAVE_GLASS."""

    name: str = "glass_mapper"
    inputs: tuple[Topic[Any], ...] = (SCAN, ODOMETRY, TRANSFORMS)
    optional_inputs: tuple[Topic[Any], ...] = (MAP,)
    outputs: tuple[Topic[Any], ...] = (GLASS,)
    serves: tuple[Service[Any, Any] | Task[Any, Any, Any], ...] = (SAVE_GLASS,)
    latency: float = 0.01

    def __init__(
        self, robot: RobotModel, specular: SpecularConfig | None = None, config: GlassMapConfig | None = None
    ) -> None:
        self._robot = robot
        self._spatial_mounts = {m.frame: m.base_from_sensor for m in robot.sensors}
        self._mounts = {frame: mount.to_se2() for frame, mount in self._spatial_mounts.items()}
        self._motion = BaseMotion()
        self._twist = np.zeros(3)
        self._detector = SpecularDetector(specular)
        self.glass = GlassMap(config)
        self._map_from_odom: SE2 | None = None
        self._map: OccupancyGrid | None = None
        self._told: GlassWalls | None = None
        self._newest_ns = 0
        scans, clouds = (topics_of_kind(robot, kind) for kind in (SensorKind.SCAN, SensorKind.CLOUD))
        self._scan_topics = scans
        self._cloud_topics = () if scans else clouds
        echoes = (ECHOES,) if robot.rangers else ()
        self.inputs = (*self._scan_topics, *self._cloud_topics, ODOMETRY, TRANSFORMS, *echoes)

    def start(self) -> None:
        """Subscribe, serve, and tell twice a second what changed."""
        for topic in self._scan_topics:
            self.ctx.subscribe(topic, self._on_scan)
        for topic in self._cloud_topics:
            self.ctx.subscribe(topic, self._on_cloud)
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(MAP, self._on_map)
        if ECHOES in self.inputs:
            self.ctx.subscribe(ECHOES, self._on_echo)
        self.ctx.serve(SAVE_GLASS, self._save)
        self.ctx.timer(PERIOD, self._tell)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._motion.add(odometry)
        self._twist = np.array([odometry.linear[0], odometry.linear[1], odometry.angular[2]])

    def _on_transforms(self, transforms: Transforms) -> None:
        for edge in transforms.transforms:
            if (edge.parent, edge.child) == ("map", "odom"):
                self._map_from_odom = edge.parent_from_child.to_se2()

    def _on_map(self, grid: OccupancyGrid) -> None:
        self._map = grid

    def _on_scan(self, scan: LaserScan) -> None:
        scan = upright(self._robot.timed(scan), self._spatial_mounts[scan.frame])
        self._take(scan, self._mounts[scan.frame])

    def _on_cloud(self, cloud: PointCloud) -> None:
        """Take what a scanner of many rings sees at its own height."""
        with suppress(StaleInputError):
            ring, base_from_ring = level_ring(cloud, self._spatial_mounts[cloud.frame], self._motion)
            self._take(ring, base_from_ring.to_se2())

    def _take(self, scan: LaserScan, base_from_scanner: SE2) -> None:
        if self._map_from_odom is None:
            return
        self._newest_ns = max(self._newest_ns, scan.stamp_ns)
        twist = twist_of_sensor(base_from_scanner, self._twist)
        try:
            self.glass.add_scan(scan, self._map_from_base(scan.stamp_ns) @ base_from_scanner, twist)
            for peak in self._detector.detect(scan):
                at_ns = scan.stamp_ns + round(peak.beam * scan.time_increment * 1e9)
                self.glass.add_peak(peak, self._map_from_base(at_ns) @ base_from_scanner)
        except StaleInputError:
            return  # a scan of a moment without a pose cannot be placed

    def _on_echo(self, echo: JudgedEcho) -> None:
        if self._map_from_odom is not None:
            self.glass.add_echo(echo, self._map_from_odom @ echo.pose.to_se2())

    def _map_from_base(self, stamp_ns: int) -> SE2:
        assert self._map_from_odom is not None
        return self._map_from_odom @ self._motion.planar_at(stamp_ns)

    def _tell(self) -> None:
        segments, confidence = self.glass.segments()
        told = self._told
        if told is None:
            is_news = len(segments) > 0
        else:
            is_news = len(told.segments) != len(segments) or not np.allclose(told.segments, segments, atol=0.02)
        if is_news:
            if told is None or len(told.segments) != len(segments):
                self.ctx.log("GLASS", f"{len(segments)} pieces of glass are believed", pieces=len(segments))
            self._told = GlassWalls(self._newest_ns, "map", segments, confidence)
            self.ctx.publish(GLASS, self._told)

    def _save(self, request: SaveMapRequest) -> Nothing:
        segments, confidence = self.glass.segments()
        area = 0.0
        if self._map is not None:
            spec = self._map.spec
            area = float(np.count_nonzero(seen_through_glass(spec, self._map.data, segments)) * spec.resolution**2)
        save_glass(Path(request.stem), GlassFile("map", segments, confidence, area))
        self.ctx.log("SEEN_THROUGH_GLASS", f"{area:.1f} m2 of the map were only seen through glass", area_m2=area)
        return Nothing()
