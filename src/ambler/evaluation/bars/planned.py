"""Planning, costmaps and fusing scanners."""

from __future__ import annotations

from collections.abc import Sequence

from ambler.evaluation.bars.row import Judge, Row, all_of, at_most, every


def _is_planner_met(size: int, **limits: float) -> Judge:
    places = [f"{place}_{size}_" for place in limits]
    return all_of(
        *(at_most(f"{place}_{size}_", ms=limit) for place, limit in limits.items()),
        *(at_most(p, goals_missed=0) for p in places),
        lambda f: all(abs(f[p + "cost_difference"]) <= 1e-6 for p in places),
    )


_PLANNER = (
    "open {open_%d_ms:.1f}, clutter {clutter_%d_ms:.1f}, rooms {rooms_%d_ms:.1f}, serpentine {serpentine_%d_ms:.1f} ms"
)


ROWS: Sequence[Row] = (
    Row(
        "planner 1000²",
        "32.6, 36.6, 42.6, 25.0 ms; oracle's cost",
        "bench_planner.json",
        _PLANNER % ((1000,) * 4),
        _is_planner_met(1000, open=32.6, clutter=36.6, rooms=42.6, serpentine=25.0),
    ),
    Row(
        "planner 4000²",
        "818, 858, 898, 448 ms; oracle's cost",
        "bench_planner.json",
        _PLANNER % ((4000,) * 4),
        _is_planner_met(4000, open=818.0, clutter=858.0, rooms=898.0, serpentine=448.0),
    ),
    Row(
        "global paths on drawn grids: cost over that of the path down the gradient of a full potential (navfn's method)",
        "≤ 1 (integral of the cell weights along the polyline)",
        "bench_planner.json",
        "; ".join(
            f"{name} {{{name}_cost_ratio_vs_gradient_median:.4f}} median, {{{name}_cost_ratio_vs_gradient_mean:.4f}} mean, "
            f"{{{name}_dearer_paths}} of {{{name}_paths}} dearer, by {{{name}_cost_ratio_vs_gradient_max:.4f}} at most"
            for name in ("open", "clutter", "rooms")
        ),
        all_of(*(at_most(f"{name}_", dearer_paths=0) for name in ("open", "clutter", "rooms"))),
    ),
    Row(
        "local inflation 60²",
        "≤ 0.3 ms",
        "bench_costmap.json",
        "{inflation_60_ms:.3f} ms",
        at_most(inflation_60_ms=0.3),
    ),
    Row(
        "frontier search 1000²",
        "≤ 16 ms",
        "bench_frontier.json",
        "{search_1000_ms:.2f} ms; 4000² after a change {incremental_4000_ms:.2f} ms",
        at_most(search_1000_ms=16.0),
    ),
    Row("scan match", "≤ 3 ms", "bench_slam2d.json", "{match_ms:.2f} ms", at_most(match_ms=3.0)),
    Row(
        "three scanners merged, at 1 m/s and 90°/s",
        "≤ 1 cm, ≤ one scan, ≤ 2 ms per 100 thousand points",
        "bench_merger.json",
        "{noisy_wheels_carry_p99_m:.4f} m (99 %; {noisy_wheels_drives:.0f} drives with the errors of wheels and gyroscope; "
        "{wheels_alone_error_p99_m:.4f} m to the walls by the wheels alone), {latency_max_ms:.0f} of {scan_period_ms:.0f} ms, "
        "{merge_100k_points_median_cpu_ms:.2f} ms ({ratio_vs_numpy_merge_100k_points:.2f} of NumPy's)",
        lambda f: (
            f["scan_error_p99_m"] <= 0.01
            and f["noisy_wheels_carry_p99_m"] <= 0.01
            and f["latency_max_ms"] <= f["scan_period_ms"]
            and f["merge_100k_points_median_cpu_ms"] <= 2.0
        ),
    ),
    Row(
        "where three scanners of `amr_omni` sit, and their clocks",
        "≤ 5 mm, ≤ 0.1°, ≤ 2 ms in 10 mountings",
        "calibration.json",
        "{within_bars} of {runs}; worst {position_error_max_mm:.1f} mm, {yaw_error_max_deg:.3f}°, {offset_error_max_ms:.2f} ms",
        every("", "within_bars", of=10),
    ),
    Row(
        "depot and a floor plan, `diff`: random goals of known maps",
        "all reached, 0 collisions",
        "navigation.json",
        "{maps_depot_diff_reached} of {maps_depot_diff_goals} and {medium_img_13_diff_reached} of {medium_img_13_diff_goals} reached, "
        "{maps_depot_diff_collisions} and {medium_img_13_diff_collisions} collisions, "
        "{maps_depot_diff_speed_median_mps:.2f} m/s",
        all_of(*(every(p, "reached", "goals", of=200) for p in ("maps_depot_diff_", "medium_img_13_diff_"))),
    ),
)
