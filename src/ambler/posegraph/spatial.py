"""Solves pose graphs of space: Gauss-Newton on SE(3), damped (Levenberg-Marquardt) only when the cost rises, on SciPy's sparse LU.

Cost = sum over edges of rho(e^T Omega e) + sum over tilts |R^T up - measured|^2 / sigma^2. e = (R_z^T (R_i^T (t_j - t_i) - t_z), Log(R_z^T R_i^T R_j)) lies in
the measured frame; poses are perturbed on the right, t + R rho and R Exp(phi). Robust kernels as in `solver`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csc_matrix, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from ambler.core.errors import BadInputError
from ambler.kernels.pose_graph import robust_cost_weight
from ambler.posegraph.so3 import exp_all, inverse_right_jacobians, log_all, skew_all
from ambler.posegraph.solver import SolverConfig

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tilts:
    """What is known of the attitude of some poses: `up` float64 (K, 3) is the unit vector against gravity in the frames of poses `of` int64 (K,), each of its
    components with the standard deviation `sigma` (K,) (rad); `up_graph` (3,) is the same vector in the graph's frame."""

    of: I64 = field(default_factory=lambda: np.zeros(0, np.int64))
    up: F64 = field(default_factory=lambda: np.zeros((0, 3)))
    sigma: F64 = field(default_factory=lambda: np.zeros(0))
    up_graph: F64 = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, eq=False)
class SpatialGraph:
    """`places` float64 (N, 3) and `rotations` (N, 3, 3) of the poses; edges int64 (E,) `edge_from` and `edge_to` with the measured relative `edge_places` (E, 3),
    `edge_rotations` (E, 3, 3) and `information` (E, 6, 6), translation first; a direction of no information is left free. `is_robust` bool (E,) marks the edges under the robust kernel."""

    places: F64
    rotations: F64
    edge_from: I64
    edge_to: I64
    edge_places: F64
    edge_rotations: F64
    information: F64
    is_robust: NDArray[np.bool_]
    tilts: Tilts = field(default_factory=Tilts)


@dataclass(frozen=True, eq=False)
class SpatialSolution:
    """Optimised `places` (N, 3) and `rotations` (N, 3, 3); `edge_chi2` (E,) = e^T Omega e of each edge, `cost` of all under the robust kernel, `weights` (E,) what that left of
    each edge (1: all). `iterations` counts linear solves."""

    places: F64
    rotations: F64
    edge_chi2: F64
    weights: F64
    cost: float
    iterations: int
    converged: bool


def solve_spatial(graph: SpatialGraph, fixed: int = 0, config: SolverConfig | None = None) -> SpatialSolution:
    """Minimise the cost over all poses but `fixed`; raises BadInputError for a graph that is malformed or not connected."""
    config = config or SolverConfig()
    _check(graph, fixed)
    roots = square_roots(graph.information)
    places, rotations = graph.places.copy(), graph.rotations.copy()
    state = _linearized(graph, roots, places, rotations, config)
    damping, converged, iterations = 0.0, False, 0
    while not converged and damping <= config.max_damping and iterations < config.max_iterations:
        iterations += 1
        step = _step(state, fixed, damping)
        moved = (places + np.einsum("nij,nj->ni", rotations, step[:, :3]), rotations @ exp_all(step[:, 3:]))
        tried = _linearized(graph, roots, *moved, config)
        if tried.cost <= state.cost:
            drop = state.cost - tried.cost
            (places, rotations), state = moved, tried
            damping = 0.0 if damping <= config.first_damping else 0.1 * damping
            is_still = np.abs(step).max(initial=0.0) < config.step_tolerance
            converged = bool(drop <= config.cost_tolerance * state.cost + 1e-12 or is_still)
        else:
            converged = tried.cost - state.cost <= config.cost_tolerance * state.cost
            damping = max(config.first_damping, 10.0 * damping)
    return SpatialSolution(places, rotations, state.edge_chi2, state.weights, state.cost, iterations, converged)


class SpatialMarginals:
    """What a graph knows about where one pose lies seen from another, at the poses that it has, which should be its optimum."""

    def __init__(self, graph: SpatialGraph, fixed: int = 0, weights: F64 | None = None) -> None:
        """`weights` (E,) multiply the information of the edges. Raises BadInputError for a malformed graph."""
        _check(graph, fixed)
        information = graph.information if weights is None else graph.information * weights[:, None, None]
        roots = square_roots(information)
        self._graph, self._n = graph, len(graph.places)
        self._is_free = np.arange(self._n) != fixed
        state = _linearized(graph, roots, graph.places, graph.rotations, SolverConfig(robust_width=np.inf))
        self._factor = _factor(state.normal, self._is_free, 0.0)

    def relative(self, a: int, b: int) -> F64:
        """Return the covariance (6, 6) of pose b in the frame of pose a, perturbed on the right of a_from_b."""
        g = self._graph
        turn = g.rotations[b].T @ g.rotations[a]
        arm = g.rotations[a].T @ (g.places[b] - g.places[a])
        jacobian = np.zeros((6, 6 * self._n))
        # of pose a: moved by (rho, phi) it sees b moved by -(rho + phi x arm), in b's axes
        jacobian[:3, 6 * a : 6 * a + 3], jacobian[:3, 6 * a + 3 : 6 * a + 6] = -turn, turn @ skew_all(arm[None])[0]
        jacobian[3:, 6 * a + 3 : 6 * a + 6] = -turn
        jacobian[:, 6 * b : 6 * b + 6] = np.eye(6)
        rows = np.ascontiguousarray(jacobian[:, np.repeat(self._is_free, 6)])
        covariance = rows @ self._factor.solve(np.ascontiguousarray(rows.T))
        return np.asarray(0.5 * (covariance + covariance.T))


def square_roots(information: F64) -> F64:
    """Return symmetric matrices (E, 6, 6) whose squares are these, which may be singular."""
    values, vectors = np.linalg.eigh(information)
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.asarray(scaled @ vectors.transpose(0, 2, 1))


def residuals(graph: SpatialGraph, places: F64, rotations: F64) -> tuple[F64, F64, F64]:
    """Return the residuals (E, 6) of all edges and their Jacobians (E, 6, 6) to the poses that they come from and lead to."""
    a, b = graph.edge_from, graph.edge_to
    back = graph.edge_rotations.transpose(0, 2, 1)
    there = rotations[a].transpose(0, 2, 1)
    arm = np.einsum("eij,ej->ei", there, places[b] - places[a])
    turned = back @ there @ rotations[b]
    angle = log_all(turned)
    out = np.concatenate([np.einsum("eij,ej->ei", back, arm - graph.edge_places), angle], axis=1)
    from_a, from_b = np.zeros((len(a), 6, 6)), np.zeros((len(a), 6, 6))
    curve = inverse_right_jacobians(angle)
    from_a[:, :3, :3], from_a[:, :3, 3:] = -back, back @ skew_all(arm)
    from_a[:, 3:, 3:] = -curve @ rotations[b].transpose(0, 2, 1) @ rotations[a]
    from_b[:, :3, :3], from_b[:, 3:, 3:] = turned, curve
    return out, from_a, from_b


@dataclass(frozen=True, eq=False)
class _State:
    cost: float
    edge_chi2: F64
    weights: F64
    normal: csc_array
    gradient: F64


def _linearized(graph: SpatialGraph, roots: F64, places: F64, rotations: F64, config: SolverConfig) -> _State:
    """Return the normal equations (6N, 6N) at these poses, all of them free, and the cost there."""
    e, from_a, from_b = residuals(graph, places, rotations)
    white = np.einsum("eij,ej->ei", roots, e)
    chi2 = np.einsum("ei,ei->e", white, white)
    rho, weights = chi2.copy(), np.ones(len(chi2))
    for k in np.flatnonzero(graph.is_robust):
        rho[k], weights[k] = robust_cost_weight(chi2[k], int(config.robust_kernel), config.robust_width)
    scale = np.sqrt(weights)
    white *= scale[:, None]
    ja, jb = (roots @ j * scale[:, None, None] for j in (from_a, from_b))
    t = graph.tilts
    seen = np.einsum("kji,j->ki", rotations[t.of], t.up_graph)
    off, leans = (seen - t.up) / t.sigma[:, None], skew_all(seen) / t.sigma[:, None, None]
    edges, n = len(e), len(places)
    rows, columns = [], []
    for poses in (graph.edge_from, graph.edge_to):
        rows.append(np.broadcast_to(np.arange(6 * edges).reshape(-1, 6, 1), (edges, 6, 6)))
        columns.append(np.broadcast_to(6 * poses[:, None, None] + np.arange(6)[None, None, :], (edges, 6, 6)))
    rows.append(np.broadcast_to(6 * edges + np.arange(3 * len(t.of)).reshape(-1, 3, 1), (len(t.of), 3, 3)))
    columns.append(np.broadcast_to(6 * t.of[:, None, None] + 3 + np.arange(3)[None, None, :], (len(t.of), 3, 3)))
    values = np.concatenate([ja.ravel(), jb.ravel(), leans.ravel()])
    places_of = (np.concatenate([r.ravel() for r in rows]), np.concatenate([c.ravel() for c in columns]))
    jacobian = csc_array(coo_array((values, places_of), shape=(6 * edges + 3 * len(t.of), 6 * n)))
    all_residuals = np.concatenate([white.ravel(), off.ravel()])
    cost = float(rho.sum() + (off * off).sum())
    return _State(cost, chi2, weights, csc_array(jacobian.T @ jacobian), np.asarray(jacobian.T @ all_residuals))


def _factor(normal: csc_array, is_free: NDArray[np.bool_], damping: float) -> SuperLU:
    keep = np.flatnonzero(np.repeat(is_free, 6))
    part = csc_array(normal[keep][:, keep])
    diagonal = part.diagonal()
    # A direction that nothing determines gets next to no stiffness instead of a singular matrix.
    raised = part + diags_array(damping * diagonal + 1e-9 * (1.0 + diagonal))
    return splu(csc_matrix(raised), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _step(state: _State, fixed: int, damping: float) -> F64:
    """Return the increment (N, 6) that minimises the quadratic model."""
    n = len(state.gradient) // 6
    is_free = np.arange(n) != fixed
    out = np.zeros((n, 6))
    if n > 1:
        gradient = state.gradient.reshape(-1, 6)[is_free].ravel()
        out[is_free] = -_factor(state.normal, is_free, damping).solve(gradient).reshape(-1, 6)
    return out


def _check(graph: SpatialGraph, fixed: int) -> None:
    n, e = len(graph.places), len(graph.edge_from)
    wanted = ((n, 3), (n, 3, 3), (e,), (e, 3), (e, 3, 3), (e, 6, 6), (e,))
    arrays = (graph.places, graph.rotations, graph.edge_to, graph.edge_places, graph.edge_rotations, graph.information, graph.is_robust)  # fmt: skip
    if tuple(a.shape for a in arrays) != wanted:
        raise BadInputError(f"pose graph: array shapes do not fit: {tuple(a.shape for a in arrays)}")
    if not 0 <= fixed < n:
        raise BadInputError(f"pose graph: fixed pose {fixed} is none of the {n} poses")
    ends = np.concatenate((graph.edge_from, graph.edge_to))
    if e and (ends.min() < 0 or ends.max() >= n):
        raise BadInputError("pose graph: an edge names a pose that does not exist")
    if np.any(graph.edge_from == graph.edge_to):
        raise BadInputError("pose graph: an edge joins a pose with itself")
    if not all(np.isfinite(a).all() for a in arrays):
        raise BadInputError("pose graph: poses, measurements or information are not finite")
    joined = coo_array((np.ones(e), (graph.edge_from, graph.edge_to)), shape=(n, n))
    count, label = connected_components(joined, directed=False)
    if count > 1:
        lost = int(np.flatnonzero(label != label[fixed])[0])
        raise BadInputError(f"pose graph: pose {lost} is not connected with the fixed pose {fixed}")
