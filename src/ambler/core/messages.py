"""Everything that travels on the bus: frozen, slotted records that never change after birth.

`stamp_ns` is the instant of the measurement that a message was computed from, in nanoseconds. Arrays are read-only.
Poses are SE3, so that a recording holds exactly what the nodes saw. Each record names its ROS 2 type in `wire.ros_messages`.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se3 import SE3, Vector3

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


_SIX_FLOATS = struct.Struct("<6f")
_THREE_FLOATS = struct.Struct("<3f")


_ARRAYS: dict[type, tuple[str, ...]] = {}


def _freeze(message: Any) -> None:
    """Make the arrays of a message read-only; which fields hold arrays is found once per class."""
    kind = type(message)
    names = _ARRAYS.get(kind)
    if names is None:
        names = _ARRAYS[kind] = tuple(
            f.name for f in fields(message) if isinstance(getattr(message, f.name), np.ndarray)
        )
    for name in names:
        getattr(message, name).flags.writeable = False


class Message:
    """Marks a record of the bus and makes its arrays read-only."""

    __slots__ = ()

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan(Message):
    """One planar scan; beam i points at angle_min + i * angle_increment in `frame` and was taken at stamp + i * time_increment.

    `ranges` float32 (N,): +inf means "nothing within range_max", NaN means "no measurement". `intensities` (N,) or (0,).
    The scalars are rounded to float32 at birth, as the wire holds them, so that a replay feeds exactly the same scan.
    """

    stamp_ns: int
    frame: str
    angle_min: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: F32
    intensities: F32

    def __post_init__(self) -> None:
        names = ("angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")
        rounded = _SIX_FLOATS.unpack(_SIX_FLOATS.pack(*(getattr(self, name) for name in names)))
        for name, value in zip(names, rounded, strict=True):
            object.__setattr__(self, name, value)
        _freeze(self)


_FOUR_FLOATS = struct.Struct("<4f")


@dataclass(frozen=True, slots=True, eq=False)
class Range(Message):
    """One echo of a transducer: the distance to the nearest surface anywhere within `field_of_view` (rad, the full angle) about the
    x axis of `frame`. `range` +inf means "nothing within range_max", -inf "nearer than range_min", NaN "no measurement".
    The scalars are rounded to float32 at birth, as the wire holds them."""

    stamp_ns: int
    frame: str
    field_of_view: float
    range_min: float
    range_max: float
    range: float

    def __post_init__(self) -> None:
        names = ("field_of_view", "range_min", "range_max", "range")
        rounded = _FOUR_FLOATS.unpack(_FOUR_FLOATS.pack(*(getattr(self, name) for name in names)))
        for name, value in zip(names, rounded, strict=True):
            object.__setattr__(self, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedEcho(Message):
    """What one measurement of the transducer `sensor` says beside what light sees. `pose` is that of the transducer in `frame` at the
    stamp; it looks along its x axis into a cone of `half_angle` (rad). `distance` is metres to the surface (inf: nothing within range);
    the cone is proved free up to `free`. `is_unexplained`: confirmed by an echo before, and no light comes from there."""

    stamp_ns: int
    frame: str
    sensor: str
    pose: SE3
    half_angle: float
    distance: float
    free: float
    is_unexplained: bool


@dataclass(frozen=True, slots=True, eq=False)
class GlassWalls(Message):
    """What is believed to be glass: segments float32 (N, 4) of (x0, y0, x1, y1) in `frame` and the confidence of each, float32 (N,)."""

    stamp_ns: int
    frame: str
    segments: F32
    confidence: F32


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(Message):
    """One 3-D scan in the sensor frame: points float32 (N, 3), intensity float32 (N,), time float32 (N,) in seconds after
    the stamp, ring uint16 (N,). Only returns are listed, at whatever range; a consumer that limits its range may still use a
    farther return as free space."""

    stamp_ns: int
    frame: str
    points: F32
    intensity: F32
    time: F32
    ring: NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class Imu(Message):
    """Angular velocity (rad/s) and specific force (m/s^2) in the sensor frame."""

    stamp_ns: int
    frame: str
    angular_velocity: Vector3
    linear_acceleration: Vector3


@dataclass(frozen=True, slots=True, eq=False)
class GnssFix(Message):
    """A position by satellites: WGS 84 latitude, longitude (deg), altitude (m), NaN without a fix; `variance` east, north, up (m²)."""

    stamp_ns: int
    frame: str
    latitude: float
    longitude: float
    altitude: float
    variance: Vector3


@dataclass(frozen=True, slots=True, eq=False)
class Image(Message):
    """A picture in a camera's optical frame (height, width), row 0 at the top: grey values uint8, or of a depth camera uint16, the distances along
    its axis in millimetres, 0 where it measured none."""

    stamp_ns: int
    frame: str
    data: NDArray[np.uint8] | NDArray[np.uint16]

    @property
    def is_depth(self) -> bool:
        """Whether it holds distances."""
        return bool(self.data.dtype == np.uint16)

    @property
    def grey(self) -> NDArray[np.uint8]:
        """The grey values; raises BadInputError when it holds distances."""
        if self.is_depth:
            raise BadInputError(f"{self.frame} sends distances, no grey picture")
        return self.data.astype(np.uint8, copy=False)

    @property
    def depth(self) -> NDArray[np.uint16]:
        """The distances in millimetres; raises BadInputError when it holds grey values."""
        if not self.is_depth:
            raise BadInputError(f"{self.frame} sends a grey picture, no distances")
        return self.data.astype(np.uint16, copy=False)


@dataclass(frozen=True, slots=True, eq=False)
class CameraInfo(Message):
    """How the camera with this frame projects. A focal length of zero means that it was never calibrated, as in ROS."""

    stamp_ns: int
    frame: str
    model: CameraModel


class PowerSupply(enum.IntEnum):
    """What the charger does; the numbers are those of sensor_msgs/BatteryState. NOT_CHARGING: contact, but no current."""

    UNKNOWN = 0
    CHARGING = 1
    DISCHARGING = 2
    NOT_CHARGING = 3
    FULL = 4


@dataclass(frozen=True, slots=True, eq=False)
class BatteryState(Message):
    """Volts, amperes (positive while charging), and the share 0..1 of the charge that is left; NaN where it is not measured. Rounded
    to float32 at birth, as the wire holds them."""

    stamp_ns: int
    frame: str
    voltage: float
    current: float
    share: float
    supply: PowerSupply

    def __post_init__(self) -> None:
        names = ("voltage", "current", "share")
        rounded = _THREE_FLOATS.unpack(_THREE_FLOATS.pack(*(getattr(self, name) for name in names)))
        for name, value in zip(names, rounded, strict=True):
            object.__setattr__(self, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class Odometry(Message):
    """A pose of `child` in `frame` with the velocity in the child frame; covariances float64 (6, 6), (x, y, z, roll, pitch, yaw)."""

    stamp_ns: int
    frame: str
    child: str
    pose: SE3
    linear: Vector3
    angular: Vector3
    pose_covariance: F64
    twist_covariance: F64


@dataclass(frozen=True, slots=True, eq=False)
class VelocityCommand(Message):
    """A wanted velocity in the base frame, m/s and rad/s."""

    stamp_ns: int
    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class JoystickState(Message):
    """What a person holds: axes float32 (N,) in -1..1, and buttons uint8 (M,), 1 while pressed."""

    stamp_ns: int
    frame: str
    axes: F32
    buttons: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class TransformStamped(Message):
    """One edge of the transform tree."""

    stamp_ns: int
    parent: str
    child: str
    parent_from_child: SE3


@dataclass(frozen=True, slots=True, eq=False)
class Transforms(Message):
    """Several edges of the transform tree at once."""

    stamp_ns: int
    transforms: tuple[TransformStamped, ...]


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid(Message):
    """Occupancy int8 [iy, ix]: -1 unknown, 0 free ... 100 occupied."""

    stamp_ns: int
    frame: str
    spec: GridSpec
    data: NDArray[np.int8]


@dataclass(frozen=True, slots=True, eq=False)
class CostGrid(Message):
    """Costs uint8 [iy, ix]: 0 free ... 253 inscribed, 254 lethal, 255 unknown."""

    stamp_ns: int
    frame: str
    spec: GridSpec
    data: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Path(Message):
    """A path in `frame`: poses float64 (N, 3) of (x, y, yaw)."""

    stamp_ns: int
    frame: str
    poses: F64


@dataclass(frozen=True, slots=True, eq=False)
class PoseStamped(Message):
    """A pose in a frame: a goal, an estimate, a truth."""

    stamp_ns: int
    frame: str
    pose: SE3


@dataclass(frozen=True, slots=True, eq=False)
class PointStamped(Message):
    """A point in a frame."""

    stamp_ns: int
    frame: str
    point: Vector3


@dataclass(frozen=True, slots=True, eq=False)
class Polygon(Message):
    """A closed polygon float32 (N, 3) in a frame: the footprint, a boundary."""

    stamp_ns: int
    frame: str
    points: F32


@dataclass(frozen=True, slots=True, eq=False)
class Number(Message):
    """A number that somebody outside tells: a speed, a radius; rounded to float32, as the wire holds it."""

    stamp_ns: int
    value: float


@dataclass(frozen=True, slots=True, eq=False)
class Code(Message):
    """A small whole number that somebody outside tells, -128 to 127."""

    stamp_ns: int
    value: int


@dataclass(frozen=True, slots=True, eq=False)
class VisibilityGraphView(Message):
    """A visibility graph for people to see: `nodes` float32 (N, 3) with `node_kinds` uint8 (0 corner, 1 gap, 2 driven), `edges` float32 (E, 2, 3) with `edge_kinds`
    uint8 (0 sight, 1 contour, 2 trajectory), and `contours`, each float32 (M, 3)."""

    stamp_ns: int
    frame: str
    nodes: F32
    node_kinds: NDArray[np.uint8]
    edges: F32
    edge_kinds: NDArray[np.uint8]
    contours: tuple[F32, ...]


class FrontierState(enum.IntEnum):
    """What the explorer thinks of a frontier."""

    OPEN = 0
    TARGET = 1
    UNREACHABLE = 2
    TOO_SMALL = 3
    OUTSIDE_BOUNDARY = 4


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """One connected group of frontier cells: cells float32 (N, 2) in metres, centroid, goal, its state and the reason in words."""

    cells: F32
    centroid: tuple[float, float]
    goal: tuple[float, float, float] | None
    path_distance: float
    state: FrontierState
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Frontiers(Message):
    """All frontiers of one map."""

    stamp_ns: int
    frame: str
    frontiers: tuple[Frontier, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SlamHealth(Message):
    """How good the last scan match was. `covariance` float64 (3, 3) of (x, y, yaw); `degeneracy` is the ratio of the smallest to
    the largest eigenvalue of the translational information (1 = isotropic, 0 = a corridor)."""

    stamp_ns: int
    score: float
    inlier_ratio: float
    degeneracy: float
    covariance: F64
    submaps: int
    nodes: int
    loop_closures: int


@dataclass(frozen=True, slots=True, eq=False)
class GroundLevels(Message):
    """Levels of the map of ground: the `active` one, on which the robot is, of `count`. Who stands at one of `passages` float64 (N, 5), (level from, level to,
    x, y, yaw) in the map frame, is on both."""

    stamp_ns: int
    frame: str
    active: int
    count: int
    passages: F64


@dataclass(frozen=True, slots=True, eq=False)
class Contact(Message):
    """A contact of the robot with something that is not the ground, as the simulator's ground truth sees it.

    `approach` is told of somebody who walks: the fastest speed (m/s) at which the point of the robot that is touched moved towards him
    within the last half second, negative if it only moved away; and of what a robot meets within half a second after somebody touched it, who may
    have pushed it there: the speed at which it drove itself. None for everything else.
    """

    stamp_ns: int
    robot_geom: str
    other_geom: str
    position: Vector3
    speed: float
    force: float
    approach: float | None = None


class GateState(enum.IntEnum):
    """What the velocity gate lets pass."""

    PAUSED = 0
    ARMED = 1
    PROTECTIVE_STOP = 2
    EMERGENCY_STOP = 3
    FAULT = 4


@dataclass(frozen=True, slots=True, eq=False)
class GateStatus(Message):
    """State of the velocity gate, why, and which source drives."""

    stamp_ns: int
    state: GateState
    reason: str
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class Text(Message):
    """A text that holds from now on, such as a robot's description; it travels without its stamp and comes back with 0."""

    stamp_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Status(Message):
    """A node's state for people and logs: a short code, a sentence, and a flat JSON object of fields."""

    stamp_ns: int
    node: str
    code: str
    text: str
    fields_json: str = "{}"


class OutsideKind(enum.IntEnum):
    """What came through the outside door."""

    CALL = 0
    GOAL = 1
    CANCEL = 2


@dataclass(frozen=True, slots=True, eq=False)
class OutsideCall(Message):
    """A service called, a goal sent or cancelled from outside the stack. `name` is that of the table, `number` counts the calls of
    one stack (a CANCEL carries the number of its goal), `data` is the request or goal as CDR."""

    stamp_ns: int
    kind: OutsideKind
    name: str
    number: int
    data: bytes = b""
