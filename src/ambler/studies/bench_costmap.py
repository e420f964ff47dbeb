"""Inflation and the update of a rolling window, beside SciPy's distance transform.

All times are those of the processor, one thread."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ambler.core.grid import GridSpec
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.inflation import cost_table
from ambler.costmap.layer import Moment
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.costmap.obstacle_layer import ObstacleLayer, SensorRays
from ambler.costmap.voxel_layer import VoxelConfig, VoxelLayer, view_of_cloud, view_of_depth
from ambler.kernels.distance_transform import inflate
from ambler.robots.depth import optical
from ambler.sim.depth_camera import DepthCameraSensor
from ambler.sim.lidar import LidarSensor
from ambler.sim.scene import build_scene
from ambler.sim.sensors import D430, VLP_16
from ambler.studies.made_overhangs import room_world
from ambler.studies.planner_worlds import inflated, make_world
from ambler.studies.timing import median_ms

BAR_LOCAL_MS = 0.3


def measure(sizes: Sequence[int], runs: int, seed: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Measure grids of `sizes` squared cells and both costmaps; tells a line of each. Returns processor milliseconds, medians."""
    fields: dict[str, Any] = {}
    for n in sizes:
        cells = make_world("clutter", max(n, 200), np.random.default_rng(seed))[-n:, -n:].copy()
        fields |= _inflation(cells, n, runs)
        tell(
            f"inflation {n} x {n}: {fields[f'inflation_{n}_ms']:.3f} ms,"
            f" a changed 3 m box {fields[f'inflation_{n}_box_3m_ms']:.3f} ms,"
            f" SciPy {fields[f'peer_scipy_inflation_{n}_ms']:.2f} ms, cells wrong {fields[f'inflation_{n}_cells_wrong']}"
        )
    fields["local_update_ms"] = _local_update(runs)
    tell(f"local costmap, 6 m, 720 rays: {fields['local_update_ms']:.3f} ms per update")
    fields["global_update_1000_ms"] = _global_update(runs)
    tell(f"global costmap, 1000 x 1000, 2 m changed: {fields['global_update_1000_ms']:.3f} ms per map")
    fields |= _voxels(runs)
    tell(
        f"voxel layer, 6 m: {fields['voxel_depth_ms']:.3f} ms per depth picture of 106 x 60,"
        f" {fields['voxel_cloud_ms']:.3f} ms per cloud of {fields['voxel_cloud_points']} points"
    )
    return fields


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether every cell is SciPy's, and a window of 60 x 60 cells, if measured, is inflated in time."""
    is_right = all(wrong == 0 for name, wrong in fields.items() if name.endswith("_cells_wrong"))
    return is_right and bool(fields.get("inflation_60_ms", 0.0) <= BAR_LOCAL_MS)


def _inflation(cells: NDArray[np.uint8], n: int, runs: int) -> dict[str, Any]:
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
    return {
        f"inflation_{n}_ms": full,
        f"inflation_{n}_box_3m_ms": box,
        f"inflation_{n}_cells_wrong": wrong,
        f"peer_scipy_inflation_{n}_ms": peer,
        f"ratio_vs_scipy_inflation_{n}": full / peer,
    }


def _local_update(runs: int) -> float:
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
    footprint = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
    robot = RobotModel("bench", DriveKind.DIFFERENTIAL, footprint, VelocityLimits())
    costmap, spec = GlobalCostmap(GlobalCostmapConfig(), robot), GridSpec(0.05, 1000, 1000, 0.0, 0.0)
    chance = np.random.default_rng(0)
    maps = [chance.choice(np.array([-1, 0, 100], np.int8), spec.shape, p=[0.2, 0.78, 0.02])] * 2
    maps[1] = maps[0].copy()
    maps[1][100:140, 100:140] = 0
    turns = itertools.cycle(maps)
    return _median(lambda: costmap.set_map(spec, next(turns)), 4 * runs)


def _voxels(runs: int) -> dict[str, Any]:
    """What a depth picture and a cloud cost a local window in an office's worth of tables, from the message's array to the drawn cells."""
    world = room_world(0).from_start()
    scene, config = build_scene(world), VoxelConfig()
    cells = math.ceil(LocalCostmapConfig().size / LocalCostmapConfig().resolution)
    spec = GridSpec(0.05, cells, cells, -0.5, -3.0)
    pose, mount = optical((0.25, 0.0, 1.12), 0.0, 20.0), SE3((0.0, 0.0, 0.78))
    depth = DepthCameraSensor(D430, "depth", scene, 0).take(pose, 0).depth
    lidar, still = LidarSensor(VLP_16, "velodyne", scene, 0), np.array([0.0, 0.1])
    lidar.sweep(still, np.array([mount.translation] * 2), np.array([mount.rotation] * 2))
    cloud = lidar.to_cloud(0)
    layers = [VoxelLayer(config, 1.15), VoxelLayer(config, 0.83)]
    poses, elevation = mount.matrix()[None, :3].copy(), (VLP_16.elevations[0], VLP_16.elevations[-1])

    def see_depth() -> None:
        layers[0].add(view_of_depth(depth, D430.model, pose, 0.0, D430.range_min, D430.range_max))
        layers[0].update(spec, Moment())

    def see_cloud() -> None:
        layers[1].add(view_of_cloud(cloud.points, cloud.time, poses, 1.0, 0.0, VLP_16.range_min, elevation, config))
        layers[1].update(spec, Moment())

    return {
        "voxel_depth_ms": _median(see_depth, 20 * runs),
        "voxel_cloud_ms": _median(see_cloud, 20 * runs),
        "voxel_cloud_points": len(cloud.points),
    }


def _median(work: Callable[[], object], runs: int) -> float:
    return median_ms(work, runs, time.process_time, uncounted_runs=1)
