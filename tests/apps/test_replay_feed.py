"""What a replay is fed: what its own nodes do not make, without what the recorder repeated for viewers."""

from pathlib import Path

from ambler.apps.replay import _feed
from ambler.bridges.recorder import Recorder
from ambler.core import messages as m
from ambler.core.se3 import SE3
from ambler.runtime.topics import TRANSFORMS


def test_edges_of_own_nodes_are_not_fed_though_the_recorder_repeats_them(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run")
    for k, (writer, parent, child) in enumerate([("slam", "map", "odom"), ("base", "odom", "base")] * 3):
        edge = m.TransformStamped(k, parent, child, SE3((float(k), 0.0, 0.0)))
        recorder.on_message(TRANSFORMS, m.Transforms(k, (edge,)), 10 + k, writer)
    recorder.close()
    fed = list(_feed(tmp_path / "run", frozenset({"slam"})))
    assert [time_ns for _, _, time_ns in fed] == [11, 13, 15]
    for topic, message, time_ns in fed:
        assert topic is TRANSFORMS
        assert isinstance(message, m.Transforms)
        assert [(e.child, e.stamp_ns) for e in message.transforms] == [("base", time_ns - 10)]
