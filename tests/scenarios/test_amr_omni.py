"""The robot with three scanners explores with the merged scan, and its recording replays."""

from pathlib import Path

import pytest

from ambler.apps.judgement import judge
from ambler.apps.replay import replay_run
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from tests.scenarios.conftest import explore


@pytest.fixture(scope="module")
def amr_run(tmp_path_factory: pytest.TempPathFactory) -> SimulatedRun:
    return explore(tmp_path_factory.mktemp("amr"), RunOptions(world="lab_empty", robot="amr_omni", port=None))


def test_it_explores_with_three_scanners(amr_run: SimulatedRun) -> None:
    fields = judge(amr_run).fields
    assert amr_run.ended == "finished"
    assert fields["collisions"] == 0
    assert fields["coverage_ratio"] >= 0.99
    assert fields["ate_rms_m"] <= 0.03


def test_the_raw_scans_replay_to_the_same_bits(amr_run: SimulatedRun, tmp_path: Path) -> None:
    comparison = replay_run(amr_run.folder.root, tmp_path).comparison
    assert comparison.is_equal, str(comparison)
    assert {"/scan", "/merged_points", "/map", "/cmd_vel"} <= {t.topic for t in comparison.topics}
