"""Time of the particle update, scan matching, the EKF step and the search of the whole map, one core."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.kernels.likelihood_field import cast_ray
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.localization.localizer import Observation
from ambler.localization.particle_filter import ParticleFilter, ParticleFilterConfig, SensorModel
from ambler.localization.planar_ekf import EkfConfig, PlanarEkf
from ambler.localization.relocalizer import Relocalizer, RelocalizerConfig
from ambler.localization.surface_map import SurfaceMap
from ambler.studies.timing import elapsed_ms

BAR_PARTICLE_UPDATE_MS = 5.0
BAR_EKF_STEP_US = 50.0
START = SE2(22.5, 22.3, 0.2)


def measure(particles: int, beams: int, runs: int, seed: int) -> dict[str, Any]:
    """Return medians on a map of 50 x 50 m at 5 cm."""
    rng = np.random.default_rng(seed)
    cells, spec = _building(rng)
    SurfaceMap.from_occupancy(cells, spec)
    started = time.perf_counter()
    surfaces = SurfaceMap.from_occupancy(cells, spec)
    fields: dict[str, Any] = {
        "map_prepare_ms": 1e3 * (time.perf_counter() - started),
        "surfaces": len(surfaces.surfaces),
    }
    observations = _circle(surfaces, rng, max(runs, 20))
    fields |= _particle_fields(surfaces, observations, particles, beams, seed)
    fields |= _tracker_fields(surfaces, observations)
    fields |= _ekf_fields(rng)
    return fields


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether the particle update and the step of the EKF are quick enough."""
    return bool(fields["particle_update_ms"] <= BAR_PARTICLE_UPDATE_MS and fields["ekf_step_us"] <= BAR_EKF_STEP_US)


def _building(rng: np.random.Generator) -> tuple[NDArray[np.int8], Any]:
    """Rooms of 5 x 5 m with a door in every wall and boxes at random: int8 (1000, 1000) and its GridSpec."""
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
    angles = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    out = []
    for k in range(count):
        pose = START @ SE2.exp(np.array([0.16 * k, 0.0, 0.4 * k]))
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


def _particle_fields(
    surfaces: SurfaceMap, observations: list[Observation], count: int, beams: int, seed: int
) -> dict[str, float]:
    """Median update with a fixed number of particles: move, weigh, cluster, resample, refine; both sensor models."""
    fields: dict[str, float] = {"particles": count, "beams": beams}
    for name, model in (("particle_update_ms", SensorModel.LIKELIHOOD_FIELD), ("beam_update_ms", SensorModel.BEAM)):
        config = ParticleFilterConfig(
            sensor_model=model,
            particles_least=count,
            particles_most=count,
            max_beams=beams,
            update_way=0.0,
            recovery_fast=0.0,
        )
        particles = ParticleFilter(surfaces, config, np.random.default_rng(seed))
        particles.set_pose(0, observations[0].odom_from_base, START, np.diag([0.01, 0.01, 0.01]))
        for observation in observations[:10]:
            particles.update(observation)
        fields[name] = _median_ms(particles.update, observations[10:])
        estimate = particles.estimate
        if estimate is not None:
            error = estimate.map_from_base.distance_to(observations[-1].odom_from_base)
            fields[name.replace("update_ms", "error_m")] = error
    return fields


def _tracker_fields(surfaces: SurfaceMap, observations: list[Observation]) -> dict[str, float]:
    tracker = GridTracker(surfaces, GridTrackerConfig())
    tracker.set_pose(0, observations[0].odom_from_base, START, np.diag([0.01, 0.01, 0.01]))
    for observation in observations[:10]:
        tracker.update(observation)
    work = observations[10:]
    tracker_ms = _median_ms(tracker.update, work)
    relocalizer = Relocalizer(surfaces, RelocalizerConfig())
    relocalizer.search(work[0].points_base)
    search_ms = _median_ms(relocalizer.search, [observation.points_base for observation in work[:5]])
    return {"tracker_update_ms": tracker_ms, "relocalization_search_ms": search_ms}


def _ekf_fields(rng: np.random.Generator) -> dict[str, float]:
    """Median of one measurement, alternately wheels (50 Hz) and gyroscope (50 Hz)."""
    ekf = PlanarEkf(EkfConfig())
    covariance = np.diag([1e-3, 1e-3, 1e-3])
    twists = np.array([0.5, 0.0, 0.1]) + 0.03 * rng.standard_normal((4000, 3))

    def step(k: int) -> None:
        ekf.add_twist(k * 20_000_000, twists[k], covariance)
        ekf.add_imu(k * 20_000_000 + 10_000_000, float(twists[k, 2]), 1e-4)

    step(0)
    return {"ekf_step_us": 500.0 * _median_ms(step, range(1, 3001))}


def _median_ms(work: Callable[[Any], object], inputs: Iterable[Any]) -> float:
    """Return the median time of one call for each input."""
    return statistics.median(elapsed_ms(partial(work, value)) for value in inputs)
