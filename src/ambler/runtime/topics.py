"""The one table of everything that travels. Recording, bridges, health limits and replay are derived from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeVar

from ambler.core import messages as m

M = TypeVar("M", bound=m.Message)

Delivery = Literal["latest", "queue", "latched"]


@dataclass(frozen=True, slots=True)
class Topic(Generic[M]):
    """A typed stream; `instance` tells several devices of one kind apart (`of`). `max_age` is the age in seconds after which the newest message must not be used (None: never stale).

    A topic has one writer unless `has_many_writers`; `is_truth` marks the simulator's ground truth; `is_bulk` what is for the nodes of the robot only, neither recorded nor
    shown, because a replay computes it again.
    """

    name: str
    type: type[M]
    ros_name: str
    delivery: Delivery = "queue"
    depth: int = 10
    max_age: float | None = None
    is_truth: bool = False
    has_many_writers: bool = False
    is_bulk: bool = False
    instance: str = ""

    def of(self, instance: str) -> Topic[M]:
        """Return the same stream of one of several devices, told apart by its frame: `imu` of `rear_imu` is /imu/rear_imu."""
        name, ros_name = f"{self.name}.{instance}", f"{self.ros_name}/{instance}"
        return replace(self, name=name, ros_name=ros_name, instance=instance)

    @property
    def table_name(self) -> str:
        """The name under which the table declares it, without the instance."""
        return self.name.removesuffix(f".{self.instance}") if self.instance else self.name


_TABLE: dict[str, Topic[Any]] = {}


def _topic(
    name: str,
    message_type: type[M],
    ros_name: str,
    delivery: Delivery = "queue",
    depth: int = 10,
    max_age: float | None = None,
    is_truth: bool = False,
    has_many_writers: bool = False,
    is_bulk: bool = False,
) -> Topic[M]:
    topic = Topic(name, message_type, ros_name, delivery, depth, max_age, is_truth, has_many_writers, is_bulk)
    _TABLE[name] = topic
    return topic


# Sensors
SCAN = _topic("scan", m.LaserScan, "/scan", max_age=0.5)
SCANNERS = _topic("scanners", m.LaserScan, "/scanners", depth=20, max_age=0.5, has_many_writers=True)
MERGED_FREE = _topic("merged_free", m.PointCloud, "/merged_free", depth=2, max_age=0.5)
MERGED_CLOUD = _topic("merged_cloud", m.PointCloud, "/merged_points", depth=2, max_age=0.5)
RANGES = _topic("ranges", m.Range, "/ultrasonic", depth=50, max_age=0.5)
ECHOES = _topic("echoes", m.JudgedEcho, "/echoes", depth=50, max_age=0.5)
CLOUD = _topic("cloud", m.PointCloud, "/points", max_age=0.5)
IMU = _topic("imu", m.Imu, "/imu", depth=200, max_age=0.2)
WHEEL_ODOMETRY = _topic("wheel_odometry", m.Odometry, "/wheel_odom", depth=100, max_age=0.3)
ODOMETRY = _topic("odometry", m.Odometry, "/odom", depth=100, max_age=0.3)
REGISTERED_CLOUD = _topic("registered_cloud", m.PointCloud, "/registered_scan", depth=2, max_age=0.5, is_bulk=True)
REGISTERED_VIEW = _topic("registered_view", m.PointCloud, "/registered_view", depth=2, max_age=0.5)
TERRAIN_MAP = _topic("terrain_map", m.PointCloud, "/terrain_map", depth=2, max_age=1.0)
FIRM_GROUND = _topic("firm_ground", m.PointCloud, "/firm_ground", depth=2)
TERRAIN_CLEARING = _topic("terrain_clearing", m.Number, "/terrain_clearing", depth=2)
TERRAIN_MAP_EXT = _topic("terrain_map_ext", m.PointCloud, "/terrain_map_ext", depth=2, max_age=3.0)
IMAGE = _topic("image", m.Image, "/camera/image", depth=2, max_age=0.5)
CAMERA_INFO = _topic("camera_info", m.CameraInfo, "/camera/camera_info", "latched", 1)
DEPTH = _topic("depth", m.Image, "/depth/image", depth=2, max_age=0.5)
DEPTH_INFO = _topic("depth_info", m.CameraInfo, "/depth/camera_info", "latched", 1)
BATTERY = _topic("battery", m.BatteryState, "/battery_state", depth=10, max_age=2.0)
JOYSTICK = _topic("joystick", m.JoystickState, "/joy", "latest", 1, max_age=0.4)
# Transforms
TRANSFORMS = _topic("transforms", m.Transforms, "/tf", depth=200, has_many_writers=True)
STATIC_TRANSFORMS = _topic("static_transforms", m.Transforms, "/tf_static", "latched", 1)
ROBOT_DESCRIPTION = _topic("robot_description", m.Text, "/robot_description", "latched", 1)
# Mapping
MAP = _topic("map", m.OccupancyGrid, "/map", "latched", 1)
MATCHED_SCAN = _topic("matched_scan", m.PointCloud, "/matched_scan", depth=2)
SLAM_POSE = _topic("slam_pose", m.PoseStamped, "/slam_pose", depth=50)
GROUND_LEVELS = _topic("ground_levels", m.GroundLevels, "/ground_levels", "latched", 1)
SLAM_HEALTH = _topic("slam_health", m.SlamHealth, "/slam_health")
GLASS = _topic("glass", m.GlassWalls, "/glass", "latched", 1)
TRAJECTORY = _topic("trajectory", m.Path, "/trajectory", "latched", 1)
MAP_CORRECTIONS = _topic("map_corrections", m.Transforms, "/map_corrections", "latched", 1, is_bulk=True)
MAP_CLOUD = _topic("map_cloud", m.PointCloud, "/overall_map", "latched", 1)
# Localization in a known map
LOCALIZED_POSE = _topic("localized_pose", m.Odometry, "/localized_pose", depth=50)
SET_POSE = _topic("set_pose", m.PoseStamped, "/set_pose", depth=2)
# Navigation
GOAL = _topic("goal", m.PoseStamped, "/goal_pose", depth=2)
GLOBAL_COSTMAP = _topic("global_costmap", m.CostGrid, "/global_costmap/costmap", "latched", 1)
LOCAL_COSTMAP = _topic("local_costmap", m.CostGrid, "/local_costmap/costmap", "latched", 1, max_age=1.0)
FOOTPRINT = _topic("footprint", m.Polygon, "/footprint", depth=1)
PATH = _topic("path", m.Path, "/plan", "latched", 1)
BLOCKED = _topic("blocked", m.Path, "/blocked", "latched", 1)
MOVERS = _topic("movers", m.PointCloud, "/movers", depth=2)
LOCAL_PATH = _topic("local_path", m.Path, "/local_plan", depth=1)
FRONTIERS = _topic("frontiers", m.Frontiers, "/frontiers", "latched", 1)
VISIBILITY_GRAPH = _topic("visibility_graph", m.VisibilityGraphView, "/visibility_graph", "latched", 1)
VELOCITY_REQUEST = _topic("velocity_request", m.VelocityCommand, "/cmd_vel_nav", "latest", 1, max_age=0.3)
TELEOP_REQUEST = _topic("teleop_request", m.VelocityCommand, "/cmd_vel_teleop", "latest", 1, max_age=0.4)
STEER_REQUEST = _topic("steer_request", m.VelocityCommand, "/cmd_vel_steer", "latest", 1, max_age=0.4)
DOCKING_REQUEST = _topic("docking_request", m.VelocityCommand, "/cmd_vel_docking", "latest", 1, max_age=0.3)
VELOCITY_COMMAND = _topic("velocity_command", m.VelocityCommand, "/cmd_vel", "latest", 1, max_age=0.5)
GATE_STATUS = _topic("gate_status", m.GateStatus, "/gate_status", "latched", 1)
STATUS = _topic("status", m.Status, "/status", depth=50, has_many_writers=True)
# What came through the outside door (runtime.door); written by the executor itself, so that a replay can repeat it
OUTSIDE_CALLS = _topic("outside_calls", m.OutsideCall, "/outside_calls", depth=100)
# Orders of people and other programs, with the names of the original deployment (docs/live_view.md); no node writes them
WAY_POINT = _topic("way_point", m.PointStamped, "/way_point", depth=2)
GOAL_POINT = _topic("goal_point", m.PointStamped, "/goal_point", depth=2)
BOUNDARY = _topic("boundary", m.Polygon, "/navigation_boundary", depth=2)
ADDED_OBSTACLES = _topic("added_obstacles", m.PointCloud, "/added_obstacles", depth=2)
MAP_CLEARING = _topic("map_clearing", m.Number, "/map_clearing", depth=2)
CLOUD_CLEARING = _topic("cloud_clearing", m.Number, "/cloud_clearing", depth=2)
SPEED = _topic("speed", m.Number, "/speed", depth=2)
STOP = _topic("stop", m.Code, "/stop", depth=2)
# Docking
DOCK_POSE = _topic("dock_pose", m.PoseStamped, "/dock_pose", depth=20)
# Ground truth, in simulation only; no algorithm may subscribe to it
TRUE_POSE = _topic("true_pose", m.Odometry, "/ground_truth/pose", depth=100, is_truth=True)
TRUE_START = _topic("true_start", m.PoseStamped, "/ground_truth/start", "latched", 1, is_truth=True)
CONTACT = _topic("contact", m.Contact, "/ground_truth/contacts", depth=100, is_truth=True)
TRUE_MAP = _topic("true_map", m.OccupancyGrid, "/ground_truth/map", "latched", 1, is_truth=True)


def all_topics() -> tuple[Topic[Any], ...]:
    """Return every declared topic in the order of declaration, which is also the order of delivery at one instant."""
    return tuple(_TABLE.values())


def order_topics() -> tuple[Topic[Any], ...]:
    """Return the topics by which people and other programs tell a robot what to do."""
    orders = (WAY_POINT, GOAL_POINT, BOUNDARY, ADDED_OBSTACLES, MAP_CLEARING, CLOUD_CLEARING, SPEED, STOP)
    return (GOAL, SET_POSE, TELEOP_REQUEST, STEER_REQUEST, *orders)


def topic_named(name: str) -> Topic[Any]:
    """Return a topic, or an instance of one, by its name or its ROS name; raises KeyError."""
    if name in _TABLE:
        return _TABLE[name]
    for topic in _TABLE.values():
        if topic.ros_name == name:
            return topic
    separator = "/" if name.startswith("/") else "."
    plain, _, instance = name.rpartition(separator)
    if plain and instance:
        return topic_named(plain).of(instance)
    raise KeyError(f"no topic {name!r}")
