"""A mission of one's own: a node that serves a task "rounds" by driving a square a number of times. `python examples/own_mission.py`."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ambler.apps.judgement import judge
from ambler.apps.robot import Parts
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.se2 import SE2
from ambler.nodes.steps import TaskStep
from ambler.runtime.node import GoalHandle, GoalTicket, Node, Task, TaskOutcome
from ambler.runtime.tasks import NAVIGATE, NavigateGoal, NavigateResult


@dataclass(frozen=True, slots=True)
class RoundsGoal:
    """How often to go round."""

    rounds: int


@dataclass(frozen=True, slots=True)
class RoundsProgress:
    """Corners reached so far."""

    corners: int


ROUNDS = Task("rounds", RoundsGoal, RoundsProgress, RoundsProgress, ("CORNER_NOT_REACHED",))
CORNERS = (SE2(1.5, 0.0), SE2(1.5, 1.0), SE2(0.0, 1.0), SE2(0.0, 0.0))


class RoundsNode(Node):
    """Drives from corner to corner; the first that cannot be reached ends the mission with a name."""

    name = "rounds"
    serves = (ROUNDS,)
    calls = (NAVIGATE,)

    def __init__(self) -> None:
        self._handle: GoalHandle[RoundsGoal, RoundsProgress, RoundsProgress] | None = None
        self._ticket: GoalTicket | None = None
        self._done = 0

    def start(self) -> None:
        self.ctx.serve_task(ROUNDS, self._on_goal, self._on_cancel)

    def _on_goal(self, handle: GoalHandle[RoundsGoal, RoundsProgress, RoundsProgress]) -> None:
        self._handle, self._done = handle, 0
        self._drive()

    def _on_cancel(self, handle: GoalHandle[RoundsGoal, RoundsProgress, RoundsProgress]) -> None:
        self._handle = None
        if self._ticket is not None:
            self._ticket.cancel()

    def _drive(self) -> None:
        goal = NavigateGoal(CORNERS[self._done % len(CORNERS)], yaw_tolerance=3.2)
        self._ticket = self.ctx.send_goal(NAVIGATE, goal, self._arrived)

    def _arrived(self, outcome: TaskOutcome[NavigateResult]) -> None:
        handle = self._handle
        if handle is None:
            return
        if not outcome.is_success:
            handle.fail("CORNER_NOT_REACHED", f"corner {self._done + 1}: {outcome.text}", RoundsProgress(self._done))
            return
        self._done += 1
        handle.feedback(RoundsProgress(self._done))
        if self._done == handle.goal.rounds * len(CORNERS):
            handle.succeed(RoundsProgress(self._done))
        else:
            self._drive()


def main(out: Path) -> dict[str, object]:
    options = RunOptions((TaskStep(ROUNDS, RoundsGoal(1)),), "lab_empty", "diff", port=None, time_limit=120.0)
    run = SimulatedRun(options, RunFolder(out), parts=Parts(nodes=(RoundsNode(),)))
    try:
        run.run()
        assert run.end is not None
        return {**judge(run).fields, "corners": run.end.ends[0].result.corners}
    finally:
        run.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        result = main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder))
        print({name: result[name] for name in ("ended", "corners", "collisions", "path_length_m")})
