"""One update of the terrain analysis with clouds of a Mid-360 in a furnished hall, near and wide, and its terrain: processor time."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

from ambler.core.se3 import SE3
from ambler.kernels import terrain_columns, terrain_ground
from ambler.perception.terrain import TerrainAnalysis
from ambler.perception.terrain_config import TerrainConfig, wide
from ambler.robots.spatial_robots import mecanum
from ambler.sim.solids import WorldSpec
from ambler.studies.made_ground import LEVEL, Rover, made, slab
from ambler.studies.timing import elapsed_ms

BAR_MS = 1.0  # the near update, median
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
    terrain_columns.warm_up()
    terrain_ground.warm_up()
    model = mecanum().model
    rover = Rover(hall(seed), model, seed)
    ways = 2.0 * np.sin(np.arange(runs + UNCOUNTED) * 0.02)
    scans = [rover.scan(SE3((float(x), 0.0, LEVEL))) for x in ways]
    near = TerrainConfig().for_robot(model)
    fields: dict[str, Any] = {"runs": runs, "points": int(np.median([len(scan[0]) for scan in scans]))}
    for name, config in (("near", near), ("wide", wide(near))):
        analysis = TerrainAnalysis(config)
        updates, terrains = [], []
        for scan in scans:
            updates.append(elapsed_ms(partial(analysis.update, *scan, rover.elevation), time.thread_time))
            terrains.append(elapsed_ms(analysis.terrain, time.thread_time))
        fields[f"{name}_window_m"] = config.size
        for what, times in (("update", updates[UNCOUNTED:]), ("terrain", terrains[UNCOUNTED:])):
            fields[f"{name}_{what}_ms"] = round(float(np.median(times)), 4)
            fields[f"{name}_{what}_p95_ms"] = round(float(np.percentile(times, 95)), 4)
    return fields


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether the near update is quick enough."""
    return bool(fields["near_update_ms"] <= BAR_MS)
