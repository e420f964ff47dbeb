"""The demonstration: a simulated robot explores a building that it has never seen, comes home, saves the map and is judged."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ambler.apps.config import ExplorerConfig, for_robot
from ambler.apps.console import ProgressLine
from ambler.apps.run_folder import RunFolder
from ambler.apps.stacks import explorer_nodes
from ambler.bridges.foxglove import FoxgloveBridge
from ambler.bridges.recorder import Recorder
from ambler.nodes.gate import GateNode
from ambler.nodes.operator import OperatorNode, Outcome
from ambler.nodes.simulator import SimulatorNode
from ambler.runtime.clock import SimulatedClock
from ambler.runtime.executor import Executor, NodeFailedError
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.stack import Stack
from ambler.runtime.topics import GOAL, TELEOP_REQUEST
from ambler.settings.profiles import as_values, build, merge, save_resolved
from ambler.sim.faults import Fault
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.world import load_world


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


class Demo:
    """One demonstration in one folder. `run` explores; `serve` then keeps the robot alive for viewers."""

    def __init__(self, options: DemoOptions, folder: RunFolder) -> None:
        self.options = options
        self.folder = folder
        self.outcome: Outcome | None = None
        self.sim_seconds = 0.0
        self.wall_seconds = 0.0
        self.progress = ProgressLine()
        self._robot = robot_named(options.robot)
        self.world = load_world(options.world)
        self.config = explorer_config(options)
        save_resolved(folder.config, {"demo": as_values(options), "explorer": as_values(self.config)})
        self.log = RunLog(folder.log, run=folder.root.name)
        self.executor = self._make_executor()
        self.recorder = Recorder(folder.recording)
        self._remove_recorder = self.executor.tap(self.recorder.on_message)
        self.view: FoxgloveBridge | None = None

    def run(self) -> None:
        """Explore until the exploration ends, a node fails or the time limit is over."""
        options = self.options
        if options.port is not None:
            self.view = FoxgloveBridge(options.port, options.host, options.token, self.executor.inject)
            self.executor.tap(self.view.on_message)
        started = time.perf_counter()
        try:
            self.executor.run(options.time_limit)
        except NodeFailedError as failure:
            self.log.write(self.executor.now_ns, "demo", failure.code, str(failure))
        finally:
            self.wall_seconds = time.perf_counter() - started
            self.sim_seconds = self.executor.now_ns * 1e-9
            self.progress.close()
            self._remove_recorder()
            self.recorder.close()

    @property
    def ended(self) -> str:
        """How the exploration ended: `finished` (with proof), a failure's name, `node_failed` or `time_limit`."""
        if self.executor.failure is not None:
            return "node_failed"
        if self.outcome is None:
            return "time_limit"
        return "finished" if self.outcome.is_success else self.outcome.code.lower()

    def serve(self) -> None:
        """Let the robot live on in real time until interrupted; a goal clicked in the viewer drives it there."""
        if isinstance(self.executor, LockstepExecutor):
            self.executor.clock.pace(1.0)
        self.executor.run()

    def close(self) -> None:
        """Release everything."""
        if self.view is not None:
            self.view.close()
        self.executor.close()
        self.log.close()

    def _make_executor(self) -> Executor:
        options = self.options
        faults = tuple(Fault.parse(text) for text in options.faults)
        config = SimulationConfig(options.seed, options.is_perfect, options.physics, faults)
        simulation = Simulation(self.world, self._robot, config)
        operator = OperatorNode(
            str(self.folder.map_stem),
            self._finish,
            self.progress.show,
            saves_glass=self.config.maps_glass(self._robot.model),
        )
        nodes = explorer_nodes(self._robot.model, self.config)
        stack = Stack([SimulatorNode(simulation), *nodes, operator], external=(GOAL, TELEOP_REQUEST))
        if options.is_realtime:
            return LiveExecutor(stack, log=self.log, on_failure=self._stop_robot)
        return LockstepExecutor(stack, SimulatedClock(), self.log, self._stop_robot)

    def _finish(self, outcome: Outcome) -> None:
        self.outcome = outcome
        self.executor.stop()

    def _stop_robot(self, reason: str) -> None:
        gate = self.executor.stack.node("gate")
        assert isinstance(gate, GateNode)
        index = self.executor.stack.nodes.index(gate)
        self.executor.post(self.executor.contexts[index], 0, lambda: gate.stop_now(reason))
