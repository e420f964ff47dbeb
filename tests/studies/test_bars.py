"""The exit codes of the benchmarks: what misses its bar, and what may be missing."""

from __future__ import annotations

from typing import Any

import pytest

from ambler.studies import bench_costmap, bench_planner, bench_posegraph

COSTMAP = {
    "inflation_60_ms": 0.05,
    "inflation_60_cells_wrong": 0,
    "inflation_200_ms": 2.0,
    "inflation_200_cells_wrong": 0,
}
PLANNER = {"open_1000_ms": 2.0, "open_1000_cost_difference": 0.0, "open_1000_goals_missed": 0, "open_300_ms": 99.0}
POSEGRAPH = {"intel_chi2": 45.0047, "ratio_vs_gtsam_intel": 0.5, "ratio_vs_gtsam_intel_with_build": 1.5}
POSEGRAPH |= {"MIT_from_odometry_chi2": 41.1633, "MIT_from_odometry_is_converged": True}


@pytest.mark.parametrize(
    ("module", "good", "missed"),
    [
        (bench_costmap, COSTMAP, {"inflation_60_ms": 0.31}),
        (bench_costmap, COSTMAP, {"inflation_200_cells_wrong": 1}),
        (bench_planner, PLANNER, {"open_1000_ms": 33.0}),
        (bench_planner, PLANNER, {"open_1000_cost_difference": 1.0}),
        (bench_planner, PLANNER, {"open_300_goals_missed": 1}),
        (bench_posegraph, POSEGRAPH, {"intel_chi2": 45.1}),
        (bench_posegraph, POSEGRAPH, {"ratio_vs_gtsam_intel": 1.01}),
        (bench_posegraph, POSEGRAPH, {"MIT_from_odometry_chi2": 41.0}),
        (bench_posegraph, POSEGRAPH, {"MIT_from_odometry_is_converged": False}),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_missed_bar_is_told(module: Any, good: dict[str, Any], missed: dict[str, Any]) -> None:
    assert module.meets_bars(good)
    assert not module.meets_bars(good | missed)


def test_what_was_not_measured_misses_no_bar() -> None:
    assert bench_costmap.meets_bars({"inflation_200_ms": 2.0, "inflation_200_cells_wrong": 0})
    assert bench_planner.meets_bars({"open_4000_ms": 818.0})
    assert bench_posegraph.meets_bars({"intel_chi2": 45.0047})
