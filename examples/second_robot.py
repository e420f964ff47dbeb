"""A second robot: two explore one building in one process, each with its own map and recording. `python examples/second_robot.py`."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from ambler.apps.judgement import judge
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.se2 import SE2


def main(out: Path, world: str = "two_rooms", seed: int = 0) -> dict[str, dict[str, object]]:
    """Explore with two robots of `diff`; returns the result of each by its name."""
    first = RunOptions(world=world, robot="diff", seed=seed, port=None, time_limit=900.0)
    second = RunOptions(world=world, robot="diff", seed=seed + 1, start=SE2(-0.1, -1.2, 0.0), port=None)
    run = SimulatedRun(first, RunFolder(out), mates={"second": second})
    try:
        run.run()
        return {robot.prefix or "first": judge(run, robot).fields for robot in run.team}
    finally:
        run.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        for name, fields in main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder)).items():
            print(name, {k: fields[k] for k in ("ended", "coverage_ratio", "collisions", "ate_rms_m", "sim_seconds")})
