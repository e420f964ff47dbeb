"""The lists of nodes that make a robot explore, and drive in a known map."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import ExplorerConfig
from ambler.apps.known_map import KnownMapConfig
from ambler.control.dynamic_window import local_planner
from ambler.control.omni_pursuit import OmniPursuit
from ambler.core.grid import GridSpec
from ambler.core.protocols import LocalPlanner
from ambler.core.robot import RobotModel
from ambler.costmap.global_costmap import GlobalCostmap
from ambler.costmap.local_costmap import LocalCostmap
from ambler.exploration.strategies import strategy_named
from ambler.exploration.survey import FrontierSurvey
from ambler.nodes.controller import ControllerNode
from ambler.nodes.explorer import ExplorerNode
from ambler.nodes.gate import GateNode
from ambler.nodes.glass_mapper import GlassMapperNode
from ambler.nodes.localization import LocalizationNode
from ambler.nodes.map_server import MapServerNode
from ambler.nodes.navigator import NavigatorNode
from ambler.nodes.odometry import OdometryNode
from ambler.nodes.planner import GlobalPlannerNode
from ambler.nodes.scan_merger import ScanMergerNode
from ambler.nodes.slam2d import Slam2dNode
from ambler.perception.merger import MergerConfig
from ambler.perception.scanner_profile import calibrated_robot, clock_offsets, with_clock_offsets
from ambler.planning.distance import distance_field
from ambler.planning.grid_planner import GridPlanner
from ambler.runtime.node import Node


def explorer_nodes(robot: RobotModel, config: ExplorerConfig) -> list[Node]:
    """Return everything between the sensors and the base: SLAM, planning, control, exploration, and the gate."""
    robot = calibrated_robot(robot, config.scanners)
    distances = partial(distance_field, escape_radius=config.planner.escape_radius)
    survey = FrontierSurvey(config.survey, distances)
    glass = [GlassMapperNode(robot, config.specular, config.glass_map)] if config.maps_glass(robot) else []
    return [
        OdometryNode(robot),
        *_mergers(robot, config),
        *glass,
        Slam2dNode(robot, config.slam2d),
        *_driving_nodes(robot, config),
        ExplorerNode(config.explore, survey, strategy_named(config.strategy, distances)),
        GateNode(robot, config.gate, clock_offsets=clock_offsets(config.scanners)),
    ]


def known_map_nodes(
    robot: RobotModel, config: KnownMapConfig, spec: GridSpec, occupancy: NDArray[np.int8]
) -> list[Node]:
    """Return everything between the sensors and the base of a robot in the map `occupancy` int8 [iy, ix]: map server, localization,
    planning, control, and the gate. Who sends it to goals comes on top (NAVIGATE)."""
    robot = calibrated_robot(robot, config.driving.scanners)
    return [
        OdometryNode(robot),
        *_mergers(robot, config.driving),
        MapServerNode(spec, occupancy),
        LocalizationNode(robot, config.make_localizer, config.localization),
        *_driving_nodes(robot, config.driving),
        GateNode(robot, config.driving.gate, clock_offsets=clock_offsets(config.driving.scanners)),
    ]


def _mergers(robot: RobotModel, config: ExplorerConfig) -> list[Node]:
    if len(robot.scanners) <= 1:
        return []
    return [ScanMergerNode(with_clock_offsets(MergerConfig.from_robot(robot), config.scanners))]


def _driving_nodes(robot: RobotModel, config: ExplorerConfig) -> list[Node]:
    """Global planner, controller and navigator."""
    return [
        GlobalPlannerNode(GlobalCostmap(config.global_costmap, robot), GridPlanner(config.planner), robot=robot),
        ControllerNode(
            robot, _local_planner(robot, config), LocalCostmap(config.local_costmap, robot), config.slam2d.planar
        ),
        NavigatorNode(config.navigation),
    ]


def _local_planner(robot: RobotModel, config: ExplorerConfig) -> LocalPlanner:
    if config.controller == "pursuit":
        return OmniPursuit(config.pursuit, robot)
    return local_planner(config.controller, config.rollout, robot)
