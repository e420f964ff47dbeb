"""`ambler bench control`: one cycle of the local planner in cluttered windows, and one step of the velocity gate."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ambler.core.grid import GridSpec
    from ambler.core.robot import RobotModel

GATE_POINTS = (360, 2000)


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("control", help="local planner and velocity gate: time per cycle")
    parser.add_argument("--runs", type=int, default=300, help="cycles per measurement")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print medians of CPU time; exit 1 when the planner's median at 60 x 60 cells is above 3 ms."""
    from ambler.evaluation.results import write_results
    from ambler.kernels import footprint, rollout

    begin = time.perf_counter()
    footprint.warm_up()
    rollout.warm_up()
    fields: dict[str, Any] = {"runs": args.runs}
    for cells in (60, 120):
        for kind in ("differential", "omni"):
            median, worst = planner_times(cells, kind, args.runs, args.seed)
            fields[f"rollout_{kind}_{cells}_ms"] = round(median, 4)
            fields[f"rollout_{kind}_{cells}_p95_ms"] = round(worst, 4)
    for count in GATE_POINTS:
        median, worst = gate_times(count, args.runs, args.seed)
        fields[f"gate_step_{count}_points_ms"] = round(median, 4)
        fields[f"gate_step_{count}_points_p95_ms"] = round(worst, 4)
    for name, value in fields.items():
        print(f"{name:40} {value}")
    if args.json is not None:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if fields["rollout_differential_60_ms"] <= 3.0 else 1


def cluttered_window(cells: int, rng: np.random.Generator) -> tuple[NDArray[np.uint8], GridSpec]:
    """Return a window of 5 cm cells with boxes strewn over it, free around its middle and along a winding way ahead."""
    import numpy as np

    from ambler.core.grid import COST_LETHAL, GridSpec

    half = cells * 0.05 / 2.0
    spec = GridSpec(0.05, cells, cells, -half, -half)
    costs = np.zeros(spec.shape, np.uint8)
    for _ in range(cells // 3):
        iy, ix = rng.integers(0, cells, 2)
        costs[iy : iy + 3, ix : ix + 3] = COST_LETHAL
    centers = spec.centers_of(np.argwhere(costs == COST_LETHAL))
    is_on_the_way = (centers[:, 0] > -0.6) & (np.abs(centers[:, 1] - 0.2 * np.sin(centers[:, 0])) < 0.5)
    for iy, ix in spec.cells_of(centers[is_on_the_way]):
        costs[iy, ix] = 0
    return costs, spec


def bench_robot(kind: str) -> RobotModel:
    """Return a robot of the size that the reference was measured with."""
    import numpy as np

    from ambler.core.robot import DriveKind, RobotModel, VelocityLimits

    footprint = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
    return RobotModel("bench", DriveKind(kind), footprint, VelocityLimits(vy_max=0.4 if kind == "omni" else 0.0))


def planner_times(cells: int, kind: str, runs: int, seed: int) -> tuple[float, float]:
    """Return median and 95th percentile of one control cycle, milliseconds."""
    import numpy as np

    from ambler.control.config import RolloutConfig
    from ambler.control.trajectory_rollout import TrajectoryRollout
    from ambler.core.errors import NoValidControlError
    from ambler.core.protocols import BodyVelocity
    from ambler.core.se2 import SE2

    rng = np.random.default_rng(seed)
    planner = TrajectoryRollout(RolloutConfig(), bench_robot(kind))
    x = np.linspace(0.0, 3.0, 61)
    path = np.stack((x, 0.2 * np.sin(x), np.zeros_like(x)), axis=1)
    times = []
    for _ in range(runs):
        costs, spec = cluttered_window(cells, rng)
        velocity = BodyVelocity(float(rng.uniform(0.1, 0.7)), 0.0, float(rng.uniform(-0.3, 0.3)))

        def cycle(costs: Any = costs, spec: Any = spec, velocity: Any = velocity) -> None:
            planner.set_path(path)
            try:
                planner.compute_command(costs, spec, SE2(0.0, 0.0, 0.1), velocity)
            except NoValidControlError:
                return

        times.append(milliseconds(cycle))
    return float(np.median(times)), float(np.percentile(times, 95))


def gate_times(count: int, runs: int, seed: int) -> tuple[float, float]:
    """Return median and 95th percentile of one step of the gate with `count` points within 5 m, milliseconds."""
    import numpy as np

    from ambler.core.protocols import BodyVelocity
    from ambler.core.se2 import SE2
    from ambler.safety.config import GateConfig
    from ambler.safety.gate import VelocityGate

    rng = np.random.default_rng(seed)
    gate = VelocityGate(GateConfig(), bench_robot("differential"))
    angle, radius = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.6, 5.0, count)
    points = np.stack((radius * np.cos(angle), radius * np.sin(angle)), axis=1)
    gate.arm(0)
    times = []
    for k in range(1, runs + 1):
        now_ns = k * 20_000_000
        gate.update_points("laser", now_ns, points, SE2())
        gate.update_odometry(now_ns, SE2())
        gate.request("navigation", now_ns, BodyVelocity(0.6, 0.0, 0.4), now_ns)
        times.append(milliseconds(lambda now_ns=now_ns: gate.step(now_ns)))  # type: ignore[misc]
    return float(np.median(times)), float(np.percentile(times, 95))


def milliseconds(work: Callable[[], Any]) -> float:
    """Return the CPU time of one call."""
    start = time.process_time_ns()
    work()
    return (time.process_time_ns() - start) * 1e-6
