"""Covariances of a pose graph against the inverse of the dense normal matrix, and against drawn errors."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.posegraph.marginals import Marginals
from ambler.posegraph.solver import PoseGraph, solve


def _graph(rng: np.random.Generator, n: int, loops: int) -> PoseGraph:
    """Return a random walk with exact measurements and some loops."""
    poses = np.zeros((n, 3))
    for k in range(1, n):
        yaw = poses[k - 1, 2] + rng.normal(0.0, 0.6)
        poses[k] = [poses[k - 1, 0] + np.cos(yaw), poses[k - 1, 1] + np.sin(yaw), yaw]
    a = np.concatenate((np.arange(n - 1), rng.integers(0, n // 2, loops)))
    b = np.concatenate((np.arange(1, n), rng.integers(n // 2 + 1, n, loops)))
    d = poses[b, :2] - poses[a, :2]
    c, s = np.cos(poses[a, 2]), np.sin(poses[a, 2])
    z = np.stack((c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], poses[b, 2] - poses[a, 2]), axis=1)
    root = rng.normal(size=(len(a), 3, 3))
    information = root @ root.transpose(0, 2, 1) + 10.0 * np.eye(3)
    return PoseGraph(poses, a, b, z, information, np.zeros(len(a), np.bool_))


def _dense(graph: PoseGraph, fixed: int) -> np.ndarray:
    """Return the covariance (3 N, 3 N) by differences of the residuals, with zeros at the fixed pose."""
    n = len(graph.poses)

    def residuals(poses: np.ndarray) -> np.ndarray:
        d = poses[graph.edge_to, :2] - poses[graph.edge_from, :2]
        yaw = poses[graph.edge_from, 2] + graph.measurements[:, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.stack((c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]), axis=1)
        return np.concatenate((turn, (poses[graph.edge_to, 2] - poses[graph.edge_from, 2])[:, None]), axis=1)

    jacobian = np.zeros((len(graph.edge_from), 3, 3 * n))
    for k in range(3 * n):
        step = np.zeros(3 * n)
        step[k] = 1e-6
        step = step.reshape(n, 3)
        jacobian[:, :, k] = (residuals(graph.poses + step) - residuals(graph.poses - step)) / 2e-6
    h = np.einsum("eik,eij,ejl->kl", jacobian, graph.information, jacobian)
    free = np.setdiff1d(np.arange(3 * n), 3 * fixed + np.arange(3))
    out = np.zeros((3 * n, 3 * n))
    out[np.ix_(free, free)] = np.linalg.inv(h[np.ix_(free, free)])
    return out


@pytest.mark.parametrize("seed", range(4))
def test_marginals_are_the_blocks_of_the_dense_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, fixed = 40, int(rng.integers(40))
    graph = _graph(rng, n, 3 * seed)
    marginals, dense = Marginals(graph, fixed), _dense(graph, fixed)
    for k in range(n):
        block = dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        np.testing.assert_allclose(marginals.covariances[k], block, rtol=1e-6, atol=1e-9)


def test_a_relative_covariance_does_not_depend_on_which_pose_is_held() -> None:
    rng = np.random.default_rng(7)
    graph = _graph(rng, 30, 4)
    others = np.array([3, 11, 20])
    first = Marginals(graph, 0).relative(25, others)
    for fixed in (25, 11, 29):
        np.testing.assert_allclose(Marginals(graph, fixed).relative(25, others), first, rtol=1e-6, atol=1e-10)


def test_a_relative_covariance_is_that_of_solutions_with_drawn_errors() -> None:
    rng = np.random.default_rng(3)
    graph = _graph(rng, 14, 2)
    graph = PoseGraph(*(*_parts(graph)[:4], 400.0 * graph.information, graph.is_robust))
    want = Marginals(graph).relative(13, np.array([5]))[0]
    roots = np.linalg.cholesky(np.linalg.inv(graph.information))
    drawn = []
    for _ in range(600):
        noise = np.einsum("eij,ej->ei", roots, rng.normal(size=graph.measurements.shape))
        poses = solve(
            PoseGraph(graph.poses, graph.edge_from, graph.edge_to, graph.measurements + noise, *_parts(graph)[4:])
        ).poses
        c, s = np.cos(poses[5, 2]), np.sin(poses[5, 2])
        d = poses[13] - poses[5]
        drawn.append([c * d[0] + s * d[1], -s * d[0] + c * d[1], (d[2] + np.pi) % (2 * np.pi) - np.pi])
    got = np.cov(np.array(drawn).T)
    scale = np.sqrt(np.diag(want))
    np.testing.assert_allclose(got / np.outer(scale, scale), want / np.outer(scale, scale), atol=0.2)


def test_a_graph_that_does_not_hold_a_pose_is_refused() -> None:
    graph = _graph(np.random.default_rng(0), 6, 0)
    parts = list(_parts(graph))
    parts[4] = np.zeros_like(graph.information)
    with pytest.raises(BadInputError, match="not determined"):
        Marginals(PoseGraph(*parts))


def _parts(graph: PoseGraph) -> tuple:
    return graph.poses, graph.edge_from, graph.edge_to, graph.measurements, graph.information, graph.is_robust
