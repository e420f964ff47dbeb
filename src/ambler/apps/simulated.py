"""A simulated robot: a checked scene → devices → nodes → a run. Exploring, driving in a known map and docking are steps of one program."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ambler.apps.config import RobotConfig
from ambler.apps.docks import docks_of_world
from ambler.apps.programs import steps_to_values
from ambler.apps.robot import MapGrid, Parts, Site, robot_nodes
from ambler.apps.run import RobotInRun, Run, ViewOptions
from ambler.apps.run_folder import RunFolder
from ambler.apps.saved_site import copy_site
from ambler.apps.scene import RunOptions, Scene, checked_scene
from ambler.apps.simulated_robot import simulated_nodes
from ambler.apps.simulator_client import RunningSimulator, SimulatorOptions, live_devices
from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.nodes.devices.table import device_nodes
from ambler.nodes.operator import OperatorConfig
from ambler.nodes.steps import ExploreStep, ProgramEnd
from ambler.runtime.clock import SystemClock
from ambler.runtime.node import Node
from ambler.runtime.tasks import SAVE_CLOUD, SAVE_GLASS, SAVE_GRAPH, SAVE_STATIONS
from ambler.settings.profiles import as_values, save_resolved
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.wire.graph_files import graph_file, load_graph
from ambler.wire.map_files import load_map, save_map

FIRST = "robot"  # the name of the first robot in its world


class SimulatedRobot(RobotInRun):
    """One robot of a world: its options as they were checked, its map and docks, and its stack of nodes."""

    def __init__(
        self,
        options: RunOptions,
        scene: Scene,
        folder: RunFolder,
        devices: Sequence[Node],
        prefix: str = "",
        parts: Parts | None = None,
    ) -> None:
        """`devices` are the nodes of its devices; see `SimulatedRun` for the others."""
        self.options = options
        self.scene = scene
        self.model, self.config = scene.robot.model, scene.config
        site = Site(self._map(folder), self._docks(folder), self._graph(folder), scene.site)
        saved = {"run": _plain(options), "steps": steps_to_values(options.steps)}
        save_resolved(folder.config, {**saved, "robot": as_values(self.config)})
        nodes = [*devices, *robot_nodes(self.model, self.config, site, options.seed, parts)]
        super().__init__(
            folder, nodes, options.steps, operator_config(options, self.config, self.model, folder), prefix
        )

    @property
    def truth(self) -> Path:
        """The recording that holds its ground truth."""
        return self.folder.simulator / f"{FIRST}.truth" if self.options.is_apart else self.folder.recording

    @property
    def world_from_map(self) -> SE2:
        """Where the frame of the robot's map lies: at its start when it made the map, else at the world's own start."""
        return self.scene.start if self.options.makes_map else self.scene.world.start

    def _map(self, folder: RunFolder) -> MapGrid | None:
        """The known map, kept in the folder; None when the robot makes one, or knows a site, which is kept there, too."""
        if self.scene.site is not None and self.options.map_file is not None:
            copy_site(self.options.map_file, folder.known_map_stem)
            first = self.scene.site.levels[0]
            save_map(folder.known_map_stem, first.spec, first.occupancy)
        if self.scene.grid is None:
            return None
        save_map(folder.known_map_stem, *self.scene.grid)
        return load_map(folder.known_map_stem.with_suffix(".yaml"))

    def _graph(self, folder: RunFolder) -> dict[str, NDArray[Any]] | None:
        """The graph that was saved with the known map, kept in the folder, for a planner that has one; None where there is none."""
        saved = None if self.options.map_file is None else graph_file(self.options.map_file.with_suffix(""))
        if saved is None or not saved.exists() or self.config.global_planner != "visibility_graph":
            return None
        shutil.copyfile(saved, graph_file(folder.known_map_stem))
        return load_graph(saved)

    def _docks(self, folder: RunFolder) -> DockDatabase | None:
        """The docks that the robot knows, in the frame of its map; the file at the run's start is kept for its replay."""
        if not self.scene.world.docks or not self.model.scanners:
            return None
        if self.options.known_docks_file is not None:
            shutil.copyfile(self.options.known_docks_file, folder.first_docks)
            return DockDatabase.load(self.options.known_docks_file)
        path = folder.docks if self.options.docks_file is None else self.options.docks_file
        database = docks_of_world(self.scene.world.seen_from(self.world_from_map), path)
        database.save()
        shutil.copyfile(path, folder.first_docks)
        return database


class SimulatedRun(Run):
    """Programs of one simulated robot, or of several in one world. `robot` is the first, with everything in `folder` itself; further ones,
    `mates` by their names, have folders of their own in it. World, physics, view, clock and time limit are the first one's."""

    def __init__(
        self,
        options: RunOptions,
        folder: RunFolder,
        scene: Scene | None = None,
        parts: Parts | None = None,
        mates: Mapping[str, RunOptions] | None = None,
    ) -> None:
        """`scene`: the options as they were checked before; `parts`: what is brought along in place of what is configured. Raises
        BadInputError."""
        self.options = options
        parts = parts if parts is not None else Parts()
        self.scene = scene = scene if scene is not None else checked_scene(options, parts.robot)
        others = {name: (mate, checked_scene(mate)) for name, mate in (mates or {}).items()}
        if options.is_apart and others:
            raise BadInputError("the simulator in a process of its own is for one robot")
        clock = _clock(options)
        self.simulator = _simulator(options, scene, folder, clock)
        if self.simulator is not None:
            devices = {FIRST: _live_nodes(scene, self.simulator, clock)}
        else:
            devices = _world_nodes(options, scene, others, parts)
        self.robot = SimulatedRobot(options, scene, folder, devices[FIRST], "", parts)
        team = [self.robot]
        for name, (mate, other) in others.items():
            team.append(SimulatedRobot(mate, other, RunFolder(folder.root / name), devices[name], name))
        self.team = tuple(team)
        view = _view(options, scene)
        super().__init__(folder, team, view, clock)

    @property
    def end(self) -> ProgramEnd | None:
        """How the first robot's program ended, None while it goes on."""
        return self.robot.end

    @property
    def ended(self) -> str:
        """How the first robot's program ended, in one word."""
        return self.ended_of(self.robot)

    @property
    def text(self) -> str:
        """Why it ended, empty when all went well."""
        return self.text_of(self.robot)

    def ended_of(self, robot: RobotInRun) -> str:
        """As of any run; a program that only explores ends as `finished`, with the proof."""
        ended = super().ended_of(robot)
        return "finished" if ended == "succeeded" and robot.steps == (ExploreStep(),) else ended

    def run(self, time_limit: float | None = None) -> None:
        """Run as any run does; the time limit is that of the options unless another is given."""
        super().run(self.options.time_limit if time_limit is None else time_limit)

    def close(self) -> None:
        """Release everything, the simulator last."""
        super().close()
        if self.simulator is not None:
            self.simulator.__exit__(None, None, None)


def _view(options: RunOptions, scene: Scene) -> ViewOptions | None:
    if options.port is None:
        return None
    return ViewOptions(options.port, options.host, options.token, scene.config.topic_names)


def _clock(options: RunOptions) -> SystemClock | None:
    """The system's clock for a live robot, one that begins at zero for a simulated one in real time, None for lockstep."""
    return SystemClock(from_zero=not options.is_apart) if options.is_apart or options.is_realtime else None


def _world_nodes(
    options: RunOptions, scene: Scene, others: Mapping[str, tuple[RunOptions, Scene]], parts: Parts
) -> dict[str, list[Node]]:
    """Put all robots into one world; returns the nodes of the devices of each."""
    config = SimulationConfig(options.seed, options.is_perfect, options.physics, scene.faults)
    spec, robot, camera, off = scene.world, scene.robot, scene.camera, options.imperfections
    if off is not None:
        spec, robot = off.of_world(spec), off.of_robot(robot)
        if camera is None:  # it tells the projection of its drawing
            camera = next((spec.model for spec in scene.robot.cameras.values()), None)
    robot = robot if parts.built is None else parts.built(robot)
    bodies = [BodySpec(FIRST, robot, scene.start)]
    bodies += [BodySpec(name, other.robot, other.start, mate.seed) for name, (mate, other) in others.items()]
    world = World(spec, bodies, config)
    nodes = {name: simulated_nodes(world, name, other.camera) for name, (_, other) in others.items()}
    model, has_map = scene.robot.model, scene.config.mapping != "ground"
    return {FIRST: simulated_nodes(world, FIRST, camera, parts.devices, model, has_map=has_map), **nodes}


def _simulator(
    options: RunOptions, scene: Scene, folder: RunFolder, clock: SystemClock | None
) -> RunningSimulator | None:
    """Start the simulator in a process of its own, where that is wanted."""
    if not options.is_apart or clock is None:
        return None
    start = scene.start
    robot = f"{FIRST}={options.robot}@{start.x!r},{start.y!r},{math.degrees(start.yaw)!r}"
    wanted = SimulatorOptions(options.world, (robot,), options.seed, options.physics, options.is_perfect)
    return RunningSimulator(wanted, folder.simulator, lambda: clock.now_ns).__enter__()


def _live_nodes(scene: Scene, simulator: RunningSimulator, clock: SystemClock | None) -> list[Node]:
    """The nodes of the drivers that reach the robot of the other process."""
    assert clock is not None
    cameras = {frame: spec.model for frame, spec in scene.robot.cameras.items()}
    cameras |= {frame: spec.model for frame, spec in scene.robot.depth_cameras.items()}
    model = scene.robot.model
    devices = live_devices(model, simulator.places[FIRST], lambda: clock.now_ns, cameras)
    return device_nodes(model, devices, calibration=scene.camera)


def operator_config(options: RunOptions, config: RobotConfig, robot: RobotModel, folder: RunFolder) -> OperatorConfig:
    """Return what the operator of a run is told."""
    if not options.makes_map:
        return OperatorConfig(may_turn=options.may_turn)
    glass = (SAVE_GLASS,) if config.maps_glass(robot) else ()
    graph = (SAVE_GRAPH,) if config.global_planner == "visibility_graph" else ()
    cloud = (SAVE_CLOUD,) if config.saves_cloud else ()
    stations = (SAVE_STATIONS,) if config.holds_stations else ()
    return OperatorConfig(str(folder.map_stem), (*glass, *graph, *cloud, *stations))


def _plain(options: RunOptions) -> dict[str, Any]:
    values = {name: value for name, value in as_values(replace(options, steps=())).items() if name != "steps"}
    return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}
