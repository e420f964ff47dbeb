"""A robot is a list of nodes: everything between its devices and its base, the same whether it is simulated, live or replayed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import RobotConfig
from ambler.apps.saved_site import SavedSite
from ambler.control.local_planners import local_planner
from ambler.core.devices import RobotDevices
from ambler.core.grid import GridSpec
from ambler.core.protocols import GlobalPlanner, LocalPlanner
from ambler.core.robot import RobotModel
from ambler.costmap.global_costmap import GlobalCostmap, global_layers
from ambler.costmap.layer import Layer
from ambler.costmap.local_costmap import LocalCostmap, local_layers
from ambler.costmap.terrain_layer import TerrainLayer, TerrainLayerConfig
from ambler.costmap.voxel_layer import VoxelLayer
from ambler.docking.database import DockDatabase
from ambler.exploration.strategies import NearestStrategy, Strategy
from ambler.exploration.survey import DistanceField, FrontierSurvey
from ambler.exploration.tour import TourStrategy
from ambler.localization.odometry import WheelInertialOdometry
from ambler.nodes.cloud_localization import CloudLocalizationNode
from ambler.nodes.controller import ControllerNode
from ambler.nodes.docking import DockingNode
from ambler.nodes.echoes import EchoNode
from ambler.nodes.explorer import ExplorerNode
from ambler.nodes.gate import GateNode
from ambler.nodes.glass_mapper import GlassMapperNode
from ambler.nodes.ground_mapper import GroundMapperNode
from ambler.nodes.ground_server import GroundServerNode
from ambler.nodes.layer_inputs import LayerInput
from ambler.nodes.lidar_odometry import LidarOdometryNode
from ambler.nodes.localization import LocalizationNode
from ambler.nodes.map_server import MapServerNode
from ambler.nodes.navigator import NavigatorNode
from ambler.nodes.odometry import OdometryNode
from ambler.nodes.planner import GlobalPlannerNode
from ambler.nodes.scan_merger import ScanMergerNode
from ambler.nodes.slam2d import Slam2dNode
from ambler.nodes.stations import StationNode
from ambler.nodes.terrain import TerrainNode
from ambler.nodes.voxel_inputs import VoxelFeed
from ambler.perception.merger import MergerConfig
from ambler.perception.scanner_profile import calibrated_robot
from ambler.planning.distance import distance_field
from ambler.planning.grid_planner import GridPlanner
from ambler.planning.visibility_planner import VisibilityPlanner
from ambler.runtime.node import Node
from ambler.sim.sim_robot import SimRobot

WIDE_VIEWS = 0.2  # seconds between two views of a sensor that the global costmap takes: it is drawn twice a second

MapGrid = tuple[GridSpec, NDArray[np.int8]]


@dataclass(frozen=True)
class Site:
    """What a robot is told of the place: a map, occupancy int8 [iy, ix], or a site with its levels of ground (neither: it makes one), docks (None: it does not
    dock), and the graph that was saved with the map or site (None: a planner that has one begins anew)."""

    grid: MapGrid | None = None
    docks: DockDatabase | None = None
    graph: Mapping[str, NDArray[Any]] | None = None
    saved: SavedSite | None = None


@dataclass(frozen=True)
class Parts:
    """What an integrator brings along: in place of what the configuration would build (None: as configured), layers drawn over
    the usual ones with what feeds them, and nodes beside the rest. A layer serves one costmap. In simulation also a robot that
    no name stands for, `built`, which says how it was built in truth where that is not as it was drawn, and `devices`, which puts drivers of one's own in the place of simulated devices."""

    local_planner: LocalPlanner | None = None
    global_planner: GlobalPlanner | None = None
    strategy: Strategy | None = None
    global_layers: tuple[Layer, ...] = ()
    local_layers: tuple[Layer, ...] = ()
    global_inputs: tuple[LayerInput[Any], ...] = ()
    local_inputs: tuple[LayerInput[Any], ...] = ()
    nodes: tuple[Node, ...] = ()
    robot: SimRobot | None = None
    built: Callable[[SimRobot], SimRobot] | None = None
    devices: Callable[[RobotDevices], RobotDevices] | None = None


def robot_nodes(
    robot: RobotModel, config: RobotConfig, site: Site, seed: int = 0, parts: Parts | None = None
) -> list[Node]:
    """Return everything between the sensors and the base: where it is (SLAM, or localization in a map), planning, control, exploration
    where there is no map, docking where there are docks, the nodes of `parts`, and the gate. Who gives it tasks comes on top."""
    parts = parts if parts is not None else Parts()
    robot = calibrated_robot(robot, config.scanners)
    out = config.planner
    distances = partial(distance_field, escape_radius=out.escape_radius, way_out=out.way_out)
    makes_map = site.grid is None and site.saved is None
    maps_ground = makes_map and config.mapping == "ground"
    nodes = sensing_nodes(robot, config, closes_loops=maps_ground)
    if site.saved is not None:
        nodes += _site_nodes(robot, config, site.saved)
    elif site.grid is None:
        nodes += _mapping_nodes(robot, config)
    else:
        localizer = partial(config.make_localizer, seed=seed)
        nodes += [MapServerNode(*site.grid), LocalizationNode(robot, localizer, config.localization)]
    nodes += _driving_nodes(robot, config, parts, site, has_levels=maps_ground or site.saved is not None)
    if makes_map:
        survey = FrontierSurvey(config.survey, distances)
        strategy = parts.strategy or _strategy(config, distances)
        config.check_stations()
        nodes.append(ExplorerNode(config.explore, survey, strategy, has_levels=maps_ground))
        nodes += [StationNode(config.stations)] if config.holds_stations else []
    if site.docks is not None:
        nodes.append(DockingNode(robot, site.docks, config.docking))
    gate = GateNode(robot, config.gate_for(robot), specular=config.specular)
    return [*nodes, *parts.nodes, gate]


def sensing_nodes(robot: RobotModel, config: RobotConfig, *, closes_loops: bool = False) -> list[Node]:
    """Return what makes odometry, and one scan of several. `robot` has its scanners where they are calibrated. `closes_loops`: LiDAR-inertial odometry
    tells map -> odom, too, because nothing else does."""
    config.check_odometry(robot)
    has_lidar = config.odometry_source == "lidar"
    odometry = LidarOdometryNode(robot, config.lio, config.air, closes_loops=closes_loops) if has_lidar else None
    nodes: list[Node] = [odometry or OdometryNode(robot, WheelInertialOdometry(config.odometry))]
    if config.uses_terrain(robot):
        nodes.append(TerrainNode(robot, config.ground))
    if len(robot.scanners) > 1:
        nodes.append(ScanMergerNode(MergerConfig.from_robot(robot)))
    return nodes


def _mapping_nodes(robot: RobotModel, config: RobotConfig) -> list[Node]:
    if config.mapping == "ground":
        return [GroundMapperNode(robot, config.ground, config.ground_map)]
    glass = [GlassMapperNode(robot, config.specular, config.glass_map)] if config.maps_glass(robot) else []
    return [*glass, Slam2dNode(robot, config.slam2d)]


def _site_nodes(robot: RobotModel, config: RobotConfig, site: SavedSite) -> list[Node]:
    """What serves the levels of a saved site, and finds the robot in its cloud: anywhere, unless it is told where it is switched on."""
    ground, start = site.ground(), config.localization.initial_pose
    guess = None if start is None else ground.standing_at(start)
    return [GroundServerNode(ground), CloudLocalizationNode(robot, site.cloud, config.lio.localize, guess)]


def _driving_nodes(robot: RobotModel, config: RobotConfig, parts: Parts, site: Site, *, has_levels: bool) -> list[Node]:
    """What judges echoes, global planner, controller and navigator."""
    global_planner = parts.global_planner or _global_planner(config, site)
    controller = parts.local_planner or _local_planner(robot, config)
    (wide_voxels, wide_inputs), (near_voxels, near_inputs) = (_voxels(robot, config, p) for p in (WIDE_VIEWS, 0.0))
    wide_layers = (*global_layers(config.global_costmap), *wide_voxels, *parts.global_layers)
    near_layers = (*_near_layers(robot, config), *near_voxels, *parts.local_layers)
    wide = GlobalCostmap(config.global_costmap, robot, wide_layers)
    near = LocalCostmap(config.local_costmap, robot, near_layers)
    echoes = [EchoNode(robot, config.slam2d.planar)] if robot.rangers else []
    return [
        *echoes,
        GlobalPlannerNode(wide, global_planner, layer_inputs=(*wide_inputs, *parts.global_inputs)),
        ControllerNode(
            *(robot, controller, near, config.slam2d.planar),
            layer_inputs=(*near_inputs, *parts.local_inputs),
            movers=config.movers,
            yielding=config.yielding,
            specular=config.specular,
            unseen=config.unseen_ground if has_levels else None,
        ),
        NavigatorNode(config.navigation, robot, has_levels=has_levels),
    ]


def _voxels(
    robot: RobotModel, config: RobotConfig, period: float
) -> tuple[tuple[Layer, ...], tuple[LayerInput[Any], ...]]:
    """Return a voxel layer with what feeds it every `period` seconds at most; nothing where none is wanted."""
    if not config.uses_voxels(robot):
        return (), ()
    layer = VoxelLayer(config.voxel, robot.top)
    return (layer,), VoxelFeed(robot, layer, period, has_terrain=config.uses_terrain(robot)).inputs


def _global_planner(config: RobotConfig, site: Site) -> GlobalPlanner:
    if config.global_planner == "visibility_graph":
        return VisibilityPlanner(config.visibility, site.graph)
    return GridPlanner(config.planner)


def _local_planner(robot: RobotModel, config: RobotConfig) -> LocalPlanner:
    return local_planner(config.controller, robot, config.rollout, config.pursuit, config.primitives)


def _near_layers(robot: RobotModel, config: RobotConfig) -> tuple[Layer, ...]:
    """Return the layers of the local costmap; where the terrain is analysed it is the floor."""
    seen, *others = local_layers(config.local_costmap)
    if not config.uses_terrain(robot):
        return (seen, *others)
    ground = config.ground
    return (seen, TerrainLayer(TerrainLayerConfig(ground.step, voxel=ground.voxel, cell=ground.cell)), *others)


def _strategy(config: RobotConfig, distances: DistanceField) -> Strategy:
    if config.strategy == "tour":
        return TourStrategy(distances, config.tour)
    return config.greedy if config.strategy == "greedy" else NearestStrategy()
