"""The pose-graph solver: derivatives, recorded optima, a dense twin, robustness against wrong loop closures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.kernels import pose_graph as kernels
from ambler.posegraph.solver import InitialGuess, PoseGraph, RobustKernel, SolverConfig, solve
from ambler.posegraph.structure import NormalEquations, Structure
from ambler.wire.g2o import read_g2o
from tests.public_data import public


def ring(rng: np.random.Generator, n: int = 40, loops: int = 12, noise: float = 0.02) -> tuple[PoseGraph, np.ndarray]:
    """Return a ring of n poses with odometry and chords (flagged), and the true poses."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    truth = np.column_stack((5.0 * np.cos(angle), 5.0 * np.sin(angle), angle + np.pi / 2))
    a = np.concatenate((np.arange(n - 1), rng.integers(0, n // 2, loops)))
    b = np.concatenate((np.arange(1, n), rng.integers(n // 2, n, loops)))
    z = np.empty((len(a), 3))
    for k, (i, j) in enumerate(zip(a, b, strict=True)):
        exact = SE2.from_array(truth[i]).inverse() @ SE2.from_array(truth[j])
        z[k] = (exact @ SE2.exp(rng.normal(0.0, noise, 3))).as_array()
    poses = [SE2.from_array(truth[0])]
    for k in range(n - 1):
        poses.append(poses[-1] @ SE2.from_array(z[k]))
    information = np.repeat(np.diag([1.0, 1.0, 1.0])[None] / noise**2, len(a), axis=0)
    guess = np.array([p.as_array() for p in poses])
    return PoseGraph(guess, a, b, z, information, np.arange(len(a)) >= n - 1), truth


def dense_chi2(graph: PoseGraph, poses: np.ndarray) -> float:
    """Return the sum of e^T Omega e with the group operations of core (the slow twin)."""
    total = 0.0
    for i, j, z, omega in zip(graph.edge_from, graph.edge_to, graph.measurements, graph.information, strict=True):
        i_from_j = SE2.from_array(poses[i]).inverse() @ SE2.from_array(poses[j])
        e = (SE2.from_array(z).inverse() @ i_from_j).as_array()
        total += e @ omega @ e
    return float(total)


@pytest.mark.parametrize(("name", "optimum"), [("intel", 45.0047), ("manhattan3500", 146.0766)])
@pytest.mark.parametrize("guess", list(InitialGuess))
def test_recorded_graphs_reach_their_known_optimum(name: str, optimum: float, guess: InitialGuess) -> None:
    file = read_g2o(public(f"posegraph/{name}.g2o"))
    flags = np.zeros(len(file.edge_from), np.bool_)
    graph = PoseGraph(file.poses, file.edge_from, file.edge_to, file.measurements, file.information, flags)
    result = solve(graph, config=SolverConfig(initial_guess=guess))
    assert result.converged
    assert result.chi2 == pytest.approx(optimum, rel=1e-5)
    assert result.chi2 == pytest.approx(dense_chi2(graph, result.poses), rel=1e-9)
    np.testing.assert_allclose(result.poses[0], file.poses[0], atol=1e-12)


def test_gtsam_finds_the_same_poses() -> None:
    gtsam = pytest.importorskip("gtsam")
    graph, _ = ring(np.random.default_rng(3))
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.poses):
        values.insert(k, gtsam.Pose2(*pose))
    for i, j, z, omega in zip(graph.edge_from, graph.edge_to, graph.measurements, graph.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(omega)
        factors.add(gtsam.BetweenFactorPose2(int(i), int(j), gtsam.Pose2(*z), noise))
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.poses[0]), gtsam.noiseModel.Constrained.All(3)))
    theirs = gtsam.GaussNewtonOptimizer(factors, values).optimize()
    ours = solve(graph, config=SolverConfig(robust_kernel=RobustKernel.NONE))
    for k in range(len(graph.poses)):
        pose = theirs.atPose2(k)
        np.testing.assert_allclose(ours.poses[k, :2], [pose.x(), pose.y()], atol=2e-4)


@pytest.mark.parametrize("kernel", list(RobustKernel))
def test_gradient_and_normal_matrix_match_differences(kernel: RobustKernel) -> None:
    rng = np.random.default_rng(1)
    graph, truth = ring(rng, n=7, loops=4)
    a = rng.normal(size=(len(graph.edge_from), 3, 3))
    graph = PoseGraph(
        truth + rng.normal(0.0, 0.3, truth.shape),
        *(graph.edge_from, graph.edge_to, graph.measurements, a @ a.transpose(0, 2, 1) + np.eye(3)),
        is_robust=np.ones(len(a), np.bool_),
    )
    s = Structure.of(7, graph.edge_from, graph.edge_to, 2)
    equations = NormalEquations(s)

    def cost(poses: np.ndarray) -> float:
        return float(
            kernels.linearize(
                *(poses, graph.edge_from, graph.edge_to, graph.measurements, graph.information, graph.is_robust),
                *(int(kernel), 0.7, False, s.position, s.slot, equations.diagonal, equations.lower, equations.gradient),
            )
        )

    def gradient(poses: np.ndarray) -> np.ndarray:
        cost(poses)
        out = np.zeros((7, 3))
        out[s.position >= 0] = equations.gradient[s.position[s.position >= 0]]
        return out

    numeric = np.zeros((7, 3))
    for i in range(7):
        for c in range(3):
            d = np.zeros((7, 3))
            d[i, c] = 1e-6
            numeric[i, c] = (cost(graph.poses + d) - cost(graph.poses - d)) / 4e-6  # the gradient is of cost / 2
    numeric[2] = 0.0
    np.testing.assert_allclose(gradient(graph.poses), numeric, atol=1e-4)


def test_a_step_solves_the_dense_normal_equations() -> None:
    graph, _ = ring(np.random.default_rng(2), n=30, loops=20)
    s = Structure.of(30, graph.edge_from, graph.edge_to, 0)
    equations = NormalEquations(s)
    kernels.linearize(
        *(graph.poses, graph.edge_from, graph.edge_to, graph.measurements, graph.information, graph.is_robust),
        *(0, 1.0, False, s.position, s.slot, equations.diagonal, equations.lower, equations.gradient),
    )
    n = 29
    dense = np.zeros((3 * n, 3 * n))
    for k in range(n):
        dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = equations.diagonal[k].reshape(3, 3)
        for p in range(s.row_start[k], s.row_start[k + 1]):
            block, c = equations.lower[p].reshape(3, 3), s.columns[p]
            dense[3 * k : 3 * k + 3, 3 * c : 3 * c + 3] = block
            dense[3 * c : 3 * c + 3, 3 * k : 3 * k + 3] = block.T
    for damping in (0.0, 0.3):
        damped = dense + damping * np.diag(np.diag(dense))
        expected = np.linalg.solve(damped, -equations.gradient.reshape(-1)).reshape(n, 3)
        step = equations.step(damping)
        assert step is not None
        np.testing.assert_allclose(step[1:][np.argsort(s.position[1:])], expected, rtol=1e-7, atol=1e-9)
    equations.diagonal[:] *= -1.0
    assert equations.step(0.0) is None


@given(seed=st.integers(0, 10_000), dx=st.floats(-50, 50), dyaw=st.floats(-3, 3))
@settings(max_examples=25, deadline=None)
def test_moving_the_whole_graph_moves_the_result(seed: int, dx: float, dyaw: float) -> None:
    graph, _ = ring(np.random.default_rng(seed))
    shift = SE2(dx, -0.5 * dx, dyaw)
    moved = np.array([(shift @ SE2.from_array(p)).as_array() for p in graph.poses])
    a = solve(graph)
    b = solve(PoseGraph(moved, graph.edge_from, graph.edge_to, graph.measurements, graph.information, graph.is_robust))
    assert b.cost == pytest.approx(a.cost, rel=1e-4)
    np.testing.assert_allclose(b.poses[:, :2], shift.transform(a.poses[:, :2]), atol=2e-3)


def test_exact_measurements_are_met_exactly_from_a_far_guess() -> None:
    rng = np.random.default_rng(5)
    graph, truth = ring(rng, noise=1e-3)
    z = [
        (SE2.from_array(truth[i]).inverse() @ SE2.from_array(truth[j])).as_array()
        for i, j in zip(graph.edge_from, graph.edge_to, strict=True)
    ]
    far = truth + rng.normal(0.0, 3.0, truth.shape)
    far[0] = truth[0]
    wild = PoseGraph(far, graph.edge_from, graph.edge_to, np.array(z), graph.information, graph.is_robust)
    result = solve(wild, config=SolverConfig(initial_guess=InitialGuess.CHORDAL))
    assert result.chi2 < 1e-12
    np.testing.assert_allclose(result.poses[:, :2], truth[:, :2], atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_poses_that_lead_astray_are_given_up_for_the_relaxation(seed: int) -> None:
    """From far off the given poses do not get there in as many iterations as the default needs with the relaxation."""
    rng = np.random.default_rng(seed)
    graph, truth = ring(rng, noise=5e-3)
    far = truth + rng.normal(0.0, 3.0, truth.shape)
    far[0] = truth[0]
    wild = PoseGraph(far, graph.edge_from, graph.edge_to, graph.measurements, graph.information, graph.is_robust)
    best, result = solve(graph), solve(wild)
    config = SolverConfig(initial_guess=InitialGuess.GIVEN, max_iterations=result.iterations)
    assert not solve(wild, config=config).converged
    assert result.converged
    assert result.cost == pytest.approx(best.cost, rel=1e-4)


@pytest.mark.parametrize("kernel", [RobustKernel.HUBER, RobustKernel.DCS, RobustKernel.GEMAN_MCCLURE])
def test_wrong_loop_closures_are_outvoted(kernel: RobustKernel) -> None:
    rng = np.random.default_rng(8)
    graph, truth = ring(rng, n=60, loops=30)
    z = graph.measurements.copy()
    z[-6:] += rng.uniform(2.0, 4.0, (6, 3))
    bad = PoseGraph(graph.poses, graph.edge_from, graph.edge_to, z, graph.information, graph.is_robust)

    def error(which: RobustKernel) -> float:
        poses = solve(bad, config=SolverConfig(robust_kernel=which, robust_width=2.0)).poses
        return float(np.hypot(*(poses - truth)[:, :2].T).max())

    assert error(RobustKernel.NONE) > 0.5
    assert error(kernel) < (0.2 if kernel is RobustKernel.HUBER else 0.15)
    if kernel is not RobustKernel.HUBER:
        result = solve(bad, config=SolverConfig(robust_kernel=kernel, robust_width=2.0))
        assert set(np.argsort(result.edge_chi2)[-6:]) == set(range(len(z) - 6, len(z)))


@pytest.mark.parametrize("kernel", [RobustKernel.DCS, RobustKernel.GEMAN_MCCLURE])
def test_wrong_loop_closures_do_not_bend_the_first_guess(kernel: RobustKernel) -> None:
    """From poses that are lost, half of the loop closures wrong: the guess must come from the chain, else the robust kernel would hold
    on to whichever closures the guess happens to fit."""
    rng = np.random.default_rng(8)
    graph, truth = ring(rng, n=60, loops=30)
    z = graph.measurements.copy()
    z[-15:] += rng.uniform(2.0, 4.0, (15, 3))
    lost = truth + rng.normal(0.0, 3.0, truth.shape)
    lost[0] = truth[0]
    bad = PoseGraph(lost, graph.edge_from, graph.edge_to, z, graph.information, graph.is_robust)
    config = SolverConfig(robust_kernel=kernel, robust_width=2.0, initial_guess=InitialGuess.CHORDAL)
    poses = solve(bad, config=config).poses
    assert float(np.hypot(*(poses - truth)[:, :2].T).max()) < 0.3


def test_same_input_gives_the_same_bits() -> None:
    graph, _ = ring(np.random.default_rng(4))
    assert np.array_equal(solve(graph).poses, solve(graph).poses)


def test_tiny_graphs() -> None:
    flags = np.zeros(1, np.bool_)
    one = np.array([[1.0, 2.0, 3.0]])
    pair = PoseGraph(np.zeros((2, 3)), np.array([0]), np.array([1]), one, np.eye(3)[None], flags)
    np.testing.assert_allclose(solve(pair).poses[1], [1.0, 2.0, 3.0], atol=1e-9)
    empty = PoseGraph(
        one, np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)), flags[:0]
    )
    assert solve(empty).chi2 == 0.0
    np.testing.assert_allclose(solve(empty).poses, one)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edge_to": np.array([7])}, "does not exist"),
        ({"edge_to": np.array([0])}, "with itself"),
        ({"poses": np.zeros((3, 3))}, "pose 2 is not connected"),
        ({"measurements": np.full((1, 3), np.nan)}, "not finite"),
        ({"information": np.zeros((2, 3, 3))}, "shapes"),
    ],
)
def test_malformed_graphs_are_refused(change: dict[str, np.ndarray], message: str) -> None:
    parts = {
        "poses": np.zeros((2, 3)),
        "edge_from": np.array([0]),
        "edge_to": np.array([1]),
        "measurements": np.zeros((1, 3)),
        "information": np.eye(3)[None],
        "is_robust": np.zeros(1, np.bool_),
    }
    with pytest.raises(BadInputError, match=message):
        solve(PoseGraph(**(parts | change)))
