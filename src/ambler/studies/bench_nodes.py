"""How long every callback of every node takes, beside the latency that the node declares."""

from __future__ import annotations

import gc
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.kernels.warmup import imported_kernel_modules, warm_up
from ambler.nodes.devices.node import DeviceNode
from ambler.nodes.devices.truth import TruthNode
from ambler.nodes.steps import DockStep

MEASURING_MS = 0.005  # what looking at the clock takes
TOLERANCE = 0.01  # share of callbacks that may take longer than declared: the machine interrupts us, too


def measure(robot: str, seed: int, seconds: float, out: Path) -> dict[str, float]:
    """Explore the office for some seconds and dock once; returns `<run>.<node>.<what>`."""
    warm_up(imported_kernel_modules())
    office, dock = build_runs(robot, seed, out)
    return callback_times("office", office, seconds) | callback_times("dock", dock, 120.0)


def build_runs(robot: str, seed: int, out: Path) -> tuple[Any, Any]:
    """Return an exploration of the office, and a robot that finds out where it is and docks."""
    exploring = RunOptions(world="office", robot=robot, seed=seed, port=None)
    docking = RunOptions(
        (DockStep("charger_1"),), "dock_room", "amr_omni", seed, is_lost=True, may_turn=True, port=None
    )
    office = SimulatedRun(exploring, RunFolder.new(out, "bench-office"))
    return office, SimulatedRun(docking, RunFolder.new(out, "bench-dock"))


def callback_times(name: str, run: Any, seconds: float) -> dict[str, float]:
    """Run and return median, 99th percentile and maximum (ms) of the callbacks of every node but those of simulated devices, whose
    time is the simulator's."""
    executor, taken = run.executor, defaultdict(list)
    guarded = executor.guarded

    def timed(context: Any, callback: Any) -> None:
        start = time.thread_time()  # of this thread alone: in lockstep a node's turn waits for its background work
        guarded(context, callback)
        taken[context.node.name].append(1e3 * (time.thread_time() - start))

    executor.guarded = timed
    gc.collect()
    gc.freeze()  # as `LiveExecutor` does: a search through all that was there before takes 0.1 s of some callback
    try:
        run.run(seconds)
    finally:
        run.close()
        gc.unfreeze()
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


def late_nodes(fields: dict[str, float]) -> list[str]:
    """Return the nodes that work longer than they declare more often than tolerated."""
    return [name for name in _nodes(fields) if fields[f"{name}.late_ratio"] > TOLERANCE]


def table(fields: dict[str, float]) -> str:
    """Return a line per node, with the late ones marked."""
    late = late_nodes(fields)
    lines = [f"{'node':28s} {'declared':>9s} {'median':>9s} {'p99':>9s} {'max':>9s}   ms"]
    for name in _nodes(fields):
        declared, median, p99, most = (fields[f"{name}.{n}_ms"] for n in ("declared", "median", "p99", "max"))
        mark = "  LATE" if name in late else ""
        lines.append(f"{name:28s} {declared:9.3f} {median:9.3f} {p99:9.3f} {most:9.3f} {mark}")
    return "\n".join(lines)


def _nodes(fields: dict[str, float]) -> list[str]:
    return [name.removesuffix(".declared_ms") for name in fields if name.endswith(".declared_ms")]
