"""What LiDAR-inertial odometry costs a robot: processor seconds of its node per second of a drive, callbacks and background work apart.

The drive runs in lockstep, so that the share is of processor time per second of the robot's own time, whatever else the machine does.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ambler.apps.drive import DriveRun, drive_scene
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.evaluation.process_memory import peak_memory_mb
from ambler.kernels.warmup import imported_kernel_modules, warm_up
from ambler.runtime.node import WorkKind

BAR = 0.15  # of one core, odometry alone
NODES = ("odometry", "localization")
FIRST = 5.0  # seconds that do not count: rest, and the first map


def measure(world: str, robot: str, seed: int, seconds: float, out: Path, cloud: Path | None = None) -> dict[str, Any]:
    """Drive along the world's own route for some seconds and return the shares of one core, `<node>.<what>_ratio`."""
    options = RunOptions(steps=(), world=world, robot=robot, seed=seed, port=None, physics="kinematic", map_file=cloud)
    scene = drive_scene(options, "built-in", None)
    warm_up(imported_kernel_modules())
    run = DriveRun(options, scene, RunFolder.new(out, "bench-odometry"))
    spent = watch(run.executor)
    try:
        run.run(seconds)
        ended = run.ended_of(run.robot)
    finally:
        run.close()
    counted = 1e-9 * run.executor.now_ns - FIRST
    fields: dict[str, Any] = {f"{name}_ratio": value / counted for name, value in sorted(spent.items())}
    own = [value for name, value in fields.items() if name in ("odometry.callbacks_ratio", "odometry.perception_ratio")]
    return {
        "robot_seconds": counted,
        "odometry_ratio": sum(own),
        **fields,
        "recording_mb_per_s": sum(f.stat().st_size for f in run.folder.recording.rglob("*") if f.is_file())
        / 1e6
        / (counted + FIRST),
        "peak_memory_mb": peak_memory_mb(),
        "ended": ended,
        "is_met": sum(own) <= BAR and ended in ("time_limit", "succeeded"),
    }


def watch(executor: Any) -> dict[str, float]:
    """Sum the processor seconds of the nodes' callbacks and of their background work, by its kind, from now on."""
    spent: dict[str, float] = defaultdict(float)
    guarded, in_background = executor.guarded, executor.run_in_background

    def timed(name: str, work: Callable[[], Any]) -> Any:
        begin = time.thread_time()
        try:
            return work()
        finally:
            if executor.now_ns > FIRST * 1e9:
                spent[name] += time.thread_time() - begin

    def timed_callback(context: Any, callback: Any) -> None:
        if context.node.name in NODES:
            timed(f"{context.node.name}.callbacks", lambda: guarded(context, callback))
        else:
            guarded(context, callback)

    def timed_work(context: Any, work: Any, duration_ns: int, done: Any, kind: WorkKind) -> None:
        if context.node.name in NODES:
            name = f"{context.node.name}.{kind.value}"
            in_background(context, lambda: timed(name, work), duration_ns, done, kind)
        else:
            in_background(context, work, duration_ns, done, kind)

    executor.guarded, executor.run_in_background = timed_callback, timed_work
    return spent
