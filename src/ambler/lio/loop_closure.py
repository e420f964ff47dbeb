"""Loop closure in space: keyframes of the odometry, matches where the way comes back, and a pose graph that says where the odometry's frame lies in the map.

Candidates lie within the drift that the graph allows; where that is beyond the reach of a match, a window is searched, and two places that fit about as well are none.
A match counts when it fits and lies where the graph expects it: what looks alike elsewhere does not, however many say the same, as they do along a second
corridor like the first. Closures stand under a robust kernel, so that one that contradicts the others fades.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig
from ambler.lio.corrections import corrected_pose
from ambler.lio.health import LioResult
from ambler.lio.keyframes import Keyframe, KeyframeBuilder
from ambler.lio.loop_match import Closure, error_of, match_keyframes, search_keyframes
from ambler.lio.measurements import skew
from ambler.lio.state import to_se3
from ambler.posegraph.solver import RobustKernel, SolverConfig
from ambler.posegraph.spatial import SpatialGraph, SpatialMarginals, Tilts, solve_spatial

F64 = NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])


class LoopClosure:
    """Give it every result of the odometry; `map_from_odom` is the correction at the newest keyframe. It owns no thread: a call takes tens of milliseconds
    when a keyframe is complete and nothing otherwise."""

    def __init__(self, config: LioConfig | None = None) -> None:
        self._config = config or LioConfig()
        self._loops = self._config.loops
        self._builder = KeyframeBuilder(self._config)
        self._solver = SolverConfig(robust_kernel=RobustKernel.GEMAN_MCCLURE, robust_width=self._loops.robust_width)
        self.keyframes: list[Keyframe] = []
        self.closures: list[Closure] = []
        self.map_from_keyframes: list[F64] = []
        self.is_converged = True
        self._weights = np.ones(0)
        self._first_step: tuple[F64, F64] | None = None
        self.tried = 0
        """Matches that were tried."""

    @property
    def map_from_odom(self) -> SE3:
        """The correction of the odometry's frame at the newest keyframe."""
        return _se3(self._correction(-1)) if self.keyframes else SE3()

    def add(self, result: LioResult) -> list[Closure]:
        """Take a scan's result; returns the closures that it brought, mostly none."""
        return self._take(self._builder.add(result))

    def finish(self) -> list[Closure]:
        """Complete the last keyframe with what there is, at the end of a recording."""
        return self._take(self._builder.finish())

    def corrected(self, stamps_ns: NDArray[np.int64], poses: Sequence[SE3]) -> list[SE3]:
        """Return poses of the odometry (map_from_anything) at stamps in the corrected map: corrections are blended from keyframe to keyframe by time."""
        if not self.keyframes:
            return list(poses)
        begins = np.array([frame.stamp_ns for frame in self.keyframes], np.int64)
        return [
            corrected_pose(begins, lambda k: _se3(self._correction(k)), stamp_ns, pose)
            for stamp_ns, pose in zip(stamps_ns.tolist(), poses, strict=True)
        ]

    def links(self) -> F64:
        """Return the places (K, 2, 3) in the corrected map that closures join."""
        places = np.array(self.map_from_keyframes).reshape(-1, 4, 4)[:, :3, 3]
        pairs = np.array([(c.earlier, c.later) for c in self.closures], np.int64).reshape(-1, 2)
        return np.asarray(places[pairs])

    def points(self) -> F64:
        """Return the points (M, 3) of all keyframes in the corrected map."""
        return laid_points(self.keyframes, self.map_from_keyframes)

    def _correction(self, k: int) -> F64:
        return np.asarray(self.map_from_keyframes[k] @ np.linalg.inv(self.keyframes[k].odom_from_keyframe))

    def _take(self, frame: Keyframe | None) -> list[Closure]:
        if frame is None:
            return []
        correction = self._correction(-1) if self.keyframes else np.eye(4)
        self.keyframes.append(frame)
        self.map_from_keyframes.append(correction @ frame.odom_from_keyframe)
        if len(self.keyframes) == 2:
            self._join_the_start()
        new = self._matches(len(self.keyframes) - 1)
        if new:
            self.closures += new
            self._solve()
        return new

    def _join_the_start(self) -> None:
        """Measure where the scanner stood before it moved; the odometry knows its attitude there worse than anywhere."""
        first, second = self.keyframes
        if first.way != 0.0 or not first.is_at_rest:
            return
        guess = np.linalg.inv(second.odom_from_keyframe) @ first.odom_from_keyframe
        found = match_keyframes(
            (second, first), (1, 0), guess, self._loops
        )  # what was seen at rest is sparse: it is laid on the other
        if found is None or found.is_weak:
            return
        first_from_second = np.asarray(np.linalg.inv(found.earlier_from_later), np.float64)
        carried = _adjoint(found.earlier_from_later)
        self._first_step = (first_from_second, np.asarray(carried @ found.covariance @ carried.T, np.float64))
        self.map_from_keyframes[1] = self.map_from_keyframes[0] @ first_from_second

    def _matches(self, newest: int) -> list[Closure]:
        """Match the newest keyframe with the nearest of those that the graph does not know well enough from it."""
        c, frames, poses = self._loops, self.keyframes, np.array(self.map_from_keyframes)
        ways = np.array([frame.way for frame in frames])
        distances = np.linalg.norm(poses[:, :3, 3] - poses[newest, :3, 3], axis=1)
        is_candidate = ways[newest] - ways > c.way_least
        if not is_candidate.any():
            return []
        marginals = SpatialMarginals(self._graph(), 0, self._edge_weights())
        out = []
        order = [int(k) for k in np.argsort(distances, kind="stable") if is_candidate[k]]
        for k in order[: 4 * c.candidates_most]:
            spread = marginals.relative(k, newest)
            sigma = float(np.sqrt(np.linalg.eigvalsh(spread[:3, :3])[-1]))
            if distances[k] > c.distance_most + 3.0 * sigma or sigma < c.gain_least * c.match_sigma[0]:
                continue
            expected = np.linalg.inv(poses[k]) @ poses[newest]
            self.tried += 1
            window = 3.0 * np.sqrt([np.linalg.eigvalsh(spread[i : i + 3, i : i + 3])[-1] for i in (0, 3)])
            pair, indices = (frames[k], frames[newest]), (k, newest)
            if window[0] <= c.reach:
                found = match_keyframes(pair, indices, expected, c)
            else:
                near = (min(float(window[0]), c.window_most), min(float(window[1]), np.pi))
                found = search_keyframes(pair, indices, (poses[k], poses[newest]), near, c)
            if found is not None:
                out.append((found, self._surprise(found, expected, spread)))
            if len(out) >= c.candidates_most:
                break
        return [closure for closure, surprise in out if surprise <= c.gate]

    def _surprise(self, closure: Closure, expected: F64, spread: F64) -> float:
        """Return the squared normalized distance of a closure from what the graph expects."""
        error = error_of(expected, closure.earlier_from_later)
        return float(error @ np.linalg.solve(spread + closure.covariance, error))

    def _edge_weights(self) -> F64:
        """Return what the robust kernel left of each edge: all of the chain, which grew since."""
        chain = len(self.keyframes) - 1
        return np.concatenate([np.ones(chain), self._weights[len(self._weights) - len(self.closures) :]])

    def _graph(self) -> SpatialGraph:
        """Return keyframes in a chain, closures, and what gravity says of their tilts."""
        frames, c = self.keyframes, self._loops
        chain = [np.linalg.inv(a.odom_from_keyframe) @ b.odom_from_keyframe for a, b in pairwise(frames)]
        edges = np.array([*chain, *(closure.earlier_from_later for closure in self.closures)]).reshape(-1, 4, 4)
        spreads = [frame.covariance for frame in frames[:-1]]
        if self._first_step is not None:
            chain[0], spreads[0] = self._first_step
        information = [np.linalg.inv(spread) for spread in spreads] + [x.information for x in self.closures]
        n, poses = len(frames), np.array(self.map_from_keyframes)
        level = [k for k in range(n) if frames[k].up is not None]
        ups = np.array([frames[k].up for k in level]).reshape(-1, 3)
        sigmas = np.array([max(c.tilt_sigma, c.tilt_factor * frames[k].up_sigma) for k in level])
        return SpatialGraph(
            places=poses[:, :3, 3],
            rotations=poses[:, :3, :3],
            edge_from=np.array([*range(n - 1), *(x.earlier for x in self.closures)], np.int64),
            edge_to=np.array([*range(1, n), *(x.later for x in self.closures)], np.int64),
            edge_places=edges[:, :3, 3],
            edge_rotations=edges[:, :3, :3],
            information=np.array(information).reshape(-1, 6, 6),
            is_robust=np.arange(n - 1 + len(self.closures)) >= n - 1,
            tilts=Tilts(np.array(level, np.int64), ups, sigmas, self._up(ups / sigmas[:, None] ** 2, poses[level])),
        )

    def _up(self, ups: F64, poses: F64) -> F64:
        """Return the direction against gravity in the map (3,), which began level by an accelerometer with a bias: the weighted mean of all keyframes."""
        if len(ups) == 0:
            return UP
        mean = np.einsum("nij,nj->i", poses[:, :3, :3], ups)
        return np.asarray(mean / np.linalg.norm(mean))

    def _solve(self) -> None:
        """Solve from where the poses are, and from where all closures would have them, of which the better end counts: a closure that moves the map
        far has no weight at the first, and a false one spoils the second."""
        graph = self._graph()
        trusting = solve_spatial(replace(graph, is_robust=np.zeros_like(graph.is_robust)), 0, self._solver)
        starts = (graph, replace(graph, places=trusting.places, rotations=trusting.rotations))
        solution = min((solve_spatial(start, 0, self._solver) for start in starts), key=lambda s: s.cost)
        self.is_converged = solution.converged
        self._weights = solution.weights
        for k, pose in enumerate(self.map_from_keyframes):
            moved = pose.copy()
            moved[:3, :3], moved[:3, 3] = solution.rotations[k], solution.places[k]
            self.map_from_keyframes[k] = moved


def laid_points(keyframes: Sequence[Keyframe], map_from_keyframes: Sequence[F64]) -> F64:
    """Return the points (M, 3) of keyframes at their places (4, 4) in a map."""
    laid = [f.cloud.points @ m[:3, :3].T + m[:3, 3] for f, m in zip(keyframes, map_from_keyframes, strict=True)]
    return np.concatenate([np.zeros((0, 3)), *laid])


def _adjoint(pose: F64) -> F64:
    """Return what turns perturbations (6,) on the right of a pose (4, 4) into those on the right of its inverse, sign turned."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = pose[:3, :3]
    out[:3, 3:] = skew(pose[:3, 3]) @ pose[:3, :3]
    return out


def _se3(matrix: F64) -> SE3:
    return to_se3(matrix[:3, 3], matrix[:3, :3])
