"""A client from outside: another thread asks for paths, sends goals and pauses a robot that drives. `python examples/outside_client.py`."""

from __future__ import annotations

import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import AmblerError
from ambler.core.se2 import SE2
from ambler.nodes.steps import NavigateStep
from ambler.runtime.executor import Executor
from ambler.runtime.tasks import (
    ARM,
    COMPUTE_PATH,
    NAVIGATE,
    PAUSE,
    GateRequest,
    NavigateGoal,
    PlanRequest,
)

FAR = SE2(3.0, 1.5, 0.0)


def client(executor: Executor, said: dict[str, object]) -> None:
    """Ask for a path until there is one, pause, arm and drive, all through the executor's outside door."""
    while "path_length_m" not in said:
        try:
            path = executor.call(COMPUTE_PATH, PlanRequest(FAR)).result().path
            said["path_length_m"] = float(np.hypot(*np.diff(path.poses[:, :2], axis=0).T).sum())
        except AmblerError as error:  # there is no map, or no pose yet
            said["first_answer"] = error.code
    said["paused"] = executor.call(PAUSE, GateRequest("client", "a look around")).result().is_done
    said["armed"] = executor.call(ARM, GateRequest("client")).result().is_done
    ticket = executor.send_goal(NAVIGATE, NavigateGoal(FAR), lambda told: said.setdefault("state", told.state))
    code = ticket.outcome.result().code
    said["outcome"] = code
    executor.stop()


def main(out: Path) -> dict[str, object]:
    """Let a robot live on for the client when its own program, one short drive, is over; returns what the client heard."""
    options = RunOptions((NavigateStep(SE2(0.5, 0.0, 0.0)),), "lab_empty", "diff", port=None, time_limit=90.0)
    run = SimulatedRun(options, RunFolder(out))
    said: dict[str, object] = {}
    thread = threading.Thread(target=client, args=(run.executor, said))
    try:
        run.run()
        thread.start()
        run.executor.run(90.0)
        thread.join(10.0)
        return said
    finally:
        run.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder)))
