"""The stages of 2-D SLAM on the scans of a simulated drive through the office, one thread, medians in milliseconds."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.perception.planar import PlanarConfig, scan_to_points
from ambler.registration.correlative import Window, correlate
from ambler.registration.gauss_newton import refine
from ambler.registration.planar_scan import PlanarScan, filter_voxels, filter_voxels_adaptively
from ambler.sim.robots import robot_named
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.world_file import load_world
from ambler.slam2d.config import FrontEndConfig, Slam2dConfig
from ambler.slam2d.slam import Slam2d
from ambler.slam2d.submaps import ActiveSubmaps
from ambler.studies.timing import elapsed_ms, median_ms

PERIOD_NS = 100_000_000
BAR_MATCH_MS = 3.0


def measure(seed: int, scans: int) -> dict[str, float]:
    """Return medians: `match_ms` is the whole match (filters, a window of 0.1 m and 20 degrees, refinement), `refine_ms` its last
    part, `insert_ms` one scan into both active submaps, `update_ms` a whole update of `Slam2d`, `render_ms` the map."""
    config = FrontEndConfig()
    slam = Slam2d(Slam2dConfig())
    active = ActiveSubmaps(config.insertion, config.scans_per_submap)
    rng = np.random.default_rng(seed)
    times: dict[str, list[float]] = {name: [] for name in ("match", "refine", "insert", "update")}
    for scan, pose in drive(seed, scans):
        target = active.target
        if target is not None:
            prior = target.to_submap(pose) @ SE2(*rng.normal(0.0, [0.03, 0.03, 0.02]))

            def match(scan: PlanarScan = scan, target: Any = target, prior: SE2 = prior) -> None:
                points = filter_voxels_adaptively(
                    filter_voxels(scan.points, config.voxel_size), config.match_max_voxel, config.match_min_points
                )
                start = correlate(target.grid, points, prior, Window()).grid_from_base
                fine = partial(refine, target.grid, points, start, prior, config.refine)
                times["refine"].append(elapsed_ms(fine))

            times["match"].append(elapsed_ms(match))
        times["insert"].append(elapsed_ms(partial(active.insert, scan, pose)))
        times["update"].append(elapsed_ms(partial(slam.update, scan)))
    result = {f"{name}_ms": float(np.median(values)) for name, values in times.items()}
    return {**result, "render_ms": median_ms(slam.render_map, 9), "scans": float(scans)}


def meets_bars(fields: dict[str, float]) -> bool:
    """Whether a match is quick enough."""
    return fields["match_ms"] <= BAR_MATCH_MS


def drive(seed: int, scans: int) -> list[tuple[PlanarScan, SE2]]:
    """Drive `diff` back and forth along the office's corridor; returns planar scans with the true poses at their stamps."""
    robot = robot_named("diff")
    simulation = Simulation(load_world("office"), robot, SimulationConfig(seed))
    mount = robot.model.sensor("laser").base_from_sensor
    out: list[tuple[PlanarScan, SE2]] = []
    now_ns, pose = 0, simulation.start_from_base.to_se2()
    while len(out) < scans:
        phase = (now_ns // 10_000_000_000) % 2
        simulation.command(BodyVelocity(0.5 if phase == 0 else -0.25, 0.0, 0.15))
        now_ns += PERIOD_NS
        step = simulation.step(now_ns)
        after = simulation.start_from_base.to_se2()
        twist = (pose.inverse() @ after).log() / (PERIOD_NS * 1e-9)
        out += [(scan_to_points(scan, mount, twist, PlanarConfig(range_max=20.0)), pose) for scan in step.scans]
        pose = after
    return out
