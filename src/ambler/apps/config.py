"""The configuration of the exploring robot: one dataclass made of the rooms' own, with per-robot differences in one place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from ambler.control.config import RolloutConfig
from ambler.control.local_planners import Controller
from ambler.control.pursuit_config import PursuitConfig
from ambler.core.robot import RobotModel
from ambler.costmap.global_costmap import GlobalCostmapConfig
from ambler.costmap.inflation import InflationConfig, turning_cost
from ambler.costmap.local_costmap import LocalCostmapConfig
from ambler.exploration.survey import SurveyConfig
from ambler.grids.probability_grid import InsertionConfig
from ambler.missions.explore_commands import ExploreConfig
from ambler.missions.navigate import NavigationConfig
from ambler.nodes.slam2d import Slam2dNodeConfig
from ambler.perception.glass import SpecularConfig
from ambler.perception.glass_map import GlassMapConfig
from ambler.perception.planar import PlanarConfig
from ambler.perception.scanner_profile import ScannerCalibration
from ambler.planning.grid_planner import PlannerConfig
from ambler.safety.config import GateConfig
from ambler.slam2d.config import FrontEndConfig, Slam2dConfig


@dataclass(frozen=True, slots=True)
class ExplorerConfig:
    """Everything that the exploring robot can be told; the defaults come from `for_robot`."""

    strategy: str = "tour"
    controller: Controller = "rollout"
    slam2d: Slam2dNodeConfig = field(default_factory=Slam2dNodeConfig)
    global_costmap: GlobalCostmapConfig = field(default_factory=GlobalCostmapConfig)
    local_costmap: LocalCostmapConfig = field(default_factory=LocalCostmapConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    navigation: NavigationConfig = field(default_factory=NavigationConfig)
    rollout: RolloutConfig = field(default_factory=RolloutConfig)
    pursuit: PursuitConfig = field(default_factory=PursuitConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    survey: SurveyConfig = field(default_factory=SurveyConfig)
    explore: ExploreConfig = field(default_factory=ExploreConfig)
    scanners: Mapping[str, ScannerCalibration] = field(default_factory=dict)
    glass: Literal["auto", "on", "off"] = "auto"
    specular: SpecularConfig = field(default_factory=SpecularConfig)
    glass_map: GlassMapConfig = field(default_factory=GlassMapConfig)

    def maps_glass(self, robot: RobotModel) -> bool:
        """Say whether glass is looked for: `auto` means on robots with ultrasonic transducers."""
        return bool(robot.scanners) and (self.glass == "on" or (self.glass == "auto" and bool(robot.rangers)))


# A scanner at 10 Hz fills 150 scans before the robot has left its neighbourhood; passing rays count for more than Cartographer's
# 0.49, so that walls stay one cell thick (docs/slam2d.md). The points of a cloud are means of several returns and need no such help.
SHARP = FrontEndConfig(
    match_max_voxel=0.3, match_min_points=350, scans_per_submap=150, insertion=InsertionConfig(p_miss=0.46)
)

SHARP_CLOUD = replace(SHARP, insertion=InsertionConfig())

PADDING = 0.05  # metres that the controller keeps around the footprint; the planner keeps twice as much


def looks_around(robot: RobotModel) -> bool:
    """Whether the robot sees on all sides, so that it may look at a frontier with any heading."""
    scans = [mount for mount in robot.sensors if mount.kind == "scan"]
    is_full = any(mount.azimuth[1] - mount.azimuth[0] > 2.0 * math.pi - 0.1 for mount in scans)
    return is_full or len(scans) > 1 or any(mount.kind == "cloud" for mount in robot.sensors)


def for_robot(robot: RobotModel) -> ExplorerConfig:
    """Return the defaults for a robot: sizes from its footprint, the scanner's kind and range from its mounts."""
    uses_cloud = any(mount.kind == "cloud" for mount in robot.sensors)
    planar = PlanarConfig(range_max=10.0) if uses_cloud else PlanarConfig(range_max=20.0)
    # The planner leaves out gaps in which the controller could not turn a little to either side.
    inflation = InflationConfig(inscribed_radius=robot.inscribed_radius + 2.0 * PADDING)
    return ExplorerConfig(
        slam2d=Slam2dNodeConfig(
            uses_cloud=uses_cloud, planar=planar, slam=Slam2dConfig(front_end=SHARP_CLOUD if uses_cloud else SHARP)
        ),
        # The controller keeps more distance than the gate enforces, else the gate would hold motions that the controller wants.
        global_costmap=GlobalCostmapConfig(inflation=inflation),
        rollout=RolloutConfig(padding=PADDING),
        gate=GateConfig(margin=0.02),
        planner=PlannerConfig(escape_radius=robot.circumscribed_radius + 0.1),
        explore=ExploreConfig(yaw_tolerance=math.pi) if looks_around(robot) else ExploreConfig(),
        survey=SurveyConfig.from_robot(robot, turning_cost(robot, inflation)),
    )
