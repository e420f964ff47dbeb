"""SLAM as one object in a simulated room: accuracy, odometry faults, the smooth correction, the map."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ambler.apps.config import SHARP
from ambler.core.se2 import SE2, wrap_angle
from ambler.registration.planar_scan import PlanarScan
from ambler.slam2d.back_end import JobResult
from ambler.slam2d.config import FrontEndConfig, Slam2dConfig
from ambler.slam2d.graph import OptimizedGraph
from ambler.slam2d.offline import points_on_walls
from ambler.slam2d.slam import Slam2d
from tests.registration.room import distance_to_walls, loop_of, ranges_at, scan_at
from tests.slam2d.drives import PERIOD_NS, RING, around_the_ring, drive, errors, oval, run, short_submaps

OF_ROBOTS = Slam2dConfig(FrontEndConfig(telling=SHARP.telling))


def scale(pose: SE2, motion: SE2) -> SE2:
    """Odometry 5 % too long that turns 5 % too much."""
    return SE2(1.05 * motion.x, 1.05 * motion.y, 1.05 * motion.yaw)


def dead(pose: SE2, motion: SE2) -> SE2:
    """Odometry that stands still."""
    return SE2()


@pytest.mark.parametrize("with_odometry", [True, False])
def test_a_lap_in_the_room_ends_where_it_began(with_odometry: bool) -> None:
    course = drive(oval(1.5), scale)
    results = run(Slam2d(), course, with_odometry=with_odometry, rng=np.random.default_rng(1))
    error = errors(course.truth, [r.map_from_base for r in results])
    assert error[:, 0].max() < 0.025
    assert error[:, 1].max() < math.radians(0.4)
    assert min(r.inlier_ratio for r in results[20:]) > 0.8
    for r in results:
        assert (r.map_from_odom @ r.odom_from_base).distance_to(r.map_from_base) < 1e-9


def test_a_base_at_rest_begins_its_map_with_ten_scans_and_not_with_the_noise_of_one() -> None:
    rng = np.random.default_rng(4)
    yaws = []
    for _ in range(12):
        slam, later = Slam2d(), []
        for k in range(20):
            slam.add_odometry(k * PERIOD_NS, SE2())
            scan = scan_at(SE2(0.3, 0.2, 0.1))
            noisy = scan.points * (1.0 + 0.01 * rng.standard_normal((len(scan.points), 1)) / 3.0)
            result = slam.update(replace(scan, stamp_ns=k * PERIOD_NS, points=noisy.astype(np.float32)))
            if k < 10:
                assert result.map_from_base == SE2()
            else:
                later.append(result.map_from_base.yaw)
        assert slam.nodes == 10  # at rest no more are needed
        yaws.append(float(np.mean(later)))
    # Maps of one scan turn by 0.41 mrad (standard deviation) from one to the next, those of ten by 0.13.
    assert float(np.std(yaws)) < 2.5e-4


@pytest.mark.parametrize("config", [OF_ROBOTS, Slam2dConfig()], ids=["robots", "logs"])
def test_between_smooth_walls_the_way_is_that_of_the_odometry(config: Slam2dConfig) -> None:
    """Nothing tells how far along the robot is; the texture of the cells held it back by several percent of the way."""
    walls = np.array([[-60.0, -1.62, 60.0, -1.62], [-60.0, 1.58, 60.0, 1.58]])
    truth = [SE2(0.08 * k, 0.02 * math.sin(0.1 * k), 0.0) for k in range(200)]
    course = drive(truth, walls=walls, range_max=12.0)
    results = run(Slam2d(config), course, with_odometry=True, rng=np.random.default_rng(2), with_background=False)
    found = results[0].map_from_base.inverse() @ results[-1].map_from_base
    assert found.x == pytest.approx(truth[-1].x, abs=0.03)
    assert abs(found.y - (truth[-1].y - truth[0].y)) < 0.02


@pytest.mark.parametrize("step", [0.05, 0.1])
def test_a_log_that_begins_in_motion_between_smooth_walls_keeps_its_way(step: float) -> None:
    """A scanner of 180 beams hits the walls of a corridor in the same pattern wherever it is: laid on the first scan, the second fits best where it has not moved,
    and what does not move is not drawn. Nearly all of the way was lost so."""
    walls = np.array(loop_of((-1.0, -1.5), (26.0, -1.5), (26.0, 1.5), (-1.0, 1.5)))
    angles, rng, slam = np.radians(np.arange(180) - 90.0), np.random.default_rng(1), Slam2d()
    truth = [SE2(0.02 + step * k, 0.1, 0.0) for k in range(round(12.0 / step))]
    poses = []
    for k, pose in enumerate(truth):
        ranges = ranges_at(pose, angles, walls) + rng.normal(0.0, 0.01, len(angles))
        points = ranges[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        slam.add_odometry(k * PERIOD_NS, pose)
        scan = PlanarScan(k * PERIOD_NS, points.astype(np.float32), np.zeros((0, 2), np.float32))
        poses.append(slam.update(scan).map_from_base)
    assert poses[-1].x - poses[0].x == pytest.approx(truth[-1].x - truth[0].x, abs=0.2)


@pytest.mark.parametrize("noise", [0.01, 0.02])
def test_a_base_that_stood_at_first_and_drives_straight_on_is_not_held_at_its_start(noise: float) -> None:
    """Ten scans at rest show spots on far walls that the same beams hit again a little farther on: they fit best where the base has not moved, and what does not move is not
    drawn. Many logs begin so; all of the way was lost, and the robot's own, right odometry doubted."""
    walls = np.array(
        [
            *loop_of((-30.0, -14.0), (50.0, -14.0), (50.0, 22.0), (-30.0, 22.0)),
            *loop_of((12.0, 9.0), (18.0, 9.0), (18.0, 16.0), (12.0, 16.0)),
        ]
    )
    angles, rng, slam = np.radians(np.arange(180) - 89.5), np.random.default_rng(1), Slam2d()
    at = np.concatenate((np.zeros(11), np.cumsum(np.minimum(0.003 * np.arange(1, 100), 0.06))))
    for k, x in enumerate(at.tolist()):
        ranges = ranges_at(SE2(x, 0.1, 0.0), angles, walls) + rng.normal(0.0, noise, len(angles))
        points = (ranges[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))[ranges < 30.0]
        slam.add_odometry(k * PERIOD_NS, SE2(1.03 * x, 0.0, 0.0))
        scan = PlanarScan(k * PERIOD_NS, points.astype(np.float32), np.zeros((0, 2), np.float32))
        assert abs(slam.update(scan).map_from_base.x - x) < 0.3, f"scan {k}"


@pytest.mark.parametrize(("field", "width"), [(57.0, 2.6), (70.0, 3.2)])
def test_a_depth_camera_is_not_held_back_where_the_walls_that_it_has_drawn_end(field: float, width: float) -> None:
    """It sees two pieces of wall, whose far ends are those of its range. On cells they fit best where they were drawn before: it stood in a corridor that it drove through, and
    right odometry was doubted."""
    rng, slam = np.random.default_rng(3), Slam2d()
    walls = [[-2.0, -0.5 * width, 22.0, -0.5 * width], [22.0, -0.5 * width, 22.0, 0.5 * width]]
    at = -2.0
    for door in (1.3, 5.1, 9.6, 13.2, 18.4):  # recessed by 15 cm
        high = 0.5 * width + 0.15
        walls += [[at, 0.5 * width, door, 0.5 * width], [door, 0.5 * width, door, high]]
        walls += [[door, high, door + 0.9, high], [door + 0.9, high, door + 0.9, 0.5 * width]]
        at = door + 0.9
    walls.append([at, 0.5 * width, 22.0, 0.5 * width])
    angles = np.radians(np.linspace(-0.5 * field, 0.5 * field, 320))
    for k, x in enumerate(np.concatenate((np.zeros(15), np.arange(0.0, 16.0, 0.15))).tolist()):
        ranges = ranges_at(SE2(x, 0.1, 0.0), angles, np.array(walls))
        ranges += 0.005 * ranges * rng.standard_normal(len(ranges))
        points = (ranges[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))[ranges < 4.0]
        slam.add_odometry(k * PERIOD_NS, SE2(1.01 * x, 0.0, 0.0))
        scan = PlanarScan(k * PERIOD_NS, points.astype(np.float32), np.zeros((0, 2), np.float32))
        assert abs(slam.update(scan).map_from_base.x - x) < 0.5, f"scan {k}"


def test_one_wall_across_the_way_overrules_odometry_that_is_too_long() -> None:
    walls = np.array([[-60.0, -1.62, 14.0, -1.62], [-60.0, 1.58, 14.0, 1.58], [14.0, -1.62, 14.0, 1.58]])
    truth = [SE2(0.05 * k, 0.0, 0.0) for k in range(160)]
    course = drive(truth, scale, walls=walls, range_max=30.0)
    results = run(Slam2d(OF_ROBOTS), course, with_odometry=True, rng=np.random.default_rng(2), with_background=False)
    found = results[0].map_from_base.inverse() @ results[-1].map_from_base
    assert found.x == pytest.approx(truth[-1].x, abs=0.04)  # the odometry says 0.40 m more


def test_odometry_that_stands_still_is_overruled_by_the_scans() -> None:
    course = drive(oval(1.0), dead)
    results = run(Slam2d(), course, with_odometry=True)
    assert errors(course.truth, [r.map_from_base for r in results])[:, 0].max() < 0.05


def test_odometry_that_tells_three_times_the_way_is_found_out_and_not_followed() -> None:
    """Wheels that spin: after a few scans the windows widen and the last motion is tried as well, and no scan is matched elsewhere."""
    course = drive(oval(1.0, 80), lambda pose, motion: SE2(3.0 * motion.x, motion.y, motion.yaw))
    results = run(Slam2d(), course, with_odometry=True, rng=np.random.default_rng(1), with_background=False)
    assert errors(course.truth, [r.local_from_base for r in results])[:, 0].max() < 0.06


@pytest.mark.parametrize("with_heading", [False, True])
@pytest.mark.parametrize("at", [1, 2, 5, 20])
@pytest.mark.parametrize("leap", [SE2(0.8, 0.0, 0.3), SE2(0.0, -3.0, 1.5), SE2(40.0, 30.0, 0.7)])
def test_a_leap_of_odometry_is_not_followed_from_the_first_scan_on(at: int, leap: SE2, with_heading: bool) -> None:
    """Its zero is set anew, or the first scan of a log came before the first odometry: before 25 scans had told what is usual it was believed, and
    one of kilometres filled the memory."""
    truth = oval(0.3)
    course = drive(truth, lambda pose, motion: leap if pose is truth[at - 1] else motion)
    feeds = {"with_odometry": True, "with_heading": with_heading, "with_background": False}
    results = run(Slam2d(), course, rng=np.random.default_rng(1), **feeds)
    assert errors(course.truth, [r.local_from_base for r in results])[:, 0].max() < 0.08


def test_odometry_that_begins_late_is_none_before_its_beginning() -> None:
    """It counted as odometry that stands, with the first pose of a bag at its first scan as well as with a clock that is ahead."""
    course = drive(oval(0.5, 60))
    for ahead_ns in (3_000_000_000, 100_000_000_000):
        slam, results = Slam2d(), []
        for k, pose in enumerate(course.truth):
            slam.add_odometry((k + 1) * PERIOD_NS + ahead_ns, course.odometry[k])
            rng = np.random.default_rng(k)
            results.append(slam.update(scan_at(pose, (k + 1) * PERIOD_NS, course.walls, rng, range_max=30.0)))
        assert errors(course.truth[:25], [r.local_from_base for r in results[:25]])[:, 0].max() < 0.06


@pytest.mark.parametrize("seed", [1, 2])
def test_wheels_that_stand_still_are_doubted_before_the_robot_leaves_the_window(seed: int) -> None:
    """At 1.7 m/s only windows that have widened reach as far as the robot drives from scan to scan."""
    course = drive(oval(1.0, 60), lambda pose, motion: SE2(0.0, 0.0, motion.yaw))
    results = run(Slam2d(), course, with_odometry=True, rng=np.random.default_rng(seed), with_background=False)
    assert errors(course.truth, [r.local_from_base for r in results])[:, 0].max() < 0.06


@pytest.mark.parametrize("at", [25, 33])
def test_a_scan_that_fits_nowhere_near_is_found_again_as_far_as_wheels_slip(at: int) -> None:
    """Key frames, one per 0.3 m: between two of them the base goes on by a metre and turns with it, of which odometry tells the beginning only."""
    way = oval(1.5, 35)
    truth = [*way[: at + 1], *way[at + 4 :]]
    course = drive(truth, lambda pose, motion: pose.inverse() @ way[at + 1] if pose is way[at] else motion)
    results = run(Slam2d(), course, with_odometry=True, rng=np.random.default_rng(1), with_background=False)
    assert errors(course.truth, [r.local_from_base for r in results])[:, 0].max() < 0.06


def test_a_loop_after_scans_that_told_nothing_is_sought_as_far_as_that_may_have_led() -> None:
    """Wheels turn by 14 degrees more than they tell while nothing is seen around a corner: far more than scan matching drifts on the way."""
    truth, dark = around_the_ring(0.25, 8.0), range(88, 100)
    kinked = {id(truth[k]) for k in dark}

    def slipped(pose: SE2, motion: SE2) -> SE2:
        return SE2(motion.x, motion.y, motion.yaw + 0.25 / len(dark)) if id(pose) in kinked else motion

    course = drive(truth, slipped, RING, 12.0)
    slam = Slam2d(short_submaps(24))
    rng = np.random.default_rng(1)
    for k, pose in enumerate(truth):
        scan = scan_at(pose, (k + 1) * PERIOD_NS, RING, rng, range_max=12.0)
        slam.add_odometry(scan.stamp_ns, course.odometry[k])
        slam.update(replace(scan, points=scan.points[:0]) if k - 1 in dark else scan)
        work = slam.take_background_work()
        if work is not None:
            slam.commit(work())
    seen = [truth[slam.stamp_of_node(k) // PERIOD_NS - 1] for k in (0, slam.nodes - 1)]
    assert errors(seen, [slam.local_from_node(k) for k in (0, slam.nodes - 1)])[1, 0] > 2.0, "the way is bent"
    slam.finish()
    assert errors(seen, [slam.map_from_node(k) for k in (0, slam.nodes - 1)])[1, 0] < 0.1


def test_nodes_are_added_on_motion_only() -> None:
    slam, scan = Slam2d(), scan_at(SE2(0.3, 0.1, 0.2))
    nodes = [slam.update(replace(scan, stamp_ns=(k + 1) * PERIOD_NS)).node for k in range(30)]
    assert nodes[0] == 0
    assert nodes[1:] == [None] * 29
    assert slam.nodes == 1
    moved = replace(scan_at(SE2(0.6, 0.1, 0.2)), stamp_ns=31 * PERIOD_NS)
    slam.add_odometry(30 * PERIOD_NS, SE2())
    slam.add_odometry(31 * PERIOD_NS, SE2(0.3, 0.0, 0.0))
    assert slam.update(moved).node == 1


def test_of_two_scanners_at_one_instant_both_are_drawn() -> None:
    """The rear one stands where the front one stood when it was drawn, and has not moved since; a scan that is there twice is drawn once."""
    slam, drawn, twice = Slam2d(), [], []
    for k, pose in enumerate(oval(0.5)):
        slam.add_odometry(k * PERIOD_NS, pose)
        for later_ns, is_front in ((0, True), (1000, False), (2000, False)):
            scan = scan_at(pose, k * PERIOD_NS + later_ns)
            is_seen = (scan.points[:, 0] > 0.0) == is_front
            result = slam.update(replace(scan, points=scan.points[is_seen], origin=(0.2 if is_front else -0.3, 0.0)))
            (twice if later_ns == 2000 else drawn).append(result.node is not None)
    front, rear = drawn[0::2], drawn[1::2]
    assert sum(front) > 20
    assert rear[10:] == front[10:]
    assert not any(twice[10:])


def test_scans_without_points_follow_the_prediction() -> None:
    slam, course = Slam2d(), drive(oval(0.25))
    run(slam, course, with_odometry=True)
    nodes, none = slam.nodes, np.zeros((0, 2), np.float32)
    n = len(course.truth)
    motion = SE2(0.05, 0.0, 0.02)
    slam.add_odometry((n + 1) * PERIOD_NS, course.odometry[-1] @ motion)
    before = course.truth[0].inverse() @ course.truth[-1]
    result = slam.update(PlanarScan((n + 1) * PERIOD_NS, none, none))
    assert result.local_from_base.distance_to(before @ motion) < 0.03
    assert result.node is None
    assert slam.nodes == nodes
    assert result.covariance[0, 0] >= 0.01


def test_corrections_reach_the_published_pose_gradually() -> None:
    slam, course = Slam2d(), drive(oval(1.0))
    half = len(course.truth) // 2
    before = run(slam, course, with_odometry=True, last=half, with_background=False)[-1].map_from_odom
    back_end = slam._back_end
    shift = SE2(0.8, -0.3, 0.2)
    moved = np.array([(shift @ SE2.from_array(p)).as_array() for p in back_end.graph.poses])
    slam.commit(JobResult((), (), (), {}, OptimizedGraph(moved, (), is_converged=True), slam.nodes - 1))
    target = shift @ before
    after = run(slam, course, with_odometry=True, first=half, with_background=False)
    away = [r.map_from_odom.distance_to(target) for r in after]
    whole = before.distance_to(target)
    steps = [a.map_from_odom.distance_to(b.map_from_odom) for a, b in pairwise(after)]
    # A first-order lag: each period takes 1 - exp(-dt / tau) of what is left; a little more for the matches themselves.
    share = 1.0 - math.exp(-0.1 / slam.config.correction_time)
    assert away[0] == pytest.approx((1.0 - share) * whole, rel=0.1)
    assert max(steps) < 1.2 * share * whole
    assert away[-1] < 0.03
    assert all(b < a + 0.02 for a, b in pairwise(away))


def test_the_map_shows_the_walls_within_one_cell() -> None:
    slam, course = Slam2d(short_submaps()), drive(oval(1.2))
    results = run(slam, course, with_odometry=True)
    slam.finish()
    spec, occupancy = slam.render_map()
    assert set(np.unique(occupancy).tolist()) == {-1, 0, 100}
    room_from_map = course.truth[0] @ results[0].map_from_base.inverse()
    walls = room_from_map.transform(spec.centers_of(np.argwhere(occupancy == 100)))
    assert len(walls) > 400
    assert np.quantile(distance_to_walls(walls), 0.99) < 0.05
    assert distance_to_walls(walls).max() < 0.075
    # Each return of the true scans lies on an occupied cell or beside one.
    poses = np.array([(room_from_map.inverse() @ t).as_array() for t in course.truth])
    assert points_on_walls([scan_at(t) for t in course.truth], poses, spec, occupancy) > 0.995
    # What the robot drove over is free.
    cells = spec.cells_of(poses[:, :2])
    assert (occupancy[cells[:, 0], cells[:, 1]] == 0).all()
    # Rendering again, from what is kept, gives the same map.
    again = slam.render_map()
    assert again[0] == spec
    assert np.array_equal(again[1], occupancy)


def test_trusted_odometry_that_leads_into_a_new_view_is_not_left_for_what_looks_alike() -> None:
    """A square room that looks the same four ways, of which the robot sees a quarter at a time: after a turn in place nothing of the scan is known, and where the robot
    looked before it would fit perfectly."""
    walls = np.array([*loop_of((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0))])
    for yaw in (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi):
        corners = SE2(0.0, 0.0, yaw).transform(np.array([[3.2, -0.4], [3.2, 0.4]]))
        walls = np.concatenate([walls, corners.reshape(1, 4)])
    ahead = [SE2(-0.45 + 0.03 * k, 0.0, 0.0) for k in range(16)]
    turned = SE2(0.0, 0.0, 0.5 * math.pi)
    slam = Slam2d(Slam2dConfig())
    for k, pose in enumerate([*ahead, turned]):
        stamp_ns = (k + 1) * 1_000_000_000
        scan = scan_at(pose, stamp_ns, walls)
        is_ahead = np.abs(np.arctan2(scan.points[:, 1], scan.points[:, 0])) < math.radians(42.0)
        slam.add_odometry(stamp_ns, pose)
        result = slam.update(replace(scan, points=scan.points[is_ahead]))
    moved = ahead[0].inverse() @ turned
    assert abs(wrap_angle(result.local_from_base.yaw - moved.yaw)) < 0.2
    assert result.local_from_base.distance_to(moved) < 0.2
