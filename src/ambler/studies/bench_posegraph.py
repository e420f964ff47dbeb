"""Recorded planar graphs to their known optima beside gtsam in the same run: two from good starts, two from their odometry, where each makes a start of its own."""

from __future__ import annotations

import importlib.util
import statistics
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ambler.core.se2 import SE2
from ambler.posegraph.solver import PoseGraph, solve
from ambler.studies.timing import elapsed_ms
from ambler.wire.g2o import G2oGraph, read_g2o

OPTIMA = {"intel": 45.0047, "manhattan3500": 146.0766}
OPTIMA_FROM_ODOMETRY = {"MIT": 41.1633, "ais2klinik": 172.8156}
"""Graphs whose odometry leads plain Gauss-Newton astray."""
TOLERANCE = 1e-3


def measure(data: Path, runs: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Solve every graph of a folder of .g2o files; tells a line of each. Times are medians in milliseconds."""
    fields: dict[str, Any] = {}
    for name, optimum in OPTIMA.items():
        fields |= _from_file(name, read_g2o(data / f"{name}.g2o"), optimum, runs, tell)
    for name, optimum in OPTIMA_FROM_ODOMETRY.items():
        if (data / f"{name}.g2o").exists():
            fields |= _from_odometry(name, read_g2o(data / f"{name}.g2o"), optimum, runs, tell)
        else:
            tell(f"{name}: no such file in {data}, left out")
    if "peer_gtsam_intel_optimize_ms" not in fields:
        tell("gtsam is not installed: no peer times (in the source folder: .venv/bin/pip install '.[bench]')")
    return fields


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether every optimum is found to 0.1 %, from odometry with convergence, and gtsam, where it was measured, is not faster."""
    optima = OPTIMA | {f"{name}_from_odometry": optimum for name, optimum in OPTIMA_FROM_ODOMETRY.items()}
    return all(
        abs(fields[f"{name}_chi2"] / optimum - 1.0) <= TOLERANCE
        and fields.get(f"{name}_is_converged", True)
        and fields.get(f"ratio_vs_gtsam_{name}", 0.0) <= 1.0
        for name, optimum in optima.items()
        if f"{name}_chi2" in fields
    )


def _from_file(name: str, file: G2oGraph, optimum: float, runs: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Solve a graph from the poses in its file, beside gtsam."""
    flags = np.zeros(len(file.edge_from), np.bool_)
    graph = PoseGraph(file.poses, file.edge_from, file.edge_to, file.measurements, file.information, flags)
    result = solve(graph)
    works: dict[str, Callable[[], object]] = {"own": partial(solve, graph), **_gtsam_works(graph)}
    times = _interleaved_medians(works, runs)
    fields: dict[str, Any] = {
        f"{name}_chi2": result.chi2,
        f"{name}_chi2_error_pct": 100.0 * (result.chi2 / optimum - 1.0),
        f"{name}_iterations": result.iterations,
        f"{name}_solve_ms": times["own"],
    }
    tell(f"{name}: chi2 {result.chi2:.4f} (known {optimum}), {result.iterations} iterations, {times['own']:.1f} ms")
    return fields | _gtsam_fields(name, times, tell) if "gtsam_optimize" in works else fields


def _from_odometry(name: str, file: G2oGraph, optimum: float, runs: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Solve a graph from the poses that follow its odometry."""
    graph = _along_odometry(file)
    result = solve(graph)
    times = _interleaved_medians({"own": partial(solve, graph), **_gtsam_started_works(graph)}, runs)
    tell(f"{name} from its odometry: chi2 {result.chi2:.4f} (known {optimum}), {times['own']:.1f} ms")
    fields: dict[str, Any] = {
        f"{name}_from_odometry_chi2": result.chi2,
        f"{name}_from_odometry_chi2_error_pct": 100.0 * (result.chi2 / optimum - 1.0),
        f"{name}_from_odometry_iterations": result.iterations,
        f"{name}_from_odometry_is_converged": result.converged,
        f"{name}_from_odometry_solve_ms": times["own"],
    }
    if "gtsam_start" not in times:
        return fields
    chi2, peer = _gtsam_started_chi2(graph), times["gtsam_start"] + times["gtsam_optimize"]
    tell(f"  gtsam from its own start: chi2 {chi2:.4f}, {peer:.1f} ms; ours takes {times['own'] / peer:.2f} of it")
    return fields | {
        f"peer_gtsam_{name}_from_odometry_chi2": chi2,
        f"peer_gtsam_{name}_from_odometry_ms": peer,
        f"ratio_vs_gtsam_{name}_from_odometry": times["own"] / peer,
    }


def _along_odometry(file: G2oGraph) -> PoseGraph:
    """Return the graph with poses that follow its odometry, the edges from each pose to the next."""
    steps = {
        int(a): SE2.from_array(file.measurements[k])
        for k, (a, b) in enumerate(zip(file.edge_from, file.edge_to, strict=True))
        if b == a + 1
    }
    poses = [SE2.from_array(file.poses[0])]
    for k in range(len(file.poses) - 1):
        poses.append(poses[-1] @ steps.get(k, SE2()))
    flags = np.zeros(len(file.edge_from), np.bool_)
    start = np.array([pose.as_array() for pose in poses])
    return PoseGraph(start, file.edge_from, file.edge_to, file.measurements, file.information, flags)


def _gtsam_fields(name: str, times: dict[str, float], tell: Callable[[str], None]) -> dict[str, float]:
    both = times["gtsam_optimize"] + times["gtsam_build"]
    tell(
        f"  gtsam Gauss-Newton: {times['gtsam_optimize']:.1f} ms, with the building of its graph {both:.1f} ms;"
        f" ours takes {times['own'] / times['gtsam_optimize']:.2f} of the former, everything included"
    )
    return {
        f"peer_gtsam_{name}_optimize_ms": times["gtsam_optimize"],
        f"peer_gtsam_{name}_build_ms": times["gtsam_build"],
        f"ratio_vs_gtsam_{name}": times["own"] / times["gtsam_optimize"],
        f"ratio_vs_gtsam_{name}_with_build": times["own"] / both,
    }


def _interleaved_medians(works: dict[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Return each work's median in ms; the works take turns, so that a busy moment of the machine meets all of them."""
    samples: dict[str, list[float]] = {key: [] for key in works}
    for _ in range(runs):
        for key, work in works.items():
            samples[key].append(elapsed_ms(work))
    return {key: statistics.median(values) for key, values in samples.items()}


def _gtsam_works(graph: PoseGraph) -> dict[str, Callable[[], object]]:
    if importlib.util.find_spec("gtsam") is None:
        return {}
    import gtsam

    factors, values = _gtsam_graph(graph)
    return {
        "gtsam_build": partial(_gtsam_graph, graph),
        "gtsam_optimize": lambda: gtsam.GaussNewtonOptimizer(factors, values).optimize(),
    }


def _gtsam_started_works(graph: PoseGraph) -> dict[str, Callable[[], object]]:
    """Return gtsam's own start (chordal: the one in the plane, LAGO, takes no covariances and fails on both graphs), and what it finds from there."""
    if importlib.util.find_spec("gtsam") is None:
        return {}
    import gtsam

    in_space, (factors, _) = _gtsam_graph_in_space(graph), _gtsam_graph(graph)
    start = _gtsam_start(in_space)
    return {
        "gtsam_start": partial(gtsam.InitializePose3.initialize, in_space),
        "gtsam_optimize": lambda: gtsam.LevenbergMarquardtOptimizer(factors, start).optimize(),
    }


def _gtsam_started_chi2(graph: PoseGraph) -> float:
    import gtsam

    factors, _ = _gtsam_graph(graph)
    found = gtsam.LevenbergMarquardtOptimizer(factors, _gtsam_start(_gtsam_graph_in_space(graph))).optimize()
    return float(2.0 * factors.error(found))


def _gtsam_start(in_space: Any) -> Any:
    import gtsam

    values, found = gtsam.Values(), gtsam.InitializePose3.initialize(in_space)
    for key in found.keys():  # noqa: SIM118 (these are no dictionary's)
        pose = found.atPose3(key)
        values.insert(key, gtsam.Pose2(pose.x(), pose.y(), pose.rotation().yaw()))
    return values


def _gtsam_graph_in_space(graph: PoseGraph) -> Any:
    """Return the factors of a graph as those of poses in space."""
    import gtsam

    def pose_of(x: float, y: float, yaw: float) -> Any:
        return gtsam.Pose3(gtsam.Rot3.Yaw(yaw), np.array([x, y, 0.0]))

    factors = gtsam.NonlinearFactorGraph()
    for k in range(len(graph.edge_from)):
        information = np.eye(6) * float(np.diag(graph.information[k]).max())
        information[np.ix_((3, 4, 2), (3, 4, 2))] = graph.information[k]  # gtsam's order: rotation first
        noise = gtsam.noiseModel.Gaussian.Information(information)
        z = pose_of(*graph.measurements[k].tolist())
        factors.add(gtsam.BetweenFactorPose3(int(graph.edge_from[k]), int(graph.edge_to[k]), z, noise))
    first = pose_of(*graph.poses[0].tolist())
    factors.add(gtsam.PriorFactorPose3(0, first, gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
    return factors


def _gtsam_graph(graph: PoseGraph) -> tuple[Any, Any]:
    """Return the factors of a graph and its poses in gtsam's own classes."""
    import gtsam

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, (x, y, yaw) in enumerate(graph.poses.tolist()):
        values.insert(k, gtsam.Pose2(x, y, yaw))
    for k in range(len(graph.edge_from)):
        noise = gtsam.noiseModel.Gaussian.Information(graph.information[k])
        z = gtsam.Pose2(*graph.measurements[k].tolist())
        factors.add(gtsam.BetweenFactorPose2(int(graph.edge_from[k]), int(graph.edge_to[k]), z, noise))
    first = gtsam.Pose2(*graph.poses[0].tolist())
    factors.add(gtsam.PriorFactorPose2(0, first, gtsam.noiseModel.Constrained.All(3)))
    return factors, values
