"""One run of a list of nodes in one folder: executor, recording, log and live view, whatever the robot does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ambler.apps.run_folder import RunFolder
from ambler.bridges.foxglove import FoxgloveBridge
from ambler.bridges.recorder import Recorder
from ambler.nodes.gate import GateNode
from ambler.runtime.clock import SimulatedClock
from ambler.runtime.executor import Executor, NodeFailedError
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.topics import Topic


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Where the live view listens, and what viewers must present (None: nothing)."""

    port: int = 8765
    host: str = "127.0.0.1"
    token: str | None = None


class SimulatedRun:
    """Runs nodes, a gate among them, until the time limit or `executor.stop`; then `serve` may keep the robot alive for viewers."""

    def __init__(
        self,
        folder: RunFolder,
        nodes: Sequence[Node],
        external: Sequence[Topic[Any]],
        view: ViewOptions | None = None,
        *,
        is_realtime: bool = False,
    ) -> None:
        self.folder = folder
        self.sim_seconds = 0.0
        self.wall_seconds = 0.0
        self.view: FoxgloveBridge | None = None
        self._view_options = view
        self.log = RunLog(folder.log, run=folder.root.name)
        stack = Stack(list(nodes), external=tuple(external))
        self.executor: Executor
        if is_realtime:
            self.executor = LiveExecutor(stack, log=self.log, on_failure=self._stop_robot)
        else:
            self.executor = LockstepExecutor(stack, SimulatedClock(), self.log, self._stop_robot)
        self.recorder = Recorder(folder.recording, self.executor.troubles.note, is_lossy=is_realtime)
        self._remove_recorder = self.executor.tap(self.recorder.on_message)

    def run(self, time_limit: float) -> None:
        """Run for at most `time_limit` simulated seconds, or until a node fails or somebody stops the executor."""
        view = self._view_options
        if view is not None:
            self.view = FoxgloveBridge(view.port, view.host, view.token, self.executor.inject)
            self.executor.tap(self.view.on_message)
        started = time.perf_counter()
        try:
            self.executor.run(time_limit)
        except NodeFailedError as failure:
            self.log.write(self.executor.now_ns, "run", failure.code, str(failure))
        finally:
            self.wall_seconds = time.perf_counter() - started
            self.sim_seconds = self.executor.now_ns * 1e-9
            self._remove_recorder()
            self.recorder.close()

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

    def _stop_robot(self, reason: str) -> None:
        context = self.executor.context_of(GateNode.name)
        gate = context.node
        assert isinstance(gate, GateNode)
        self.executor.post(context, 0, lambda: gate.stop_now(reason))
