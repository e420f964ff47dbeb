"""Solves pose graphs of the plane: Gauss-Newton on a fixed sparsity pattern, damped (Levenberg-Marquardt) only when the cost rises.

Cost = sum over edges of rho(e^T Omega e), without a factor 1/2; e is the edge's residual in the measured frame (kernels.pose_graph).
Robust kernels (Huber; dynamic covariance scaling; Geman-McClure) act on the edges that are flagged, usually loop closures.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.kernels import pose_graph as kernels
from ambler.posegraph.structure import NormalEquations, Structure

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]


class RobustKernel(enum.IntEnum):
    """How the cost of a flagged edge grows with its error."""

    NONE = kernels.NO_KERNEL
    HUBER = kernels.HUBER
    DCS = kernels.DCS
    GEMAN_MCCLURE = kernels.GEMAN_MCCLURE


class InitialGuess(enum.Enum):
    """Where to start: the graph's own poses; the chordal relaxation (rotations, then translations, both linear); or the poses, and where
    these lead uphill or not to an end, the relaxation too, of which the better end counts."""

    AUTO = "auto"
    GIVEN = "given"
    CHORDAL = "chordal"


@dataclass(frozen=True, slots=True)
class SolverConfig:
    """`robust_width` is the whitened error (sigmas) at which the kernel begins; tolerances end the iterations."""

    robust_kernel: RobustKernel = RobustKernel.HUBER
    robust_width: float = 3.0
    initial_guess: InitialGuess = InitialGuess.AUTO
    max_iterations: int = 50
    cost_tolerance: float = 1e-6
    step_tolerance: float = 1e-6
    first_damping: float = 1e-4
    max_damping: float = 1e8


@dataclass(frozen=True)
class PoseGraph:
    """poses float64 (N, 3) of (x, y, yaw); edges int64 (E,) from and to; measurements float64 (E, 3) = from_from_to;
    information float64 (E, 3, 3), symmetric; is_robust bool (E,) marks the edges under the robust kernel."""

    poses: F64
    edge_from: I64
    edge_to: I64
    measurements: F64
    information: F64
    is_robust: NDArray[np.bool_]


@dataclass(frozen=True)
class SolveResult:
    """Optimised poses (N, 3), yaw in [-pi, pi); chi2 = sum of e^T Omega e over all edges, edge_chi2 (E,) its parts, cost = the
    same under the robust kernel; iterations count linear solves."""

    poses: F64
    chi2: float
    cost: float
    edge_chi2: F64
    iterations: int
    converged: bool


def solve(
    graph: PoseGraph, fixed: int = 0, config: SolverConfig | None = None, structure: Structure | None = None
) -> SolveResult:
    """Minimise the cost over all poses but `fixed`; raises BadInputError for a graph that is malformed or not connected. Whoever solves the same edges with
    other weights gives the `structure` that he had `structure_of` them."""
    config = config or SolverConfig()
    graph = checked(graph, fixed)
    equations = NormalEquations(structure or structure_of(graph, fixed))
    poses, cost, iterations, converged = _best_end(graph, fixed, config, equations)
    edge_chi2 = np.empty(len(graph.edge_from))
    kernels.edge_chi2(poses, graph.edge_from, graph.edge_to, graph.measurements, graph.information, edge_chi2)
    poses[:, 2] = (poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return SolveResult(poses, float(edge_chi2.sum()), cost, edge_chi2, iterations, converged)


def structure_of(graph: PoseGraph, fixed: int = 0) -> Structure:
    """Return the sparsity of a graph's equations; raises BadInputError for one that is not connected."""
    return Structure.of(len(graph.poses), graph.edge_from, graph.edge_to, fixed)


_End = tuple[F64, float, int, bool]  # poses, cost, iterations, whether they converged
TRIAL = 10
"""Iterations after which the given poses count as a bad start."""


def _best_end(graph: PoseGraph, fixed: int, config: SolverConfig, equations: NormalEquations) -> _End:
    """Minimise from where the configuration says."""
    if config.initial_guess is InitialGuess.GIVEN:
        return _minimise(graph, graph.poses, config, equations)
    if config.initial_guess is InitialGuess.CHORDAL:
        return _minimise(graph, _chordal_guess(graph, fixed, equations), config, equations)
    trial = _minimise(graph, graph.poses, config, equations, is_trial=True)
    if trial[3]:
        return trial
    relaxed = _minimise(graph, _chordal_guess(graph, fixed, equations), config, equations)
    if relaxed[1] > trial[1] or not np.isfinite(relaxed[1]):
        relaxed = _minimise(graph, trial[0], config, equations)
    return relaxed[0], relaxed[1], trial[2] + relaxed[2], relaxed[3]


def _minimise(
    graph: PoseGraph, poses: F64, config: SolverConfig, equations: NormalEquations, *, is_trial: bool = False
) -> _End:
    """Iterate; a trial gives up at the first step uphill, and after a few steps."""
    damping = 0.0
    cost = linearize(graph, poses, config, equations)
    last = min(TRIAL, config.max_iterations) if is_trial else config.max_iterations
    for iteration in range(1, last + 1):
        step = equations.step(damping)
        if step is not None:
            moved = poses + step
            new_cost = linearize(graph, moved, config, equations)
            if new_cost <= cost:
                drop = cost - new_cost
                poses, cost = moved, new_cost
                damping = 0.0 if damping <= config.first_damping else damping * 0.1
                if (
                    drop <= config.cost_tolerance * cost + 1e-12
                    or np.abs(step).max(initial=0.0) < config.step_tolerance
                ):
                    return poses, cost, iteration, True
                continue
            linearize(graph, poses, config, equations)
            if new_cost - cost <= config.cost_tolerance * cost:
                return poses, cost, iteration, True
        damping = max(config.first_damping, damping * 10.0)
        if is_trial or damping > config.max_damping:
            return poses, cost, iteration, False
    return poses, cost, last, False


def linearize(
    graph: PoseGraph,
    poses: F64,
    config: SolverConfig,
    equations: NormalEquations,
    *,
    is_translation_only: bool = False,
) -> float:
    """Fill the normal equations at `poses` (N, 3) and return the robust cost."""
    s = equations.structure
    return float(
        kernels.linearize(
            *(poses, graph.edge_from, graph.edge_to, graph.measurements, graph.information, graph.is_robust),
            *(int(config.robust_kernel), config.robust_width, is_translation_only, s.position, s.slot),
            *(equations.diagonal, equations.lower, equations.gradient),
        )
    )


def _chordal_guess(graph: PoseGraph, fixed: int, equations: NormalEquations) -> F64:
    """Return poses from the linear relaxation of the rotations (Martinec and Pajdla, 2007; Carlone et al., 2015), then of the
    translations. Flagged edges count a thousandth, so that wrong loop closures cannot bend the guess."""
    s = equations.structure
    trust = np.where(graph.is_robust, 1e-3, 1.0)
    directions = np.zeros((len(graph.poses), 2))
    directions[fixed] = np.cos(graph.poses[fixed, 2]), np.sin(graph.poses[fixed, 2])
    yaws = np.ascontiguousarray(graph.measurements[:, 2])
    weights = trust * graph.information[:, 2, 2]
    kernels.linearize_chordal(
        *(directions, graph.edge_from, graph.edge_to, yaws, weights, s.position, s.slot),
        *(equations.diagonal, equations.lower, equations.gradient),
    )
    step = equations.step(0.0)
    if step is None:
        return graph.poses
    directions += step[:, :2]
    poses = np.zeros_like(graph.poses)
    poses[:, 2] = np.arctan2(directions[:, 1], directions[:, 0])
    poses[fixed] = graph.poses[fixed]
    plain = PoseGraph(
        *(poses, graph.edge_from, graph.edge_to, graph.measurements, graph.information * trust[:, None, None]),
        is_robust=np.zeros(len(trust), np.bool_),
    )
    linearize(plain, poses, SolverConfig(), equations, is_translation_only=True)
    step = equations.step(0.0)
    return graph.poses if step is None else poses + step


def checked(graph: PoseGraph, fixed: int) -> PoseGraph:
    """Return a copy whose arrays the kernels take; raises BadInputError for a malformed graph."""
    n, e = len(graph.poses), len(graph.edge_from)
    shapes = (graph.poses.shape, graph.measurements.shape, graph.information.shape, graph.is_robust.shape)
    if shapes != ((n, 3), (e, 3), (e, 3, 3), (e,)) or graph.edge_to.shape != (e,):
        raise BadInputError(f"pose graph: array shapes do not fit: {shapes}")
    if not 0 <= fixed < n:
        raise BadInputError(f"pose graph: fixed pose {fixed} is none of the {n} poses")
    ends = np.concatenate((graph.edge_from, graph.edge_to))
    if e and (ends.min() < 0 or ends.max() >= n):
        raise BadInputError("pose graph: an edge names a pose that does not exist")
    if np.any(graph.edge_from == graph.edge_to):
        raise BadInputError(
            f"pose graph: edge {int(np.argmax(graph.edge_from == graph.edge_to))} joins a pose with itself"
        )
    for name in ("poses", "measurements", "information"):
        if not np.isfinite(getattr(graph, name)).all():
            raise BadInputError(f"pose graph: {name} are not finite")
    return PoseGraph(  # with writeable arrays: read-only ones are another type to the compiler
        np.array(graph.poses, np.float64, order="C"),
        np.require(graph.edge_from, np.int64, ["C", "W"]),
        np.require(graph.edge_to, np.int64, ["C", "W"]),
        np.require(graph.measurements, np.float64, ["C", "W"]),
        np.require(graph.information, np.float64, ["C", "W"]),
        np.require(graph.is_robust, np.bool_, ["C", "W"]),
    )
