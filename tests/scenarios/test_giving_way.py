"""A wide robot, a narrow corridor, and somebody who never yields."""

from __future__ import annotations

from pathlib import Path

import pytest

from ambler.apps.judgement import judge
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.se2 import SE2
from ambler.nodes.steps import NavigateStep

CORRIDOR = """
start: {x: 1.5, y: 1.0, yaw_deg: 0}
walls:
  - {from: [0, 0], to: [19, 0], thickness: 0.1}
  - {from: [19, 0], to: [19, 2], thickness: 0.1}
  - {from: [0, 2], to: [8.3, 2], thickness: 0.1}
  - {from: [9.7, 2], to: [19, 2], thickness: 0.1}
  - {from: [8.3, 2], to: [8.3, 4], thickness: 0.1}
  - {from: [9.7, 2], to: [9.7, 4], thickness: 0.1}
  - {from: [8.3, 4], to: [9.7, 4], thickness: 0.1}
  - {from: [0, 0], to: [0, 2], thickness: 0.1}
people:
  - {name: walker, way: [[5, 1.0], [16, 1.0]], speed: 1.0, yields: false}
"""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_wide_robot_gets_past_somebody_who_never_yields(seed: int, tmp_path: Path) -> None:
    """A corridor of 2 m, a robot of 0.8 m, and somebody who walks up and down its middle: there is one niche, and it is used."""
    world = tmp_path / "corridor.yaml"
    world.write_text(CORRIDOR)
    options = RunOptions((NavigateStep(SE2(16.0, 0.0, 0.0)),), str(world), "amr_omni", seed=seed, port=None)
    run = SimulatedRun(options, RunFolder(tmp_path / "run"))
    try:
        run.run(300.0)
        fields = judge(run).fields
        log = run.folder.log.read_text()
    finally:
        run.close()
    assert fields["ended"] == "succeeded"
    assert fields["collisions"] == 0
    assert "NAVIGATION_GIVING_WAY" in log
