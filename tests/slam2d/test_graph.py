"""Edges of the SLAM graph: what their information means, and what becomes of loop closures that are wrong."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from ambler.core.se2 import SE2
from ambler.slam2d.config import GraphConfig
from ambler.slam2d.graph import Edge, EdgeKind, Graph, diagonal_information, information_of, optimize

SIGMA = (0.02, math.radians(0.5))


def test_information_is_the_inverse_of_the_variance() -> None:
    assert np.allclose(np.linalg.inv(diagonal_information((0.1, 0.02))), np.diag([0.01, 0.01, 0.0004]))


def test_an_edges_information_holds_in_the_frame_of_its_measurement() -> None:
    """A pose told along the axes of the submap, 3 cm uncertain along x and 1 cm along y, seen by a base that is turned by 90 degrees:
    to the base the large uncertainty lies along its own y."""
    covariance = np.diag([0.03**2, 0.01**2, 0.002**2])
    turned = np.linalg.inv(information_of(covariance, 0.5 * math.pi, (0.0, 0.0)))
    assert np.allclose(turned, np.diag([0.01**2, 0.03**2, 0.002**2]))
    samples = np.random.default_rng(3).multivariate_normal(np.zeros(3), covariance, 40_000)
    yaw = 0.7
    local = np.column_stack([SE2(0.0, 0.0, -yaw).transform(samples[:, :2]), samples[:, 2]])
    floor = np.diag([0.004**2, 0.004**2, 0.001**2])
    told = np.linalg.inv(information_of(covariance, yaw, (0.004, 0.001)))
    assert np.allclose(told, np.cov(local.T) + floor, rtol=0.05, atol=2e-6)


def ring(noise: float = 0.002) -> tuple[Graph, list[SE2]]:
    """A chain of 40 vertices around a circle, whose odometry edges drift."""
    rng, graph = np.random.default_rng(5), Graph()
    truth = [SE2(5.0 * math.cos(a), 5.0 * math.sin(a), a + 0.5 * math.pi) for a in np.linspace(0.0, 2.0 * math.pi, 40)]
    pose = truth[0]
    graph.add_vertex(pose)
    for a, b in pairwise(truth):
        motion = (a.inverse() @ b) @ SE2(*(noise * rng.standard_normal(3) + (0.004, 0.0, 0.004)).tolist())
        pose = pose @ motion
        graph.add_vertex(pose)
        graph.add_edge(
            Edge(graph.vertices - 2, graph.vertices - 1, motion, diagonal_information(SIGMA), EdgeKind.LOCAL)
        )
    return graph, truth


def worst(poses: np.ndarray, truth: list[SE2]) -> float:
    return max(math.hypot(p[0] - t.x, p[1] - t.y) for p, t in zip(poses, truth, strict=True))


def closing(truth: list[SE2], a: int, b: int, error: SE2 | None = None) -> Edge:
    measured = truth[a].inverse() @ truth[b] @ (error or SE2())
    return Edge(a, b, measured, diagonal_information(SIGMA), EdgeKind.INTER)


def test_a_right_loop_closure_stays_and_pulls_the_chain_together() -> None:
    graph, truth = ring()
    assert worst(graph.poses, truth) > 0.4
    solved = optimize(graph.snapshot(), [closing(truth, 0, 39), closing(truth, 2, 38)], GraphConfig())
    assert solved.rejected == ()
    assert worst(solved.poses, truth) < 0.5 * worst(graph.poses, truth)


def test_a_wrong_loop_closure_is_thrown_out_and_bends_nothing() -> None:
    """Among right ones, one that is 3 m wrong: named, and the poses are those without it."""
    graph, truth = ring()
    right = [closing(truth, k, 39 - k) for k in range(4)]
    wrong = closing(truth, 10, 30, SE2(3.0, 1.0, 0.5))
    solved = optimize(graph.snapshot(), [*right, wrong], GraphConfig())
    assert solved.rejected == ((10, 30),)
    without = optimize(graph.snapshot(), right, GraphConfig())
    assert np.abs(solved.poses - without.poses).max() < 0.01


def test_a_loop_closure_that_disagrees_twice_as_much_does_not_bend_twice_as_much() -> None:
    """Within the width of rejection the robust kernel holds it; by least squares its pull would grow with its error."""
    graph, truth = ring(noise=0.0)
    right, held = [closing(truth, k, 39 - k) for k in range(4)], GraphConfig(reject_width=8.0)
    base = optimize(graph.snapshot(), right, held).poses
    bends = []
    for error in (0.12, 0.24):  # 6 and 12 sigma of the closure, before anything gives way
        solved = optimize(graph.snapshot(), [*right, closing(truth, 10, 12, SE2(error, 0.0, 0.0))], held)
        assert solved.rejected == ()
        bends.append(float(np.hypot(*(solved.poses - base)[:, :2].T).max()))
    assert 0.01 < bends[0] < bends[1] < 1.3 * bends[0]


def test_a_loop_closure_that_is_false_only_where_it_claims_little_is_thrown_out() -> None:
    """Along an alley, in which it trusts itself to 0.1 m and is 0.65 m off, it bends nothing and must not stay as if it were true."""
    graph, truth = ring(noise=0.0)
    right = [closing(truth, k, 39 - k) for k in range(4)]
    away = truth[10].inverse() @ truth[12]
    information = diagonal_information((0.02, math.radians(0.2)))
    information[0, 0] = 0.1**-2
    for off, is_false in ((0.2, False), (0.65, True)):
        edge = Edge(10, 12, away @ SE2(off, 0.0, 0.0), information, EdgeKind.INTER)
        assert optimize(graph.snapshot(), [*right, edge], GraphConfig()).rejected == (((10, 12),) if is_false else ())


def submaps_up_and_down(slip: float) -> tuple[Graph, list[SE2], list[int]]:
    """Eight hundred scans up and down a corridor of 50 m, every fortieth begins a submap that holds eighty of them; wheels slip by `slip` (m) once on the way. Returns the graph, the truth of
    its vertices, and the vertices of scans."""
    graph, truth, scans, submaps = Graph(), [], [], []
    up = [SE2(x, 0.0, 0.0) for x in np.linspace(0.0, 50.0, 400)]
    true = up + [SE2(pose.x, 1.0, math.pi) for pose in reversed(up)]
    local = [true[0]]
    for k, (a, b) in enumerate(pairwise(true)):
        local.append(local[-1] @ ((a.inverse() @ b) @ SE2(-slip if k == 200 else 0.0, 0.0, 0.0)))
    for k, pose in enumerate(local):
        if k % 40 == 0:
            submaps.append((graph.add_vertex(pose), pose))
            truth.append(true[k])
        vertex = graph.add_vertex(pose)
        truth.append(true[k])
        for start, begun in submaps[-2:]:
            intra = diagonal_information(GraphConfig().intra_sigma)
            graph.add_edge(Edge(start, vertex, begun.inverse() @ pose, intra, EdgeKind.INTRA))
        if scans:
            motion = local[k - 1].inverse() @ pose
            information = diagonal_information(GraphConfig().local_sigma)
            graph.add_edge(Edge(scans[-1], vertex, motion, information, EdgeKind.LOCAL))
        scans.append(vertex)
    return graph, truth, scans


def test_a_chain_that_many_closures_contradict_gives_way() -> None:
    """Wheels slipped by 1.2 m, and ten scans at the end see where the loop began: all true, and a stiff chain throws all of them out."""
    graph, truth, scans = submaps_up_and_down(1.2)
    sure = diagonal_information(GraphConfig().inter_sigma)
    closures = [Edge(0, v, truth[0].inverse() @ truth[v], sure, EdgeKind.INTER) for v in scans[-10:]]
    assert len(optimize(graph.snapshot(), closures, GraphConfig()).rejected) == 10
    solved = optimize(graph.snapshot(), closures, GraphConfig(), graph.intra)
    assert solved.is_loosened
    assert solved.rejected == ()
    assert all(math.hypot(*(solved.poses[v, :2] - truth[v].as_array()[:2])) < 0.1 for v in scans[-10:])


def test_a_chain_does_not_give_way_to_closures_that_contradict_each_other() -> None:
    """Ten places that look alike, each elsewhere: some of them could be believed if the chain were loose enough."""
    graph, truth, scans = submaps_up_and_down(0.0)
    sure, rng = diagonal_information(GraphConfig().inter_sigma), np.random.default_rng(4)
    closures = [
        Edge(0, v, truth[0].inverse() @ truth[v] @ SE2(*rng.uniform(-3.0, 3.0, 2).tolist(), 0.0), sure, EdgeKind.INTER)
        for v in scans[-10:]
    ]
    solved = optimize(graph.snapshot(), closures, GraphConfig(), graph.intra)
    assert not solved.is_loosened
    assert np.abs(solved.poses - graph.poses).max() < 0.05
