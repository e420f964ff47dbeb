"""Loop closure and background jobs on a ring of corridors in which the odometry slips on one side."""

import math
from functools import lru_cache

import numpy as np

from ambler.core.se2 import SE2
from ambler.slam2d.back_end import JobResult
from ambler.slam2d.config import LoopConfig
from ambler.slam2d.graph import Edge, EdgeKind
from ambler.slam2d.loop_closure import Closure, SubmapLinks, confirmed
from ambler.slam2d.slam import Slam2d
from tests.slam2d.drives import RING, Drive, around_the_ring, drive, errors, run, short_submaps


def slip(pose: SE2, motion: SE2) -> SE2:
    """Wheels spin on the lower side: there the odometry is 8 % too long; it turns a little too much everywhere."""
    factor = 1.08 if pose.y < -4.0 and abs(pose.yaw) < 0.1 else 1.0
    return SE2(factor * motion.x, motion.y, motion.yaw + 0.01 * abs(motion.x))


@lru_cache(maxsize=1)
def ring() -> Drive:
    return drive(around_the_ring(), slip, RING, 5.0)


def gap(truth: list[SE2], estimates: list[SE2]) -> float:
    """Return how wrong the last nodes lie relative to those that were near them on the first lap, metres."""
    first = range(len(truth) // 3)
    worst = 0.0
    for i in range(len(truth) - 20, len(truth)):
        j = int(np.argmin([truth[k].distance_to(truth[i]) for k in first]))
        worst = max(worst, (estimates[j].inverse() @ estimates[i]).distance_to(truth[j].inverse() @ truth[i]))
    return worst


def test_a_loop_closure_brings_the_ends_together() -> None:
    course, slam = ring(), Slam2d(short_submaps())
    results = run(slam, course, with_odometry=True, rng=np.random.default_rng(3))
    local = errors(course.truth, [r.local_from_base for r in results])
    assert local[-1, 0] > 0.2  # it did drift
    slam.finish()
    nodes = [k for k, r in enumerate(results) if r.node is not None]
    truth = [course.truth[k] for k in nodes]
    assert slam.loop_closures > 5
    drifted = gap(truth, [slam.local_from_node(i) for i in range(slam.nodes)])
    closed = gap(truth, [slam.map_from_node(i) for i in range(slam.nodes)])
    assert drifted > 0.2
    assert closed < 0.12
    assert closed < 0.4 * drifted
    everywhere = errors(truth, [slam.map_from_node(i) for i in range(slam.nodes)])[:, 0]
    assert np.sqrt((everywhere**2).mean()) < 0.75 * np.sqrt((local[:, 0] ** 2).mean())


def equal(a: JobResult, b: JobResult) -> bool:
    """Compare two results bit for bit."""
    assert len(a.edges) == len(b.edges)
    assert len(a.pending) == len(b.pending)
    for x, y in zip((*a.edges, *(c.edge for c in a.pending)), (*b.edges, *(c.edge for c in b.pending)), strict=True):
        assert (x.edge_from, x.edge_to, x.from_from_to, x.kind) == (y.edge_from, y.edge_to, y.from_from_to, y.kind)
        assert np.array_equal(x.information, y.information)
    assert (a.optimized is None) == (b.optimized is None)
    if a.optimized is not None and b.optimized is not None:
        assert np.array_equal(a.optimized.poses, b.optimized.poses)
        assert a.optimized.rejected == b.optimized.rejected
    return a.newest_node == b.newest_node


def test_a_background_job_is_pure_and_its_result_may_arrive_late() -> None:
    course, slam = ring(), Slam2d(short_submaps())
    n = len(course.truth)
    run(slam, course, with_odometry=True, last=n - 10, with_background=False)
    work = next(slam.final_work(), None)
    assert work is not None
    assert slam.take_background_work() is None  # one at a time
    poses = slam._back_end.graph.poses.copy()
    early = work()
    assert np.array_equal(slam._back_end.graph.poses, poses)
    assert slam.loop_closures == 0
    newest = slam.nodes - 1
    run(slam, course, with_odometry=True, first=n - 10, with_background=False)
    late = work()
    assert equal(early, late)
    assert early.optimized is not None
    young = [slam.map_from_node(newest).inverse() @ slam.map_from_node(i) for i in range(newest, slam.nodes)]
    assert len(young) > 1
    slam.commit(late)
    assert slam.loop_closures == len(late.edges) - len(early.optimized.rejected)
    anchor = slam._back_end.nodes[newest].vertex
    assert slam.map_from_node(newest) == SE2.from_array(early.optimized.poses[anchor])
    for i, relative in enumerate(young):  # younger nodes move along
        now = slam.map_from_node(newest).inverse() @ slam.map_from_node(newest + i)
        assert np.abs((relative.inverse() @ now).as_array()).max() < 1e-9


def test_the_same_input_gives_the_same_bits() -> None:
    ends = []
    for _ in range(2):
        course, slam = ring(), Slam2d(short_submaps())
        results = run(slam, course, with_odometry=True, rng=np.random.default_rng(5), last=150)
        slam.finish()
        spec, occupancy = slam.render_map()
        ends.append((slam._back_end.graph.poses.copy(), results[-1].map_from_base, spec, occupancy))
    assert np.array_equal(ends[0][0], ends[1][0])
    assert ends[0][1:3] == ends[1][1:3]
    assert np.array_equal(ends[0][3], ends[1][3])


def closure(node: int, shift: tuple[float, float, float]) -> Closure:
    return Closure(Edge(0, node, SE2(), np.eye(3), EdgeKind.INTER), shift)


def test_surprising_closures_wait_for_one_that_agrees() -> None:
    config = LoopConfig()
    far = config.surprise + 1.0
    small, big = closure(1, (0.1, 0.0, 0.0)), closure(2, (far, 0.0, 0.0))
    believed, waiting = confirmed([small, big], [], config)
    assert (believed, waiting) == ([small], [big])
    same_node = closure(2, (far, 0.05, 0.0))
    assert confirmed([same_node], [big], config) == ([], [big, same_node])
    other_turn = closure(3, (far, 0.0, config.agreement[1] * 1.5))
    assert confirmed([other_turn], [big], config) == ([], [big, other_turn])
    agreeing = closure(3, (far + 0.5 * config.agreement[0], 0.0, 0.0))
    assert confirmed([agreeing], [big], config) == ([big, agreeing], [])


def test_path_lengths_take_the_shortest_way_through_loops() -> None:
    links = SubmapLinks()
    for length in (0.0, 5.0, 6.0, 7.0):
        links.add_submap(length)
    assert links.distances_from(0) == [0.0, 5.0, 11.0, 18.0]
    links.add_loop(3, 0)
    assert links.distances_from(0) == [0.0, 5.0, 8.0, 1.0]
    assert links.distances_from(3) == [1.0, 6.0, 7.0, 0.0]
    links.add_submap(2.0)
    assert math.isclose(links.distances_from(4)[0], 3.0)
