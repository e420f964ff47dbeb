"""The solver in space: derivatives, planted graphs, what it leaves free, and gtsam beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.posegraph.so3 import exp_all, inverse_right_jacobians, log_all, skew_all
from ambler.posegraph.solver import RobustKernel, SolverConfig
from ambler.posegraph.spatial import SpatialGraph, SpatialMarginals, Tilts, residuals, solve_spatial

F = np.ndarray


def drawn(seed: int, n: int = 40, noise: float = 0.0, loops: int = 25) -> tuple[SpatialGraph, F, F]:
    """A graph that begins away from its truth, and the true places and rotations."""
    rng = np.random.default_rng(seed)
    rotations, places = [np.eye(3)], [np.zeros(3)]
    for _ in range(n - 1):
        places.append(places[-1] + rotations[-1] @ np.array([2.0, 0.0, 0.3]))
        rotations.append(rotations[-1] @ exp_all(0.3 * rng.standard_normal((1, 3)))[0])
    r, t = np.array(rotations), np.array(places)
    far = [sorted(rng.choice(n, 2, replace=False)) for _ in range(loops)]
    a, b = (np.array([*range(n - 1), *(p[0] for p in far)]), np.array([*range(1, n), *(p[1] for p in far)]))
    measured = r[a].transpose(0, 2, 1) @ r[b] @ exp_all(noise * rng.standard_normal((len(a), 3)))
    arms = np.einsum("eij,ej->ei", r[a].transpose(0, 2, 1), t[b] - t[a]) + noise * rng.standard_normal((len(a), 3))
    root = rng.standard_normal((len(a), 6, 6)) + 3.0 * np.eye(6)
    begun = r @ exp_all(0.1 * rng.standard_normal((n, 3))), t + 0.3 * rng.standard_normal((n, 3))
    begun[0][0], begun[1][0] = r[0], t[0]
    information = root @ root.transpose(0, 2, 1)
    return SpatialGraph(begun[1], begun[0], a, b, arms, measured, information, a + 1 != b), t, r


def test_logarithm_undoes_the_exponential_up_to_half_a_turn() -> None:
    rng = np.random.default_rng(1)
    v = rng.standard_normal((300, 3))
    v *= (np.linspace(0.0, np.pi - 1e-6, 300) / np.linalg.norm(v, axis=1))[:, None]
    assert np.abs(log_all(exp_all(v)) - v).max() < 1e-7


def test_the_right_jacobian_is_that_of_the_logarithm() -> None:
    v, h = np.array([[0.4, -1.2, 0.7]]), 1e-6
    steps = np.vstack([np.eye(3), -np.eye(3)]) * h
    moved = log_all(exp_all(np.tile(v, (6, 1))) @ exp_all(steps))
    assert np.abs((moved[:3] - moved[3:]).T / (2 * h) - inverse_right_jacobians(v)[0]).max() < 1e-6
    assert np.allclose(skew_all(v)[0] @ [1.0, 2.0, 3.0], np.cross(v[0], [1.0, 2.0, 3.0]))


@pytest.mark.parametrize("is_from", [True, False])
def test_jacobians_of_edges_are_the_numeric_ones(*, is_from: bool) -> None:
    graph, _, _ = drawn(2, noise=0.3)
    _, from_a, from_b = residuals(graph, graph.places, graph.rotations)
    edge, h = 45, 1e-6
    pose = (graph.edge_from if is_from else graph.edge_to)[edge]
    for k in range(6):
        sides = []
        for sign in (1.0, -1.0):
            step = np.zeros(6)
            step[k] = sign * h
            places, rotations = graph.places.copy(), graph.rotations.copy()
            places[pose] += rotations[pose] @ step[:3]
            rotations[pose] = rotations[pose] @ exp_all(step[None, 3:])[0]
            sides.append(residuals(graph, places, rotations)[0][edge])
        numeric = (sides[0] - sides[1]) / (2 * h)
        assert np.abs(numeric - (from_a if is_from else from_b)[edge][:, k]).max() < 1e-6


def test_it_recovers_a_planted_graph() -> None:
    graph, places, rotations = drawn(3)
    solved = solve_spatial(graph)
    assert solved.converged
    assert solved.cost < 1e-12
    assert np.abs(solved.places - places).max() < 1e-7
    assert np.abs(solved.rotations - rotations).max() < 1e-7


def test_a_false_loop_moves_nothing_under_a_robust_kernel() -> None:
    graph, places, _ = drawn(4, noise=0.002)
    graph = replace(graph, information=1e4 * np.tile(np.eye(6), (len(graph.edge_from), 1, 1)))
    wrong = graph.edge_places.copy()
    wrong[45] += (8.0, -5.0, 3.0)
    config = SolverConfig(robust_kernel=RobustKernel.GEMAN_MCCLURE)
    near = solve_spatial(graph)  # a robust kernel needs a start that tells true loops from false ones
    spoiled = replace(graph, places=near.places, rotations=near.rotations, edge_places=wrong)
    solved = solve_spatial(spoiled, config=config)
    assert solved.converged
    assert solved.weights[45] < 0.01
    assert np.abs(solved.places - places).max() < 0.05
    plain = solve_spatial(replace(spoiled, is_robust=np.zeros_like(graph.is_robust)))
    assert np.abs(plain.places - places).max() > 0.5


def test_a_direction_without_information_stays_where_the_chain_has_it() -> None:
    graph, places, _ = drawn(5, n=10, loops=1)
    information = 1e2 * np.tile(np.eye(6), (10, 1, 1))
    information[9] = np.diag([1e6, 1e6, 0.0, 1e6, 1e6, 1e6])
    wrong = graph.edge_places.copy()
    wrong[9] += graph.edge_rotations[9] @ np.array(
        [0.0, 0.0, 5.0]
    )  # along the direction that is free in the measured frame
    solved = solve_spatial(replace(graph, information=information, edge_places=wrong))
    assert solved.converged
    assert np.abs(solved.places - places).max() < 1e-6


def test_tilts_keep_a_bent_chain_level() -> None:
    n = 30
    a, b = np.arange(n - 1), np.arange(1, n)
    bend = exp_all(np.array([[0.0, 0.01, 0.0]]))[0]
    rotations, places = [np.eye(3)], [np.zeros(3)]
    for _ in range(n - 1):
        places.append(places[-1] + rotations[-1][:, 0])
        rotations.append(rotations[-1] @ bend)
    steps = np.tile([1.0, 0.0, 0.0], (n - 1, 1))
    information = np.tile(np.diag([1e4] * 3 + [1e4] * 3), (n - 1, 1, 1))
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    tilts = Tilts(np.arange(n), up, np.full(n, 1e-4))
    graph = SpatialGraph(np.array(places), np.array(rotations), a, b, steps, np.tile(bend, (n - 1, 1, 1)), information, np.zeros(n - 1, np.bool_), tilts)  # fmt: skip
    assert abs(graph.places[-1, 2]) > 3.0
    solved = solve_spatial(graph)
    assert solved.converged
    assert abs(solved.places[-1, 2]) < 0.01


def test_the_covariance_between_two_poses_of_a_chain_adds_up() -> None:
    """Along a straight chain of independent errors positions walk and angles lever: what sampling gives."""
    n, rng = 6, np.random.default_rng(7)
    sigma = np.array([0.02, 0.01, 0.03, 0.002, 0.004, 0.003])
    a, b = np.arange(n - 1), np.arange(1, n)
    places = np.stack([[3.0 * k, 0.0, 0.0] for k in range(n)])
    eye = np.tile(np.eye(3), (n, 1, 1))
    information = np.tile(np.diag(sigma**-2), (n - 1, 1, 1))
    graph = SpatialGraph(places, eye, a, b, np.tile([3.0, 0.0, 0.0], (n - 1, 1)), eye[1:], information, np.zeros(n - 1, np.bool_))  # fmt: skip
    told = SpatialMarginals(graph).relative(1, 5)
    ends = []
    for _ in range(20000):
        r, t = np.eye(3), np.zeros(3)
        noise = sigma * rng.standard_normal((4, 6))
        turns = exp_all(noise[:, 3:])
        for k in range(4):
            t = t + r @ (np.array([3.0, 0.0, 0.0]) + noise[k, :3])
            r = r @ turns[k]
        ends.append(np.concatenate([r.T @ (t - [12.0, 0.0, 0.0]), log_all(r[None])[0]]))
    sampled = np.cov(np.array(ends).T)
    assert np.abs(told - sampled).max() < 0.05 * np.abs(sampled).max()
    assert np.diag(told) == pytest.approx(np.diag(sampled), rel=0.05)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"edge_to": np.full(64, 99)}, "does not exist"),
        ({"places": np.zeros((39, 3))}, "shapes"),
        ({"edge_places": np.full((64, 3), np.nan)}, "not finite"),
    ],
)
def test_malformed_graphs_are_refused(change: dict[str, F], text: str) -> None:
    graph, _, _ = drawn(8)
    with pytest.raises(BadInputError, match=text):
        solve_spatial(replace(graph, **change))


def test_a_pose_apart_is_refused() -> None:
    graph, _, _ = drawn(9, n=10, loops=0)
    keep = np.arange(9) != 4
    names = ("edge_from", "edge_to", "edge_places", "edge_rotations", "information", "is_robust")
    with pytest.raises(BadInputError, match="not connected"):
        solve_spatial(replace(graph, **{name: getattr(graph, name)[keep] for name in names}))


def test_its_optimum_is_that_of_gtsam() -> None:
    gtsam = pytest.importorskip("gtsam")
    graph, _, _ = drawn(10, noise=0.05)
    graph = replace(graph, is_robust=np.zeros_like(graph.is_robust))
    ours = solve_spatial(graph)
    assert ours.converged
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    swap = np.r_[3:6, 0:3]  # gtsam puts rotation first
    for k in range(len(graph.edge_from)):
        noise = gtsam.noiseModel.Gaussian.Information(graph.information[k][np.ix_(swap, swap)])
        relative = gtsam.Pose3(gtsam.Rot3(graph.edge_rotations[k]), graph.edge_places[k])
        factors.add(gtsam.BetweenFactorPose3(int(graph.edge_from[k]), int(graph.edge_to[k]), relative, noise))
    factors.add(gtsam.NonlinearEqualityPose3(0, gtsam.Pose3(gtsam.Rot3(graph.rotations[0]), graph.places[0])))
    for k in range(len(graph.places)):
        values.insert(k, gtsam.Pose3(gtsam.Rot3(graph.rotations[k]), graph.places[k]))
    theirs = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    places = np.array([theirs.atPose3(k).translation() for k in range(len(graph.places))])
    # gtsam's residual of translation is Log's, ours is not: equal to first order in the noise.
    assert np.abs(ours.places - places).max() < 0.05
