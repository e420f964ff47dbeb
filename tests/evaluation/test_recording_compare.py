"""Two recordings are equal, or the first difference is named by topic, index and time."""

from dataclasses import replace

import numpy as np
import pytest

from ambler.bridges.recorder import Recorder
from ambler.core import messages as m
from ambler.core.se3 import SE3
from ambler.evaluation.recording_compare import ReplayComparison, compare_recordings
from ambler.runtime import topics
from ambler.wire.mcap_file import McapRecorder
from ambler.wire.mcap_reader import read_recording


def pose(k, x=0.0):
    return m.PoseStamped(k * 100_000_000, "map", SE3((x, 0.0, 0.0)))


def record(folder, changes=None, count=10):
    """Write poses and commands; `changes` maps an index to another x, or to None for a dropped message."""
    recorder = McapRecorder(folder)
    for k in range(count):
        x = (changes or {}).get(k, 0.0)
        if x is not None:
            recorder.write("/slam_pose", pose(k, x), k * 100_000_000 + 5)
        recorder.write("/cmd_vel", m.VelocityCommand(k), k * 100_000_000 + 7)
    recorder.close()
    return folder


def test_equal_recordings_are_equal(tmp_path):
    outcome = compare_recordings(record(tmp_path / "a"), record(tmp_path / "b"))
    assert outcome.is_equal
    assert outcome.equal_count == 20
    assert str(outcome) == "20 messages on 2 topics are equal"


def test_the_last_bit_of_one_number_is_found_and_named(tmp_path):
    nearly = np.nextafter(0.0, 1.0)
    outcome = compare_recordings(record(tmp_path / "a"), record(tmp_path / "b", {6: float(nearly)}))
    assert not outcome.is_equal
    assert str(outcome) == "first difference: /slam_pose message 6 at 0.600000 s: bytes differ"
    counts = {t.topic: t.equal_count for t in outcome.topics}
    assert counts == {"/cmd_vel": 10, "/slam_pose": 6}
    assert compare_recordings(tmp_path / "a", tmp_path / "b", ["/cmd_vel"]).is_equal


@pytest.mark.parametrize(
    ("counts", "kind"), [((10, 8), "only in the reference"), ((8, 10), "only in the other recording")]
)
def test_missing_ends_are_named(tmp_path, counts, kind):
    outcome = compare_recordings(record(tmp_path / "a", count=counts[0]), record(tmp_path / "b", count=counts[1]))
    assert outcome.first_difference.kind == kind
    assert outcome.first_difference.index == 8
    assert "0.800000 s" in str(outcome)


@pytest.mark.parametrize("shift", [0.0, 1e-9])
def test_transforms_of_a_replay_are_compared_as_they_are_recorded(tmp_path, shift):
    """The recorder repeats the newest of every edge; the replay's nodes tell theirs one by one."""
    told = [
        (m.TransformStamped(k, *(("map", "odom") if k % 3 == 0 else ("odom", "base")), SE3((float(k), 0.0, 0.0))), k)
        for k in range(9)
    ]
    recorder = Recorder(tmp_path / "run")
    for edge, k in told:
        recorder.on_message(topics.TRANSFORMS, m.Transforms(k, (edge,)), k, edge.child)
    recorder.close()
    comparison = ReplayComparison(read_recording(tmp_path / "run"), ["/tf"])
    for edge, k in told:
        moved = replace(edge, parent_from_child=SE3((k + shift * (k == 4), 0.0, 0.0)))
        comparison.on_message(topics.TRANSFORMS, m.Transforms(k, (moved,)), k)
    assert comparison.result().is_equal == (shift == 0.0)


def test_a_replay_is_compared_message_by_message_and_times_may_be_ignored(tmp_path):
    reference = list(read_recording(record(tmp_path / "a")))
    for compare_times in (True, False):
        comparison = ReplayComparison(reference, ["/slam_pose"], compare_times=compare_times)
        for k in range(10):
            comparison.on_message(topics.SLAM_POSE, pose(k), k * 100_000_000 + 6)
            comparison.on_message(topics.VELOCITY_COMMAND, m.VelocityCommand(99), k)
        outcome = comparison.result()
        assert outcome.is_equal == (not compare_times)
        if compare_times:
            assert outcome.first_difference.kind == "delivered +0.000000001 s off"
