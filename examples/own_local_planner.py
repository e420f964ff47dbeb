"""A local planner of one's own: follow a carrot on the path, stop before anything lethal. Run it: `python examples/own_local_planner.py`."""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.apps.judgement import judge
from ambler.apps.robot import Parts
from ambler.apps.run_folder import RunFolder
from ambler.apps.simulated import RunOptions, SimulatedRun
from ambler.core.errors import InvalidPathError, NoValidControlError
from ambler.core.grid import COST_INSCRIBED, GridSpec
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.nodes.steps import NavigateStep


class Carrot:
    """Drives to a point 0.4 m ahead on the path (core.protocols.LocalPlanner)."""

    def __init__(self, ahead: float = 0.4, speed: float = 0.4) -> None:
        self._ahead, self._speed = ahead, speed
        self._path: NDArray[np.float64] = np.zeros((0, 3))
        self.trajectory: NDArray[np.float64] = np.zeros((0, 3))

    def set_path(self, path_odom: NDArray[np.float64]) -> None:
        if len(path_odom) == 0:
            raise InvalidPathError("the path is empty")
        self._path = path_odom

    def compute_command(
        self, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2, velocity: BodyVelocity
    ) -> BodyVelocity:
        away = np.hypot(*(self._path[:, :2] - (odom_from_base.x, odom_from_base.y)).T)
        nearest = int(np.argmin(away))
        later = np.nonzero(away[nearest:] > self._ahead)[0]
        goal = self._path[nearest + int(later[0])] if len(later) else self._path[-1]
        self.trajectory = np.array([odom_from_base.as_array(), goal])
        cell = spec.cell_of(goal[0], goal[1])
        if spec.contains_cell(*cell) and COST_INSCRIBED <= costs[cell] < 255:
            raise NoValidControlError("something stands before the carrot")
        x, y = odom_from_base.inverse().transform(goal[None, :2])[0]
        distance = math.hypot(x, y)
        if not len(later) and distance < 0.1:  # there: turn to the wanted heading
            turn = math.remainder(goal[2] - odom_from_base.yaw, math.tau)
            return BodyVelocity(wz=max(-0.8, min(0.8, 1.5 * turn)))
        bearing = math.atan2(y, x)
        turn = max(-1.0, min(1.0, 2.0 * bearing))
        return BodyVelocity(wz=turn) if abs(bearing) > 0.5 else BodyVelocity(min(self._speed, distance), 0.0, turn)


def main(out: Path) -> dict[str, object]:
    options = RunOptions((NavigateStep(SE2(3.0, 1.5, 0.0)),), "lab_empty", "diff", port=None, time_limit=90.0)
    run = SimulatedRun(options, RunFolder(out), parts=Parts(local_planner=Carrot()))
    try:
        run.run()
        return judge(run).fields
    finally:
        run.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        result = main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder))
        print({name: result[name] for name in ("ended", "goals_reached", "worst_goal_error_m", "collisions")})
