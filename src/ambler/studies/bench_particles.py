"""`ambler bench particles`: time of the particle update, scan matching, the EKF step and the search of the whole map, one core."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from ambler.core.se2 import SE2
    from ambler.localization.localizer import Observation
    from ambler.localization.surface_map import SurfaceMap

PARTICLE_UPDATE_MS = 5.0
EKF_STEP_US = 50.0


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("particles", help="particle filter, grid tracker, EKF and relocalization: times")
    parser.add_argument("--particles", type=int, default=2000)
    parser.add_argument("--beams", type=int, default=60)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure on a map of 50 x 50 m at 5 cm; exit 1 when the particle update or the EKF step is slower than its bar."""
    import numpy as np

    from ambler.evaluation.results import write_results
    from ambler.localization.surface_map import SurfaceMap

    begin = time.perf_counter()
    rng = np.random.default_rng(args.seed)
    cells, spec = _building(rng)
    SurfaceMap.from_occupancy(cells, spec)
    started = time.perf_counter()
    surfaces = SurfaceMap.from_occupancy(cells, spec)
    fields: dict[str, Any] = {
        "map_prepare_ms": 1e3 * (time.perf_counter() - started),
        "surfaces": len(surfaces.surfaces),
    }
    observations = _circle(surfaces, rng, max(args.runs, 20))
    fields |= _particle_fields(surfaces, observations, args)
    fields |= _tracker_fields(surfaces, observations)
    fields |= _ekf_fields(rng)
    for name, value in fields.items():
        print(f"{name:28s} {value:10.3f}" if isinstance(value, float) else f"{name:28s} {value:10d}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    is_good = fields["particle_update_ms"] <= PARTICLE_UPDATE_MS and fields["ekf_step_us"] <= EKF_STEP_US
    return 0 if is_good else 1


def _building(rng: np.random.Generator) -> tuple[NDArray[np.int8], Any]:
    """Rooms of 5 x 5 m with a door in every wall and boxes at random: int8 (1000, 1000) and its GridSpec."""
    import numpy as np

    from ambler.core.grid import GridSpec

    cells = np.zeros((1000, 1000), np.int8)
    for k in range(0, 1001, 100):
        line = slice(max(0, k - 1), k + 1)
        cells[line, :] = 100
        cells[:, line] = 100
    for iy in range(10):
        for ix in range(10):
            door = int(rng.integers(20, 60))
            if ix < 9:
                cells[iy * 100 + door : iy * 100 + door + 20, ix * 100 + 98 : ix * 100 + 102] = 0
            if iy < 9:
                cells[iy * 100 + 98 : iy * 100 + 102, ix * 100 + door : ix * 100 + door + 20] = 0
            for _ in range(2):
                y, x = (int(v) for v in rng.integers(8, 80, 2) + np.array([100 * iy, 100 * ix]))
                height, width = rng.integers(4, 14, 2)
                if abs(y - 100 * iy - 50) > 22 or abs(x - 100 * ix - 50) > 22:
                    cells[y : y + height, x : x + width] = 100
    return cells, GridSpec(0.05, 1000, 1000, 0.0, 0.0)


def _circle(surfaces: SurfaceMap, rng: np.random.Generator, count: int) -> list[Observation]:
    """Scans of 720 beams with 1 cm noise on a circle of 0.4 m in the middle room."""
    import math

    import numpy as np

    from ambler.core.se2 import SE2
    from ambler.kernels.likelihood_field import cast_ray
    from ambler.localization.localizer import Observation

    angles = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    out = []
    for k in range(count):
        pose = _start() @ SE2.exp(np.array([0.16 * k, 0.0, 0.4 * k]))
        ranges = np.array(
            [
                cast_ray(
                    surfaces.cells, surfaces.frame, pose.x, pose.y, math.cos(a + pose.yaw), math.sin(a + pose.yaw), 25.0
                )
                for a in angles
            ]
        )
        ranges += 0.01 * rng.standard_normal(720)
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1).astype(np.float32)
        out.append(Observation(k * 100_000_000, pose, points))
    return out


def _start() -> SE2:
    from ambler.core.se2 import SE2

    return SE2(22.5, 22.3, 0.2)


def _median_ms(work: Callable[[int], Any], count: int) -> float:
    import statistics

    samples = []
    for k in range(count):
        begin = time.perf_counter()
        work(k)
        samples.append(1e3 * (time.perf_counter() - begin))
    return statistics.median(samples)


def _particle_fields(
    surfaces: SurfaceMap, observations: list[Observation], args: argparse.Namespace
) -> dict[str, float]:
    """Median update with a fixed number of particles: move, weigh, cluster, resample, refine; both sensor models."""
    import numpy as np

    from ambler.localization.particle_filter import ParticleFilter, ParticleFilterConfig, SensorModel

    fields: dict[str, float] = {"particles": args.particles, "beams": args.beams}
    for name, model in (("particle_update_ms", SensorModel.LIKELIHOOD_FIELD), ("beam_update_ms", SensorModel.BEAM)):
        config = ParticleFilterConfig(
            sensor_model=model,
            particles_least=args.particles,
            particles_most=args.particles,
            max_beams=args.beams,
            update_way=0.0,
            recovery_fast=0.0,
        )
        particles = ParticleFilter(surfaces, config, np.random.default_rng(args.seed))
        particles.set_pose(0, observations[0].odom_from_base, _start(), np.diag([0.01, 0.01, 0.01]))
        for observation in observations[:10]:
            particles.update(observation)
        work = observations[10:]
        fields[name] = _median_ms(lambda k, p=particles, w=work: p.update(w[k]), len(work))  # type: ignore[misc]
        estimate = particles.estimate
        if estimate is not None:
            error = estimate.map_from_base.distance_to(observations[-1].odom_from_base)
            fields[name.replace("update_ms", "error_m")] = error
    return fields


def _tracker_fields(surfaces: SurfaceMap, observations: list[Observation]) -> dict[str, float]:
    import numpy as np

    from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
    from ambler.localization.relocalizer import Relocalizer, RelocalizerConfig

    tracker = GridTracker(surfaces, GridTrackerConfig())
    tracker.set_pose(0, observations[0].odom_from_base, _start(), np.diag([0.01, 0.01, 0.01]))
    for observation in observations[:10]:
        tracker.update(observation)
    work = observations[10:]
    tracker_ms = _median_ms(lambda k: tracker.update(work[k]), len(work))
    relocalizer = Relocalizer(surfaces, RelocalizerConfig())
    relocalizer.search(work[0].points_base)
    search_ms = _median_ms(lambda k: relocalizer.search(work[k].points_base), 5)
    return {"tracker_update_ms": tracker_ms, "relocalization_search_ms": search_ms}


def _ekf_fields(rng: np.random.Generator) -> dict[str, float]:
    """Median of one measurement, alternately wheels (50 Hz) and gyroscope (50 Hz)."""
    import numpy as np

    from ambler.localization.planar_ekf import EkfConfig, PlanarEkf

    ekf = PlanarEkf(EkfConfig())
    covariance = np.diag([1e-3, 1e-3, 1e-3])
    twists = np.array([0.5, 0.0, 0.1]) + 0.03 * rng.standard_normal((4000, 3))

    def step(k: int) -> None:
        ekf.add_twist(k * 20_000_000, twists[k], covariance)
        ekf.add_imu(k * 20_000_000 + 10_000_000, float(twists[k, 2]), 1e-4)

    step(0)
    return {"ekf_step_us": 500.0 * _median_ms(lambda k: step(k + 1), 3000)}
