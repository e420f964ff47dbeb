"""What the controller knows of its surroundings: odometry, the newest map -> odom, and the local costmap fed by a scanner."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError, TransformError
from ambler.core.messages import GlassWalls, LaserScan, Odometry, Path, PointCloud, Range, Transforms
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.costmap.local_costmap import LocalCostmap
from ambler.costmap.obstacle_layer import SensorRays
from ambler.nodes.merged_rays import MergedRays
from ambler.nodes.range_view import RangeView, cone_of
from ambler.perception.planar import PlanarConfig, cloud_to_points, level, scan_to_points
from ambler.registration.planar_scan import PlanarScan

F64 = NDArray[np.float64]

LEAD_MAX = 0.3  # seconds by which an odometry pose is carried forward at most


def default_planar(robot: RobotModel) -> PlanarConfig:
    """Return a height band from above the floor to above the robot and its scanners: a wall close by is hit only by beams that
    are still high, so a band that ends below the scanner would lose it."""
    top = max([robot.body_height, *(m.base_from_sensor.translation[2] for m in robot.sensors)])
    return PlanarConfig(height_max=top + 0.1, range_max=10.0)


class LocalView:
    """Joins scans, odometry and transforms; keeps the local costmap up to date."""

    def __init__(self, robot: RobotModel, costmap: LocalCostmap, planar: PlanarConfig | None = None) -> None:
        self._mounts = {m.frame: m.base_from_sensor for m in robot.sensors}
        self.uses_cloud = any(m.kind == "cloud" for m in robot.sensors)
        self.costmap = costmap
        self.stamp_ns: int | None = None
        self._planar = planar if planar is not None else default_planar(robot)
        self._motion = BaseMotion()
        self._rays = MergedRays(robot, self._planar) if len(robot.scanners) > 1 and not self.uses_cloud else None
        self._ranges = RangeView(robot)
        self._has_ranges = bool(robot.rangers)
        self._glass: GlassWalls | None = None
        self._odometry: Odometry | None = None
        self._odom_from_map: SE2 | None = None

    def add_odometry(self, odometry: Odometry) -> None:
        """Take a pose of the base and its velocity."""
        self._motion.add(odometry)
        self._ranges.add_odometry(odometry)
        self._odometry = odometry

    def add_transforms(self, transforms: Transforms) -> None:
        """Take the newest map -> odom out of a message."""
        for edge in transforms.transforms:
            if (edge.parent, edge.child) == ("map", "odom"):
                self._odom_from_map = edge.parent_from_child.to_se2().inverse()

    @property
    def uses_merged(self) -> bool:
        """Whether the costmap lives on the points of several merged scanners (`add_merged`) and not on a scan."""
        return self._rays is not None

    def add_free(self, free: PointCloud) -> None:
        """Take the rays of merged scanners that met nothing; before `add_merged`."""
        if self._rays is not None:
            self._rays.add_free(free)

    def add_merged(self, cloud: PointCloud) -> None:
        """Mark and clear with the points of several scanners, each ray from its own."""
        if self._rays is not None:
            self._mark(self._rays.to_planar(cloud, self._motion))

    def add_scan(self, scan: LaserScan) -> None:
        """Mark and clear with a planar scan; that of merged scanners only explains echoes."""
        if self._has_ranges:
            self._ranges.add_scan(scan)
        if self._rays is not None:
            return
        self._mark(scan_to_points(scan, self._mounts[scan.frame], self._twist(), self._planar))

    def add_cloud(self, cloud: PointCloud) -> None:
        """Mark and clear with the height band of a cloud, levelled by the lean that the odometry tells."""
        mount = level(self._mounts[cloud.frame], *self._lean())
        self._mark(cloud_to_points(cloud, mount, self._twist(), self._planar))

    def add_range(self, measured: Range) -> None:
        """Mark and clear with the cone of an ultrasonic transducer; the costs show it with the next scan."""
        placed = self._ranges.judge(measured)
        if placed is not None:
            self.costmap.add_cones([cone_of(placed.echo, placed.odom_from_base)], measured.stamp_ns * 1e-9)

    def add_glass(self, glass: GlassWalls) -> None:
        """Take the glass of the map; it is drawn where the newest map -> odom puts it."""
        self._glass = glass

    def now(self, now_ns: int) -> tuple[SE2, BodyVelocity]:
        """Return the pose of the base, carried forward to now, and its velocity; raises TransformError without odometry."""
        o = self._odometry
        if o is None:
            raise TransformError("odom_from_base: no odometry yet")
        age = min(LEAD_MAX, max(0.0, (now_ns - o.stamp_ns) * 1e-9))
        velocity = BodyVelocity(o.linear[0], o.linear[1], o.angular[2])
        return o.pose.to_se2() @ SE2.exp(self._twist() * age), velocity

    def to_odom(self, path: Path) -> F64:
        """Return the poses of a path in the odom frame; raises TransformError when map -> odom is not known yet."""
        if path.frame == "odom":
            return np.array(path.poses)
        if self._odom_from_map is None:
            raise TransformError("map_from_odom: nobody has told it yet")
        out = np.empty_like(path.poses)
        out[:, :2] = self._odom_from_map.transform(path.poses[:, :2])
        out[:, 2] = path.poses[:, 2] + self._odom_from_map.yaw
        return out

    def _twist(self) -> F64:
        o = self._odometry
        return np.zeros(3) if o is None else np.array([o.linear[0], o.linear[1], o.angular[2]])

    def _lean(self) -> tuple[float, float]:
        if self._odometry is None:
            return 0.0, 0.0
        w, x, y, z = self._odometry.pose.rotation
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        return roll, math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))

    def _mark(self, scan: PlanarScan) -> None:
        try:
            odom_from_base = self._motion.planar_at(scan.stamp_ns)
        except StaleInputError:
            return  # a scan of a moment without odometry cannot be placed; if that lasts, the odometry is stale
        starts, free_starts = (odom_from_base.transform(s) for s in scan.ray_starts())
        hits = odom_from_base.transform(scan.points)
        free_ends = odom_from_base.transform(scan.free_points)
        if self._has_ranges and self.uses_cloud:
            self._ranges.add_points("planar", hits)
        if self._glass is not None and self._odom_from_map is not None:
            ends = self._odom_from_map.transform(self._glass.segments.reshape(-1, 2))
            self.costmap.set_glass(ends.reshape(-1, 4))
        self.costmap.update(odom_from_base, [SensorRays(scan.origin, hits, free_ends, starts, free_starts)])
        self.stamp_ns = scan.stamp_ns
