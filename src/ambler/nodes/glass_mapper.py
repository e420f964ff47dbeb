"""Glass on the bus: raw scans and judged echoes in, segments of glass out; saves them beside the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ambler.core.errors import TransformError
from ambler.core.messages import GlassWalls, JudgedEcho, LaserScan, OccupancyGrid, Odometry, Transforms
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.transforms import TransformTree
from ambler.perception.glass import SpecularConfig, SpecularDetector, upright
from ambler.perception.glass_map import GlassMap, GlassMapConfig, seen_through_glass, twist_of_sensor
from ambler.runtime.node import Node, Service, Task
from ambler.runtime.tasks import SAVE_GLASS, Nothing, SaveMapRequest
from ambler.runtime.topics import ECHOES, GLASS, MAP, ODOMETRY, SCAN, SCANNERS, TRANSFORMS, Topic
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
        self._spatial_mounts = {m.frame: m.base_from_sensor for m in robot.sensors}
        self._mounts = {frame: mount.to_se2() for frame, mount in self._spatial_mounts.items()}
        self._poses = TransformTree(history=2.0)
        self._twist = np.zeros(3)
        self._detector = SpecularDetector(specular)
        self.glass = GlassMap(config)
        self._map_from_odom: SE2 | None = None
        self._map: OccupancyGrid | None = None
        self._told: GlassWalls | None = None
        self._newest_ns = 0
        self._scan_topic = SCAN if len(robot.scanners) <= 1 else SCANNERS
        echoes = (ECHOES,) if robot.rangers else ()
        self.inputs = (self._scan_topic, ODOMETRY, TRANSFORMS, *echoes)

    def start(self) -> None:
        """Subscribe, serve, and tell twice a second what changed."""
        self.ctx.subscribe(self._scan_topic, self._on_scan)
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(MAP, self._on_map)
        if ECHOES in self.inputs:
            self.ctx.subscribe(ECHOES, self._on_echo)
        self.ctx.serve(SAVE_GLASS, self._save)
        self.ctx.timer(PERIOD, self._tell)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._poses.set("odom", "base", odometry.stamp_ns, odometry.pose)
        self._twist = np.array([odometry.linear[0], odometry.linear[1], odometry.angular[2]])

    def _on_transforms(self, transforms: Transforms) -> None:
        for edge in transforms.transforms:
            if (edge.parent, edge.child) == ("map", "odom"):
                self._map_from_odom = edge.parent_from_child.to_se2()

    def _on_map(self, grid: OccupancyGrid) -> None:
        self._map = grid

    def _on_scan(self, scan: LaserScan) -> None:
        self._newest_ns = max(self._newest_ns, scan.stamp_ns)
        scan = upright(scan, self._spatial_mounts[scan.frame])
        try:
            twist = twist_of_sensor(self._mounts[scan.frame], self._twist)
            self.glass.add_scan(scan, self._map_from_sensor(scan.frame, scan.stamp_ns), twist)
            for peak in self._detector.detect(scan):
                at_ns = scan.stamp_ns + round(peak.beam * scan.time_increment * 1e9)
                self.glass.add_peak(peak, self._map_from_sensor(scan.frame, at_ns))
        except TransformError:
            return  # a scan of a moment without a pose cannot be placed

    def _on_echo(self, echo: JudgedEcho) -> None:
        if self._map_from_odom is not None:
            self.glass.add_echo(echo, self._map_from_odom @ echo.pose.to_se2())

    def _map_from_sensor(self, frame: str, stamp_ns: int) -> SE2:
        if self._map_from_odom is None:
            raise TransformError("map_from_odom: nobody has told it yet")
        return self._map_from_odom @ self._poses.lookup("odom", "base", stamp_ns).to_se2() @ self._mounts[frame]

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
