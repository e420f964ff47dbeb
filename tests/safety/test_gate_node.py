"""The gate's node: its heartbeat, what it makes of a failed part, of leaning bodies, of moving ones, and of what no scanner sees."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.messages import GateState, LaserScan, Odometry, PointCloud, VelocityCommand
from ambler.core.robot import SensorMount
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.gate import GateNode
from ambler.runtime.tasks import GateRequest
from ambler.safety.points import bridged, pulled_nearer
from tests.safety.test_gaps import AHEAD, PUCK, Rig
from tests.safety.test_many_scanners import HandMadeContext


def taken_points(rig: Rig) -> list[np.ndarray]:
    """Keep what the gate is given from now on."""
    taken: list[np.ndarray] = []
    take = rig.node.gate.update_points

    def keep(sensor: str, stamp_ns: int, points: np.ndarray, pose: SE2) -> None:
        taken.append(points)
        take(sensor, stamp_ns, points, pose)

    rig.node.gate.update_points = keep  # type: ignore[method-assign]
    return taken


def odometry(now_ns: int, pose: SE3, vx: float) -> Odometry:
    covariance = np.zeros((6, 6))
    return Odometry(now_ns, "odom", "base", pose, (vx, 0.0, 0.0), (0.0, 0.0, 0.0), covariance, covariance)


def test_it_beats_50_times_a_second() -> None:
    periods: list[float] = []

    class Context(HandMadeContext):
        def timer(self, period: float, callback: Any) -> None:
            periods.append(period)

    node = GateNode(Rig(AHEAD[0]).model)
    node.ctx = Context()  # type: ignore[assignment]
    node.start()
    assert periods == [0.02]


def test_a_failed_part_stops_the_robot_at_once_and_for_good() -> None:
    rig = Rig(AHEAD[0])
    for _ in range(50):
        command = rig.tick(-0.2)
    assert command.vx == pytest.approx(-0.2)
    rig.node.stop_now("slam failed")
    assert rig.context.last["velocity_command"].vx == 0.0
    assert not rig.context.callbacks["reset_stop"](GateRequest("test", "")).is_done
    assert not rig.context.callbacks["arm"](GateRequest("test", "")).is_done
    assert rig.tick(-0.2).vx == 0.0


def test_a_base_that_lies_on_its_side_is_stopped_whoever_pushed_it_over() -> None:
    for roll, is_stopped in ((1.4, True), (-1.4, True), (3.1, True), (0.6, False)):
        rig = Rig(AHEAD[0])
        for _ in range(50):
            rig.tick(-0.2)
        pose = SE3((0.0, 0.0, 0.2), (math.cos(0.5 * roll), math.sin(0.5 * roll), 0.0, 0.0))
        for _ in range(20):
            rig.context.now_ns += 20_000_000
            rig.context.callbacks["odometry"](odometry(rig.context.now_ns, pose, 0.0))
        rig.context.step()
        status = rig.context.last["gate_status"]
        assert (status.state is GateState.FAULT and "TIPPED_OVER" in status.reason) == is_stopped, status.reason


@pytest.mark.parametrize("blind", ["nan", "empty", "too near"])
@pytest.mark.parametrize("mount", [AHEAD[0], PUCK], ids=["scan", "cloud"])
def test_a_scanner_that_measures_nothing_stops_the_robot_until_it_does(mount: SensorMount, blind: str) -> None:
    rig = Rig(mount)
    for _ in range(50):
        command = rig.tick(-0.2)
    assert command.vx == pytest.approx(-0.2)
    for _ in range(50):
        command = rig.tick(-0.2, silent=(mount.frame,))
        now_ns, nothing = rig.context.now_ns, np.zeros(0, np.float32)
        if mount.kind == "cloud":
            points = np.full((0 if blind == "empty" else 5, 3), np.nan, np.float32)
            zeros = np.zeros(len(points), np.float32)
            rings = np.zeros(len(points), np.uint16)
            rig.context.callbacks["cloud"](PointCloud(now_ns, mount.frame, points, zeros, zeros, rings))
        else:
            ranges = np.full(0 if blind == "empty" else 361, 0.01 if blind == "too near" else np.nan, np.float32)
            shape = (-1.57, math.radians(0.5), 0.0, 0.08, 0.05, 40.0)
            rig.context.callbacks["scan"](LaserScan(now_ns, mount.frame, *shape, ranges, nothing))
    assert command.vx == 0.0
    assert f"STALE_POINTS: no fresh scan or cloud from {mount.frame}" in rig.context.last["gate_status"].reason
    for _ in range(100):
        command = rig.tick(-0.2)
    assert command.vx == pytest.approx(-0.2)


def test_a_scan_that_finds_nothing_within_its_range_is_a_measurement() -> None:
    rig = Rig(AHEAD[0])
    for _ in range(100):
        command = rig.tick(-0.2, silent=("left",))
        shape = (-1.57, math.radians(0.5), 0.0, 0.08, 0.05, 40.0)
        ranges = np.full(361, np.inf, np.float32)
        rig.context.callbacks["scan"](LaserScan(rig.context.now_ns, "left", *shape, ranges, ranges[:0]))
    assert command.vx == pytest.approx(-0.2)


def speed_before(rig: Rig, points_base: np.ndarray, pitch: float = 0.0) -> float:
    """Drive with 0.5 m/s at points of a cloud (N, 3), told in the level base frame, with a body that leans forward; return the speed."""
    tilt = SE3((0.0, 0.0, 0.0), (math.cos(0.5 * pitch), 0.0, math.sin(0.5 * pitch), 0.0))
    sensor_from_level = (tilt @ PUCK.base_from_sensor).inverse()
    for k in range(40):
        rig.context.now_ns += 20_000_000
        now_ns = rig.context.now_ns
        rig.context.callbacks["odometry"](odometry(now_ns, tilt, 0.0))
        seen = sensor_from_level.transform(np.add(points_base, [0.0, 0.0, 1e-4 * (k % 2)])).astype(np.float32)
        zeros = np.zeros(len(seen), np.float32)
        rig.context.callbacks["cloud"](PointCloud(now_ns, "puck", seen, zeros, zeros, np.zeros(len(seen), np.uint16)))
        rig.context.callbacks["velocity_request"](VelocityCommand(now_ns, 0.5, 0.0, 0.0))
        rig.context.step()
    return float(rig.context.last["velocity_command"].vx)


def remembered(y: np.ndarray, begin: float) -> np.ndarray:
    """What the gate keeps, (N, 2) in the base frame, 0.7 m before a low box that begins at `begin` (m) on the way and of which there are returns at `y`
    (m, odom frame): from near, all rays pass above it. The drive is 1.3 m long."""
    ringed = replace(PUCK, elevation=(-math.radians(15.0), math.radians(15.0)))
    rig = Rig(ringed)
    taken = taken_points(rig)
    grid = np.meshgrid(begin + np.arange(0.0, 0.3, 0.01), y, (0.16, 0.2))
    for k in range(14):
        pose = SE3((0.1 * k, 0.0, 0.0))
        box = np.add(np.stack([axis.ravel() for axis in grid], axis=1), [0.0, 0.0, 1e-4 * (k % 2)])
        local = (pose @ ringed.base_from_sensor).inverse().transform(box)
        seen = local[np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1])) > ringed.elevation[0]]
        rig.context.now_ns += 100_000_000
        told = np.append(seen, [[30.0, 0.001 * k, 0.0]], axis=0).astype(np.float32)  # and something far away
        now_ns, zeros = rig.context.now_ns, np.zeros(len(told), np.float32)
        rings = np.zeros(len(told), np.uint16)
        rig.context.callbacks["odometry"](odometry(now_ns, pose, 0.0))
        rig.context.callbacks["cloud"](PointCloud(now_ns, "puck", told, zeros, zeros, rings))
    assert len(seen) == 0, "from near"
    return taken[-1]


def test_an_edge_that_no_ray_meets_any_more_is_remembered_no_farther_than_it_is() -> None:
    """A low box that begins anywhere within a column of the memory."""
    for begin in np.arange(2.0, 2.05, 0.01):
        kept = remembered(np.linspace(-0.1, 0.1, 21), float(begin))
        assert begin - 0.03 < float(np.min(kept[:, 0])) + 1.3 < begin + 0.01


def test_an_edge_of_which_little_was_met_is_remembered_without_gaps() -> None:
    kept = remembered(np.array([-0.14, 0.0, 0.13]), 2.0)
    across = np.sort(kept[kept[:, 0] < 0.75, 1])
    assert across[0] < -0.1
    assert across[-1] > 0.1
    assert np.diff(across).max() < 0.06, "no corner fits in"


def test_what_is_pulled_nearer_is_not_pulled_into_the_footprint() -> None:
    normals, offsets = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]), np.array([0.5, 0.3, 0.5, 0.3])
    points = np.array([[1.0, 0.0, 0.2], [0.51, 0.0, 0.2], [0.46, 0.0, 0.2], [0.0, -0.8, 0.2]])
    pulled = pulled_nearer(points, 0.02, normals, offsets)
    np.testing.assert_allclose(pulled[:, 0], [0.98, 0.5, 0.46, 0.0])
    np.testing.assert_allclose(pulled[:, 1], [0.0, 0.0, 0.0, -0.78])
    assert len(pulled_nearer(points[:0], 0.02, normals, offsets)) == 0


def test_no_corner_fits_between_what_is_remembered_of_one_thing() -> None:
    front = np.array([[1.0, -0.13, 0.3], [1.0, 0.0, 0.3], [1.04, 0.03, 0.3]])
    seen = np.array([[1.0, -0.25, 0.5], [1.0, -0.45, 0.5], [1.0, -0.49, 0.5]])
    points = bridged(front, seen)
    np.testing.assert_allclose(points[:3], front)
    between = points[3:]
    np.testing.assert_allclose(
        sorted(between[:, 1]), [-0.21, -0.17, -0.13 + 0.13 / 3, 0.0 - 0.13 / 3, 0.015], atol=1e-9
    )
    assert between[:, 2].max() <= 0.5
    assert len(bridged(front[:0], seen)) == 0, "what it sees is left as it is"
    wall = np.column_stack((np.zeros(40), np.arange(40) * 0.04, np.zeros(40)))
    corner = np.concatenate((wall, wall[1:, [1, 0, 2]]))
    assert len(bridged(corner, seen[:0])) == len(corner), "a corner of two walls is not rounded off"


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_bridges_lie_between_points_and_leave_no_gap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack((rng.uniform(0.0, 1.0, (30, 2)), np.zeros(30)))
    out = bridged(points[:20], points[20:])
    assert len(out) < 3 * 30 * 3
    for x, y, _ in out[20:]:
        assert np.hypot(points[:, 0] - x, points[:, 1] - y).min() <= 0.075
    for i, j in itertools.combinations(range(30), 2):  # the plain twin of the kernel
        a, b = points[i, :2], points[j, :2]
        apart, middle = np.hypot(*(a - b)), 0.5 * (a + b)
        others = np.delete(points[:, :2], (i, j), axis=0)
        is_free = np.hypot(*(others - middle).T).min() > 0.5 * apart
        is_bridged = np.hypot(*(out[20:, :2] - (a + (b - a) / math.ceil(apart / 0.05))).T).min(initial=1.0) < 1e-9
        assert is_bridged == (0.05 < apart <= 0.15 and is_free and i < 20) or not is_free


def bar(x: float, z: float) -> np.ndarray:
    y = np.linspace(-0.15, 0.15, 40)
    return np.stack((np.full_like(y, x), y, np.full_like(y, z)), axis=1)


@pytest.mark.parametrize(("z", "is_free"), [(0.12, True), (0.18, False), (0.59, False), (0.65, True)])
def test_what_is_higher_than_a_foot_and_lower_than_the_robot_stops_it(z: float, is_free: bool) -> None:
    """The body is 0.5 m high, its scanner sits at 0.5 m; 10 cm above that count."""
    speed = speed_before(Rig(PUCK), bar(0.45, z))
    assert speed == pytest.approx(0.5) if is_free else speed < 0.1


def test_obstacles_count_from_where_the_robot_must_brake() -> None:
    assert 0.05 < speed_before(Rig(PUCK), bar(0.55, 0.3)) < 0.45


@pytest.mark.parametrize("pitch", [0.0, math.radians(20.0)])
def test_the_floor_is_no_obstacle_to_a_body_that_leans(pitch: float) -> None:
    assert speed_before(Rig(PUCK), bar(0.55, 0.0), pitch) == pytest.approx(0.5)
    assert speed_before(Rig(PUCK), bar(0.45, 0.3), pitch) < 0.1


def test_a_mean_that_is_remembered_counts_as_an_obstacle_alone() -> None:
    rig = Rig(AHEAD[0])
    rig.turn_away()
    taken = taken_points(rig)
    rig.tick(0.0)
    behind = taken[-1][np.hypot(*taken[-1].T) < 2.0]
    assert len(behind) > 0
    _, counts = np.unique(behind, axis=0, return_counts=True)
    assert set(counts) == {2}, "two points are what it takes"


def test_beams_are_moved_to_the_instant_of_the_stamp() -> None:
    """At 1 m/s the last beam is measured 0.1 s after the first, 10 cm further on."""
    rig = Rig(AHEAD[0])
    taken = taken_points(rig)
    now_ns = rig.context.now_ns
    rig.context.callbacks["odometry"](odometry(now_ns, SE3((0.0, 0.0, 0.0)), 1.0))
    ranges = np.full(2, 2.0, np.float32)
    scan = LaserScan(now_ns, "left", -0.5 * math.pi, math.pi, 0.1, 0.08, 0.05, 40.0, ranges, ranges[:0])
    rig.context.callbacks["scan"](scan)
    first, last = taken[-1]
    assert first[0] == pytest.approx(0.35, abs=1e-6)
    assert last[0] == pytest.approx(0.45, abs=1e-6)


def test_a_cloud_that_ends_after_the_odometry_is_left_out_and_the_robot_stops_when_that_lasts() -> None:
    """Odometry may be as old as 0.25 s: a turn of 0.1 s that began 0.2 s after it ends beyond that."""
    rig = Rig(PUCK)
    for _ in range(50):
        command = rig.tick(0.4)
    assert command.vx == pytest.approx(0.4)
    taken = taken_points(rig)
    for k in range(30):
        rig.context.now_ns += 20_000_000
        now_ns = rig.context.now_ns
        points = np.array([[6.0, 0.0, 0.0], [6.0, 0.1, 0.001 * k]], np.float32)
        late = np.array([0.0, 0.1], np.float32)
        cloud = PointCloud(now_ns - 100_000_000, "puck", points, late, late, np.zeros(2, np.uint16))
        rig.context.callbacks["cloud"](cloud)
        rig.context.callbacks["velocity_request"](VelocityCommand(now_ns, 0.4, 0.0, 0.0))
        rig.context.step()
        assert len(taken) == min(k + 1, 12), "until the cloud's end is 0.25 s after the odometry"
    assert rig.context.last["velocity_command"].vx == 0.0
