"""`ambler bench nodes`: how long every callback of every node takes, beside the latency that the node declares."""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

MEASURING_MS = 0.005  # what looking at the clock takes
TOLERANCE = 0.01  # share of callbacks that may take longer than declared: the machine interrupts us, too


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "nodes", help="wall time of every callback of every node beside its declared latency"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated seconds of exploring the office")
    parser.add_argument("--robot", default="amr_omni", help="robot that explores")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore the office for a while and dock once; exit 1 when a node's 99th percentile is longer than it declares."""
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    begin = time.perf_counter()
    warm_up(imported_kernel_modules())
    fields: dict[str, Any] = {}
    office, dock = _runs(args.robot, args.seed, args.out)
    fields |= _measured("office", office, args.seconds)
    fields |= _measured("dock", dock, 120.0)
    offenders = _show(fields)
    fields["offenders"] = ", ".join(offenders)
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 1 if offenders else 0


def _runs(robot: str, seed: int, out: Path) -> tuple[Any, Any]:
    """Return an exploration of the office, and a robot that finds out where it is and docks."""
    from ambler.apps.run_folder import RunFolder
    from ambler.apps.scene import RunOptions
    from ambler.apps.simulated import SimulatedRun
    from ambler.nodes.steps import DockStep

    exploring = RunOptions(world="office", robot=robot, seed=seed, port=None)
    docking = RunOptions(
        (DockStep("charger_1"),), "dock_room", "amr_omni", seed, is_lost=True, may_turn=True, port=None
    )
    office = SimulatedRun(exploring, RunFolder.new(out, "bench-office"))
    return office, SimulatedRun(docking, RunFolder.new(out, "bench-dock"))


def _measured(name: str, run: Any, seconds: float) -> dict[str, float]:
    """Run and return median, 99th percentile and maximum (ms) of the callbacks of every node but those of simulated devices, whose
    time is the simulator's."""
    import numpy as np

    from ambler.nodes.devices.node import DeviceNode
    from ambler.nodes.devices.truth import TruthNode

    executor, taken = run.executor, defaultdict(list)
    guarded = executor.guarded

    def timed(context: Any, callback: Any) -> None:
        start = time.thread_time()  # of this thread alone: in lockstep a node's turn waits for its background work
        guarded(context, callback)
        taken[context.node.name].append(1e3 * (time.thread_time() - start))

    executor.guarded = timed
    try:
        run.run(seconds)
    finally:
        run.close()
    fields: dict[str, float] = {}
    for context in executor.contexts:
        node = context.node
        samples = np.array(taken[node.name][1:])  # without `start`, before which the robot may not move
        if isinstance(node, DeviceNode | TruthNode) or len(samples) == 0:
            continue
        key = f"{name}.{node.name}"
        fields |= {
            f"{key}.declared_ms": 1e3 * node.latency,
            f"{key}.median_ms": float(np.median(samples)),
            f"{key}.p99_ms": float(np.percentile(samples, 99)),
            f"{key}.max_ms": float(samples.max()),
            f"{key}.late_ratio": float(np.mean(samples > 1e3 * node.latency + MEASURING_MS)),
        }
    return fields


def _show(fields: dict[str, float]) -> list[str]:
    """Print a table; returns the nodes that work longer than they declare more often than tolerated."""
    offenders = []
    print(f"{'node':28s} {'declared':>9s} {'median':>9s} {'p99':>9s} {'max':>9s}   ms")
    for key in [k.removesuffix(".declared_ms") for k in fields if k.endswith(".declared_ms")]:
        declared, median, p99, most = (fields[f"{key}.{n}_ms"] for n in ("declared", "median", "p99", "max"))
        is_late = fields[f"{key}.late_ratio"] > TOLERANCE
        offenders += [key] if is_late else []
        print(f"{key:28s} {declared:9.3f} {median:9.3f} {p99:9.3f} {most:9.3f} {'  LATE' if is_late else ''}")
    return offenders
