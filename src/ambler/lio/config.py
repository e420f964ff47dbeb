"""What the LiDAR-inertial filter can be told. Defaults fit spinning and solid-state LiDARs with a MEMS IMU alike."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

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
    gyro_bias_sigma: float = 0.01
    accel_bias_sigma: float = 0.05
    gap_most: float = 0.05  # seconds between two samples; a longer gap is reported, and the noise grows with it
    gyro_bias_most: float = 0.1
    accel_bias_most: float = 0.5


@dataclass(frozen=True, slots=True)
class StartConfig:
    """The beginning: `rest` seconds of stillness level the map and give the biases; after `patience` seconds without them it starts anyhow."""

    rest: float = 1.0
    samples_least: int = 20
    patience: float = 3.0
    rest_gyro_sigma: float = 0.03
    rest_accel_sigma: float = 0.25
    gravity_window: float = 0.06  # relative deviation of the mean force from 1 g or 9.81 m/s² that is believed


@dataclass(frozen=True, slots=True)
class RestConfig:
    """Zero-velocity updates: a scan's inertial measurements vary no more than `factor` times as much as at the start, and it hardly moves."""

    is_used: bool = True
    factor: float = 2.0
    speed_most: float = 0.04
    rate_most: float = 0.02
    velocity_sigma: float = 0.01
    rate_sigma: float = 0.002


@dataclass(frozen=True, slots=True)
class DegeneracyConfig:
    """A direction in which the planes of a scan say too little is left to the inertial measurements: fewer than `constraints_least` inliers' worth
    of information in total, or a smaller share of the inliers than `share_least`."""

    share_least: float = 0.008
    constraints_least: float = 8.0
    rotation_arm: float = 3.0  # metres; what a rotation of 1 rad moves a point by, to compare rotation with translation


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """Velocity of wheel odometry as a measurement: metres per second of a standing base, and a share of the speed."""

    is_used: bool = True
    sigma: float = 0.02
    share: float = 0.01
    sideways_sigma: float = 0.05


@dataclass(frozen=True, slots=True)
class PlanarConfig:
    """The soft constraint of a base on level ground: `is_used` keeps height, roll and pitch near those of the start."""

    is_used: bool = False
    height_sigma: float = 0.05
    tilt_sigma: float = math.radians(0.5)


@dataclass(frozen=True, slots=True)
class DriftConfig:
    """How far the map itself drifts, which the filter takes for exact: random walks per metre of way, added to the covariance that is told. From walks through
    development sites (docs/lio.md)."""

    position: float = 1.2e-3  # m/√m in each direction
    rotation: float = 8e-5  # rad/√m
    coasting: float = 0.01  # share of a way along which no plane faced: the scale of wheels


@dataclass(frozen=True, slots=True)
class LoopConfig:
    """Loop closure: submaps along the way, matched where they overlap again, and a pose graph. Chosen on the development sites of docs/lio.md."""

    is_used: bool = True
    keyframe_m: float = 5.0  # of way in a submap: 16 rings fill their gaps, and the drift within stays at millimetres
    keyframe_rad: float = 1.6  # or of turning, for scanners that do not look all around
    range_most: float = 40.0  # farther points are sparse, and an error of attitude moves them by centimetres
    cell: float = 0.3  # m; one point each, the mean of many returns
    points_most: int = 20000  # of a submap: 0.7 MB with its normals and its tree
    odometry_least: tuple[float, float] = (0.001, 1e-4)  # m, rad; what a submap's end is off by however short it is
    way_least: float = 30.0  # m between two submaps that are matched: nearer ones the odometry's own map has joined
    distance_most: float = 12.0  # m between the origins of two submaps that are matched: beyond they show other sides
    candidates_most: int = 3  # of a new submap, the nearest: more tell the same
    gain_least: float = 1.5  # a match is tried where the graph is less certain than it by this factor
    drift_factor: float = 3.0  # how much more the odometry may drift than `drift` says: from NEES of up to 7
    reach: float = 2.0  # m between paired points in the first pass; what the odometry drifts in a kilometre or two
    overlap_least: float = 0.55  # share of a submap's points with a partner within a quarter of it; other places reach 0.46, the same place from 12 m away has 0.68
    residual_most: float = (
        0.05  # m between planes of the same surfaces; a true place gives 0.003 to 0.012, another 0.1 and more
    )
    share_least: float = 0.02  # of pairs that face a direction; below, a match says nothing along it: normals of smooth walls sway by so much
    match_sigma: tuple[float, float] = (0.01, 3e-4)  # m, rad; what submaps bent by drift leave of a match's exactness
    gate: float = 22.5  # squared normalized distance of a match from what the graph expects: 99.9 % of six dimensions
    window_most: float = 20.0  # m to each side that are searched where the drift is beyond `reach`: half a submap
    tilt_sigma: float = 0.02  # rad; of gravity at one keyframe. Its errors are those of the accelerometer's bias, common to tens of keyframes in a row
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
class LioConfig:
    """The whole filter. `imu_from_lidar` is (x, y, z, roll, pitch, yaw) in metres and radians, None: from the recording, else the identity.

    `lidar_clock` is how many seconds the LiDAR's stamps lag behind the IMU's. `noise` (m) is that of a point to its plane.
    """

    map: VoxelMapConfig = field(default_factory=VoxelMapConfig)
    scan: ScanConfig = field(default_factory=ScanConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    start: StartConfig = field(default_factory=StartConfig)
    rest: RestConfig = field(default_factory=RestConfig)
    degeneracy: DegeneracyConfig = field(default_factory=DegeneracyConfig)
    wheels: WheelConfig = field(default_factory=WheelConfig)
    planar: PlanarConfig = field(default_factory=PlanarConfig)
    drift: DriftConfig = field(default_factory=DriftConfig)
    alone: AloneConfig = field(default_factory=AloneConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    imu_from_lidar: tuple[float, float, float, float, float, float] | None = None
    lidar_clock: float = 0.0
    estimates_mount: bool = False
    mount_sigma: tuple[float, float] = (0.05, 0.03)  # m and rad that the mount is told to, where it is estimated
    refines_mount: bool = True  # of whole recordings: the filter's last word on the mount holds for all poses
    refined_sigma: tuple[float, float] = (0.003, 0.003)  # m and rad that plates are built to, about 0.2 degrees
    estimates_clock: bool = False
    has_imu: bool = True  # False: a LiDAR alone, with motion between scans that goes on as it was
    noise: float = 0.1  # of single returns 1-2 cm; the rest is what five noisy neighbours make of a plane, and that errors of one plane are shared
    outlier_scale: float = 0.15
    iterations_most: int = 3
    converged_m: float = 1e-3
    converged_rad: float = 1e-4
    insert_m: float = 0.05  # at rest the map does not grow
    insert_rad: float = 0.01
    inliers_least: int = 50
    coast_most: float = 1.0  # seconds without a scan that fits after which a robot's odometry is not told any more: an IMU alone is a decimetre off by then

    @property
    def extras(self) -> int:
        """How many error states follow the seventeen."""
        return (6 if self.estimates_mount or self.estimates_clock else 0) + (1 if self.estimates_clock else 0)
