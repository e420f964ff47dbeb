"""The list of nodes that makes a robot explore."""

from __future__ import annotations

from functools import partial

from ambler.apps.config import ExplorerConfig
from ambler.control.dynamic_window import local_planner
from ambler.core.robot import RobotModel
from ambler.costmap.global_costmap import GlobalCostmap
from ambler.costmap.local_costmap import LocalCostmap
from ambler.exploration.strategies import strategy_named
from ambler.exploration.survey import FrontierSurvey
from ambler.nodes.controller import ControllerNode
from ambler.nodes.explorer import ExplorerNode
from ambler.nodes.gate import GateNode
from ambler.nodes.glass_mapper import GlassMapperNode
from ambler.nodes.navigator import NavigatorNode
from ambler.nodes.planner import GlobalPlannerNode
from ambler.nodes.scan_merger import ScanMergerNode
from ambler.nodes.slam2d import Slam2dNode
from ambler.perception.merger import MergerConfig
from ambler.perception.scanner_profile import calibrated_robot, with_clock_offsets
from ambler.planning.distance import distance_field
from ambler.planning.grid_planner import GridPlanner
from ambler.runtime.node import Node


def explorer_nodes(robot: RobotModel, config: ExplorerConfig) -> list[Node]:
    """Return everything between the sensors and the base: SLAM, planning, control, exploration, and the gate."""
    robot = calibrated_robot(robot, config.scanners)
    distances = partial(distance_field, escape_radius=config.planner.escape_radius)
    survey = FrontierSurvey(config.survey, distances)
    merger = (
        [ScanMergerNode(with_clock_offsets(MergerConfig.from_robot(robot), config.scanners))]
        if len(robot.scanners) > 1
        else []
    )
    glass = [GlassMapperNode(robot, config.specular, config.glass_map)] if config.maps_glass(robot) else []
    return [
        *merger,
        *glass,
        Slam2dNode(robot, config.slam2d),
        GlobalPlannerNode(GlobalCostmap(config.global_costmap, robot), GridPlanner(config.planner), robot=robot),
        ControllerNode(
            robot,
            local_planner(config.controller, config.rollout, robot),
            LocalCostmap(config.local_costmap, robot),
            config.slam2d.planar,
        ),
        NavigatorNode(),
        ExplorerNode(config.explore, survey, strategy_named(config.strategy, distances)),
        GateNode(robot, config.gate),
    ]
