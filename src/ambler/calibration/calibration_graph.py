"""All unknowns of a calibration in one least-squares problem, solved by sparse Gauss-Newton.

Unknown: the base's path (knots), each scanner's mounting X and clock offset o, and the odometry's systematic error (a matrix
M near the identity: true twist = M times measured twist). Measured: the odometry between knots, and the relative poses z of
pairs of scans, S_a^-1 S_b with S = T(stamp - o) X. Perturbations are on the right; T between knots follows the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from ambler.calibration import planar_arrays as se2

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


TIE_SIGMA = 2e-4


@dataclass(frozen=True, slots=True)
class OdometryModel:
    """How far the odometry is trusted: true twist = (M + slip) · measured twist + noise.

    `matrix_sigma` (3, 3): prior deviations of M from the identity. `ties`: (entry, other, factor) of M's nine entries row by row: the
    first deviates by `factor` times what the other does, because unequal wheels cause both. Slip is the sum of `slip_modes` (J, 3, 3), each times its own
    slowly changing value of deviation `slip_sigma` (J,) and correlation time `slip_time` s. The noise of a step: shares of the
    way (`along`, `aside`) and of the turn (`turn`), and floors in metres and radians.
    """

    matrix_sigma: F64
    slip_modes: F64
    slip_sigma: F64
    ties: tuple[tuple[int, int, float], ...] = ()
    slip_time: float = 2.0
    along: float = 0.004
    aside: float = 0.004
    turn: float = 0.004
    floor: float = 3e-4
    turn_floor: float = 5e-4

    @classmethod
    def differential(cls, track: float | None = None, slip: float = 0.015) -> OdometryModel:
        """Two wheels on one axle through the base's origin; `track` (m) is their distance, if known; `slip` is each wheel's."""
        sigma = np.array([[0.03, 1e-6, 3e-3], [1e-4, 1e-6, 1e-4], [0.05, 1e-6, 0.03]])
        width = 0.5 if track is None else track
        both, apart = np.eye(3), np.zeros((3, 3))
        apart[0, 2], apart[2, 0] = 0.25 * width, 1.0 / width
        ties = () if track is None else ((2, 6, 0.25 * track * track),)
        return cls(sigma, np.array([both, apart]), slip * np.array([0.5**0.5, 2**0.5]), ties)

    @classmethod
    def omni(cls, slip: float = 0.015) -> OdometryModel:
        """A base that also moves sideways; each direction slips for itself."""
        sigma = np.array([[0.03, 5e-4, 1e-3], [5e-4, 0.04, 1e-3], [0.02, 0.02, 0.03]])
        modes = np.zeros((3, 3, 3))
        modes[np.arange(3), np.arange(3), np.arange(3)] = 1.0
        return cls(sigma, modes, np.array([slip, 2 * slip, slip]))

    @classmethod
    def mecanum(cls, reach: float, slip: float = 0.015) -> OdometryModel:
        """Four mecanum wheels; `reach` (m) is half the track plus half the wheel base.

        A wheel i that is larger by d_i adds d_i * turns_i * counted_i to the identity. The sums are symmetric up to reach²: x and y
        mix equally, which tells a skewed base from scanners that are all mounted askew; that needs driving along both.
        """
        counted = np.array([[1.0, -1.0, -reach], [1.0, 1.0, reach], [1.0, 1.0, -reach], [1.0, -1.0, reach]])
        turns = 0.25 * counted / np.array([1.0, 1.0, reach * reach])
        modes = turns[:, :, None] * counted[:, None, :]
        sigma = np.array([[0.03, 5e-3, 5e-3], [5e-3, 0.05, 5e-3], [0.02, 0.02, 0.03]])
        square = reach * reach
        return cls(sigma, modes, np.full(4, slip), ((1, 3, 1.0), (2, 6, square), (5, 7, square)))


@dataclass(frozen=True, slots=True)
class Pairs:
    """Relative poses of scans: nodes `target`, `source` (P,), `poses` (P, 3) target_from_source, `information` (P, 3, 3)."""

    target: I64
    source: I64
    poses: F64
    information: F64

    def subset(self, keep: NDArray[np.bool_]) -> Pairs:
        """Return the pairs marked True."""
        return Pairs(self.target[keep], self.source[keep], self.poses[keep], self.information[keep])


@dataclass(frozen=True, slots=True)
class Unknowns:
    """`path` (K, 3) of the base at the knots, `slip` (K - 1, J), `mounts` (N, 3), `offsets` (N,) s, `matrix` (3, 3)."""

    path: F64
    slip: F64
    mounts: F64
    offsets: F64
    matrix: F64


@dataclass(frozen=True, slots=True)
class Solution:
    """The solved unknowns, covariance (4N, 4N) of (x, y, yaw, offset) per scanner as the noise models tell it, and the
    weighted misfit of the pairs per degree of freedom."""

    unknowns: Unknowns
    covariance: F64
    misfit: float


class CalibrationGraph:
    """The problem for one set of scan nodes: `scanner` (M,) index and `stamps` (M,) s by the scanner's clock."""

    def __init__(self, odometry: se2.PlanarTrack, knots: F64, scanner: I64, stamps: F64, model: OdometryModel) -> None:
        self._odometry, self._knots, self._model = odometry, knots, model
        self._scanner, self._stamps = scanner, stamps
        at_knots = odometry.at(knots)
        self._steps = se2.log(se2.compose(se2.inverse(at_knots[:-1]), at_knots[1:]))
        self._knot_from_odom = se2.inverse(at_knots)
        self._step_weights = self._weights()

    def _weights(self) -> F64:
        model, steps = self._model, self._steps
        way, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
        sigma = np.stack(
            [
                np.hypot(model.floor, model.along * way),
                np.hypot(model.floor, model.aside * way),
                np.hypot(model.turn_floor, model.turn * turn),
            ],
            axis=1,
        )
        return np.asarray(1.0 / sigma)

    def start(self, mounts: F64, offsets: F64) -> Unknowns:
        """Return a first guess whose path is the odometry."""
        path = self._odometry.at(self._knots)
        slip = np.zeros((len(self._steps), len(self._model.slip_sigma)))
        return Unknowns(se2.compose(se2.inverse(path[:1]), path), slip, mounts, offsets, np.eye(3))

    def _matrices(self, unknowns: Unknowns) -> F64:
        """Return M + slip of every step between knots, (K - 1, 3, 3)."""
        return np.asarray(unknowns.matrix + np.einsum("kj,jab->kab", unknowns.slip, self._model.slip_modes))

    def _columns(self, unknowns: Unknowns) -> tuple[int, int, int, int, int]:
        """Return the first columns of slip, mounts, offsets, matrix, and how many there are (the path begins at 0)."""
        slip = 3 * len(self._knots)
        mounts = slip + unknowns.slip.size
        offsets = mounts + 3 * len(unknowns.mounts)
        matrix = offsets + len(unknowns.offsets)
        return slip, mounts, offsets, matrix, matrix + 9

    def node_poses(self, unknowns: Unknowns) -> F64:
        """Return the poses (M, 3) of the scanners at their nodes."""
        return se2.compose(self._base_poses(unknowns)[0], unknowns.mounts[self._scanner])

    def sensor_twists(self, unknowns: Unknowns) -> F64:
        """Return the twists (M, 3) of the scanners at their nodes, in their own frames."""
        twists = self._twists(unknowns)
        return np.asarray(np.einsum("nij,nj->ni", se2.adjoint(se2.inverse(unknowns.mounts))[self._scanner], twists))

    def _twists(self, unknowns: Unknowns) -> F64:
        times = self._stamps - unknowns.offsets[self._scanner]
        k = self._step_of(times)
        return np.asarray(np.einsum("nij,nj->ni", self._matrices(unknowns)[k], self._odometry.twist_at(times)))

    def _step_of(self, times: F64) -> I64:
        return np.clip(np.searchsorted(self._knots, times, side="right") - 1, 0, len(self._knots) - 2)

    def _base_poses(self, unknowns: Unknowns) -> tuple[F64, I64, F64, F64]:
        """Return the base at every node (M, 3), the knot before each (M,), the way from there (M, 3), and the same as the
        odometry measured it, as a twist (M, 3)."""
        times = self._stamps - unknowns.offsets[self._scanner]
        k = self._step_of(times)
        measured = se2.log(se2.compose(self._knot_from_odom[k], self._odometry.at(times)))
        way = se2.exp(np.einsum("nij,nj->ni", self._matrices(unknowns)[k], measured))
        return se2.compose(unknowns.path[k], way), k, way, measured

    def solve(self, guess: Unknowns, pairs: Pairs, iterations: int = 8, robust: float = 3.0) -> Solution:
        """Minimise; pairs beyond `robust` standard deviations lose weight (Cauchy)."""
        unknowns = guess
        hessian = sparse.csc_matrix((0, 0))
        for _ in range(iterations):
            hessian, gradient, _ = self._normal_equations(unknowns, pairs, robust)
            step = _factorize(hessian).solve(-gradient)
            unknowns = self._moved(unknowns, step)
            if np.abs(step).max() < 1e-7:
                break
        hessian, _, misfit = self._normal_equations(unknowns, pairs, robust)
        return Solution(unknowns, self._covariance(hessian, unknowns), misfit)

    def _moved(self, unknowns: Unknowns, step: F64) -> Unknowns:
        slip, mounts, offsets, matrix, _ = self._columns(unknowns)
        return Unknowns(
            se2.compose(unknowns.path, se2.exp(step[:slip].reshape(-1, 3))),
            unknowns.slip + step[slip:mounts].reshape(unknowns.slip.shape),
            se2.compose(unknowns.mounts, se2.exp(step[mounts:offsets].reshape(-1, 3))),
            unknowns.offsets + step[offsets:matrix],
            unknowns.matrix + step[matrix:].reshape(3, 3),
        )

    def _covariance(self, hessian: sparse.csc_matrix, unknowns: Unknowns) -> F64:
        """Covariance of mounts and offsets, ordered (x, y, yaw, offset) per scanner, translations in the scanner's frame."""
        _, mounts, offsets, matrix, size = self._columns(unknowns)
        wanted = matrix - mounts
        columns = np.zeros((size, wanted))
        columns[mounts + np.arange(wanted), np.arange(wanted)] = 1.0
        block = _factorize(hessian).solve(columns)[mounts:matrix]
        count = matrix - offsets
        order = np.array([[3 * s, 3 * s + 1, 3 * s + 2, 3 * count + s] for s in range(count)]).reshape(-1)
        return np.asarray(block[np.ix_(order, order)])

    def _normal_equations(
        self, unknowns: Unknowns, pairs: Pairs, robust: float
    ) -> tuple[sparse.csc_matrix, F64, float]:
        blocks = _Blocks(self._columns(unknowns)[-1])
        misfit = self._add_pairs(blocks, unknowns, pairs, robust)
        self._add_odometry(blocks, unknowns)
        self._add_priors(blocks, unknowns)
        jacobian, residual = blocks.assemble()
        hessian = (jacobian.T @ jacobian).tocsc()
        return hessian, np.asarray(jacobian.T @ residual), misfit

    def _add_pairs(self, blocks: _Blocks, unknowns: Unknowns, pairs: Pairs, robust: float) -> float:
        base, knot, way, measured = self._base_poses(unknowns)
        mounts = unknowns.mounts[self._scanner]
        poses = se2.compose(base, mounts)
        relative = se2.compose(se2.inverse(poses[pairs.target]), poses[pairs.source])
        residual = se2.log(se2.compose(se2.inverse(pairs.poses), relative))
        root = np.linalg.cholesky(pairs.information).transpose(0, 2, 1)
        white = np.einsum("pij,pj->pi", root, residual)
        chi2 = np.einsum("pi,pi->p", white, white)
        weight = 1.0 / (1.0 + chi2 / (3.0 * robust**2))
        root = root * np.sqrt(weight)[:, None, None]
        knot_from_sensor = se2.compose(way, mounts)
        by_knot = se2.adjoint(se2.inverse(knot_from_sensor))
        by_base = se2.adjoint(se2.inverse(mounts))
        by_time = -(by_base @ self._twists(unknowns)[:, :, None])
        by_matrix = np.einsum("nia,nj->niaj", by_base, measured).reshape(-1, 3, 9)
        by_slip = by_base @ np.einsum("jab,nb->naj", self._model.slip_modes, measured)
        back = -se2.adjoint(se2.inverse(relative))
        rows = blocks.rows(3 * len(residual)).reshape(-1, 3)
        first_slip, first_mount, first_offset, first_matrix, _ = self._columns(unknowns)
        for nodes, factor in ((pairs.target, root @ back), (pairs.source, root)):
            s = self._scanner[nodes]
            blocks.add(rows, 3 * knot[nodes], factor @ by_knot[nodes])
            blocks.add(rows, first_mount + 3 * s, factor)
            blocks.add(rows, first_offset + s, factor @ by_time[nodes])
            blocks.add(rows, np.full(len(nodes), first_matrix), factor @ by_matrix[nodes])
            blocks.add(rows, first_slip + by_slip.shape[2] * knot[nodes], factor @ by_slip[nodes])
        blocks.residual.append(np.einsum("pij,pj->pi", root, residual).reshape(-1))
        return float(np.sum(weight * chi2) / max(3.0 * np.sum(weight), 1.0))

    def _add_odometry(self, blocks: _Blocks, unknowns: Unknowns) -> None:
        path, steps, weights = unknowns.path, self._steps, self._step_weights
        moved = se2.compose(se2.inverse(path[:-1]), path[1:])
        believed = np.einsum("kij,kj->ki", self._matrices(unknowns), steps)
        residual = se2.log(se2.compose(se2.inverse(se2.exp(believed)), moved))
        rows = blocks.rows(3 * len(steps)).reshape(-1, 3)
        k = np.arange(len(steps))
        scale = weights[:, :, None]
        blocks.add(rows, 3 * (k + 1), scale * np.eye(3))
        blocks.add(rows, 3 * k, -scale * se2.adjoint(se2.inverse(moved)))
        first_slip, _, _, first_matrix, _ = self._columns(unknowns)
        for axis in range(3):
            block = np.zeros((len(steps), 3, 3))
            block[:, axis, :] = -weights[:, axis, None] * steps
            blocks.add(rows, np.full(len(steps), first_matrix + 3 * axis), block)
        modes = np.einsum("jab,kb->kaj", self._model.slip_modes, steps)
        blocks.add(rows, first_slip + modes.shape[2] * k, -scale * modes)
        blocks.residual.append((weights * residual).reshape(-1))
        self._add_slip(blocks, unknowns, first_slip)

    def _add_slip(self, blocks: _Blocks, unknowns: Unknowns, first: int) -> None:
        """Slip is a first-order Gauss-Markov process of each mode."""
        slip, sigma = unknowns.slip, self._model.slip_sigma
        count, modes = slip.shape
        keep = float(np.exp(-(self._knots[1] - self._knots[0]) / self._model.slip_time))
        weight = 1.0 / (sigma * np.sqrt(1.0 - keep * keep))
        k = np.arange(count - 1)
        rows = blocks.rows(modes * (count - 1)).reshape(-1, modes)
        blocks.add(rows, first + modes * (k + 1), np.tile(np.diag(weight), (count - 1, 1, 1)))
        blocks.add(rows, first + modes * k, np.tile(np.diag(-keep * weight), (count - 1, 1, 1)))
        blocks.residual.append((weight * (slip[1:] - keep * slip[:-1])).reshape(-1))
        rows = blocks.rows(modes).reshape(1, modes)
        blocks.add(rows, np.array([first]), np.diag(1.0 / sigma)[None])
        blocks.residual.append(slip[0] / sigma)

    def _add_priors(self, blocks: _Blocks, unknowns: Unknowns) -> None:
        first = self._columns(unknowns)[3]
        deviation = (unknowns.matrix - np.eye(3)).reshape(-1)
        target = np.zeros(9)
        sigma = self._model.matrix_sigma.reshape(-1).copy()
        for entry, other, factor in self._model.ties:
            sigma[entry] = TIE_SIGMA
            target[entry] = factor * deviation[other]
        rows = blocks.rows(9)
        weights = 1.0 / sigma
        blocks.add(rows[:, None], first + np.arange(9), weights[:, None, None])
        for entry, other, factor in self._model.ties:
            column = np.array([first + other])
            blocks.add(rows[entry : entry + 1, None], column, np.array([[[-factor * weights[entry]]]]))
        blocks.residual.append(weights * (deviation - target))
        anchor = blocks.rows(3)
        blocks.add(anchor.reshape(1, 3), np.zeros(1, np.int64), 1e4 * np.eye(3)[None])
        blocks.residual.append(np.zeros(3))


def _factorize(hessian: sparse.csc_matrix) -> SuperLU:
    """Factorize a symmetric positive matrix; its few dense rows come last in the order of least degree."""
    return splu(hessian, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class _Blocks:
    """Collects the dense blocks of a sparse Jacobian."""

    def __init__(self, columns: int) -> None:
        self._columns, self._count = columns, 0
        self._parts: list[tuple[I64, I64, F64]] = []
        self.residual: list[F64] = []

    def rows(self, count: int) -> I64:
        """Reserve rows and return their indices."""
        self._count += count
        return np.arange(self._count - count, self._count)

    def add(self, rows: I64, first_columns: I64, blocks: F64) -> None:
        """Add blocks (P, r, c) at rows (P, r) and columns first_columns (P,) + 0 … c - 1."""
        p, r, c = blocks.shape
        i = np.broadcast_to(rows[:, :, None], (p, r, c))
        j = np.broadcast_to(first_columns[:, None, None] + np.arange(c), (p, r, c))
        self._parts.append((i.reshape(-1), j.reshape(-1), blocks.reshape(-1)))

    def assemble(self) -> tuple[sparse.csr_matrix, F64]:
        """Return the Jacobian and the residual vector."""
        i, j, v = (np.concatenate(parts) for parts in zip(*self._parts, strict=True))
        matrix = sparse.csr_matrix((v, (i, j)), shape=(self._count, self._columns))
        return matrix, np.concatenate(self.residual)


def jackknife(graph: CalibrationGraph, solution: Solution, pairs: Pairs, times: F64, blocks: int = 8) -> F64:
    """Return variances (4N,) of (x, y, yaw, offset) per scanner from leaving out one stretch of time after the other.

    They hold whatever the noise models get wrong: correlated slip, systematic misfits. `times` (P,) tell when each pair was.
    """
    edges = np.quantile(times, np.linspace(0.0, 1.0, blocks + 1))
    estimates = []
    for b in range(blocks):
        keep = (times < edges[b]) | (times >= edges[b + 1]) if b < blocks - 1 else times < edges[b]
        part = graph.solve(solution.unknowns, pairs.subset(keep), iterations=3).unknowns
        estimates.append(np.column_stack([part.mounts, part.offsets]).reshape(-1))
    spread = np.array(estimates)
    return np.asarray((blocks - 1) * np.var(spread, axis=0))
