"""A drive: a simulated robot is driven along a route through a world with three dimensions, and everything is recorded. Without a saved cloud it maps
while it is driven; with one it finds out where in it it is.

Its recording holds clouds, inertial measurements, wheel odometry and the ground truth, for `ambler lio` and everybody else who maps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import RobotConfig, robot_config
from ambler.apps.robot import sensing_nodes
from ambler.apps.run import RobotInRun, Run, ViewOptions
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated_robot import simulated_nodes
from ambler.core.errors import BadInputError
from ambler.core.messages import Contact, Odometry, Status, Transforms
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.collisions import Collision, find_collisions, find_contacts
from ambler.evaluation.spatial_error import spatial_error
from ambler.lio.cloud_map import CloudMap
from ambler.nodes.cloud_localization import CloudLocalizationNode
from ambler.nodes.gate import GateNode
from ambler.nodes.route_driver import RouteDriverNode
from ambler.runtime.clock import SystemClock
from ambler.runtime.node import Node
from ambler.runtime.topics import CONTACT, ODOMETRY, STATUS, TRANSFORMS, TRUE_POSE
from ambler.settings.profiles import as_values, save_resolved
from ambler.sim.faults import Fault, FaultInjector
from ambler.sim.rig_errors import as_built
from ambler.sim.robots import SimRobot, robot_named
from ambler.sim.route import Route, built_in_route, heading_of, load_route
from ambler.sim.solids import WorldSpec
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import read_recording
from ambler.wire.trajectory_files import write_tum_3d

BUILT_IN = "built-in"
ROBOT = "robot"  # the robot's name in its world
SAMPLED = 10  # true poses between two points at which a way is measured, so that the gait does not count
NEAR_START = 1.0  # metres from the start at which a route must begin


@dataclass(frozen=True)
class DriveScene:
    """What the options mean, checked: the robot as drawn, its configuration, its world, where it starts, and the route."""

    robot: SimRobot
    config: RobotConfig
    world: WorldSpec
    start: SE2
    route: Route
    faults: tuple[Fault, ...]
    cloud_map: CloudMap | None = None
    guess: SE3 | None = None


def drive_scene(options: RunOptions, drive: str, speed: float | None, guess: SE3 | None = None) -> DriveScene:
    """Load and check everything before anything runs; `drive` is a route file or `built-in`, `speed` (m/s) takes the place of the
    route's; `guess` is where the base is in the saved cloud `options.map_file` at first. The robot starts at the route's first waypoint unless the options say where. Raises BadInputError with one sentence."""
    if options.is_apart:
        raise BadInputError("a drive along a route runs in this process: leave --apart out")
    robot = robot_named(options.robot)
    if not robot.model.clouds:
        raise BadInputError(
            f"robot {options.robot} has no LiDAR of many rings: drive mecanum, go2, g1 or spot along a route"
        )
    world = load_world(options.world)
    route = built_in_route(world) if drive == BUILT_IN else load_route(Path(drive), world)
    if speed is not None:
        route = replace(route, speed=speed)
    start = SE2(*route.points[0], heading_of(route.points))
    if options.start is not None:
        start = world.start @ options.start
        off = start.distance_to(SE2(*route.points[0], 0.0))
        if off > NEAR_START:
            raise BadInputError(
                f"--start lies {off:.1f} m from the route's first waypoint, at most {NEAR_START:g} m are asked"
            )
    faults = tuple(Fault.parse(text) for text in options.faults)
    FaultInjector(faults, world, robot.faulty_frames)
    config = robot_config(robot.model, {"odometry_source": "lidar", **options.profile}, has_map=False)
    cloud_map = None
    if options.map_file is not None:
        if config.odometry_source != "lidar":
            raise BadInputError("--map: localization in a saved cloud needs odometry_source lidar")
        cloud_map = CloudMap.load(options.map_file, config.lio.localize.map)
    elif guess is not None:
        raise BadInputError("--guess says where in a saved cloud the robot is: it needs --map")
    return DriveScene(robot, config, world, start, route, faults, cloud_map, guess)


class DriveRun(Run):
    """One robot that somebody drives along a route."""

    def __init__(self, options: RunOptions, scene: DriveScene, folder: RunFolder) -> None:
        """The robot is built with the errors of mounts and clocks that its seed draws, unless everything is perfect."""
        self.options, self.scene = options, scene
        robot = scene.robot if options.is_perfect else as_built(scene.robot, options.seed)
        config = SimulationConfig(options.seed, options.is_perfect, options.physics, scene.faults)
        world = World(scene.world, [BodySpec(ROBOT, robot, scene.start)], config)
        model = scene.robot.model
        nodes = simulated_nodes(world, ROBOT, described=model, has_map=False)
        gate = replace(scene.config, mapping="ground").gate_for(model)  # nobody maps, but the way leads over slopes
        nodes += [
            *placing_nodes(model, scene.config, scene.cloud_map, scene.guess),
            GateNode(model, gate, specular=scene.config.specular),
        ]
        has_legs = scene.robot.gait is not None
        route = scene.route
        driver = partial(RouteDriverNode, route.points, route.speed, model, scene.start, has_legs=has_legs)
        self.robot = RobotInRun(folder, nodes, (), driver)
        run = {"world": options.world, "robot": options.robot, "seed": options.seed, "physics": options.physics}
        save_resolved(folder.config, {"run": run, "route": as_values(scene.route), "robot": as_values(scene.config)})
        clock = SystemClock(from_zero=True) if options.is_realtime else None
        view = (
            None
            if options.port is None
            else ViewOptions(options.port, options.host, options.token, scene.config.topic_names)
        )
        super().__init__(folder, [self.robot], view, clock)


def placing_nodes(robot: RobotModel, config: RobotConfig, cloud_map: CloudMap | None, guess: SE3 | None) -> list[Node]:
    """Return what makes odometry and says where odom lies in the map: loop closure, or localization in a saved cloud."""
    nodes = sensing_nodes(robot, config, closes_loops=cloud_map is None)
    if cloud_map is None:
        return nodes
    return [*nodes, CloudLocalizationNode(robot, cloud_map, config.lio.localize, guess)]


@dataclass(frozen=True, slots=True)
class DriveVerdict:
    """The result of a drive: `fields` as they go into JSON."""

    fields: dict[str, Any]
    collisions: tuple[Collision, ...]

    @property
    def is_good(self) -> bool:
        """Whether the route was driven to its end without a collision, and in a saved cloud with its place known at the end."""
        is_placed = self.fields.get("place", "tracking") in ("found", "tracking")
        return self.fields["ended"] == "succeeded" and not self.collisions and is_placed


def judge_drive(run: DriveRun) -> DriveVerdict:
    """Judge a drive from the ground truth in its recording, and write the true poses of the first IMU beside it (`truth.tum`)."""
    stamps_ns: list[int] = []
    poses: list[SE3] = []
    contacts: list[Contact] = []
    for recorded in read_recording(run.folder.recording, [TRUE_POSE.ros_name, CONTACT.ros_name]):
        if recorded.topic == TRUE_POSE.ros_name:
            truth = recorded.decode_as(Odometry)
            stamps_ns.append(truth.stamp_ns)
            poses.append(truth.pose)
        else:
            contacts.append(recorded.decode_as(Contact))
    scene, truth_file = run.scene, run.folder.root / "truth.tum"
    mount = imu_mount(scene.robot.model)
    write_tum_3d(truth_file, stamps_ns, [pose @ mount for pose in poses])
    places = np.array([pose.translation for pose in poses[::SAMPLED]]).reshape(-1, 3)
    steps = np.diff(places, axis=0)
    collisions = find_collisions(contacts)
    fields: dict[str, Any] = {
        "world": scene.world.name,
        "robot": run.options.robot,
        "ended": run.ended_of(run.robot),
        "text": run.text_of(run.robot) or None,
        "route_length_m": scene.route.length,
        "path_length_m": float(np.linalg.norm(steps, axis=1).sum()),
        "climbed_m": float(np.maximum(steps[:, 2], 0.0).sum()),
        "height_range_m": float(np.ptp(places[:, 2])) if len(places) else None,
        "tilt_max_deg": max((tilt_deg(pose) for pose in poses), default=None),
        "collisions": len(collisions),
        "contacts": len(find_contacts(contacts)),
        "sim_seconds": run.run_seconds,
        "run_seconds": run.wall_seconds,
        "real_time_factor": run.run_seconds / run.wall_seconds,
        **(_place_fields(run, stamps_ns, poses) if scene.cloud_map is not None else {}),
        "recording": str(run.folder.recording),
        "truth": str(truth_file),
    }
    return DriveVerdict(fields, collisions)


def _place_fields(run: DriveRun, truth_ns: list[int], truth: list[SE3]) -> dict[str, Any]:
    """Return when the robot found its place in the saved cloud, how it ended, and how far what it told bends the true way: where the cloud truly lies in the world nobody knows,
    so the best rigid motion is taken out."""
    state, found_ns = "NOT_FOUND", None
    stamps_ns: list[int] = []
    placed: list[SE3] = []
    odometry: list[Odometry] = []
    for recorded in read_recording(run.folder.recording, [STATUS.ros_name, ODOMETRY.ros_name, TRANSFORMS.ros_name]):
        if recorded.topic == STATUS.ros_name:
            code = recorded.decode_as(Status).code
            state = code.removeprefix("CLOUD_") if code.startswith("CLOUD_") else state
            if code == "CLOUD_FOUND" and found_ns is None:
                found_ns = recorded.log_time_ns
        elif recorded.topic == ODOMETRY.ros_name:
            odometry.append(recorded.decode_as(Odometry))
        else:
            edges = [e for e in recorded.decode_as(Transforms).transforms if e.parent == "map" and e.child == "odom"]
            if edges and odometry and (not stamps_ns or edges[0].stamp_ns > stamps_ns[-1]):
                near = min(odometry[-200:], key=lambda o: abs(o.stamp_ns - edges[0].stamp_ns))
                stamps_ns.append(edges[0].stamp_ns)
                placed.append(edges[0].parent_from_child @ near.pose)
    fields: dict[str, Any] = {"place": state.lower(), "place_found_s": None, "place_rms_m": None}
    if found_ns is not None:
        fields["place_found_s"] = 1e-9 * (found_ns - truth_ns[0])
    if len(placed) > 2:
        error = spatial_error(np.array(stamps_ns, np.int64), placed, np.array(truth_ns, np.int64), truth)
        fields["place_rms_m"] = error.ate_rms_m
    return fields


def imu_mount(robot: RobotModel) -> SE3:
    """Return base_from_imu of the first IMU."""
    return robot.of_kind(SensorKind.IMU)[0].base_from_sensor


def tilt_deg(pose: SE3) -> float:
    """Return the angle (deg) between a body's upward axis and the vertical."""
    return float(np.degrees(np.arccos(np.clip(pose.rotate((0.0, 0.0, 1.0))[2], -1.0, 1.0))))
