"""One run of one robot or several: nodes and an operator each, one executor, recordings, log and live view, and an orderly end."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from ambler.apps.console import ProgressLine
from ambler.apps.run_folder import RunFolder
from ambler.apps.signals import on_interrupt
from ambler.bridges.foxglove import FoxgloveBridge
from ambler.bridges.recorder import Recorder
from ambler.evaluation.process_memory import peak_memory_mb
from ambler.evaluation.results import processor_seconds
from ambler.nodes.gate import GateNode
from ambler.nodes.operator import OperatorConfig, OperatorNode
from ambler.nodes.steps import ProgramEnd, Step
from ambler.runtime.clock import Clock, SimulatedClock
from ambler.runtime.executor import Executor, NodeFailedError
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.names import NameProfile
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import END_PROGRAM, EndProgramRequest
from ambler.runtime.topics import Topic, order_topics

Driver = Callable[[Callable[[ProgramEnd], None], Callable[[int, str], None]], Node]
WIND_UP = 60.0  # seconds of the executor that the end of a program may take


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Where the live view listens, what viewers must present (None: nothing), and by what names they know the topics."""

    port: int = 8765
    host: str = "127.0.0.1"
    token: str | None = None
    names: NameProfile = "own"


def outside_topics(nodes: Sequence[Node]) -> tuple[Topic[Any], ...]:
    """Return what people and other programs may put on the bus of a robot: what no node of its own writes."""
    written = {topic for node in nodes for topic in node.outputs}
    return tuple(topic for topic in order_topics() if topic not in written)


def _nothing() -> None:
    """Nobody waits for the end."""


class RobotInRun:
    """One robot of a run: its nodes and operator as a stack, and where its recording and map go. `prefix` tells several robots apart."""

    def __init__(
        self,
        folder: RunFolder,
        nodes: Sequence[Node],
        steps: tuple[Step, ...],
        operator: OperatorConfig | Driver,
        prefix: str = "",
    ) -> None:
        """`operator`: what the one who sends it to the steps is told; or who makes somebody else of what to call at the end and with
        progress."""
        self.folder = folder
        self.steps = steps
        self.prefix = prefix
        self.progress = ProgressLine()
        self.end: ProgramEnd | None = None
        self.on_end: Callable[[], None] = _nothing
        person: Node
        if isinstance(operator, OperatorConfig):
            person = OperatorNode(steps, operator, self._finish, self.progress.show)
        else:
            person = operator(self._finish, self.progress.show)
        self.stack = Stack([*nodes, person], external=outside_topics(nodes), prefix=prefix)

    def _finish(self, end: ProgramEnd) -> None:
        self.end = end
        self.on_end()


class Run:
    """Runs robots until the steps of all are done, the time limit is over or a signal comes; then `serve` may keep them alive."""

    def __init__(
        self,
        folder: RunFolder,
        robots: Sequence[RobotInRun],
        view: ViewOptions | None = None,
        clock: Clock | None = None,
    ) -> None:
        """`clock` None runs in lockstep, as fast as the machine allows; any other in the live executor. Viewers see the first robot. Raises
        BadInputError when the view cannot listen."""
        self.folder = folder
        self.robots = tuple(robots)
        self.is_interrupted = False
        self._last_call: threading.Timer | None = None
        self.run_seconds = 0.0
        self.memory_mb = 0.0
        self.cpu_seconds = 0.0
        self.wall_seconds = 0.0
        self.view = (
            None
            if view is None
            else FoxgloveBridge(*(view.port, view.host, view.token, self._on_viewer), names=view.names)
        )
        self.log = RunLog(folder.log, run=folder.root.name)
        stacks = [robot.stack for robot in robots]
        self.executor: Executor
        if clock is None:
            self.executor = LockstepExecutor(stacks, SimulatedClock(), self.log, self._stop_robots)
        else:
            self.executor = LiveExecutor(stacks, clock, self.log, self._stop_robots)
        self.recorders = [
            Recorder(robot.folder.recording, self.executor.troubles.note, is_lossy=clock is not None)
            for robot in robots
        ]
        self._ends_of_taps = [
            self.executor.tap(recorder.on_message, robot.prefix)
            for recorder, robot in zip(self.recorders, robots, strict=True)
        ]
        if self.view is not None:
            self.executor.tap(self.view.on_message, self.robots[0].prefix)
        for robot in robots:
            robot.on_end = self._stop_when_all_are_done
        self._started_ns = self.executor.now_ns
        for robot in robots:
            robot.progress.begin_ns = self._started_ns

    def ended_of(self, robot: RobotInRun) -> str:
        """How a robot's program ended, in one word of a result: `succeeded`, a failure's name, `interrupted`, `time_limit` or
        `node_failed`."""
        if self.executor.failure is not None:
            return "node_failed"
        return "time_limit" if robot.end is None else robot.end.code.lower()

    def text_of(self, robot: RobotInRun) -> str:
        """One sentence that says why it ended, empty when all went well."""
        if self.executor.failure is not None:
            return str(self.executor.failure)
        return "" if robot.end is None else robot.end.text

    def recording_failure_of(self, robot: RobotInRun) -> str | None:
        """Return why the recording of a robot ends before its run did, None if it does not."""
        return next(r.failure for r, member in zip(self.recorders, self.robots, strict=True) if member is robot)

    def run(self, time_limit: float) -> None:
        """Run for at most `time_limit` seconds of the executor. A signal or the time limit ends the programs in order: the maps so far are
        saved. A second signal raises KeyboardInterrupt."""
        started, spent = time.perf_counter(), processor_seconds()
        try:
            with on_interrupt(self._interrupt):
                if isinstance(self.executor, LiveExecutor):
                    self._run_live(time_limit)
                else:
                    self._run_lockstep(time_limit)
        except NodeFailedError as failure:
            self.executor.log_line("run", failure.code, str(failure))
        finally:
            self.wall_seconds = time.perf_counter() - started
            self.run_seconds = (self.executor.now_ns - self._started_ns) * 1e-9
            for end_tap, recorder in zip(self._ends_of_taps, self.recorders, strict=True):
                end_tap()
                recorder.close()
            for robot in self.robots:
                robot.progress.close()
            self.memory_mb, self.cpu_seconds = peak_memory_mb(), processor_seconds() - spent

    def serve(self) -> None:
        """Let the robots live on in real time until interrupted; a goal clicked in the viewer drives the first one there."""
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

    def _run_lockstep(self, time_limit: float) -> None:
        """While a program is ended the simulated clock stands, so nothing moves."""
        self.executor.run(time_limit)
        if any(robot.end is None for robot in self.robots):
            self._end_programs(time_limit)
            self.executor.run(WIND_UP)

    def _run_live(self, time_limit: float) -> None:
        """The nodes go on while programs are ended: no robot is ever without commands, and none drives blindly on its last one."""
        timer = threading.Timer(min(time_limit, threading.TIMEOUT_MAX), self._wind_up_live, (time_limit,))
        timer.daemon = True
        timer.start()
        try:
            self.executor.run()
        finally:
            timer.cancel()
            if self._last_call is not None:
                self._last_call.cancel()

    def _wind_up_live(self, time_limit: float) -> None:
        if self._last_call is not None:
            return  # it is being wound up already
        self._last_call = threading.Timer(WIND_UP, self.executor.stop)
        self._last_call.daemon = True
        self._last_call.start()
        self._end_programs(time_limit)

    def _end_programs(self, time_limit: float) -> None:
        code, text = "TIME_LIMIT", f"the time limit of {time_limit:g} s is over"
        if self.is_interrupted:
            code, text = "INTERRUPTED", "a signal ended the run"
        for robot in self.robots:
            if robot.end is None:
                self.executor.call(END_PROGRAM, EndProgramRequest(code, text), robot.prefix)

    def _interrupt(self) -> None:
        self.is_interrupted = True
        if isinstance(self.executor, LiveExecutor):  # on a thread: the one that the signal came to may hold any lock
            threading.Thread(target=self._wind_up_live, args=(math.inf,), daemon=True).start()
        else:
            self.executor.stop()

    def _stop_when_all_are_done(self) -> None:
        if all(robot.end is not None for robot in self.robots):
            self.executor.stop()

    def _on_viewer(self, topic: Topic[Any], message: Any) -> None:
        self.executor.inject(topic, message, self.robots[0].prefix)

    def _stop_robots(self, reason: str) -> None:
        """Stop every robot at its gate, whatever failed and wherever."""
        for robot in self.robots:
            gate = robot.stack.node("gate")
            assert isinstance(gate, GateNode)
            self.executor.post(self.executor.context_of("gate", robot.prefix), 0, partial(gate.stop_now, reason))
