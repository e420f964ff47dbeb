"""A whole exploration: it ends with proof, twice the same bits, replays, runs live, and stops when a part of it fails."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.judgement import judge
from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.run_report import write_run_report
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import BadInputError
from ambler.evaluation.exploration_run import read_exploration
from ambler.evaluation.recording_compare import compare_recordings
from tests.scenarios.conftest import explore


def test_it_ends_with_proof_at_home_and_maps_the_room(lab_run: SimulatedRun) -> None:
    assert lab_run.ended == "finished"
    assert lab_run.end is not None
    result = lab_run.end.ends[0].result
    assert result.is_home
    assert all(f.reason for f in result.remaining), "every frontier that is left has its reason"
    fields = judge(lab_run).fields
    assert fields["collisions"] == 0
    assert fields["coverage_ratio"] >= 0.99
    assert fields["ate_rms_m"] <= 0.05
    assert fields["nne_cells"] <= 0.8
    assert fields["nne_reverse_cells"] <= 0.8
    # After 24 s of one pass with the planar scanner (0.87 to 0.90 over three seeds); the bar of `spot` is measured in docs/results.
    assert fields["ssim"] >= 0.85


def test_the_report_is_one_page_with_its_pictures(lab_run: SimulatedRun) -> None:
    page = write_run_report(lab_run.robot, judge(lab_run)).read_text()
    assert page.count("data:image/png;base64,") >= 4
    assert "frontier" in page
    assert "<script" not in page


def test_a_second_run_with_the_same_seed_is_bit_equal(lab_run: SimulatedRun, tmp_path: Path) -> None:
    again = explore(tmp_path / "again", RunOptions(world="lab_empty", port=None))
    comparison = compare_recordings(lab_run.folder.recording, again.folder.recording)
    assert comparison.is_equal, str(comparison)
    assert comparison.equal_count > 5000
    for name in ("map.pgm", "map.yaml"):
        assert (lab_run.folder.root / name).read_bytes() == (again.folder.root / name).read_bytes()


def test_another_seed_gives_another_run(lab_run: SimulatedRun, tmp_path: Path) -> None:
    other = explore(tmp_path / "other", RunOptions(world="lab_empty", port=None, seed=1, time_limit=3.0))
    comparison = compare_recordings(lab_run.folder.recording, other.folder.recording, ["/scan"])
    assert not comparison.is_equal


def test_the_recording_replays_to_the_same_bits(lab_run: SimulatedRun, tmp_path: Path) -> None:
    comparison = replay_run(lab_run.folder.root, tmp_path).comparison
    assert comparison.is_equal, str(comparison)
    names = {t.topic for t in comparison.topics}
    assert {"/map", "/cmd_vel", "/frontiers", "/plan", "/slam_pose", "/gate_status"} <= names
    assert (tmp_path / "map.pgm").read_bytes() == (lab_run.folder.root / "map.pgm").read_bytes()


def test_a_changed_parameter_is_found_by_the_replay(lab_run: SimulatedRun, tmp_path: Path) -> None:
    (tmp_path / "recording").symlink_to(lab_run.folder.recording)
    text = lab_run.folder.config.read_text()
    assert "horizon: 1.7" in text
    (tmp_path / "config.yaml").write_text(text.replace("horizon: 1.7", "horizon: 1.5"))
    comparison = replay_run(tmp_path, tmp_path / "replay").comparison
    assert comparison.first_difference is not None
    assert comparison.first_difference.topic in ("/cmd_vel_nav", "/local_plan")


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"has no config\.yaml"):
        replay_run(tmp_path)


NEW_PROCESS = """
import sys
from pathlib import Path
from ambler.apps.scene import RunOptions
from ambler.kernels.warmup import compiled_signatures, imported_kernel_modules, warm_up
from tests.scenarios.conftest import explore

warm_up(imported_kernel_modules())
before = compiled_signatures()
explore(Path(sys.argv[1]), RunOptions(world="lab_obstacle", robot=sys.argv[2], port=None, time_limit=3.0))
after = compiled_signatures()
assert sum(before.values()) > 20
print([name for name in before if after[name] != before[name]])
"""


@pytest.mark.parametrize("robot", ["diff", "spot", "amr_omni"])
def test_no_kernel_is_compiled_while_the_robot_moves(robot: str, tmp_path: Path) -> None:
    """In a process of its own: here, a run before may have compiled what the warm-up forgot."""
    words = [sys.executable, "-c", NEW_PROCESS, str(tmp_path / "run"), robot]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stdout + done.stderr


@pytest.mark.live
def test_the_same_scenario_passes_in_the_live_executor(tmp_path: Path) -> None:
    live = explore(tmp_path / "live", RunOptions(world="lab_empty", port=None, is_realtime=True, time_limit=240.0))
    assert live.ended == "finished"
    fields = judge(live).fields
    assert fields["collisions"] == 0
    assert fields["coverage_ratio"] >= 0.98
    assert fields["ate_rms_m"] <= 0.05
    assert fields["real_time_factor"] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("victim", ["slam2d", "controller", "explorer"])
def test_a_node_that_fails_stops_the_robot(victim: str, tmp_path: Path) -> None:
    demo = SimulatedRun(RunOptions(world="lab_empty", port=None, time_limit=60.0), RunFolder(tmp_path / victim))
    node = demo.executor.stack.node(victim)

    def fail() -> None:
        raise RuntimeError("injected")

    demo.executor.contexts[demo.executor.stack.nodes.index(node)].after(6.0, fail)
    try:
        demo.run()
    finally:
        demo.close()
    assert demo.ended == "node_failed"
    record = read_exploration(demo.folder.recording)
    before = record.speeds[record.true_stamps_ns < 6_000_000_000]
    last = record.speeds[record.true_stamps_ns > record.true_stamps_ns[-1] - 100_000_000]
    assert before.max() > 0.2, "it was driving"
    assert last.max() < 0.02, "it came to rest within the second that the run lasts after a failure"
    assert record.true_stamps_ns[-1] < 7_200_000_000
    assert "NODE_FAILED" in demo.folder.log.read_text()


@pytest.mark.parametrize("factor", [0.05, 0.15])
def test_late_outputs_do_not_make_it_collide(factor: float, tmp_path: Path) -> None:
    demo = SimulatedRun(RunOptions(world="lab_empty", port=None, time_limit=200.0), RunFolder(tmp_path / "late"))
    for context in demo.executor.contexts:
        if context.node.name in ("slam2d", "controller", "planner", "navigator"):
            context.latency_ns += round(factor * 1e9)
    try:
        demo.run()
    finally:
        demo.close()
    fields = judge(demo).fields
    assert demo.ended == "finished"
    assert fields["collisions"] == 0
    assert fields["coverage_ratio"] >= 0.98


def test_truth_is_never_an_input(lab_run: SimulatedRun) -> None:
    for node in lab_run.executor.stack.nodes:
        assert not any(t.is_truth for t in (*node.inputs, *node.optional_inputs)), node.name


def test_coverage_grows_to_the_end(lab_run: SimulatedRun) -> None:
    coverage = read_exploration(lab_run.folder.recording).coverage
    assert coverage[-1, 1] > 0.98
    assert np.all(np.diff(coverage[:, 0]) > 0)


@pytest.mark.live
def test_a_live_robot_explores_behind_a_serial_line_and_a_socket(tmp_path: Path) -> None:
    live = explore(tmp_path / "apart", RunOptions(world="lab_empty", port=None, is_apart=True, time_limit=240.0))
    assert live.ended == "finished", live.text
    fields = judge(live).fields
    assert fields["collisions"] == 0
    assert fields["coverage_ratio"] >= 0.98
    assert fields["ate_rms_m"] <= 0.05
    replay = replay_run(live.folder.root, tmp_path / "replay")
    assert replay.poses is not None
    assert replay.is_good, replay.poses
