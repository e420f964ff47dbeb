"""One run of a robot in one folder: its nodes and an operator, executor, recording, log and live view, and an orderly end."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ambler.apps.console import ProgressLine
from ambler.apps.run_folder import RunFolder
from ambler.apps.signals import on_interrupt
from ambler.bridges.foxglove import FoxgloveBridge
from ambler.bridges.recorder import Recorder
from ambler.nodes.gate import GateNode
from ambler.nodes.operator import OperatorConfig, OperatorNode
from ambler.nodes.steps import ProgramEnd, Step
from ambler.runtime.clock import Clock, SimulatedClock, SystemClock
from ambler.runtime.executor import Executor, NodeFailedError
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import END_PROGRAM, EndProgramRequest
from ambler.runtime.topics import GOAL, SET_POSE, TELEOP_REQUEST, Topic

OUTSIDE: tuple[Topic[Any], ...] = (GOAL, SET_POSE, TELEOP_REQUEST)
"""What people and other programs may put on the bus of a robot."""
WIND_UP = 60.0  # seconds of the executor that the end of a program may take


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Where the live view listens, and what viewers must present (None: nothing)."""

    port: int = 8765
    host: str = "127.0.0.1"
    token: str | None = None


class RobotRun:
    """Runs nodes, a gate among them, and the steps of a program, until all are done, the time limit is over or a signal comes; then
    `serve` may keep the robot alive for viewers."""

    def __init__(
        self,
        folder: RunFolder,
        nodes: Sequence[Node],
        steps: tuple[Step, ...],
        operator: OperatorConfig,
        view: ViewOptions | None = None,
        clock: Clock | None = None,
    ) -> None:
        """`clock` None runs in lockstep, as fast as the machine allows; any other in the live executor. Raises BadInputError when the
        view cannot listen."""
        self.folder = folder
        self.steps = steps
        self.end: ProgramEnd | None = None
        self.is_interrupted = False
        self.sim_seconds = 0.0
        self.wall_seconds = 0.0
        self.progress = ProgressLine()
        self.log = RunLog(folder.log, run=folder.root.name)
        self.operator = OperatorNode(steps, operator, self._finish, self.progress.show)
        stack = Stack([*nodes, self.operator], external=OUTSIDE)
        self.executor: Executor
        if clock is None:
            self.executor = LockstepExecutor(stack, SimulatedClock(), self.log, self._stop_robot)
        else:
            self.executor = LiveExecutor(stack, clock, self.log, self._stop_robot)
        self.recorder = Recorder(folder.recording)
        self._remove_recorder = self.executor.tap(self.recorder.on_message)
        self.view: FoxgloveBridge | None = None
        if view is not None:
            self.view = FoxgloveBridge(view.port, view.host, view.token, self.executor.inject)
            self.executor.tap(self.view.on_message)
        self._started_ns = self.executor.now_ns

    @property
    def ended(self) -> str:
        """How the run ended, in one word of a result: `succeeded`, a failure's name, `interrupted`, `time_limit` or `node_failed`."""
        if self.executor.failure is not None:
            return "node_failed"
        return "time_limit" if self.end is None else self.end.code.lower()

    @property
    def text(self) -> str:
        """One sentence that says why it ended, empty when all went well."""
        if self.executor.failure is not None:
            return str(self.executor.failure)
        return "" if self.end is None else self.end.text

    def run(self, time_limit: float) -> None:
        """Run for at most `time_limit` seconds of the executor. A signal or the time limit ends the program in order: the map so far is
        saved. A second signal raises KeyboardInterrupt."""
        started = time.perf_counter()
        try:
            with on_interrupt(self._interrupt):
                self.executor.run(time_limit)
                if self.end is None:
                    self._wind_up(time_limit)
        except NodeFailedError as failure:
            self.log.write(self.executor.now_ns, "run", failure.code, str(failure))
        finally:
            self.wall_seconds = time.perf_counter() - started
            self.sim_seconds = (self.executor.now_ns - self._started_ns) * 1e-9
            self._remove_recorder()
            self.recorder.close()
            self.progress.close()

    def serve(self) -> None:
        """Let the robot live on in real time until interrupted; a goal clicked in the viewer drives it there."""
        if isinstance(self.executor, LockstepExecutor):
            self.executor.clock.pace(1.0)
        with on_interrupt(self.executor.stop):
            self.executor.run()

    def close(self) -> None:
        """Release everything."""
        if self.view is not None:
            self.view.close()
        self.executor.close()
        self.log.close()

    def _wind_up(self, time_limit: float) -> None:
        code, text = "TIME_LIMIT", f"the time limit of {time_limit:g} s is over"
        if self.is_interrupted:
            code, text = "INTERRUPTED", "a signal ended the run"
        self.executor.call(END_PROGRAM, EndProgramRequest(code, text))
        self.executor.run(WIND_UP)

    def _interrupt(self) -> None:
        self.is_interrupted = True
        self.executor.stop()

    def _finish(self, end: ProgramEnd) -> None:
        self.end = end
        self.executor.stop()

    def _stop_robot(self, reason: str) -> None:
        gate = self.executor.stack.node("gate")
        assert isinstance(gate, GateNode)
        index = self.executor.stack.nodes.index(gate)
        self.executor.post(self.executor.contexts[index], 0, lambda: gate.stop_now(reason))


def wall_clock(*, is_simulated: bool) -> SystemClock:
    """Return the clock of a live run: the system's for real devices, one that begins at zero for simulated ones."""
    return SystemClock(from_zero=is_simulated)
