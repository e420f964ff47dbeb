"""What a docking robot sees of its dock: odometry, and pictures or scans through the dock's detector into the tracker.

Several scanners are looked at as their merged cloud, not the merged scan: it holds every return of every scanner, each moved from its own
instant to the stamp, and so both legs of a V of which, near the dock, no scanner sees more than one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ambler.core.base_motion import BaseMotion
from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.messages import Image, LaserScan, Odometry, PointCloud
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.detection import DockDetection, DockDetector, DockObservation
from ambler.docking.dock import Dock, DockKind
from ambler.docking.marker_dock import MarkerDockDetector
from ambler.docking.reflector_dock import ReflectorDockDetector
from ambler.docking.tracker import DockTrack, DockTracker, TrackerConfig
from ambler.docking.v_shape_dock import VShapeDockDetector
from ambler.perception.fiducials import FiducialDetector
from ambler.perception.planar import PlanarConfig, scan_to_points

ODOMETRY_AGE_NS = 300_000_000

Look = Callable[[], DockDetection | None]


def detector_of(dock: Dock, robot: RobotModel, camera: CameraModel | None, edge_shift_px: float = 0.0) -> DockDetector:
    """Return what sees a dock, the edges of markers farther out by `edge_shift_px`; raises BadInputError for markers without a camera, or with one that was never calibrated."""
    if dock.kind is DockKind.V_SHAPE:
        return VShapeDockDetector(dock)
    if dock.kind is DockKind.REFLECTORS:
        return ReflectorDockDetector(dock)
    if robot.camera is None or camera is None:
        raise BadInputError(f"dock {dock.name} is recognized by markers, but there is no camera")
    if not min(camera.fx, camera.fy) > 0.0:
        raise BadInputError(f"camera {camera.name} is not calibrated: run `ambler calibrate camera`")
    finder = FiducialDetector(camera, [m.spec for m in dock.markers]).with_shift(edge_shift_px)
    return MarkerDockDetector(dock, finder, robot.camera.base_from_sensor)


class DockSight:
    """Follows one dock at a time. `begin` and `end` switch it; looks that were begun before are void."""

    def __init__(self, robot: RobotModel, config: TrackerConfig | None = None) -> None:
        self._robot = robot
        self._tracker = DockTracker(config, has_gyroscope=bool(robot.of_kind(SensorKind.IMU)))
        self._motion = BaseMotion()
        self._newest: Odometry | None = None
        self._detector: DockDetector | None = None
        self._kind: DockKind | None = None
        self._series = 0
        self._planar = PlanarConfig()

    @property
    def odom_from_base(self) -> SE2 | None:
        """The newest pose of the base, None before the first."""
        return None if self._newest is None else self._newest.pose.to_se2()

    @property
    def velocity(self) -> BodyVelocity:
        """The newest velocity of the base; zero before the first odometry, without which nothing moves."""
        odometry = self._newest
        if odometry is None:
            return BodyVelocity()
        return BodyVelocity(odometry.linear[0], odometry.linear[1], odometry.angular[2])

    @property
    def series(self) -> int:
        """Number of the present look-out; a detection of another one is void."""
        return self._series

    @property
    def wants_pictures(self) -> bool:
        """Whether pictures tell anything about the dock looked for."""
        return self._kind is DockKind.MARKERS

    @property
    def wants_scans(self) -> bool:
        """Whether scans tell anything about the dock looked for."""
        return self._kind in (DockKind.V_SHAPE, DockKind.REFLECTORS)

    def begin(self, dock: Dock, detector: DockDetector) -> None:
        """Look for a dock, with everything forgotten."""
        self._detector, self._kind = detector, dock.kind
        self._tracker.reset()
        self._series += 1

    def end(self) -> None:
        """Look no more; what was seen last is kept until the next look-out."""
        self._detector = self._kind = None
        self._series += 1

    def is_fresh(self, now_ns: int) -> bool:
        """Say whether odometry that is a number came a moment ago."""
        return self._newest is not None and now_ns - self._newest.stamp_ns <= ODOMETRY_AGE_NS

    def add_odometry(self, odometry: Odometry) -> None:
        """Take odometry; the track drifts with it. One that is no number is left out, and if that lasts, odometry is stale."""
        if not np.isfinite([*odometry.pose.to_se2().as_array(), *odometry.linear, *odometry.angular]).all():
            return
        self._newest = odometry
        self._motion.add(odometry)
        self._tracker.move(odometry.pose.to_se2())

    def track(self, now_ns: int) -> DockTrack | None:
        """Return where the dock is, None while that is unknown."""
        pose = self.odom_from_base
        return None if pose is None else self._tracker.track(now_ns, pose)

    def look_at_picture(self, image: Image, map_prior: SE2 | None) -> Look | None:
        """Return pure work that finds the dock in a picture, or None when nobody looks. `map_prior` is the dock in the base frame by
        the map, for as long as it is not tracked."""
        if self._detector is None or self._kind is not DockKind.MARKERS:
            return None
        return self._look(self._detector, DockObservation(image.stamp_ns, image.grey), map_prior)

    def look_at_scan(self, scan: LaserScan, map_prior: SE2 | None) -> Look | None:
        """The same for a scan, of the base frame or of a mounted scanner. Other than markers, shapes and strips bear no name: nobody looks
        for them who does not know where to expect the dock."""
        if self._detector is None or not self.wants_scans:
            return None
        scan = self._robot.timed(scan)
        mount = SE3() if scan.frame == "base" else self._robot.sensor(scan.frame).base_from_sensor
        v = self.velocity
        points = scan_to_points(scan, mount, np.array([v.vx, v.vy, v.wz]), self._planar).points
        bright = None
        if len(scan.intensities) == len(scan.ranges):
            near = max(self._planar.range_min, scan.range_min)
            far = min(self._planar.range_max, scan.range_max)
            bright = scan.intensities[(scan.ranges >= near) & (scan.ranges <= far)]
        if bright is not None and len(bright) != len(points):
            bright = None
        observation = DockObservation(scan.stamp_ns, None, points.astype(np.float64), bright)
        return self._look(self._detector, observation, map_prior)

    def look_at_cloud(self, cloud: PointCloud, map_prior: SE2 | None) -> Look | None:
        """The same for the merged cloud of several planar scanners, in the base frame at its stamp."""
        if self._detector is None or not self.wants_scans:
            return None
        points = cloud.points[:, :2].astype(np.float64)
        return self._look(self._detector, DockObservation(cloud.stamp_ns, None, points, cloud.intensity), map_prior)

    def take(self, detection: DockDetection, now_ns: int) -> bool:
        """Take what a look found; False when the tracker refused it or odometry does not reach back."""
        try:
            odom_from_base = self._motion.planar_at(detection.stamp_ns)
        except StaleInputError:
            return False
        return self._tracker.update(detection, odom_from_base, now_ns)

    def _look(self, detector: DockDetector, observation: DockObservation, map_prior: SE2 | None) -> Look | None:
        try:
            expected = self._tracker.expected(self._motion.planar_at(observation.stamp_ns))
        except StaleInputError:
            return None
        # A single sighting may be an error, and what was seen long ago may be gone: it takes the map's place only while it is told.
        is_told = self.track(observation.stamp_ns) is not None
        prior = expected if is_told or map_prior is None else map_prior
        if prior is None and self.wants_scans:
            return None
        return lambda: detector.detect(observation, prior)
