"""One update of the terrain analysis with clouds of a Mid-360 in a furnished hall, near and wide, and its terrain; the scoring of motion primitives by
what the local costmap makes of it: processor time."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ambler.control.local_window import LocalWindow
from ambler.control.motion_primitives import MotionPrimitives
from ambler.control.primitive_choice import PrimitiveChooser
from ambler.control.primitives_config import PrimitivesConfig
from ambler.core.errors import NoValidControlError
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.costmap.terrain_layer import TerrainLayer
from ambler.kernels import (
    footprint,
    primitives,
    rollout,
    terrain_columns,
    terrain_edges,
    terrain_ground,
    terrain_stairs,
    terrain_steps,
)
from ambler.perception.terrain import Ground, Terrain, TerrainAnalysis
from ambler.perception.terrain_config import TerrainConfig, wide
from ambler.robots.spatial_robots import mecanum
from ambler.sim.solids import WorldSpec
from ambler.studies.made_ground import LEVEL, Rover, made, slab
from ambler.studies.timing import elapsed_ms

BAR_MS = 1.0  # the near update, and the scoring of primitives: medians
POINTS = 1000  # of obstacles by which primitives are scored
UNCOUNTED = 10


def hall(seed: int) -> WorldSpec:
    """Return a closed hall of 12 x 12 m with boxes in it: every beam of a Mid-360 comes back, 20 000 points a cloud."""
    rng = np.random.default_rng(seed)
    walls = [
        slab(x0, x1, y0, y1, 2.5)
        for x0, x1, y0, y1 in (
            (-6.2, -6.0, -6.0, 6.0),
            (6.0, 6.2, -6.0, 6.0),
            (-6.0, 6.0, -6.2, -6.0),
            (-6.0, 6.0, 6.0, 6.2),
        )
    ]
    boxes = []
    for _ in range(12):
        x, y = float(rng.uniform(-5.5, 4.5)), float(rng.choice([-1.0, 1.0]) * rng.uniform(1.2, 5.0))
        boxes.append(
            slab(x, x + float(rng.uniform(0.2, 1.0)), y, y + float(rng.uniform(0.2, 1.0)), float(rng.uniform(0.3, 2.0)))
        )
    return made(slab(-20.0, 20.0, -20.0, 20.0), *walls, *boxes, ceiling=LEVEL + 2.5)


def measure(runs: int, seed: int) -> dict[str, Any]:
    """Return medians and 95th percentiles, milliseconds of this thread."""
    for module in (terrain_columns, terrain_ground, terrain_steps, terrain_edges, terrain_stairs):
        module.warm_up()
    model = mecanum().model
    rover = Rover(hall(seed), model, seed)
    ways = 2.0 * np.sin(np.arange(runs + UNCOUNTED) * 0.02)
    scans = [rover.scan(SE3((float(x), 0.0, LEVEL))) for x in ways]
    own = TerrainConfig().for_robot(model)  # the window of a robot that sees the floor from 5 m away on
    near = replace(own, columns=TerrainConfig().columns)
    fields: dict[str, Any] = {"runs": runs, "points": int(np.median([len(scan[0]) for scan in scans]))}
    for name, config in (("near", near), ("level_lidar", own), ("wide", wide(near))):
        analysis = TerrainAnalysis(config)
        updates, terrains = [], []
        for scan in scans:
            updates.append(elapsed_ms(partial(analysis.update, *scan, rover.elevation), time.thread_time))
            terrains.append(elapsed_ms(analysis.terrain, time.thread_time))
        fields[f"{name}_window_m"] = config.size
        for what, times in (("update", updates[UNCOUNTED:]), ("terrain", terrains[UNCOUNTED:])):
            fields[f"{name}_{what}_ms"] = round(float(np.median(times)), 4)
            fields[f"{name}_{what}_p95_ms"] = round(float(np.percentile(times, 95)), 4)
        if name == "near":
            fields |= primitive_times(model, analysis.terrain(), runs, seed)
    return fields


def primitive_times(model: RobotModel, terrain: Terrain, runs: int, seed: int) -> dict[str, Any]:
    """Return the times of scoring all paths by `POINTS` points of a local costmap made of a terrain, and of whole cycles of the local planner on it, at
    random places of it and towards random bearings."""
    for kernels in (footprint, rollout, primitives):
        kernels.warm_up()
    rng = np.random.default_rng(seed)
    config = PrimitivesConfig()
    window = LocalWindow(model, config.padding)
    chooser = PrimitiveChooser(config, model, window)
    layer = TerrainLayer()
    costmap = LocalCostmap(LocalCostmapConfig(), model, (layer,))
    x0, y0 = terrain.spec.center_of(terrain.spec.height // 2, terrain.spec.width // 2)
    is_cell = terrain.kinds != Ground.UNKNOWN
    planner = MotionPrimitives(config, model)
    scoring, cycles, seen = [], [], []
    for k in range(runs + UNCOUNTED):
        dx, dy, yaw = rng.uniform(-2.5, 2.5), rng.uniform(-2.5, 2.5), rng.uniform(-np.pi, np.pi)
        here = SE2(x0 + float(dx), y0 + float(dy), float(yaw))
        layer.set_terrain(terrain.points[:, :2].astype(np.float64), terrain.points[:, 3], is_cell)
        costmap.update(here)
        window.update(costmap.costs, costmap.spec)
        points, levels = chooser.seen(here, np.empty((0, 2)))
        if len(points) == 0:
            continue
        seen.append(len(points))
        drawn = rng.permutation(max(POINTS, len(points)))[:POINTS] % len(points)
        bearing = float(rng.uniform(-np.pi, np.pi))
        work = partial(chooser.best_group, points[drawn], levels[drawn], bearing)
        elapsed = elapsed_ms(work, time.thread_time)
        cycle = elapsed_ms(partial(_plan, planner, costmap, here, bearing), time.thread_time)
        if k >= UNCOUNTED:
            scoring.append(elapsed)
            cycles.append(cycle)
    return {
        "primitives_points": POINTS,
        "primitives_points_seen": int(np.median(seen)),
        "primitives_scoring_ms": round(float(np.median(scoring)), 4),
        "primitives_scoring_p95_ms": round(float(np.percentile(scoring, 95)), 4),
        "primitives_cycle_ms": round(float(np.median(cycles)), 4),
        "primitives_cycle_p95_ms": round(float(np.percentile(cycles, 95)), 4),
    }


def _plan(planner: MotionPrimitives, costmap: LocalCostmap, here: SE2, bearing: float) -> None:
    """One cycle towards a way-point of 8 m."""
    end = here @ SE2(8.0 * np.cos(bearing), 8.0 * np.sin(bearing), bearing)
    planner.set_path(np.array([here.as_array(), end.as_array()]))
    try:
        planner.compute_command(costmap.costs, costmap.spec, here, BodyVelocity(0.3))
    except NoValidControlError:
        return


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether the near update and the scoring of primitives are quick enough."""
    return bool(max(fields["near_update_ms"], fields["primitives_scoring_ms"]) <= BAR_MS)
