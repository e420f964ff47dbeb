"""The configuration of a robot: one dataclass, flat by room, the same for every verb, with per-robot differences in one place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from ambler.calibration.scan_calibration import CalibrationConfig
from ambler.control.config import RolloutConfig
from ambler.control.local_planners import Controller
from ambler.control.primitives_config import PrimitivesConfig
from ambler.control.pursuit_config import PursuitConfig
from ambler.control.unseen_ground import UnseenGroundConfig
from ambler.control.yielding import YieldConfig
from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_ASSUMED
from ambler.core.robot import DriveKind, RobotModel, SensorKind
from ambler.costmap.global_costmap import GlobalCostmapConfig
from ambler.costmap.inflation import InflationConfig, turning_cost
from ambler.costmap.local_costmap import LocalCostmapConfig
from ambler.costmap.voxel_layer import VoxelConfig
from ambler.exploration.fence import FenceConfig
from ambler.exploration.strategies import GreedyStrategy
from ambler.exploration.survey import SurveyConfig
from ambler.exploration.tour import TourConfig
from ambler.grids.probability_grid import InsertionConfig
from ambler.lio.config import LioConfig
from ambler.lio.station_cloud import StationCloudConfig
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.localization.localizer import Localizer
from ambler.localization.odometry import OdometryConfig
from ambler.localization.particle_filter import ParticleFilter, ParticleFilterConfig
from ambler.localization.reflector_localizer import ReflectorConfig, ReflectorLocalizer
from ambler.localization.reflectors import ReflectorMap
from ambler.localization.surface_map import SurfaceMap
from ambler.missions.blocked_ways import BlockedWaysConfig
from ambler.missions.explore_commands import ExploreConfig
from ambler.missions.navigate import NavigationConfig
from ambler.missions.recovery import RecoveryAction
from ambler.nodes.docking import DockingNodeConfig
from ambler.nodes.localization import LocalizationNodeConfig
from ambler.nodes.slam2d import Slam2dNodeConfig
from ambler.perception.air_filter import AirFilterConfig
from ambler.perception.glass import SpecularConfig
from ambler.perception.glass_map import GlassMapConfig
from ambler.perception.ground_map import GroundMapConfig
from ambler.perception.mover_track import MoverConfig
from ambler.perception.planar import PlanarConfig, default_planar
from ambler.perception.scanner_profile import ScannerCalibration, calibrated_robot
from ambler.perception.terrain_config import TerrainConfig
from ambler.planning.grid_planner import PlannerConfig
from ambler.planning.visibility_planner import VisibilityConfig
from ambler.runtime.names import NameProfile
from ambler.safety.config import GateConfig
from ambler.settings.profiles import as_values, build, merge
from ambler.slam2d.config import FrontEndConfig, LoopConfig, Slam2dConfig


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """Everything that a robot can be told, in every verb; the defaults come from `default_config`.

    `strategy`, `controller`, `localizer` and `global_planner` (`planner` or `visibility`) choose one of those whose own sections stand below.
    `odometry_source` is wheels with a gyroscope (`odometry`), or a
    LiDAR of many rings with an IMU (`lio`, without what floats in the `air`); with the latter `terrain` is analysed (`ground` configures it) and
    is the floor of the local costmap. `mapping`: a robot that explores makes its map of planar `scans` (`slam2d`), on a level floor, or of the
    `ground` that its terrain analysis sees (`ground_map`), on slopes and levels above one another. Depth cameras, or where `voxels` are always wanted clouds alone, fill a layer of voxels (`voxel`) in both
    costmaps. Where an exploration holds `stations` is in `explore.stations`. `topic_names`: how the live view calls topics (`runtime.names`). `scanners` holds calibrated mounts and
    clocks, `calibration` says how they are found; `reflector_positions` (x, y) in the map frame are what the reflector localizer looks for.
    """

    strategy: Literal["tour", "nearest", "greedy"] = "tour"
    global_planner: Literal["grid", "visibility_graph"] = "grid"
    controller: Controller = "rollout"
    localizer: Literal["tracker", "particles", "reflectors"] = "tracker"
    glass: Literal["on", "off"] = "on"
    odometry_source: Literal["wheels", "lidar"] = "wheels"
    terrain: Literal["auto", "always", "never"] = "auto"  # words that YAML does not take for true and false
    mapping: Literal["scans", "ground"] = "scans"
    voxels: Literal["auto", "always", "never"] = "auto"
    topic_names: NameProfile = "own"
    ground: TerrainConfig = field(default_factory=TerrainConfig)
    ground_map: GroundMapConfig = field(default_factory=GroundMapConfig)
    voxel: VoxelConfig = field(default_factory=VoxelConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    slam2d: Slam2dNodeConfig = field(default_factory=Slam2dNodeConfig)
    lio: LioConfig = field(default_factory=LioConfig)
    air: AirFilterConfig = field(default_factory=AirFilterConfig)
    localization: LocalizationNodeConfig = field(default_factory=LocalizationNodeConfig)
    tracker: GridTrackerConfig = field(default_factory=GridTrackerConfig)
    particles: ParticleFilterConfig = field(default_factory=ParticleFilterConfig)
    reflectors: ReflectorConfig = field(default_factory=ReflectorConfig)
    reflector_positions: tuple[tuple[float, float], ...] = ()
    global_costmap: GlobalCostmapConfig = field(default_factory=GlobalCostmapConfig)
    local_costmap: LocalCostmapConfig = field(default_factory=LocalCostmapConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    navigation: NavigationConfig = field(default_factory=NavigationConfig)
    rollout: RolloutConfig = field(default_factory=RolloutConfig)
    pursuit: PursuitConfig = field(default_factory=PursuitConfig)
    primitives: PrimitivesConfig = field(default_factory=PrimitivesConfig)
    movers: MoverConfig = field(default_factory=MoverConfig)
    yielding: YieldConfig = field(default_factory=YieldConfig)
    unseen_ground: UnseenGroundConfig = field(default_factory=UnseenGroundConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    survey: SurveyConfig = field(default_factory=SurveyConfig)
    explore: ExploreConfig = field(default_factory=ExploreConfig)
    stations: StationCloudConfig = field(default_factory=StationCloudConfig)
    tour: TourConfig = field(default_factory=TourConfig)
    greedy: GreedyStrategy = field(default_factory=GreedyStrategy)
    docking: DockingNodeConfig = field(default_factory=DockingNodeConfig)
    scanners: Mapping[str, ScannerCalibration] = field(default_factory=dict)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    specular: SpecularConfig = field(default_factory=SpecularConfig)
    glass_map: GlassMapConfig = field(default_factory=GlassMapConfig)

    def maps_glass(self, robot: RobotModel) -> bool:
        """Say whether glass is looked for: scanners of all kinds show it, planar ones also with transducers; a map of ground has no place for it."""
        return bool(robot.scanners or robot.clouds) and self.glass != "off" and self.mapping == "scans"

    def uses_terrain(self, robot: RobotModel) -> bool:
        """Say whether the ground is analysed: `auto` means on robots whose odometry registers clouds."""
        return bool(robot.clouds) and (
            self.terrain == "always" or (self.terrain == "auto" and self.odometry_source == "lidar")
        )

    @property
    def saves_cloud(self) -> bool:
        """Whether a map that is made holds, besides the ground, what was seen in three dimensions: a later run localizes in it."""
        return self.mapping == "ground" and self.lio.loops.is_used

    @property
    def holds_stations(self) -> bool:
        """Whether an exploration holds still now and then for a dense cloud."""
        return self.explore.stations.spacing > 0.0

    def check_stations(self) -> None:
        """Raise BadInputError when stations are wanted where no odometry registers clouds and closes loops, before anything runs."""
        if self.holds_stations and not self.saves_cloud:
            raise BadInputError(
                "stations (explore.stations.spacing): need a map of ground and loop closure, so odometry_source lidar, mapping ground and lio.loops.is_used"
            )

    def gate_for(self, robot: RobotModel) -> GateConfig:
        """Return the gate's numbers: on a map of ground, slopes that the robot takes are floor for the gate too, unless it is told of others."""
        if self.gate.slope > 0.0 or self.mapping != "ground" or not self.uses_terrain(robot):
            return self.gate
        return replace(self.gate, slope=math.tan(self.ground.steep))

    def uses_voxels(self, robot: RobotModel) -> bool:
        """Say whether costmaps have a layer of voxels: `auto` means on robots with depth cameras."""
        has_any = bool(robot.depth_cameras) or bool(robot.clouds)
        return has_any and (self.voxels == "always" or (self.voxels == "auto" and bool(robot.depth_cameras)))

    def make_localizer(self, surfaces: SurfaceMap, seed: int = 0) -> Localizer:
        """Build the chosen localizer for a map; `seed` is that of the particles. Raises BadInputError for reflectors without positions."""
        if self.localizer == "tracker":
            return GridTracker(surfaces, self.tracker)
        if self.localizer == "particles":
            return ParticleFilter(surfaces, self.particles, np.random.default_rng(seed))
        self.check_localizer()
        return ReflectorLocalizer(ReflectorMap.surveyed(np.array(self.reflector_positions)), self.reflectors)

    def check_odometry(self, robot: RobotModel) -> None:
        """Raise BadInputError when the chosen odometry lacks what it needs, before anything runs."""
        if self.terrain == "always" and self.odometry_source != "lidar":
            raise BadInputError("terrain always: needs registered clouds, which only odometry_source lidar gives")
        if self.mapping == "ground" and not self.uses_terrain(robot):
            raise BadInputError(
                "mapping ground: needs the terrain analysis, so odometry_source lidar and not terrain never"
            )
        if self.odometry_source == "lidar" and not can_map_ground(robot):
            raise BadInputError(
                f"odometry_source lidar: {robot.name} needs a LiDAR that gives clouds, and an IMU (spot has both)"
            )

    def check_localizer(self) -> None:
        """Raise BadInputError when the chosen localizer lacks what it needs, before anything runs."""
        if self.localizer == "reflectors" and not self.reflector_positions:
            raise BadInputError(
                "the reflector localizer needs reflector_positions in the profile: [[x, y], ...] in the map frame"
            )


# A scanner at 10 Hz fills 150 scans before the robot has left its neighbourhood. Passing rays count for more than Cartographer's
# 0.49, so that walls stay thin, and returns for more than its 0.55, because rays along a wall gnaw at it (docs/slam2d.md). The points of a cloud are means of
# several returns and lie where they lie. Between smooth walls whose ends are out of sight its own wheels are better than the texture of cells.
SHARP = FrontEndConfig(
    match_max_voxel=0.3,
    match_min_points=350,
    scans_per_submap=150,
    insertion=InsertionConfig(p_hit=0.6, p_miss=0.46),
    telling=0.002,
    picks_middle=True,
)

SHARP_CLOUD = replace(SHARP, insertion=InsertionConfig())

# Where stamps are right, loops can be searched more densely than in a log.
CLOSE_LOOPS = LoopConfig(
    query_distance=0.5, candidates_per_node=4, searches_per_job=12, tries_per_pair=24, picks_middle=True
)

FLOOR_DOUBT = 0.15  # metres above the floor from which on the gate and the map believe a cloud: a body that sways sees floor at 0.1 m
SEEN_WELL = (
    0.75  # of a scanner's range: from there many beams still meet a wall, and the robot may be that far from one
)
PADDING = 0.05  # metres that the controller keeps around the footprint; the planner keeps twice as much
TURNING_MOST = 0.25  # metres
FLOOR_SEEN = (
    0.2,
    6.2,
)  # metres beyond where a LiDAR begins to see the floor, and from the robot, where its terrain analysis has enough of it
WAY_OUT = 4.0  # metres: out of a gap between two parked cars into which a robot went before it saw how narrow it is
KNOWN_MAP_PATIENCE = 30.0  # seconds that a robot in a known map waits for a way that people block
COMPANY_PATIENCE = 300.0  # seconds after which a drive for its own sake gives up among people who hold it up
# And one of an exploration, which has other places to go; who cannot get past the robot turns round by then.
EXPLORING_PATIENCE = 20.0


def looks_around(robot: RobotModel) -> bool:
    """Whether the robot sees on all sides, so that it may look at a frontier with any heading."""
    scans = [mount for mount in robot.sensors if mount.kind is SensorKind.SCAN]
    is_full = any(mount.azimuth[1] - mount.azimuth[0] > 2.0 * math.pi - 0.1 for mount in scans)
    return is_full or len(scans) > 1 or any(mount.kind is SensorKind.CLOUD for mount in robot.sensors)


def default_config(robot: RobotModel, *, has_map: bool = False) -> RobotConfig:
    """Return the defaults for a robot: sizes from its footprint, the scanner's kind and range from its mounts. In a known map it has
    patience where people block the way, and an omnidirectional base with planar scanners pursues its path."""
    uses_cloud = any(mount.kind is SensorKind.CLOUD for mount in robot.sensors)
    # A cloud's lowest rings meet walls up to 30 m away before they meet the floor; what is floor is told by the body's lean.
    # Where such a beam meets the floor, all that it passed in the band is proved free; a planar beam that meets nothing proves less.
    # Its band is the gate's: what the gate stops for (the top of a table, the scanner's own height) the planner must know.
    planar = (
        replace(default_planar(robot), range_max=30.0, free_length=15.0, height_min=FLOOR_DOUBT)
        if uses_cloud
        else PlanarConfig(range_max=20.0)
    )
    # The planner leaves out gaps in which the controller could not turn a little to either side.
    inflation = InflationConfig(inscribed_radius=robot.inscribed_radius + 2.0 * PADDING)
    pursues = has_map and robot.drive is DriveKind.OMNI and bool(robot.scanners)
    return RobotConfig(
        controller="pursuit" if pursues else "rollout",
        slam2d=Slam2dNodeConfig(
            uses_cloud=uses_cloud,
            planar=planar,
            slam=Slam2dConfig(SHARP_CLOUD if uses_cloud else SHARP, CLOSE_LOOPS),
        ),
        localization=LocalizationNodeConfig(source="points", planar=planar) if uses_cloud else LocalizationNodeConfig(),
        particles=ParticleFilterConfig(drive=robot.drive),
        ground=TerrainConfig().for_robot(robot),
        # The controller keeps more distance than the gate enforces, else the gate would hold motions that the controller wants.
        global_costmap=GlobalCostmapConfig(inflation=inflation),
        navigation=NavigationConfig(
            blocked_patience=KNOWN_MAP_PATIENCE if has_map else 0.0,
            company_patience=COMPANY_PATIENCE if has_map else EXPLORING_PATIENCE,
            blocked=BlockedWaysConfig(front=float(robot.footprint[:, 0].max())),
        ),
        rollout=RolloutConfig(padding=PADDING),
        primitives=PrimitivesConfig(padding=PADDING),
        gate=GateConfig(margin=0.02),
        planner=PlannerConfig(escape_radius=robot.circumscribed_radius + 0.1),
        visibility=VisibilityConfig(escape_radius=robot.circumscribed_radius + 0.1),
        explore=ExploreConfig(yaw_tolerance=math.pi) if looks_around(robot) else ExploreConfig(),
        survey=replace(
            SurveyConfig.from_robot(robot, turning_cost(robot, inflation)),
            fence=FenceConfig(structure_reach=SEEN_WELL * planar.range_max),
        ),
    )


GROUND_PROFILE = {"odometry_source": "lidar", "mapping": "ground"}
"""What a robot is told where the ground is not level."""


def can_map_ground(robot: RobotModel) -> bool:
    """Whether a robot has what a map of ground needs."""
    return {SensorKind.CLOUD, SensorKind.IMU} <= {mount.kind for mount in robot.sensors}


def on_ground(config: RobotConfig, robot: RobotModel) -> RobotConfig:
    """Return a configuration for sites: the planner leaves out gaps in which the robot could not turn, up to `TURNING_MOST` on either side. Between two parked cars
    a long body with one LiDAR that looks ahead can neither turn nor see where it backs up to; so no recovery backs up there either (one that is lost goes back through what it has seen); it leaves a gap that proves too narrow by a planned way, up to `WAY_OUT` long. A frontier narrower than
    what the planner goes through is none, and one whose floor the LiDAR sees only from afar is looked at from there."""
    room = min(TURNING_MOST, robot.circumscribed_radius - robot.inscribed_radius + PADDING)
    inscribed = robot.inscribed_radius + max(room, 2.0 * PADDING)
    inflation = replace(config.global_costmap.inflation, inscribed_radius=inscribed)
    floor_from = robot.clouds[0].sees_floor_from + FLOOR_SEEN[0]
    survey = replace(
        config.survey,
        roomy_cost=turning_cost(robot, inflation),
        min_size=2.0 * inscribed,
        assumed=OCC_ASSUMED,
        sees_floor=(floor_from, FLOOR_SEEN[1]) if floor_from < FLOOR_SEEN[1] else (0.0, 0.0),
    )
    onwards = tuple(step for step in config.navigation.recoveries if step.action is not RecoveryAction.BACK_UP)
    return replace(
        config,
        global_costmap=replace(config.global_costmap, inflation=inflation),
        survey=survey,
        planner=replace(config.planner, way_out=WAY_OUT),
        visibility=replace(config.visibility, way_out=WAY_OUT),
        navigation=replace(config.navigation, recoveries=onwards),
    )


def unknown_ground(config: RobotConfig) -> RobotConfig:
    """Return a configuration for drives to goals in a place of which there is no map: both planners may attempt unknown ground, and a way that
    people block is waited for as in a known map."""
    return replace(
        config,
        planner=replace(config.planner, is_unknown_allowed=True),
        visibility=replace(config.visibility, is_unknown_allowed=True),
        navigation=replace(config.navigation, blocked_patience=KNOWN_MAP_PATIENCE, company_patience=COMPANY_PATIENCE),
    )


def recorded_config(profile: Mapping[str, Any]) -> RobotConfig:
    """Return the defaults for recordings of robots of which nothing else is known, with a profile laid over them; raises
    BadInputError that names the key."""
    return build(RobotConfig, merge(as_values(RobotConfig()), profile))


def robot_config(
    robot: RobotModel, profile: Mapping[str, Any], *, has_map: bool = False, is_unknown: bool = False
) -> RobotConfig:
    """Return the defaults for a robot with a profile laid over them; raises BadInputError that names the key, or a scanner that the robot
    does not have. `is_unknown`: it drives to goals in a place of which there is no map."""
    default = default_config(robot, has_map=has_map)
    if profile.get("mapping") == "ground":
        default = on_ground(default, robot)
    config = build(RobotConfig, merge(as_values(unknown_ground(default) if is_unknown else default), profile))
    calibrated_robot(robot, config.scanners)
    return config
