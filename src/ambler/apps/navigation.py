"""Navigation in a known map: a simulated robot finds out where it is in a saved map and drives to goals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ambler.apps.known_map import KnownMapConfig, known_map_config
from ambler.apps.run_folder import RunFolder
from ambler.apps.simulated_robot import lone_robot_nodes
from ambler.apps.simulated_run import SimulatedRun, ViewOptions
from ambler.apps.stacks import known_map_nodes
from ambler.core.errors import BadInputError
from ambler.core.messages import Odometry
from ambler.core.se2 import SE2
from ambler.evaluation.collisions import find_collisions
from ambler.evaluation.truth_frame import TruthFrame
from ambler.nodes.pilot import Journey, PilotConfig, PilotNode
from ambler.runtime.topics import CONTACT, GOAL, SET_POSE, TELEOP_REQUEST, TRUE_POSE
from ambler.settings.profiles import as_values, build, merge, save_resolved
from ambler.sim.faults import Fault
from ambler.sim.robots import robot_named
from ambler.sim.truth import truth_grid
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world
from ambler.wire.map_files import load_map, save_map
from ambler.wire.mcap_reader import read_recording

DRAWN_RESOLUTION = 0.05


@dataclass(frozen=True, slots=True)
class NavigationOptions:
    """What to run. `map_file` None draws the map from the world's plan, with the world's start as its origin; `start` is where in the map
    the robot begins. `is_lost`: the robot is not told where it starts. `may_turn`: it
    may turn in place to find out. `profile` overrides the robot's defaults (`apps.known_map.KnownMapConfig`)."""

    world: str = "office"
    robot: str = "amr_omni"
    map_file: Path | None = None
    goals: tuple[SE2, ...] = ()
    start: SE2 = field(default_factory=SE2)
    seed: int = 0
    is_lost: bool = False
    may_turn: bool = False
    is_realtime: bool = False
    physics: Literal["contact", "kinematic"] = "contact"
    port: int | None = 8765
    host: str = "127.0.0.1"
    token: str | None = None
    time_limit: float = 900.0
    profile: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()


def navigation_config(options: NavigationOptions) -> KnownMapConfig:
    """Return the robot's configuration with the options' profile laid over it; raises BadInputError for anything wrong."""
    base = as_values(known_map_config(robot_named(options.robot).model))
    if not options.is_lost:
        base = merge(base, {"localization": {"initial_pose": as_values(options.start)}})
    return build(KnownMapConfig, merge(base, options.profile))


class NavigationRun(SimulatedRun):
    """One journey in one folder: `run` drives to the goals, `judge` compares with the truth of the recording."""

    def __init__(self, options: NavigationOptions, folder: RunFolder) -> None:
        self.options = options
        self.journey: Journey | None = None
        self.config = navigation_config(options)
        robot, world = robot_named(options.robot), load_world(options.world)
        self.truth = TruthFrame(world.start)
        save_resolved(folder.config, {"navigation": _plain(options), "robot": as_values(self.config)})
        if options.map_file is None:
            save_map(folder.map_stem, *truth_grid(world.from_start(), robot.sensor_height, DRAWN_RESOLUTION))
        grid = load_map(options.map_file or folder.map_stem.with_suffix(".yaml"))
        faults = tuple(Fault.parse(text) for text in options.faults)
        config = SimulationConfig(options.seed, physics=options.physics, faults=faults)
        devices = lone_robot_nodes(world, robot, config, world.start @ options.start)
        pilot = PilotNode(PilotConfig(options.goals, may_turn=options.may_turn), self._finish)
        nodes = [*devices, *known_map_nodes(robot.model, self.config, *grid), pilot]
        view = None if options.port is None else ViewOptions(options.port, options.host, options.token)
        super().__init__(folder, nodes, (GOAL, SET_POSE, TELEOP_REQUEST), view, is_realtime=options.is_realtime)

    @property
    def ended(self) -> str:
        """How the journey ended: `arrived`, `not_localized`, the first failure's name, `node_failed` or `time_limit`."""
        if self.executor.failure is not None:
            return "node_failed"
        if self.journey is None:
            return "time_limit"
        if not self.journey.is_localized:
            return "not_localized"
        failed = [outcome.code.lower() for outcome in self.journey.outcomes if not outcome.is_success]
        return failed[0] if failed else "arrived"

    def judge(self) -> dict[str, Any]:
        """Return the fields of the result; truth and contacts come from the recording, unknown values are None."""
        truth: Odometry | None = None
        contacts = []
        for recorded in read_recording(self.folder.recording, [TRUE_POSE.ros_name, CONTACT.ros_name]):
            if recorded.topic == TRUE_POSE.ros_name:
                truth = recorded.decode_as(Odometry)
            else:
                contacts.append(recorded.decode_as(CONTACT.type))
        reached = [] if self.journey is None else [o for o in self.journey.outcomes if o.is_success]
        return {
            "world": self.options.world,
            "robot": self.options.robot,
            "localizer": self.config.localizer,
            "source": self.config.localization.source,
            "ended": self.ended,
            "goals": len(self.options.goals),
            "goals_reached": len(reached),
            "last_goal_error_m": self._goal_error(truth),
            "collisions": len(find_collisions(contacts)),
            "sim_seconds": self.sim_seconds,
            "run_seconds": self.wall_seconds,
            "recording": str(self.folder.recording),
        }

    def _goal_error(self, truth: Odometry | None) -> float | None:
        """Distance from the true pose at the end to the last goal, in the drawn map's frame."""
        if truth is None or not self.options.goals or self.options.map_file is not None:
            return None
        return self.truth.pose(truth.pose.to_se2()).distance_to(self.options.goals[-1])

    def _finish(self, journey: Journey) -> None:
        self.journey = journey
        self.executor.stop()


def parse_goal(text: str) -> SE2:
    """Read `x,y` or `x,y,yaw` in metres and radians of the map frame; raises BadInputError."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise BadInputError(f"goal {text!r}: must be x,y or x,y,yaw") from error
    if len(numbers) not in (2, 3) or not np.isfinite(numbers).all():
        raise BadInputError(f"goal {text!r}: must be x,y or x,y,yaw")
    return SE2(numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else 0.0)


def _plain(options: NavigationOptions) -> Any:
    values = as_values(options)
    values["map_file"] = None if options.map_file is None else str(options.map_file)
    return values
