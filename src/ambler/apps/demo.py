"""The demonstration: a simulated robot explores a building that it has never seen, comes home, saves the map and is judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ambler.apps.config import ExplorerConfig, for_robot
from ambler.apps.console import ProgressLine
from ambler.apps.run_folder import RunFolder
from ambler.apps.simulated_robot import lone_robot_nodes
from ambler.apps.simulated_run import SimulatedRun, ViewOptions
from ambler.apps.stacks import explorer_nodes
from ambler.nodes.operator import OperatorNode, Outcome
from ambler.runtime.topics import GOAL, TELEOP_REQUEST
from ambler.settings.profiles import as_values, build, merge, save_resolved
from ambler.sim.faults import Fault
from ambler.sim.robots import robot_named
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What to run. `port` None shows nothing; `time_limit` is in simulated seconds; `profile` overrides the robot's
    defaults; `faults` are written as in `sim.faults`."""

    world: str = "office"
    robot: str = "diff"
    seed: int = 0
    is_realtime: bool = False
    is_perfect: bool = False
    physics: Literal["contact", "kinematic"] = "contact"
    port: int | None = 8765
    host: str = "127.0.0.1"
    token: str | None = None
    time_limit: float = 3600.0
    profile: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()


def explorer_config(options: DemoOptions) -> ExplorerConfig:
    """Return the robot's configuration with the options' profile laid over it; raises BadInputError for anything wrong."""
    load_world(options.world)
    return build(ExplorerConfig, merge(as_values(for_robot(robot_named(options.robot).model)), options.profile))


class Demo(SimulatedRun):
    """One demonstration in one folder. `run` explores; `serve` then keeps the robot alive for viewers."""

    def __init__(self, options: DemoOptions, folder: RunFolder) -> None:
        self.options = options
        self.outcome: Outcome | None = None
        self.progress = ProgressLine()
        robot = robot_named(options.robot)
        self.robot = robot.model
        self.world = load_world(options.world)
        self.config = explorer_config(options)
        save_resolved(folder.config, {"demo": as_values(options), "explorer": as_values(self.config)})
        faults = tuple(Fault.parse(text) for text in options.faults)
        config = SimulationConfig(options.seed, options.is_perfect, options.physics, faults)
        operator = OperatorNode(
            str(folder.map_stem),
            self._finish,
            self.progress.show,
            saves_glass=self.config.maps_glass(robot.model),
        )
        nodes = [*lone_robot_nodes(self.world, robot, config), *explorer_nodes(robot.model, self.config), operator]
        view = None if options.port is None else ViewOptions(options.port, options.host, options.token)
        super().__init__(folder, nodes, (GOAL, TELEOP_REQUEST), view, is_realtime=options.is_realtime)

    def run(self, time_limit: float | None = None) -> None:
        """Explore until the exploration ends, a node fails or the time limit (that of the options) is over."""
        try:
            super().run(self.options.time_limit if time_limit is None else time_limit)
        finally:
            self.progress.close()

    @property
    def ended(self) -> str:
        """How the exploration ended: `finished` (with proof), a failure's name, `node_failed` or `time_limit`."""
        if self.executor.failure is not None:
            return "node_failed"
        if self.outcome is None:
            return "time_limit"
        return "finished" if self.outcome.is_success else self.outcome.code.lower()

    def _finish(self, outcome: Outcome) -> None:
        self.outcome = outcome
        self.executor.stop()
