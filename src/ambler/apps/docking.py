"""Docking in simulation: a robot in a known map drives to docks, docks, leaves them, and is taught where they are."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.known_map import KnownMapConfig
from ambler.apps.navigation import DRAWN_RESOLUTION, NavigationOptions, navigation_config
from ambler.apps.run_folder import RunFolder
from ambler.apps.simulated_robot import lone_robot_nodes
from ambler.apps.simulated_run import SimulatedRun, ViewOptions
from ambler.apps.stacks import known_map_nodes
from ambler.core.camera import CameraModel, MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.messages import BatteryState, Contact, Odometry
from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.database import DockDatabase
from ambler.docking.dock import Dock, DockKind, DockMarker, VShape
from ambler.evaluation.collisions import find_collisions
from ambler.nodes.dock_pilot import DockPilotNode, DockRounds, Errand
from ambler.nodes.docking import DockingNode, DockingNodeConfig
from ambler.runtime.topics import BATTERY, CONTACT, GOAL, SET_POSE, TELEOP_REQUEST, TRUE_POSE
from ambler.settings.profiles import as_values, save_resolved
from ambler.sim.dock_body import CONTACTS, FILM, PANEL_DEPTH, PAPER
from ambler.sim.faults import Fault
from ambler.sim.robots import robot_named
from ambler.sim.solids import SimDock, WorldSpec
from ambler.sim.truth import truth_grid
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world
from ambler.wire.map_files import load_map, save_map
from ambler.wire.mcap_reader import read_recording

RIM = 0.02  # metres by which a drawn outline is larger than the dock


@dataclass(frozen=True, slots=True)
class DockingOptions:
    """What to run: a navigation without goals, and `errands` in its place. `start` in the map overrides that of the navigation; `starts_docked` names a dock to start in instead. `docks_file` None draws the docks from the world's plan.
    `camera` replaces the calibration that the camera tells."""

    navigation: NavigationOptions
    errands: tuple[Errand, ...]
    start: SE2 | None = None
    starts_docked: str | None = None
    docks_file: Path | None = None
    camera: CameraModel | None = None
    docking: DockingNodeConfig = field(default_factory=DockingNodeConfig)


def docks_of_world(world: WorldSpec, path: Path) -> DockDatabase:
    """Return the docks of a world as a surveyor would have entered them into its drawn map, to be kept in `path`."""
    return DockDatabase(path, {dock.name: _drawn(dock) for dock in world.from_start().docks})


def _drawn(dock: SimDock) -> Dock:
    """Return a dock of a world whose frame is that of the drawn map."""
    side = 0.5 * dock.width + RIM
    near, far = dock.front - RIM, dock.panel + PANEL_DEPTH + RIM
    outline = np.array([[near, -side], [far, -side], [far, side], [near, side]])
    plain = Dock(dock.name, DockKind.MARKERS, dock.world_from_dock, outline)
    if dock.v_shape is not None:
        v = dock.v_shape
        return replace(plain, kind=DockKind.V_SHAPE, v_shape=VShape(v.angle, v.leg, SE2(v.x, 0.0, 0.0)))
    if dock.reflectors:
        strips = np.array([[dock.panel - FILM, strip.y] for strip in dock.reflectors])
        return replace(plain, kind=DockKind.REFLECTORS, reflectors=strips)
    markers = tuple(
        DockMarker(MarkerSpec(m.dictionary, m.number, m.size), dock.panel - PAPER, m.y, m.z) for m in dock.markers
    )
    return replace(plain, markers=markers)


def start_of(options: DockingOptions, world: WorldSpec) -> SE2:
    """Return where in the map the robot begins; raises BadInputError when there is no dock, or not the one to start in."""
    if not world.docks:
        raise BadInputError(f"world {world.name} has no docks; dock_room, dock_shapes and dock_hall have")
    if options.starts_docked is None:
        return options.start if options.start is not None else options.navigation.start
    for dock in world.from_start().docks:
        if dock.name == options.starts_docked:
            return dock.world_from_dock
    known = ", ".join(dock.name for dock in world.docks)
    raise BadInputError(f"world {world.name} has no dock {options.starts_docked!r}; there are {known}")


class DockingRun(SimulatedRun):
    """A list of errands in one folder: `run` does them, `judge` compares with the truth of the recording."""

    def __init__(self, options: DockingOptions, folder: RunFolder) -> None:
        self.options = options
        self.rounds: DockRounds | None = None
        navigation = options.navigation
        robot, self.world = robot_named(navigation.robot), load_world(navigation.world)
        navigation = replace(navigation, start=start_of(options, self.world))
        self.config: KnownMapConfig = navigation_config(navigation)
        if navigation.map_file is None:
            save_map(folder.map_stem, *truth_grid(self.world.from_start(), robot.sensor_height, DRAWN_RESOLUTION))
        grid = load_map(navigation.map_file or folder.map_stem.with_suffix(".yaml"))
        database = self._database(folder)
        for errand in options.errands:
            database.dock(errand.dock)
        save_resolved(folder.config, {"docking": as_values(options.docking), "robot": as_values(self.config)})
        faults = tuple(Fault.parse(text) for text in navigation.faults)
        config = SimulationConfig(navigation.seed, physics=navigation.physics, faults=faults)
        start = self.world.start @ navigation.start
        pilot = DockPilotNode(options.errands, self._finish)
        nodes = [
            *lone_robot_nodes(self.world, robot, config, start, options.camera),
            *known_map_nodes(robot.model, self.config, *grid),
            DockingNode(robot.model, database, options.docking),
            pilot,
        ]
        view = None if navigation.port is None else ViewOptions(navigation.port, navigation.host, navigation.token)
        super().__init__(folder, nodes, (GOAL, SET_POSE, TELEOP_REQUEST), view, is_realtime=navigation.is_realtime)

    def _database(self, folder: RunFolder) -> DockDatabase:
        if self.options.docks_file is not None:
            return DockDatabase.load(self.options.docks_file)
        database = docks_of_world(self.world, folder.root / "docks.yaml")
        database.save()
        return database

    @property
    def ended(self) -> str:
        """How the errands ended: `done`, `not_localized`, the first failure's name, `node_failed` or `time_limit`."""
        if self.executor.failure is not None:
            return "node_failed"
        if self.rounds is None:
            return "time_limit"
        if not self.rounds.is_localized:
            return "not_localized"
        failed = [end.code.lower() for end in self.rounds.ends if end.code != "SUCCEEDED"]
        return failed[0] if failed else "done"

    def judge(self) -> dict[str, Any]:
        """Return the fields of the result; truth and contacts come from the recording, unknown values are None."""
        truth, battery, contacts = _recorded(self.folder.recording)
        allowed = frozenset(dock.name + CONTACTS for dock in self.world.docks)
        fields: dict[str, Any] = {
            "world": self.options.navigation.world,
            "robot": self.options.navigation.robot,
            "ended": self.ended,
            "collisions": len(find_collisions(contacts, allowed=allowed)),
            "sim_seconds": self.sim_seconds,
            "run_seconds": self.wall_seconds,
            "battery_supply": None if battery is None else battery.supply.name.lower(),
            "recording": str(self.folder.recording),
        }
        for end in [] if self.rounds is None else self.rounds.ends:
            fields |= {f"{end.errand.kind.value}_text": end.text, f"{end.errand.kind.value}_code": end.code}
            if end.report is not None:
                fields |= _reported(end.errand.kind.value, end.report.attempts, end.report.seconds)
                fields[f"{end.errand.kind.value}_final_seconds"] = end.report.docking_seconds
        return fields | self._errors(truth)

    def _errors(self, truth: Odometry | None) -> dict[str, float | None]:
        """Where the robot truly stands in the nearest dock's frame at the end."""
        names = ("dock_error_x_m", "dock_error_y_m", "dock_error_m", "dock_error_yaw_deg")
        if truth is None:
            return dict.fromkeys(names)
        base = truth.pose.to_se2()
        away = [dock.world_from_dock.inverse() @ base for dock in self.world.docks]
        error = min(away, key=lambda pose: math.hypot(pose.x, pose.y))
        values = (error.x, error.y, math.hypot(error.x, error.y), math.degrees(wrap_angle(error.yaw)))
        return dict(zip(names, values, strict=True))

    def _finish(self, rounds: DockRounds) -> None:
        self.rounds = rounds
        self.executor.stop()


def _recorded(recording: Path) -> tuple[Odometry | None, BatteryState | None, list[Contact]]:
    """Return the last true pose, the last word of the battery, and all contacts."""
    truth: Odometry | None = None
    battery: BatteryState | None = None
    contacts: list[Contact] = []
    for recorded in read_recording(recording, [TRUE_POSE.ros_name, BATTERY.ros_name, CONTACT.ros_name]):
        if recorded.topic == TRUE_POSE.ros_name:
            truth = recorded.decode_as(Odometry)
        elif recorded.topic == BATTERY.ros_name:
            battery = recorded.decode_as(BatteryState)
        else:
            contacts.append(recorded.decode_as(Contact))
    return truth, battery, contacts


def _reported(kind: str, attempts: int, seconds: float) -> dict[str, Any]:
    return {f"{kind}_attempts": attempts, f"{kind}_seconds": seconds}
