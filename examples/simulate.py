"""A robot explores a world that it has never seen, and is judged against the truth: `python examples/simulate.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ambler.apps.judgement import judge
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun


def main(folder: Path = Path("runs/simulate")) -> dict[str, Any]:
    """Run and return the result: how it ended, coverage, errors, collisions."""
    run = SimulatedRun(RunOptions(world="lab_obstacle", robot="spot", seed=3, port=None), RunFolder(folder))
    try:
        run.run()
        return judge(run).fields
    finally:
        run.close()


if __name__ == "__main__":
    result = main()
    print(f"{result['ended']}: {result['coverage_ratio']:.1%} of the floor, {result['collisions']} collisions")
