"""Stations on the bus: goals and how they end, and a cloud that loop closures take along."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Status, Transforms, TransformStamped
from ambler.core.requests import TaskOutcome
from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig, LoopConfig
from ambler.nodes.stations import StationNode
from ambler.runtime.node import GoalHandle
from ambler.runtime.tasks import SAVE_STATIONS, SCAN_STATION, SaveMapRequest, ScanStationFeedback, ScanStationGoal
from ambler.runtime.topics import MAP_CORRECTIONS, ODOMETRY, REGISTERED_CLOUD, STATUS, TRAJECTORY, TRANSFORMS
from ambler.wire.station_files import load_stations
from tests.hand_made_context import HandMadeContext
from tests.lio.test_lidar_odometry_node import driven
from tests.lio.test_station_cloud import STANDS, S, cloud, odometry

WALL = np.column_stack([np.full(300, 4.1), *np.random.default_rng(4).uniform(-3.0, 3.0, (2, 300))])


class Stand:
    """A node whose robot stands or drives, with odometry at 50 Hz."""

    def __init__(self) -> None:
        self.context, self.node, self.pose = HandMadeContext(), StationNode(), STANDS
        self.context.start(self.node)
        self.outcomes: list[TaskOutcome[Any]] = []
        self.feedback: list[ScanStationFeedback] = []

    def ask(self, seconds: float = 2.0, level: int = 0) -> GoalHandle[Any, Any, Any]:
        handle = GoalHandle[Any, Any, Any](ScanStationGoal(seconds, level), self.feedback.append, self.outcomes.append)
        self.context.tasks[SCAN_STATION.name][0](handle)
        return handle

    def live(self, seconds: float, speed: float = 0.0, points: NDArray[np.floating] = WALL) -> None:
        for k in range(round(seconds * 50)):
            self.context.run(0.02)
            now_ns = self.context.now_ns
            self.pose = self.pose @ SE3((0.02 * speed, 0.0, 0.0))
            self.context.callbacks[ODOMETRY.name](odometry(now_ns, self.pose, speed))
            if k % 5 == 0:
                self.context.callbacks[REGISTERED_CLOUD.name](cloud(now_ns, self.pose.transform(points)))

    def tell(self, code: str) -> None:
        self.context.callbacks[STATUS.name](Status(self.context.now_ns, "odometry", code, ""))

    def correct(self, *corrections: tuple[int, SE3]) -> None:
        edges = tuple(TransformStamped(stamp_ns, "map", "odom", pose) for stamp_ns, pose in corrections)
        self.context.callbacks[MAP_CORRECTIONS.name](Transforms(self.context.now_ns, edges))


def test_a_station_is_told_counted_and_saved(tmp_path: Path) -> None:
    stand = Stand()
    stand.ask(level=1)
    stand.live(4.0)
    (outcome,) = stand.outcomes
    assert outcome.code == "SUCCEEDED"
    assert outcome.result.number == 1
    assert outcome.result.points == pytest.approx(300, abs=3)
    assert outcome.result.scans == pytest.approx(20, abs=1)
    assert {f.state for f in stand.feedback} == {"waiting for rest", "holding"}
    assert [(m.code, m.text[:10]) for m in stand.context.messages(STATUS)] == [("STATION_DONE", "station 1:")]
    stand.context.services[SAVE_STATIONS.name](SaveMapRequest(str(tmp_path / "map")))
    (saved,) = load_stations(tmp_path / "map")
    assert saved.map_from_base == STANDS  # nothing was corrected yet
    assert (saved.number, saved.level, saved.seconds) == (1, 1, pytest.approx(2.0))
    assert saved.points[:, 0] == pytest.approx(4.1, abs=1e-3)


def test_loop_closures_move_what_was_collected_before_them(tmp_path: Path) -> None:
    stand = Stand()
    stand.ask()
    stand.live(4.0)
    begun_ns = stand.node.clouds.stations[0].stamp_ns
    early, late = SE3.from_rpy((0.1, 0.0, 0.0), 0.0, 0.0, 0.0), SE3.from_rpy((0.3, -0.2, 0.1), 0.0, 0.0, 0.05)
    stand.correct((begun_ns - 2 * S, SE3()), (begun_ns - S, early), (begun_ns + S, late), (begun_ns + 2 * S, SE3()))
    stand.context.services[SAVE_STATIONS.name](SaveMapRequest(str(tmp_path / "map")))
    halfway = (early @ STANDS).interpolate(late @ STANDS, 0.5)
    (saved,) = load_stations(tmp_path / "map")
    assert saved.map_from_base.translation == pytest.approx(halfway.translation, abs=1e-9)
    assert saved.map_from_base.rotation == pytest.approx(halfway.rotation, abs=1e-9)
    assert saved.points[:, 0] == pytest.approx(4.1, abs=1e-3)  # in itself it stays as it was
    stand.correct((begun_ns - S, late))
    stand.context.services[SAVE_STATIONS.name](SaveMapRequest(str(tmp_path / "map")))
    (saved,) = load_stations(tmp_path / "map")
    assert saved.map_from_base.translation == pytest.approx((late @ STANDS).translation)


def test_corrections_are_those_of_the_odometry_that_closes_loops() -> None:
    """A body at rest beside a keyframe lies, corrected, where the corrected trajectory has that keyframe."""
    from tests.lio.carried import walk

    _, recorded = walk()
    eager = replace(LioConfig(), loops=LoopConfig(keyframe_m=2.0, way_least=10.0))
    context = driven(len(recorded), config=eager, closes_loops=True)
    told, trajectory = context.messages(MAP_CORRECTIONS), context.messages(TRAJECTORY)
    assert any(code == "LIO_LOOP_CLOSED" for code, _ in context.logged)
    assert 1 < len(told) < len(trajectory)  # told only when something has moved
    edges = told[-1].transforms
    assert [(e.parent, e.child) for e in edges] == [("map", "odom")] * len(edges)
    now = [e for m in context.messages(TRANSFORMS) for e in m.transforms if e.parent == "map"][-1].parent_from_child
    assert np.linalg.norm(now.translation) > 1e-3
    assert edges[-1].parent_from_child.translation == pytest.approx(now.translation, abs=1e-9)
    assert edges[-1].parent_from_child.rotation == pytest.approx(now.rotation, abs=1e-9)
    odometry_poses = {m.stamp_ns: m.pose for m in context.messages(ODOMETRY)}
    stamps = np.array(list(odometry_poses))
    first = next(k for k, p in enumerate(trajectory) if len(p.poses) == len(edges))
    path = trajectory[first].poses
    for edge, place in list(zip(edges, path, strict=True))[1:]:
        base = odometry_poses[int(stamps[np.argmin(np.abs(stamps - edge.stamp_ns))])]
        lidar = (edge.parent_from_child @ base).translation
        assert np.hypot(lidar[0] - place[0], lidar[1] - place[1]) < 0.35  # the LiDAR is beside the base


def test_who_moves_the_robot_ends_its_station_and_is_told() -> None:
    stand = Stand()
    stand.ask(seconds=5.0)
    stand.live(3.0)
    stand.live(0.5, speed=0.5)
    (outcome,) = stand.outcomes
    assert outcome.code == "MOVED"
    assert outcome.result.number == 1  # what was seen before is kept
    (status,) = stand.context.messages(STATUS)
    assert status.code == "STATION_MOVED"
    assert "moved after" in status.text


def test_a_robot_that_drives_on_gets_no_station() -> None:
    stand = Stand()
    stand.ask()
    stand.live(8.0, speed=0.5)
    (outcome,) = stand.outcomes
    assert (outcome.code, outcome.result.number) == ("NOT_AT_REST", 0)
    assert stand.node.clouds.stations == []


def test_lost_in_its_map_it_collects_nothing() -> None:
    stand = Stand()
    stand.ask(seconds=5.0)
    stand.live(3.0)
    stand.tell("LIO_LOST")
    assert [o.code for o in stand.outcomes] == ["LOST"]
    stand.ask()
    stand.live(0.5)
    assert [o.code for o in stand.outcomes] == ["LOST", "LOST"]
    stand.tell("LIO_GOOD")
    stand.ask()
    stand.live(4.0)
    assert [o.code for o in stand.outcomes] == ["LOST", "LOST", "SUCCEEDED"]
    assert stand.outcomes[-1].result.number == 1


def test_without_odometry_it_ends() -> None:
    stand = Stand()
    stand.ask()
    stand.context.run(2.0)
    assert [o.code for o in stand.outcomes] == ["STALE_INPUT"]


def test_what_is_cancelled_leaves_nothing() -> None:
    stand = Stand()
    handle = stand.ask(seconds=5.0)
    stand.live(3.0)
    stand.context.tasks[SCAN_STATION.name][1](handle)
    stand.live(5.0)
    assert [o.code for o in stand.outcomes] == ["CANCELLED"]
    assert stand.node.clouds.stations == []


def test_holding_for_ever_is_refused() -> None:
    stand = Stand()
    for seconds in (0.0, -1.0, 1e5, float("nan")):
        stand.ask(seconds=seconds)
    assert [o.code for o in stand.outcomes] == ["NOT_AT_REST"] * 4


def test_without_stations_an_empty_table_is_saved_and_where_nothing_can_be_written_it_says_so(tmp_path: Path) -> None:
    stand = Stand()
    stand.context.services[SAVE_STATIONS.name](SaveMapRequest(str(tmp_path / "map")))
    assert load_stations(tmp_path / "map") == []
    with pytest.raises(BadInputError, match="nowhere"):
        stand.context.services[SAVE_STATIONS.name](SaveMapRequest(str(tmp_path / "nowhere" / "map")))
