"""`ambler bench costmap`: inflation, beside that of SciPy's transform in the same run, and the update of a rolling window.

All times are those of the processor, one thread."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LOCAL_BAR_MS = 0.3


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("costmap", help="costmaps: inflation and rolling update")
    parser.add_argument("--sizes", type=int, nargs="+", default=[60, 200, 1000, 4000])
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; exit 1 when the inflation of a 60 x 60 window takes more than 0.3 ms or differs from SciPy's distances."""
    import numpy as np

    from ambler.cli.planner_worlds import make_world
    from ambler.evaluation.results import write_results

    begin = time.perf_counter()
    fields: dict[str, Any] = {}
    is_good = True
    for n in args.sizes:
        cells = make_world("clutter", max(n, 200), np.random.default_rng(args.seed))[-n:, -n:].copy()
        fields |= _inflation(cells, n, args.runs)
        is_good &= fields[f"inflation_{n}_cells_wrong"] == 0
    if 60 in args.sizes:
        is_good &= fields["inflation_60_ms"] <= LOCAL_BAR_MS
    fields["local_update_ms"] = _local_update(args.runs)
    print(f"local costmap, 6 m, 720 rays: {fields['local_update_ms']:.3f} ms per update")
    fields["global_update_1000_ms"] = _global_update(args.runs)
    print(f"global costmap, 1000 x 1000, 2 m changed: {fields['global_update_1000_ms']:.3f} ms per map")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if is_good else 1


def _inflation(cells: NDArray[np.uint8], n: int, runs: int) -> dict[str, Any]:
    import numpy as np
    from scipy.ndimage import distance_transform_edt

    from ambler.cli.planner_worlds import inflated
    from ambler.costmap.inflation import cost_table
    from ambler.kernels.distance_transform import inflate

    repeats = runs if n > 500 else 20 * runs
    out = np.empty_like(cells)
    table = cost_table(11, 0.05, 0.25, 10.0)
    full = _median(lambda: inflate(cells, 0, n, 0, n, 11, table, out), repeats)
    side = min(60, n) // 2
    y0, y1 = n // 2 - side, n // 2 + side
    box = _median(lambda: inflate(cells, y0, y1, y0, y1, 11, table, out), 20 * runs)
    begin = time.process_time()
    squared = np.rint(distance_transform_edt(cells != 254) ** 2).astype(np.int64)
    expected = table[np.minimum(squared, len(table) - 1)]
    peer = 1e3 * (time.process_time() - begin)
    wrong = int((inflated(cells) != expected).sum())
    fields: dict[str, Any] = {
        f"inflation_{n}_ms": full,
        f"inflation_{n}_box_3m_ms": box,
        f"inflation_{n}_cells_wrong": wrong,
        f"peer_scipy_inflation_{n}_ms": peer,
        f"ratio_vs_scipy_inflation_{n}": full / peer,
    }
    text = f"a changed 3 m box {box:.3f} ms, SciPy {peer:.2f} ms, cells wrong {wrong}"
    print(f"inflation {n} x {n}: {full:.3f} ms, {text}", flush=True)
    return fields


def _local_update(runs: int) -> float:
    import numpy as np

    from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
    from ambler.core.se2 import SE2
    from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
    from ambler.costmap.obstacle_layer import ObstacleLayer, SensorRays

    footprint = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
    costmap = LocalCostmap(
        LocalCostmapConfig(), RobotModel("bench", DriveKind.DIFFERENTIAL, footprint, VelocityLimits())
    )
    angle = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    hits = (2.0 + 0.5 * np.sin(5.0 * angle))[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    obstacles = costmap.layer(ObstacleLayer)

    def update() -> None:
        obstacles.add([SensorRays((0.0, 0.0), hits)])
        costmap.update(SE2())

    return _median(update, 20 * runs)


def _global_update(runs: int) -> float:
    import itertools

    import numpy as np

    from ambler.core.grid import GridSpec
    from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
    from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig

    footprint = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
    robot = RobotModel("bench", DriveKind.DIFFERENTIAL, footprint, VelocityLimits())
    costmap, spec = GlobalCostmap(GlobalCostmapConfig(), robot), GridSpec(0.05, 1000, 1000, 0.0, 0.0)
    chance = np.random.default_rng(0)
    maps = [chance.choice(np.array([-1, 0, 100], np.int8), spec.shape, p=[0.2, 0.78, 0.02])] * 2
    maps[1] = maps[0].copy()
    maps[1][100:140, 100:140] = 0
    turns = itertools.cycle(maps)
    return _median(lambda: costmap.set_map(spec, next(turns)), 4 * runs)


def _median(work: Callable[[], Any], runs: int) -> float:
    import statistics

    work()
    times = []
    for _ in range(runs):
        begin = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - begin))
    return statistics.median(times)
