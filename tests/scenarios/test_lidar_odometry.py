"""A robot that explores on LiDAR-inertial odometry: in lockstep, replayed, and live; and what its odometry is worth beside that of its legs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.judgement import judge
from ambler.apps.replay import replay_run
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.messages import Odometry
from ambler.runtime.topics import ODOMETRY, TRUE_POSE, WHEEL_ODOMETRY, Topic
from ambler.wire.bags import open_bag
from tests.scenarios.conftest import explore

BY_LIDAR = {"odometry_source": "lidar"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> SimulatedRun:
    """One exploration of `lab_empty` with `spot`, in lockstep."""
    options = RunOptions(world="lab_empty", robot="spot", port=None, profile=BY_LIDAR)
    return explore(tmp_path_factory.mktemp("lidar"), options)


def worst_error(recording: Path, topic: Topic[Odometry]) -> tuple[float, float]:
    """Return how far the way and the heading since the first message are ever off, m and rad."""
    messages: dict[str, list[Odometry]] = {topic.ros_name: [], TRUE_POSE.ros_name: []}
    with open_bag(recording) as bag:
        for name, message, _ in bag.messages(set(messages)):
            assert isinstance(message, Odometry)
            messages[name].append(message)
    ours, truth = messages[topic.ros_name], messages[TRUE_POSE.ros_name]
    stamps = np.array([m.stamp_ns for m in truth])
    offs = []
    begin = truth[int(np.searchsorted(stamps, ours[0].stamp_ns))].pose.inverse()
    for m in ours:
        at = min(int(np.searchsorted(stamps, m.stamp_ns)), len(stamps) - 1)
        if abs(int(stamps[at]) - m.stamp_ns) > 5_000_000:
            continue
        off = (begin @ truth[at].pose).inverse() @ (ours[0].pose.inverse() @ m.pose)
        offs.append((math.hypot(*off.translation[:2]), abs(off.to_se2().yaw)))
    assert len(offs) > 500
    return max(x for x, _ in offs), max(yaw for _, yaw in offs)


def test_it_explores_the_room_on_it(run: SimulatedRun) -> None:
    assert run.ended == "finished"
    fields = judge(run).fields
    assert fields["collisions"] == 0
    assert fields["coverage_ratio"] >= 0.99
    assert fields["ate_unaligned_max_m"] <= 0.03


def test_it_is_much_better_than_the_legs(run: SimulatedRun) -> None:
    way, turn = worst_error(run.folder.recording, ODOMETRY)
    way_of_legs, turn_of_legs = worst_error(run.folder.recording, WHEEL_ODOMETRY)
    assert way < 0.03
    assert turn < math.radians(0.5)
    assert way_of_legs > 3.0 * way
    assert turn_of_legs > 3.0 * turn


def test_it_replays_to_the_same_bits(run: SimulatedRun, tmp_path: Path) -> None:
    comparison = replay_run(run.folder.root, tmp_path).comparison
    assert comparison.is_equal, str(comparison)
    assert {"/odom", "/registered_view", "/slam_pose"} <= {t.topic for t in comparison.topics}


@pytest.mark.live
def test_it_explores_live_too(tmp_path: Path) -> None:
    options = RunOptions(
        world="lab_empty", robot="spot", port=None, profile=BY_LIDAR, is_realtime=True, time_limit=240.0
    )
    live = explore(tmp_path / "live", options)
    assert live.ended == "finished"
    fields = judge(live).fields
    assert fields["collisions"] == 0
    assert fields["coverage_ratio"] >= 0.98
    assert fields["ate_unaligned_max_m"] <= 0.05
