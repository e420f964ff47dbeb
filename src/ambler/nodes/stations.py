"""Stations on the bus: registered clouds and odometry in, dense clouds of where the robot held still saved beside its map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ambler.core.messages import Odometry, PointCloud, Status, Transforms
from ambler.core.se3 import SE3
from ambler.lio.corrections import corrected_pose
from ambler.lio.station_cloud import RestWatch, ScanState, Station, StationCloudConfig, StationClouds, StationScan
from ambler.runtime.node import GoalHandle, Node, Offers, Topics
from ambler.runtime.tasks import (
    SAVE_STATIONS,
    SCAN_STATION,
    Nothing,
    SaveMapRequest,
    ScanStationFeedback,
    ScanStationGoal,
    ScanStationResult,
)
from ambler.runtime.topics import MAP_CORRECTIONS, ODOMETRY, REGISTERED_CLOUD, STATUS
from ambler.wire.station_files import StationCloud, save_stations

Handle = GoalHandle[ScanStationGoal, ScanStationFeedback, ScanStationResult]
PERIOD = 0.25  # seconds between two looks at the clock
HOLD_MOST = 300.0  # seconds


class StationNode(Node):
    """Serves SCAN_STATION, one station at a time, and SAVE_STATIONS, where loop closures have moved them to. A station that is cancelled leaves nothing."""

    name = "stations"
    inputs: Topics = (REGISTERED_CLOUD, ODOMETRY)
    optional_inputs: Topics = (MAP_CORRECTIONS, STATUS)
    outputs: Topics = (STATUS,)
    serves: Offers = (SCAN_STATION, SAVE_STATIONS)
    latency = 0.01

    def __init__(self, config: StationCloudConfig | None = None) -> None:
        self._config = config or StationCloudConfig()
        self._rest = RestWatch(self._config)
        self.clouds = StationClouds(self._config)
        self._scan: StationScan | None = None
        self._handle: Handle | None = None
        self._is_lost = False
        self._stamps_ns = np.zeros(0, np.int64)
        self._corrections: list[SE3] = []

    def start(self) -> None:
        """Subscribe and serve."""
        self.ctx.subscribe(REGISTERED_CLOUD, self._on_cloud)
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(MAP_CORRECTIONS, self._on_corrections)
        self.ctx.subscribe(STATUS, self._on_status)
        self.ctx.serve_task(SCAN_STATION, self._on_goal, self._on_cancel)
        self.ctx.serve(SAVE_STATIONS, self._save)
        self.ctx.timer(PERIOD, self._tick)

    def _on_corrections(self, message: Transforms) -> None:
        self._stamps_ns = np.array([edge.stamp_ns for edge in message.transforms], np.int64)
        self._corrections = [edge.parent_from_child for edge in message.transforms]

    def _on_status(self, status: Status) -> None:
        if status.code in ("LIO_GOOD", "LIO_DEGENERATE", "LIO_LOST"):
            self._is_lost = status.code == "LIO_LOST"
            self._tick()

    def _on_goal(self, handle: Handle) -> None:
        goal = handle.goal
        if not 0.0 < goal.seconds <= HOLD_MOST:
            handle.fail("NOT_AT_REST", f"a station holds for up to {HOLD_MOST:g} s, not for {goal.seconds:g} s")
            return
        self._handle = handle
        self._scan = StationScan(self._config, goal.seconds, goal.level, self.clouds.cell, self.ctx.now_ns)

    def _on_cancel(self, handle: Handle) -> None:
        if handle is self._handle:
            self._handle = self._scan = None
        handle.cancelled()

    def _on_odometry(self, odometry: Odometry) -> None:
        self._rest.add(odometry)
        if self._scan is not None:
            self._scan.move(odometry, self._rest)
            self._look()

    def _on_cloud(self, cloud: PointCloud) -> None:
        if self._scan is not None:
            self._scan.see(cloud)

    def _tick(self) -> None:
        if self._scan is None or self._handle is None:
            return
        self._scan.tick(self.ctx.now_ns, is_lost=self._is_lost)
        self._handle.feedback(ScanStationFeedback(self._scan.state.value, self._scan.seconds))
        self._look()

    def _look(self) -> None:
        """End the goal when its station is over."""
        scan, handle = self._scan, self._handle
        if scan is None or handle is None or scan.state is not ScanState.OVER:
            return
        self._scan = self._handle = None
        station = scan.station()
        result = ScanStationResult(0, scan.seconds, scan.scans, 0)
        if station is not None:
            self.clouds.add(station)
            number = len(self.clouds.stations)
            result = ScanStationResult(number, station.seconds, station.scans, len(station.points))
        self._tell(scan, station)
        if scan.code == "SUCCEEDED":
            handle.succeed(result)
        else:
            handle.fail(scan.code, scan.text, result)

    def _tell(self, scan: StationScan, station: Station | None) -> None:
        kept = "nothing was kept"
        if station is not None:
            number, many = len(self.clouds.stations), station.density
            kept = (
                f"station {number}: {len(station.points)} points in {station.seconds:.1f} s, {many:.1f} times one scan"
            )
        text = f"{scan.text}; {kept}" if scan.text else kept
        code = "STATION_DONE" if scan.code == "SUCCEEDED" else f"STATION_{scan.code}"
        self.ctx.log(code, text)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text))

    def _save(self, request: SaveMapRequest) -> Nothing:
        """Write all stations in the map's frame, `<stem>.stations.pcd` and the table `<stem>.stations.json`."""
        clouds = [
            StationCloud(
                *(k + 1, s.stamp_ns, s.level, self._map_from_base(s), s.seconds, s.scans, s.density),
                *(s.points, s.intensity),
            )
            for k, s in enumerate(self.clouds.stations)
        ]
        save_stations(Path(request.stem), clouds, self.clouds.cell)
        return Nothing()

    def _map_from_base(self, station: Station) -> SE3:
        if not self._corrections:
            return station.odom_from_base
        correction = self._corrections.__getitem__
        return corrected_pose(self._stamps_ns, correction, station.stamp_ns, station.odom_from_base)
