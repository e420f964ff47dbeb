"""What the controller knows of its surroundings: odometry, the newest map -> odom, and the local costmap fed by a scanner."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError, TransformError
from ambler.core.grid import COST_UNKNOWN
from ambler.core.messages import LaserScan, Odometry, Path, PointCloud, Transforms
from ambler.core.movers import Movers
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap
from ambler.costmap.obstacle_layer import ObstacleLayer, SensorRays
from ambler.costmap.terrain_layer import TerrainLayer
from ambler.nodes.merged_rays import MergedRays
from ambler.perception.glass import SpecularConfig, upright
from ambler.perception.ground_below import LEVEL_GROUND, GroundBelow
from ambler.perception.level_mount import Mount, level_mount
from ambler.perception.level_ring import level_ring
from ambler.perception.mover_track import NOTHING, MoverConfig
from ambler.perception.mover_tracker import MoverTracker
from ambler.perception.pane_returns import PaneReturns
from ambler.perception.planar import PlanarConfig, cloud_to_points, default_planar, scan_duration, scan_to_points
from ambler.perception.silent_sectors import SilentSectors, sees_too_late
from ambler.registration.planar_scan import PlanarScan
from ambler.runtime.topics import CLOUD, MERGED_CLOUD, MERGED_FREE, SCAN, Topic
from ambler.safety.stuck_scan import StuckScan

F64 = NDArray[np.float64]

LEAD_MAX = 0.3  # seconds by which an odometry pose is carried forward at most


class LocalView:
    """Joins scans, odometry and transforms; keeps the local costmap up to date and tracks what moves. It is the `Frames` of whoever feeds its
    layers."""

    def __init__(
        self,
        robot: RobotModel,
        costmap: LocalCostmap,
        planar: PlanarConfig | None = None,
        movers: MoverConfig | None = None,
        specular: SpecularConfig | None = None,
    ) -> None:
        self._robot = robot
        self._mounts = {m.frame: m.base_from_sensor for m in robot.sensors}
        self.uses_cloud = any(m.kind is SensorKind.CLOUD for m in robot.sensors)
        self.costmap = costmap
        self.stamp_ns: int | None = None
        self._planar = planar if planar is not None else default_planar(robot)
        self._motion = BaseMotion()
        self._tracker = MoverTracker(movers)
        self._repeats: dict[str, StuckScan] = {}
        self._panes = PaneReturns(specular)
        self._silences = {m.frame: SilentSectors(m.range_min) for m in robot.clouds if sees_too_late(robot, m)}
        self._obstacles = next((layer for layer in costmap.layers if isinstance(layer, ObstacleLayer)), None)
        self._rays = MergedRays(robot, self._planar) if len(robot.scanners) > 1 and not self.uses_cloud else None
        self._ground = LEVEL_GROUND
        self._odometry: Odometry | None = None
        self._odom_from_map: SE2 | None = None

    def add_odometry(self, odometry: Odometry) -> None:
        """Take a pose of the base and its velocity."""
        self._motion.add(odometry)
        self._odometry = odometry

    def add_transforms(self, transforms: Transforms) -> None:
        """Take the newest map -> odom out of a message."""
        for edge in transforms.transforms:
            if (edge.parent, edge.child) == ("map", "odom"):
                self._odom_from_map = edge.parent_from_child.to_se2().inverse()

    @property
    def tracked(self) -> Movers:
        """What moves, at the instant of the newest scan."""
        return self._tracker.movers

    def movers(self, now_ns: int) -> Movers:
        """Return what moves, as the newest scan and its going on as before tell it for now."""
        return self._tracker.movers.at(now_ns)

    def has_seen(self, points_odom: F64) -> bool:
        """Whether a sensor has told of all the cells under points (N, 2) of the odom frame."""
        cells = None if self._obstacles is None else self._obstacles.cells
        if cells is None:
            return False
        spec = self.costmap.spec
        places = spec.cells_of(points_odom)
        is_inside = (places >= 0).all(axis=1) & (places < np.array(spec.shape)).all(axis=1)
        return bool(is_inside.all() and (cells[places[:, 0], places[:, 1]] != COST_UNKNOWN).all())

    @property
    def uses_merged(self) -> bool:
        """Whether the costmap lives on the points of several merged scanners (`add_merged`) and not on a scan."""
        return self._rays is not None

    @property
    def topics(self) -> tuple[Topic[Any], ...]:
        """What it must be fed with for the costmap to live."""
        if self.uses_merged:
            return (MERGED_FREE, MERGED_CLOUD)
        return (CLOUD if self.uses_cloud else SCAN,)

    def add_free(self, free: PointCloud) -> None:
        """Take the rays of merged scanners that met nothing; before `add_merged`."""
        if self._rays is not None:
            self._rays.add_free(free)

    def add_merged(self, cloud: PointCloud) -> None:
        """Mark and clear with the points of several scanners, each ray from its own."""
        if self._rays is not None:
            self._mark(self._rays.to_planar(cloud, self._motion))

    def add_panes(self, scan: LaserScan) -> None:
        """Take the raw scan of one of several scanners; what it shows of panes is not taken for somebody who walks."""
        self._look_for_panes(self._robot.timed(scan))

    def _look_for_panes(self, scan: LaserScan) -> None:
        with suppress(TransformError):
            self._panes.look(
                upright(scan, self._mounts[scan.frame]),
                lambda stamp_ns: self.spatial_from(scan.frame, stamp_ns).to_se2(),
            )

    def add_scan(self, scan: LaserScan) -> None:
        """Mark and clear with a planar scan, unless the scanner repeats itself."""
        scan = self._robot.timed(scan)
        if self._is_repeated(scan.frame, scan.ranges, scan.stamp_ns):
            return
        self._look_for_panes(scan)
        self._mark(scan_to_points(scan, self._mount(scan), self._sweep(scan), self._planar))

    def add_cloud(self, cloud: PointCloud) -> None:
        """Mark and clear with the height band of a cloud, levelled by the lean that the odometry tells, unless the scanner repeats itself."""
        if self._is_repeated(cloud.frame, cloud.points, cloud.stamp_ns):
            return
        ground = LEVEL_GROUND
        with suppress(StaleInputError):
            ground = self._ground.under(self._motion.pose_at(cloud.stamp_ns))
        if self._panes.may_shine(cloud.intensity):
            with suppress(StaleInputError):
                ring, base_from_ring = level_ring(cloud, self._mounts[cloud.frame], self._motion)
                self._panes.look(ring, lambda stamp_ns: self._motion.planar_at(stamp_ns) @ base_from_ring.to_se2())
        scan = cloud_to_points(cloud, self._mount(cloud), self._sweep(cloud), self._planar, ground=ground)
        self._mark(scan, self._silent(cloud))

    def add_terrain(self, terrain: PointCloud) -> None:
        """Take the terrain around the robot, in the odom frame: heights of what is in the way count from its ground."""
        layer = next((layer for layer in self.costmap.layers if isinstance(layer, TerrainLayer)), None)
        if layer is not None and terrain.frame == "odom":
            ground = (terrain.points, terrain.intensity, terrain.ring)
            self._ground = GroundBelow.of_terrain(*ground, layer.config.cell, layer.config.step)

    def _silent(self, cloud: PointCloud) -> F64:
        """Return where somebody stands (K, 2) whom the scanner is too near to see, in the base's frame."""
        if cloud.frame not in self._silences:
            return NOTHING
        hidden = self._silences[cloud.frame].update(cloud.points)
        return self._mounts[cloud.frame].transform(np.column_stack((hidden, np.zeros(len(hidden)))))[:, :2]

    def _is_repeated(self, frame: str, values: NDArray[np.float32], stamp_ns: int) -> bool:
        """Whether a scanner tells the same again while the robot moves: walls that turn with it would be somebody who walks."""
        with suppress(StaleInputError):
            return self._repeats.setdefault(frame, StuckScan()).update(values, self._motion.planar_at(stamp_ns))
        return False

    def _mount(self, message: LaserScan | PointCloud) -> Mount:
        return level_mount(self._mounts[message.frame], self._motion, message.stamp_ns, scan_duration(message))

    def costmap_from(self, frame: str, stamp_ns: int) -> SE2:
        """Return where the base or a sensor was in the odom frame, or where the map lies there now; raises TransformError."""
        if frame == "odom":
            return SE2()
        if frame == "map":
            return self._known_odom_from_map()
        return self.spatial_from(frame, stamp_ns).to_se2()

    def spatial_from(self, frame: str, stamp_ns: int) -> SE3:
        """Return where the base or a sensor was in the odom frame, with its height and lean; raises TransformError."""
        mount = SE3() if frame == "base" else self._mounts.get(frame)
        if mount is None:
            raise TransformError(f"base_from_{frame}: the robot has no such sensor")
        try:
            return self._motion.pose_at(stamp_ns) @ mount
        except StaleInputError as error:
            raise TransformError(f"odom_from_base: {error}") from error

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
        odom_from_map = self._known_odom_from_map()
        out = np.empty_like(path.poses)
        out[:, :2] = odom_from_map.transform(path.poses[:, :2])
        out[:, 2] = path.poses[:, 2] + odom_from_map.yaw
        return out

    def _known_odom_from_map(self) -> SE2:
        if self._odom_from_map is None:
            raise TransformError("map_from_odom: nobody has told it yet")
        return self._odom_from_map

    def _twist(self) -> F64:
        o = self._odometry
        return np.zeros(3) if o is None else np.array([o.linear[0], o.linear[1], o.angular[2]])

    def _sweep(self, message: LaserScan | PointCloud) -> F64:
        return self._motion.sweep(message.stamp_ns, scan_duration(message), self._twist())

    def _mark(self, scan: PlanarScan, silent: F64 = NOTHING) -> None:
        try:
            odom_from_base = self._motion.planar_at(scan.stamp_ns)
        except StaleInputError:
            return  # a scan of a moment without odometry cannot be placed; if that lasts, the odometry is stale
        starts, free_starts = (odom_from_base.transform(s) for s in scan.ray_starts())
        hits = odom_from_base.transform(scan.points)
        free_ends = odom_from_base.transform(scan.free_points)
        map_from_odom = None if self._odom_from_map is None else self._odom_from_map.inverse()
        hidden = odom_from_base.transform(silent)
        is_solid = ~self._panes.include(hits, scan.stamp_ns)
        solid_starts = starts[is_solid] if len(starts) == len(hits) else starts
        solid = scan if scan.falls is None else replace(scan, falls=scan.falls.of(is_solid))
        self._tracker.update(solid, hits[is_solid], free_ends, solid_starts, free_starts, hidden, map_from_odom)
        if self._obstacles is not None:
            origin = odom_from_base.transform(np.array([scan.origin]))[0]
            place = (float(origin[0]), float(origin[1]))
            self._obstacles.add([SensorRays(place, hits, free_ends, starts, free_starts, scan.falls)])
        self.costmap.update(odom_from_base, self._odom_from_map)
        self.stamp_ns = scan.stamp_ns
