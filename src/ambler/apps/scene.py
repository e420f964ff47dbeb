"""What a run of a simulated robot is told, and what that means: everything is checked before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import GROUND_PROFILE, RobotConfig, can_map_ground, robot_config
from ambler.apps.docks import dock_of_world
from ambler.apps.robot import MapGrid
from ambler.apps.saved_site import SavedSite, check_places, is_site, load_site
from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_FREE_BELOW, OCC_OCCUPIED, GridSpec
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.kernels.footprint import footprint_edges
from ambler.nodes.steps import DockStep, ExploreStep, NavigateStep, Step, TeachStep, UndockStep
from ambler.sim.faults import Fault, FaultInjector
from ambler.sim.imperfections import Imperfections
from ambler.sim.robots import SimRobot, robot_named
from ambler.sim.solids import WorldSpec
from ambler.sim.truth import truth_grid
from ambler.sim.world_file import check_start, load_world
from ambler.wire.camera_info import load_camera_info
from ambler.wire.map_files import load_bend, load_map

DRAWN_RESOLUTION = 0.05
FIT = 0.05  # metres by which a surface may reach into a robot's outline: that of a cell is not known better
DOCKING_STEPS = (DockStep, UndockStep, TeachStep)


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What to run. A program that begins with exploring makes its map, and so does one in an unknown place (`is_unknown`), whose goals are in the frame of the robot's start; any other drives in a known one: `map_file` (with levels of ground beside it: a site, for robots that can map ground), or None: drawn from
    the world's plan. `start` is in that map's frame, whose origin is the world's own start; `starts_docked` names a dock to start in
    instead. A robot that `is_lost` is not told where it starts, and `may_turn` to find out. `docks_file` None: the docks are those of
    the world's plan; `camera_file` replaces the calibration that the camera tells. `port` None shows nothing; `time_limit` is in seconds
    of the run; `profile` overrides the robot's defaults; `faults` are written as in `sim.faults`; `imperfections`: what is off in truth, of which the robot is told nothing. `is_apart`: the simulator runs in a process of its own, and the
    robot is a live one, which reaches its devices over a serial line and a socket."""

    steps: tuple[Step, ...] = (ExploreStep(),)
    world: str = "office"
    robot: str = "diff"
    seed: int = 0
    start: SE2 | None = None
    starts_docked: str | None = None
    map_file: Path | None = None
    docks_file: Path | None = None
    camera_file: Path | None = None
    is_lost: bool = False
    may_turn: bool = False
    is_unknown: bool = False
    is_realtime: bool = False
    is_apart: bool = False
    is_perfect: bool = False
    physics: Literal["contact", "kinematic"] = "contact"
    port: int | None = 8765
    host: str = "127.0.0.1"
    token: str | None = None
    time_limit: float = 3600.0
    profile: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    imperfections: Imperfections | None = None

    @property
    def makes_map(self) -> bool:
        """Whether the robot begins without a map."""
        return self.is_unknown or (bool(self.steps) and isinstance(self.steps[0], ExploreStep))

    @property
    def docks_wanted(self) -> tuple[str, ...]:
        """The names of the docks that the steps speak of."""
        return tuple(step.dock for step in self.steps if isinstance(step, DOCKING_STEPS))

    @property
    def known_docks_file(self) -> Path | None:
        """The file of docks that is there. One that is to be taught into and is not there yet begins with the docks of the world's plan, as without one."""
        is_begun = any(isinstance(step, TeachStep) for step in self.steps)
        return None if self.docks_file is None or (is_begun and not self.docks_file.exists()) else self.docks_file


@dataclass(frozen=True)
class Scene:
    """What the options mean, checked: the robot, its configuration, its world, where it starts in the world's frame, and the map that
    it knows, or the `site` (neither: it makes one)."""

    robot: SimRobot
    config: RobotConfig
    world: WorldSpec
    start: SE2
    grid: MapGrid | None
    faults: tuple[Fault, ...]
    camera: CameraModel | None
    site: SavedSite | None = None


def checked_scene(options: RunOptions, robot: SimRobot | None = None) -> Scene:
    """Load and check everything that options name, before anything runs; raises BadInputError with one sentence. `robot` takes the place
    of the one that they name."""
    robot = robot if robot is not None else robot_named(options.robot)
    world = load_world(options.world)
    start = _start(options, world)
    if options.start is not None:
        check_start(options.world, start)
    config = _config(robot.model, options, world.start.inverse() @ start, is_level=world.is_flat)
    if config.mapping != "ground" and any(isinstance(s, NavigateStep) and s.level is not None for s in options.steps):
        raise BadInputError("a goal with a level (X,Y@LEVEL) needs a map of ground: there are no levels here")
    faults = tuple(Fault.parse(text) for text in options.faults)
    FaultInjector(faults, world, robot.faulty_frames)  # raises where a door or a scanner is not there
    _check_steps(options, robot, world)
    if config.mapping != "ground":
        there = replace(world, start=start).from_start()
        plan = truth_grid(there, robot.sensor_height, DRAWN_RESOLUTION)  # raises in a solid
        if options.starts_docked is None:
            _check_fit(options.robot, robot.model, *plan)
    site = _site(options, config)
    grid = _grid(options, robot, world) if site is None else None
    if grid is not None:
        _check_map(options, config, grid)
    if options.known_docks_file is not None:
        known = DockDatabase.load(options.known_docks_file)
        for name in options.docks_wanted:
            known.dock(name)
    camera = None if options.camera_file is None else load_camera_info(options.camera_file)
    return Scene(robot, config, world, start, grid, faults, camera, site)


def _check_fit(name: str, robot: RobotModel, spec: GridSpec, plan: NDArray[np.int8]) -> None:
    """Raise where the outline of a robot at its start, the origin of the `plan`, is crossed by a surface: it would try for ever to get out."""
    cells = np.argwhere(plan == OCC_OCCUPIED)[:, ::-1]
    surfaces = (spec.origin_x, spec.origin_y) + spec.resolution * (cells + 0.5)
    normals, offsets = footprint_edges(robot.footprint, -FIT)
    is_inside = (surfaces @ normals.T <= offsets).all(axis=1)
    if is_inside.any():
        x, y = surfaces[is_inside][0].tolist()
        raise BadInputError(
            f"{name} does not fit at its start: something stands at ({x:.2f}, {y:.2f}) m from its middle, inside of its outline; --start puts it elsewhere"
        )


def _site(options: RunOptions, config: RobotConfig) -> SavedSite | None:
    """The saved site in which a robot drives that was told so (`_config`); None where its map is a plane, or it makes one."""
    if options.makes_map or options.map_file is None or config.mapping != "ground":
        return None
    site = load_site(options.map_file, config.lio.localize.map)
    goals = [(step.map_from_goal, step.level) for step in options.steps if isinstance(step, NavigateStep)]
    check_places(site, config.localization.initial_pose, goals, str(options.map_file))
    return site


def _grid(options: RunOptions, robot: SimRobot, world: WorldSpec) -> MapGrid | None:
    """The known map: a file, or drawn from the world's plan in the frame of its own start; None when the robot makes one."""
    if options.makes_map:
        return None
    if options.map_file is not None:
        _refuse_plan_as_map(options.world, options.map_file)
        return load_map(options.map_file)
    return truth_grid(world.from_start(), robot.sensor_height, DRAWN_RESOLUTION)


def _refuse_plan_as_map(world: str, map_file: Path) -> None:
    """Raise where the map is the world's own plan: its frame is the file's, a map of that world begins where the robot starts, and every place would be meant elsewhere."""
    if Path(world).is_file() and Path(world).with_suffix("").resolve() == map_file.with_suffix("").resolve():
        raise BadInputError(
            f"{map_file}: is the plan of the world itself; without --map the map is drawn from it, in the frame of the robot's start, which goals mean"
        )


def _check_map(options: RunOptions, config: RobotConfig, grid: MapGrid) -> None:
    """Refuse a map in which nothing can be localized, and places outside of it."""
    spec, cells = grid
    name = options.map_file or f"the map of {options.world}"
    if not (cells >= OCC_OCCUPIED).any():
        raise BadInputError(f"{name}: has no wall by which a robot could be localized")
    start = config.localization.initial_pose
    if start is not None and not (
        spec.contains(start.x, start.y) and OCC_FREE <= cells[spec.cell_of(start.x, start.y)] < OCC_FREE_BELOW
    ):
        raise BadInputError(f"{name}: the start pose {start.x:g}, {start.y:g} m does not lie on its free floor")
    for step in options.steps:
        goal = step.map_from_goal if isinstance(step, NavigateStep) else None
        if goal is not None and not spec.contains(goal.x, goal.y):
            raise BadInputError(f"{name}: the goal {goal.x:g}, {goal.y:g} m lies outside of it")


def _config(robot: RobotModel, options: RunOptions, map_from_start: SE2, *, is_level: bool) -> RobotConfig:
    """The configuration of a run. Where the ground is not level, robots that can map it do, unless they are told otherwise."""
    profile = dict(options.profile)
    is_known = options.map_file is not None and is_site(options.map_file)
    if can_map_ground(robot) and (is_known if not options.makes_map else not is_level):
        profile = {**GROUND_PROFILE, **profile}
    config = robot_config(robot, profile, has_map=not options.makes_map, is_unknown=options.is_unknown)
    config.check_odometry(robot)
    if options.makes_map:
        config.check_stations()
    else:
        if config.mapping != "ground":
            config.check_localizer()
            config = with_map_bend(config, options.map_file)
        elif not is_known:
            raise BadInputError(
                "mapping ground: a known map of ground is one with levels and a cloud beside it (--map)"
            )
        if not options.is_lost and config.localization.initial_pose is None:
            config = replace(config, localization=replace(config.localization, initial_pose=map_from_start))
    return config


def with_map_bend(config: RobotConfig, map_file: Path | None) -> RobotConfig:
    """Return a configuration that knows how far the map of a file is bent, unless it was told; a map without a file was drawn exactly."""
    if map_file is None or config.localization.map_bend != (0.0, 0.0):
        return config
    return replace(config, localization=replace(config.localization, map_bend=load_bend(map_file)))


def _start(options: RunOptions, world: WorldSpec) -> SE2:
    """Where the robot starts, in the world's frame."""
    if options.starts_docked is not None:
        return dock_of_world(world, options.starts_docked).world_from_dock
    return world.start if options.start is None else world.start @ options.start


def _check_steps(options: RunOptions, robot: SimRobot, world: WorldSpec) -> None:
    steps = options.steps
    if options.is_apart and options.faults:
        raise BadInputError("the simulator in a process of its own takes no faults yet")
    if options.imperfections is not None:
        if options.is_apart or options.is_perfect:
            raise BadInputError("imperfections are for the simulator in this process, with all noise on")
        dock_of_world(world, options.imperfections.dock)
    if not steps and options.port is None:
        raise BadInputError("there is nothing to do: no step, and no view from which somebody could click a goal")
    if options.is_unknown and (options.is_lost or any(not isinstance(step, NavigateStep) for step in steps)):
        raise BadInputError("in an unknown place a robot drives to goals, and its start is where it stands")
    if any(isinstance(step, ExploreStep) for step in steps[1:]) or (options.makes_map and options.map_file is not None):
        raise BadInputError("exploring comes first and makes its own map")
    if not options.docks_wanted:
        return
    if not world.docks:
        raise BadInputError(f"world {options.world} has no docks; dock_room, dock_shapes, dock_hall and building have")
    if options.known_docks_file is None:
        for name in options.docks_wanted:
            dock_of_world(world, name)
    if not robot.model.scanners:
        raise BadInputError(f"robot {options.robot} cannot dock: it has no planar scanner")
