"""What the LiDAR-inertial filter can be told. Defaults fit spinning and solid-state LiDARs with a MEMS IMU alike."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ambler.core.errors import BadInputError
from ambler.core.units import Radians

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, slots=True)
class VoxelMapConfig:
    """The map of points. `voxel` and `spacing` exceed the gap between the rings of a scanner some metres away, else five neighbours lie on
    one ring and their plane turns about it."""

    voxel: float = 1.0
    points_per_voxel: int = 8
    spacing: float = 0.45
    merge: float = (
        0.15  # nearer returns refine a point instead of adding one: the map gets sharper than a single return
    )
    merge_most: float = (
        10.0  # later returns leave it alone, so that the map does not follow the drift of what is matched to it
    )
    voxels_most: int = 1 << 17  # 12 MB of points; more than a radius of 100 m fills in a town
    radius: float = 100.0
    evict_step: float = 10.0  # metres between two evictions
    cells_visited: int = 7  # 19 finds planes where there are few points, at twice the time
    reach: float = 1.5
    thickness: float = 0.1
    flatness: float = 0.04


@dataclass(frozen=True, slots=True)
class ScanConfig:
    """Which points are used: those within a range, one per cell of an edge that adapts so that about `points_wanted` remain."""

    range_min: float = 0.5
    range_max: float = 120.0
    voxel: float = 0.5
    voxel_min: float = 0.1
    voxel_max: float = 1.0
    points_wanted: int = 2000
    decimation: int = 1  # every n-th point only, for computers that are too slow


@dataclass(frozen=True, slots=True)
class ImuConfig:
    """Noise densities (rad/s/√Hz, m/s²/√Hz) and random walks of the biases; several times those of data sheets, because scale, misalignment
    and vibration are not modelled apart."""

    gyro_density: float = 1e-3
    accel_density: float = 1e-2
    gyro_walk: float = 1e-5
    accel_walk: float = 1e-4
    gyro_bias_sigma: Radians = 0.01
    accel_bias_sigma: float = 0.05
    gap_most: float = 0.05  # seconds between two samples; a longer gap is reported, and the noise grows with it
    gyro_bias_most: Radians = 0.1
    accel_bias_most: float = 0.5


@dataclass(frozen=True, slots=True)
class StartConfig:
    """The beginning: `rest` seconds of stillness level the map and give the biases; after `patience` seconds without them it starts anyhow. A running motor shakes who stands
    by more than `rest_gyro_sigma` and `rest_accel_sigma`, too: means over `shaken_period` s (a raised cosine, which leaves out what is above 10 Hz) may vary by `shaken_gyro_sigma` and `shaken_accel_sigma` then."""

    rest: float = 1.0
    samples_least: int = 20
    patience: float = 3.0
    rest_gyro_sigma: Radians = 0.03
    rest_accel_sigma: float = 0.25
    shaken_period: float = 0.2
    shaken_gyro_sigma: Radians = 0.01
    shaken_accel_sigma: float = 0.08  # m/s²; steps, strides and roads are at 0.3 and more
    gravity_window: float = (
        0.06  # relative deviation of the mean force from 1 g or 9.81 m/s² that is believed at rest, and
    )
    motion_window: float = 0.3  # of who moves: a car that sets off adds a third of it
    rehearsed: int = (
        10  # scans, of who begins in motion: a filter that is given away follows them to learn how fast he is
    )
    speed_sigma: float = 8.0  # m/s that the rehearsal begins with, and
    rest_speed_most: float = 0.2  # m/s that scans may say of who feels nothing
    share_least: float = 0.05  # of the planes that must face a direction for a speed along it to be told: streets and halls have 0.1, edges along a tunnel look like 0.03
    speed_alone_sigma: float = 1.0  # where the LiDAR alone has told it; and
    rehearsed_sigma: float = 0.3  # what the filter begins with after it


@dataclass(frozen=True, slots=True)
class HoleConfig:
    """A hole in clouds and inertial measurements together. Across up to `bridged` s the motion goes on as the samples on both sides say; after a longer one the place is looked
    for in the own map about where the speed before led: within `way_least` m and what it goes at `speed_more` m/s (or as fast as before), `turn_least` rad and what it turns at `rate_more` rad/s more than before;
    beyond `way_most` m in the whole map. Two sights must agree within `same_way` m and `same_turn` rad. What is found is good to `place_sigma` m and `turn_sigma` rad."""

    bridged: float = 0.25
    way_least: float = 1.0
    speed_more: float = 1.0
    turn_least: Radians = 0.3
    rate_more: Radians = 0.7
    way_most: float = 20.0
    same_way: float = 0.3
    same_turn: Radians = 0.05
    place_sigma: float = 0.1
    turn_sigma: Radians = 0.02

    def __post_init__(self) -> None:
        if not self.bridged > 0.0:
            raise BadInputError(f"hole bridged: must be positive, is {self.bridged}")


@dataclass(frozen=True, slots=True)
class RestConfig:
    """Zero-velocity updates: a scan's inertial measurements vary no more than `factor` times as much as at the start, and it hardly moves. Until then, and until
    a scan finds it more than `way_most` m or `turn_most` rad away, it is where it began; `begin_factor` times as far while the first scans build a map, whose planes lean most. The mean rate must be the bias to `rate_quiet` rad/s, the mean force gravity's to `accel_quiet` m/s², beyond what is noise in them, and to `rate_most` and `accel_most` where a motor shook it at the start:
    what sets off smoothly varies no more than what stands, and what is taken for rest until it goes too fast for that is lost: a turn of 0.2°, and for good a speed that no scan tells."""

    is_used: bool = True
    factor: float = 2.0
    speed_most: float = 0.04
    rate_most: Radians = 0.02
    accel_most: float = 0.2
    rate_quiet: Radians = 0.005
    accel_quiet: float = 0.1
    velocity_sigma: float = 0.01
    rate_sigma: Radians = 0.002
    way_most: float = 0.01
    turn_most: Radians = 0.003
    begin_factor: float = 3.0


@dataclass(frozen=True, slots=True)
class DegeneracyConfig:
    """A direction in which the planes of a scan say too little is left to the inertial measurements: fewer than `constraints_least` inliers' worth
    of information in total, or a smaller share of the inliers than `share_least`. Below `share_faint` what a direction is told may be floors and walls that lean a little."""

    share_least: float = 0.008
    share_faint: float = 0.02
    constraints_least: float = 8.0
    rotation_arm: float = 3.0  # metres; what a rotation of 1 rad moves a point by, to compare rotation with translation


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """Velocity of wheel odometry as a measurement: metres per second of a standing base, and a share of the speed. A velocity that lies more than `slip`
    standard deviations off what LiDAR and IMU tell counts the less the farther off it lies: the wheels spin."""

    is_used: bool = True
    sigma: float = 0.02
    share: float = 0.01
    sideways_sigma: float = 0.05
    slip: float = 3.0

    def __post_init__(self) -> None:
        if not self.slip > 0.0:
            raise BadInputError(f"wheels slip: must be positive, is {self.slip}")


@dataclass(frozen=True, slots=True)
class PlanarConfig:
    """The soft constraint of a base on level ground: `is_used` keeps height, roll and pitch near those of the start. Where one of them is more than `gate` standard deviations off, the ground is not level, and says nothing."""

    is_used: bool = False
    height_sigma: float = 0.05
    tilt_sigma: Radians = math.radians(0.5)
    gate: float = 3.0


@dataclass(frozen=True, slots=True)
class DriftConfig:
    """How far the map itself drifts, which the filter takes for exact: random walks per metre of way, added to the covariance that is told. From walks through
    development sites (docs/lio.md)."""

    position: float = 1.4e-4  # m/√m in each direction
    rotation: float = 1.2e-5  # rad/√m
    coasting: float = 0.01  # share of a way along which no plane faced: the scale of wheels
    coasting_acceleration: float = 0.02  # m/s² along it without wheels: a map that leans by 0.1°
    seen: float = 0.5  # s after which the speed along what is seen again is known
    begin_m: float = 0.5  # from the start by which the gaps between the rings of a single place are filled
    begin_position: float = 4e-3  # m and rad, once, on leaving it
    begin_rotation: float = 8e-5
    begin_noise: float = 4.0  # how many times noisier returns count there, beyond once, where it began at rest

    def __post_init__(self) -> None:
        if not self.begin_m > 0.0:
            raise BadInputError(f"drift begin_m: must be positive, is {self.begin_m}")
        if not self.seen > 0.0:
            raise BadInputError(f"drift seen: must be positive, is {self.seen}")


@dataclass(frozen=True, slots=True)
class LoopConfig:
    """Loop closure: submaps along the way, matched where they overlap again, and a pose graph. Chosen on the development sites of docs/lio.md."""

    is_used: bool = True
    keyframe_m: float = 5.0  # of way in a submap: 16 rings fill their gaps, and the drift within stays at millimetres
    keyframe_rad: float = 1.6  # or of turning, for scanners that do not look all around
    range_most: float = 40.0  # farther points are sparse, and an error of attitude moves them by centimetres
    cell: float = 0.3  # m; one point each, the mean of many returns
    points_most: int = 20000  # of a submap, 0.24 MB
    odometry_least: tuple[float, float] = (0.0037, 3.7e-4)  # m, rad; what a submap's end is off by however short it is
    way_least: float = 30.0  # m between two submaps that are matched: nearer ones the odometry's own map has joined
    distance_most: float = 12.0  # m between the origins of two submaps that are matched: beyond they show other sides
    candidates_most: int = 3  # of a new submap, the nearest: more tell the same
    gain_least: float = 1.5  # a match is tried where the graph is less certain than it by this factor
    drift_factor: float = 14.0  # how much more the odometry may drift than `drift` says, which is of scanners without faults; and what it coasted
    coasting_factor: float = 3.7
    reach: float = 2.0  # m between paired points in the first pass; what the odometry drifts in a kilometre or two
    overlap_least: float = 0.55  # share of a submap's points with a partner within a quarter of it; other places reach 0.46, the same place from 12 m away has 0.68
    residual_most: float = (
        0.05  # m between planes of the same surfaces; a true place gives 0.003 to 0.012, another 0.1 and more
    )
    share_least: float = 0.02  # of pairs that face a direction; below, a match says nothing along it: normals of smooth walls sway by so much
    match_sigma: tuple[float, float] = (0.01, 3e-4)  # m, rad; what submaps bent by drift leave of a match's exactness
    gate: float = 22.5  # squared normalized distance of a match from what the graph expects: 99.9 % of six dimensions
    window_most: float = 20.0  # m to each side that are searched where the drift is beyond `reach`: half a submap
    tilt_sigma: Radians = 0.02  # rad; of gravity at one keyframe. Its errors are those of the accelerometer's bias, common to tens of keyframes in a row
    tilt_factor: float = 10.0  # of what the filter says of gravity, for the same reason
    robust_width: float = 3.0  # sigmas at which a closure begins to count less


@dataclass(frozen=True, slots=True)
class AloneConfig:
    """A LiDAR without IMU: how much its motion may change, as densities of rate (rad/s/√Hz) and acceleration (m/s²/√Hz)."""

    iterations_most: int = 30  # the prediction may be far off
    rate_density: float = 1.0
    acceleration_density: float = 8.0
    speed_sigma: float = 5.0


@dataclass(frozen=True, slots=True)
class CloudMapConfig:
    """A saved cloud. `cell`: metres per point that is kept; `neighbours` make a normal; `surface_cell` knows which way its surface faces.
    `image_cell`, `image_sigma`, `depth`: grid, smoothing (m) and levels of the search from above; a sensor stands within `ground_near` m of something flat.
    A cell holds a surface that stops rays when at least `plane_points` of its points lie `plane_sigma` m (RMS) about a plane; a ray passes through it when both its ends lie `clear` m off, and it meets it with a cosine above `cosine_least`."""

    cell: float = 0.2
    neighbours: int = 12
    surface_cell: float = 0.5
    height_step: float = 0.25
    image_cell: float = 0.4
    image_sigma: float = 0.4
    depth: int = 5
    ground_near: float = 4.0
    plane_points: int = 6
    plane_sigma: float = 0.06
    clear: float = 0.6
    cosine_least: float = 0.2


@dataclass(frozen=True, slots=True)
class CloudMatchConfig:
    """Registration to a saved cloud, coarse then fine: cells of the points (m), how far their partners may be (m), rounds. A point is explained
    within `near` m of a surface that faces as its own does (cosine `facing`). At most `points_most` are used, none farther than `range_most`."""

    range_most: float = 35.0
    points_most: int = 5000
    coarse_cell: float = 1.0
    coarse_reach: float = 1.5
    coarse_rounds: int = 20
    fine_cell: float = 0.3
    fine_reach: float = 0.5
    fine_rounds: int = 15
    near: float = 0.2
    facing: float = 0.7
    tilt_most: Radians = math.radians(4.0)  # both maps are level


@dataclass(frozen=True, slots=True)
class CloudRelocalizerConfig:
    """Where in the cloud: `scans_least` are gathered before a search, at most `scans_most`; `search_points` walls are looked for from above, poses
    below `keep_ratio` of the best or `score_least` are not pursued; `candidates` are tried at every height, and of these at most `refined` that score at least `promising` times
    the best are registered.
    `guess_way` (m), `guess_turn` (rad): how far a guess may be off. A place is accepted from `accept` quality on when it leads by `margin`, or by `margin_least` while it leaves at most `rest_ratio` of what the second leaves unexplained: then `viewpoints_barely` must agree
    instead of `viewpoints`. Places are one within
    `same_way` (m) and `same_turn` (rad). A viewpoint is new after `viewpoint_way` (m) or `viewpoint_turn` (rad). Nothing found: wait `retry_after` s."""

    scans_least: int = 5
    scans_most: int = 40
    search_points: int = 250
    keep_ratio: float = 0.8
    score_least: float = 0.3
    candidates: int = 60
    refined: int = 12
    promising: float = 0.5
    guess_way: float = 2.5
    guess_turn: Radians = math.radians(36.0)
    accept: float = 0.5
    flat_least: float = 0.3  # of the floors: below a deck 0.3 m thick planes lie between its two sides, and of the right place half of them are explained
    margin: float = 0.08
    margin_least: float = 0.03
    rest_ratio: float = 0.65
    same_way: float = 1.0
    same_turn: Radians = math.radians(8.0)
    viewpoint_way: float = 1.5
    viewpoint_turn: Radians = 0.8
    viewpoints: int = 2
    viewpoints_barely: int = 3
    retry_after: float = 1.0


@dataclass(frozen=True, slots=True)
class CloudTrackerConfig:
    """Following the place in the cloud: every `period` s the last `scans` are registered. What the odometry drifts meanwhile: `walk` m/√m and `turn` rad/√m,
    and at rest a little (`idle_walk` m/√s, `idle_turn` rad/√s). `noise` (m) of a point to its plane, with what neighbours share.
    A registration below `accept` quality, or off by more than `jump` m or `jump_turn` rad, is a miss; after `misses_most` in a row the place is lost.
    What is told follows the estimate with the time constant `smooth` s."""

    period: float = 1.0
    scans: int = 10
    walk: float = 0.02
    turn: float = 0.002
    idle_walk: float = 0.001
    idle_turn: float = 0.0001
    noise: float = 0.5
    accept: float = 0.3
    jump: float = 0.6
    jump_turn: Radians = math.radians(5.0)
    misses_most: int = 10
    smooth: float = 1.0


@dataclass(frozen=True, slots=True)
class CloudLocalizerConfig:
    """Localization in a saved cloud: the map, registration to it, the search for the place and following it."""

    map: CloudMapConfig = field(default_factory=CloudMapConfig)
    match: CloudMatchConfig = field(default_factory=CloudMatchConfig)
    relocalizer: CloudRelocalizerConfig = field(default_factory=CloudRelocalizerConfig)
    tracker: CloudTrackerConfig = field(default_factory=CloudTrackerConfig)


@dataclass(frozen=True, slots=True)
class CloudGridConfig:
    """The plan cut out of a cloud: `resolution` m per cell; the floor is followed over cells of `floor_cell` m, climbing at most `climb` m from one to the
    next and across at most `gap` cells without any; what has `points_least` points between `band_low` and `band_high` m above it, or one and
    with the cells around `points_around`, is occupied. The way's
    sensor is between `sensor_least` and `sensor_most` m above its floor; every `eye_step` m it looks `reach` m far."""

    resolution: float = 0.1
    floor_cell: float = 0.5
    climb: float = 0.3
    gap: int = 2
    points_least: int = 2
    points_around: int = 5
    band_low: float = 0.2
    band_high: float = 1.5
    sensor_least: float = 0.2
    sensor_most: float = 3.0
    eye_step: float = 0.5
    reach: float = 15.0


@dataclass(frozen=True, slots=True)
class ViewConfig:
    """The registered cloud that is recorded and shown, beside the whole one for the robot's own nodes: one point per cell of `cell` metres (0: all) of every `every`-th scan.
    Whole clouds make recordings twice as large, 6 MB/s; a replay computes them again."""

    cell: float = 0.2
    every: int = 2


@dataclass(frozen=True, slots=True)
class LioConfig:
    """The whole filter. `imu_from_lidar` is (x, y, z, roll, pitch, yaw) in metres and radians, None: from the recording, else the identity.

    `lidar_clock` is how many seconds the LiDAR's stamps lag behind the IMU's. `noise` (m) is that of a point to its plane.
    """

    map: VoxelMapConfig = field(default_factory=VoxelMapConfig)
    scan: ScanConfig = field(default_factory=ScanConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    start: StartConfig = field(default_factory=StartConfig)
    hole: HoleConfig = field(default_factory=HoleConfig)
    rest: RestConfig = field(default_factory=RestConfig)
    degeneracy: DegeneracyConfig = field(default_factory=DegeneracyConfig)
    wheels: WheelConfig = field(default_factory=WheelConfig)
    planar: PlanarConfig = field(default_factory=PlanarConfig)
    drift: DriftConfig = field(default_factory=DriftConfig)
    alone: AloneConfig = field(default_factory=AloneConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    localize: CloudLocalizerConfig = field(default_factory=CloudLocalizerConfig)
    grid: CloudGridConfig = field(default_factory=CloudGridConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    imu_from_lidar: tuple[float, float, float, float, float, float] | None = None
    lidar_clock: float = 0.0
    estimates_mount: bool = False
    mount_sigma: tuple[float, float] = (0.05, 0.03)  # m and rad that the mount is told to, where it is estimated
    refines_mount: bool = True  # of whole recordings: the filter's last word on the mount holds for all poses, if it turned about all axes
    refined_sigma: tuple[float, float] = (0.003, 0.003)  # m and rad that plates are built to, about 0.2 degrees
    refined_turn: Radians = (
        0.03  # rad RMS within 3 s about every axis, from which on a recording tells the mount (`lio.turning`)
    )
    refined_clock: float = 0.002  # s that two clocks on one plate agree to
    learned_share: float = 0.3  # of what a scan says of mount and clock that is believed: its errors are not new
    estimates_clock: bool = False
    clock_sigma: float = 0.02  # s that the LiDAR's clock is told to, where it is estimated
    has_imu: bool = True  # False: a LiDAR alone, with motion between scans that goes on as it was
    noise: float = 0.1  # of single returns 1-2 cm; the rest is what five noisy neighbours make of a plane, and that errors of one plane are shared
    outlier_scale: float = 0.15
    iterations_most: int = 3
    converged_m: float = 1e-3
    converged_rad: float = 1e-4
    insert_m: float = 0.05  # at rest the map does not grow
    insert_rad: float = 0.01
    inliers_least: int = 50
    contradiction_speed: float = 0.1  # m/s; how much the updates of a scan may differ from what the IMU tells, where
    contradiction_ratio: float = (
        0.6  # a smaller share of its points lies on planes: right maps have 0.7 to 0.9, and differ by 0.01 m/s
    )
    coast_most: float = 1.0  # seconds without a scan that fits after which a robot's odometry is not told any more: an IMU alone is a decimetre off by then

    def __post_init__(self) -> None:
        if not 0.0 < self.learned_share <= 1.0:
            raise BadInputError(f"learned_share: above 0 and at most 1, is {self.learned_share}")

    @property
    def extras(self) -> int:
        """How many error states follow the seventeen."""
        return (6 if self.estimates_mount or self.estimates_clock else 0) + (1 if self.estimates_clock else 0)
