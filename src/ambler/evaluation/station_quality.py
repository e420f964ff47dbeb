"""How dense and how exact the clouds of stations are, by the surfaces of the simulated world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import truth_at
from ambler.sim.scene import RayScene
from ambler.sim.surface_distance import surface_distances
from ambler.wire.station_files import StationCloud

F64 = NDArray[np.float64]
JUDGED = 20_000  # points of a station
STRAY = 0.15  # metres from every surface: people, edges, what floats in the air
GAP = 0.2  # seconds between true poses


@dataclass(frozen=True, slots=True, eq=False)
class StationQuality:
    """Of `count` stations: medians of the seconds that they held, of their points, and of how many times as many that is as one scan's; the distances of their
    points from true surfaces (m, median and 95 %) with the stations where the map has them, and where they truly were; the share of points farther than
    `STRAY`. None: there is none."""

    count: int
    seconds: float | None = None
    points: float | None = None
    density: float | None = None
    median: float | None = None
    p95: float | None = None
    true_median: float | None = None
    true_p95: float | None = None
    stray: float | None = None

    def fields(self) -> dict[str, Any]:
        """Return the numbers as they go into JSON."""
        return {
            "stations": self.count,
            "station_seconds_median": self.seconds,
            "station_points_median": self.points,
            "station_ratio_vs_one_scan_median": self.density,
            "station_surface_median_m": self.median,
            "station_surface_p95_m": self.p95,
            "station_at_truth_surface_median_m": self.true_median,
            "station_at_truth_surface_p95_m": self.true_p95,
            "station_stray_ratio": self.stray,
        }


def judge_stations(
    stations: Sequence[StationCloud],
    world_from_map: SE3,
    truth: tuple[NDArray[np.int64], Sequence[SE3]],
    scene: RayScene,
) -> StationQuality:
    """Compare the clouds of stations with the world; `truth` are stamps and true poses of the base in it."""
    if not stations:
        return StationQuality(0)
    in_map, at_truth = [], []
    for station in stations:
        points = station.points[:: max(1, len(station.points) // JUDGED)].astype(np.float64)
        in_map.append(surface_distances(scene, (world_from_map @ station.map_from_base).transform(points)))
        world_from_base = truth_at(station.stamp_ns, *truth, GAP)
        if world_from_base is not None:
            at_truth.append(surface_distances(scene, world_from_base.transform(points)))
    distances = np.concatenate(in_map)
    median, p95 = _quantiles(distances)
    true_median, true_p95 = _quantiles(np.concatenate(at_truth)) if at_truth else (None, None)
    return StationQuality(
        count=len(stations),
        seconds=float(np.median([s.seconds for s in stations])),
        points=float(np.median([len(s.points) for s in stations])),
        density=float(np.median([s.density for s in stations])),
        median=median,
        p95=p95,
        true_median=true_median,
        true_p95=true_p95,
        stray=float(np.mean(distances > STRAY)),
    )


def _quantiles(distances: F64) -> tuple[float | None, float | None]:
    """Return median and 95 %; None where that is farther than anything that is looked for."""
    found = [float(np.quantile(distances, q, method="lower")) for q in (0.5, 0.95)]
    median, p95 = (value if np.isfinite(value) else None for value in found)
    return median, p95
