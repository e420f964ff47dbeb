"""The tables of results, made from the files in docs/results: all rows in docs/results.md, the headlines in the README."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.docking import shapes_table, table

Judge = Callable[[dict[str, Any]], bool]


@dataclass(frozen=True, slots=True)
class Row:
    """One line: `text` is a format string over the fields of `file`, whose dots are written as underscores; `is_met` judges them."""

    what: str
    bar: str
    file: str
    text: str
    is_met: Judge


def _all(*judges: Judge) -> Judge:
    return lambda fields: all(judge(fields) for judge in judges)


def _at_most(prefix: str = "", /, **limits: float) -> Judge:
    return lambda fields: all(fields[prefix + name] <= limit for name, limit in limits.items())


def _at_least(prefix: str = "", /, **limits: float) -> Judge:
    return lambda fields: all(fields[prefix + name] >= limit for name, limit in limits.items())


def _every(prefix: str, good: str, runs: str = "runs", *, of: int = 1, collisions: str = "collisions") -> Judge:
    """Every one of at least `of` runs is good, and nothing was hit."""
    return lambda f: f[prefix + good] == f[prefix + runs] >= of and f.get(prefix + collisions, 0) == 0


def _is_reported(fields: dict[str, Any]) -> bool:
    """A row without a bar: the number is told, nothing is claimed."""
    return True


def _explored(world: str, robot: str) -> str:
    p = f"{world}_{robot}_tour_"
    return (
        f"{{{p}finished}} of {{{p}runs}} with proof, {{{p}collisions}} collisions; coverage {{{p}coverage_ratio_median:.2%}} "
        f"(worst {{{p}coverage_ratio_worst:.2%}}), NNE {{{p}nne_cells_median:.2f}} / {{{p}nne_reverse_cells_median:.2f}} cells, "
        f"SSIM {{{p}ssim_median:.3f}}, trajectory error {{{p}ate_rms_m_median:.3f}} m (worst {{{p}ate_rms_m_worst:.3f}})"
    )


def _is_explored(world: str, robot: str, runs: int, *judges: Judge) -> Judge:
    return _all(_every(f"{world}_{robot}_tour_", "finished", of=runs), *judges)


def _is_lab_met(world: str) -> Judge:
    p = f"{world}_spot_tour_"
    return _is_explored(
        world,
        "spot",
        5,
        _at_least(p, coverage_ratio_median=0.99, ssim_median=0.9),
        _at_most(p, nne_cells_median=0.8, nne_reverse_cells_median=0.8),
    )


def _is_office_met(robot: str) -> Judge:
    p = f"office_{robot}_tour_"
    return _is_explored("office", robot, 3, _at_least(p, coverage_ratio_worst=0.98), _at_most(p, ate_rms_m_worst=0.05))


def _is_world_met(world: str, error: float = 0.05) -> Judge:
    prefixes = [f"{world}_{robot}_tour_" for robot in ("amr_omni", "diff")]
    return _all(
        *(_every(p, "finished", of=3) for p in prefixes),
        *(_at_least(p, reachable_coverage_ratio_worst=0.98) for p in prefixes),
        *(_at_most(p, ate_rms_m_worst=error) for p in prefixes),
    )


def _is_planner_met(size: int, **limits: float) -> Judge:
    places = [f"{place}_{size}_" for place in limits]
    return _all(
        *(_at_most(f"{place}_{size}_", ms=limit) for place, limit in limits.items()),
        *(_at_most(p, goals_missed=0) for p in places),
        lambda f: all(abs(f[p + "cost_difference"]) <= 1e-6 for p in places),
    )


def _is_docked(fields: dict[str, Any]) -> bool:
    limits = _at_most(position_error_p95_m=0.003, yaw_error_p95_deg=0.1, position_error_max_m=0.008)
    return _every("", "within_two_attempts", of=60)(fields) and limits(fields)


def _explored_briefly(world: str, robots: Sequence[str] = ("amr_omni", "diff")) -> str:
    parts = []
    for robot in robots:
        p = f"{world}_{robot}_tour_"
        parts.append(
            f"`{robot}` {{{p}finished}} of {{{p}runs}} with proof, {{{p}collisions}} collisions, worst "
            f"{{{p}reachable_coverage_ratio_worst:.2%}} and {{{p}ate_rms_m_worst:.3f}} m"
        )
    return "; ".join(parts)


_WIDE_BAR = "≥ 98 % of the reachable floor, 0 collisions, proof, ≤ 0.05 m"
_LAB_BAR = "coverage ≥ 99 %, NNE ≤ 0.8, SSIM ≥ 0.9"
_OFFICE_BAR = "≥ 98 %, 0 collisions, proof, ≤ 0.05 m"
_KEYFRAMES = (
    "{ate_rms_m:.2f} m; {revisits} revisits: {revisit_error_median_m:.3f} m, worst {revisit_error_worst_m:.2f} m"
)
_KEYFRAMES_MET = _all(
    _at_most(ate_rms_m=0.5, revisit_error_median_m=0.15, revisit_error_worst_m=1.0),
    lambda f: f["scans"] >= 100.0 * f["cpu_seconds"],
)
_LOG = (
    "{translation_mean_m:.4f} ± {translation_std_m:.4f} m, {rotation_mean_deg:.3f} ± {rotation_std_deg:.3f}°, "
    "{real_time_factor:.0f} × real time, {loop_closures} loop closures"
)
_PLANNER = (
    "open {open_%d_ms:.1f}, clutter {clutter_%d_ms:.1f}, rooms {rooms_%d_ms:.1f}, serpentine {serpentine_%d_ms:.1f} ms"
)


def _is_short(f: dict[str, Any]) -> bool:
    """Whether `tour` drives at most twice the tour with full knowledge, and less than the other strategies."""
    mine, others = "tour_ratio_vs_known_tour_median", ("nearest", "greedy")
    return f[mine] <= 2.0 and all(f["tour_path_total_m_mean"] < f[f"{name}_path_total_m_mean"] for name in others)


_VERBS = ("explore", "navigate", "navigate_lost", "dock", "undock")
_DISTURBANCES = ("stalled_disk", "full_disk", "recorder_raises", "log_raises")


def _is_localized(fields: dict[str, Any], localizer: str) -> bool:
    names = [f"{place}_{localizer}_" for place in ("aisle", "wall", "building")]
    return all(fields[n + "error_rms_m"] <= 0.01 and 0.5 <= fields[n + "nees_mean"] <= 2.0 for n in names)


ROWS: Sequence[Row] = (
    Row(
        "`./run.sh --exit`: office, `diff`, everything included",
        "≥ 4 × real time, < 1 GB",
        "run_office.json",
        "{real_time_factor:.1f} × real time, {peak_memory_mb:.0f} MB, coverage {coverage_ratio:.2%}, {collisions} collisions",
        _all(_at_least(real_time_factor=4.0, coverage_ratio=0.98), _at_most(peak_memory_mb=1000.0, collisions=0)),
    ),
    Row(
        "the same beside commit eb03a49, alternating",
        "≤ 1.1 × its time",
        "two_commits.json",
        "{office_diff_run_seconds_ratio:.2f} × its time ({office_diff_new_run_seconds:.1f} against {office_diff_old_run_seconds:.1f} s; runs of "
        "each: {runs}); coverage {office_diff_new_coverage_ratio:.2%} against {office_diff_old_coverage_ratio:.2%}",
        _at_most(office_diff_run_seconds_ratio=1.1),
    ),
    Row(
        "`lab_empty`, `spot`, 5 seeds (source: 99.04 % / 0.81 / 0.89)",
        _LAB_BAR,
        "exploration_lab.json",
        _explored("lab_empty", "spot"),
        _is_lab_met("lab_empty"),
    ),
    Row(
        "`lab_obstacle`, `spot`, 5 seeds (source: 89.04 % / 5.30 / 0.82)",
        _LAB_BAR,
        "exploration_lab.json",
        _explored("lab_obstacle", "spot"),
        _is_lab_met("lab_obstacle"),
    ),
    *(
        Row(
            f"`office`, `{robot}`, 3 seeds",
            _OFFICE_BAR,
            f"exploration_office_{robot}.json",
            _explored("office", robot),
            _is_office_met(robot),
        )
        for robot in ("diff", "spot")
    ),
    Row(
        "explorations of drawn plans of at most 1500 m² that nobody had seen",
        "≥ 98 % of the reachable floor with proof in 59 of 60, 0 collisions; in the frame of the start ≤ 0.05 m (median), ≤ 0.10 m (95 %); recoveries ≤ 5 %",
        "exploration_fresh.json",
        "{fresh_all_done} of {fresh_all_runs} ({fresh_all_done_ratio_low_95:.0%} to {fresh_all_done_ratio_high_95:.0%}), {fresh_all_collisions} "
        "collisions; {fresh_all_start_rms_m_median:.3f} m, {fresh_all_start_rms_m_95:.3f} m, worst {fresh_all_start_max_m_worst:.2f} m; "
        "recoveries {fresh_all_recovery_time_ratio:.1%}",
        _all(
            lambda f: f["fresh_all_done"] * 60 >= 59 * f["fresh_all_runs"] and f["fresh_all_runs"] >= 60,
            _at_most("fresh_all_", collisions=0, start_rms_m_median=0.05, start_rms_m_95=0.1, recovery_time_ratio=0.05),
        ),
    ),
    Row(
        "drawn campuses, dense scans, loops of 0.3 to 1 km",
        "no false closure, bent by ≤ 0.3 m in 20 of 20, error ≤ 0.1 m (median)",
        "campus.json",
        "{maps_good} of {runs} maps, {false_closures} false closures; error {ate_rms_m_median:.3f} m, bent by {bend_m_median:.2f} m (worst "
        "{bend_m_worst:.2f}); {scans_per_second_hz_median:.0f} scans/s",
        _all(_every("", "maps_good", of=20), _at_most(false_closures=0, ate_rms_m_median=0.1)),
    ),
    Row(
        "Intel log, relations",
        "≤ 0.031 m / 0.6°, aim 0.0229 m / 0.453°, ≥ 40 ×",
        "slam2d_intel.json",
        _LOG,
        _all(_at_most(translation_mean_m=0.031, rotation_mean_deg=0.6), _at_least(real_time_factor=40.0)),
    ),
    Row(
        "Freiburg 079 log, relations",
        "≤ 0.056 m, aim 0.0452 m / 0.538°, ≥ 40 ×",
        "slam2d_fr079.json",
        _LOG,
        _all(_at_most(translation_mean_m=0.056), _at_least(real_time_factor=40.0)),
    ),
    Row(
        "MIT Killian log (one scan in 0.44 s, 1.9 km), relations",
        "≤ 0.060 m / 0.5°, aim 0.0395 m / 0.352°, ≥ 250 scans/s",
        "slam2d_killian.json",
        _LOG,
        _all(
            _at_most(translation_mean_m=0.060, rotation_mean_deg=0.5), lambda f: f["scans"] >= 250.0 * f["cpu_seconds"]
        ),
    ),
    Row(
        "Freiburg campus, 1754 m outdoors: one scan per 0.5–1 m, against GMapping's poses",
        "ATE ≤ 0.5 m; revisits: median ≤ 0.15 m, worst ≤ 1 m; ≥ 100 scans/s",
        "slam2d_freiburg_campus.json",
        _KEYFRAMES,
        _KEYFRAMES_MET,
    ),
    Row(
        "fhw: one scan per 0.5–1 m, against GMapping's poses",
        "ATE ≤ 0.5 m; revisits: median ≤ 0.15 m, worst ≤ 1 m; ≥ 100 scans/s",
        "slam2d_fhw.json",
        _KEYFRAMES,
        _KEYFRAMES_MET,
    ),
    Row(
        "Belgioioso: one scan per 0.5–1 m, against GMapping's poses",
        "ATE ≤ 0.5 m; revisits: median ≤ 0.15 m, worst ≤ 1 m; ≥ 100 scans/s",
        "slam2d_belgioioso.json",
        _KEYFRAMES,
        _KEYFRAMES_MET,
    ),
    Row(
        "Edmonton: one scan per 0.5–1 m, against GMapping's poses",
        "ATE ≤ 0.5 m; revisits: median ≤ 0.15 m, worst ≤ 1 m; ≥ 100 scans/s",
        "slam2d_edmonton.json",
        _KEYFRAMES,
        _KEYFRAMES_MET,
    ),
    Row(
        "pose graphs `intel`, `manhattan3500`",
        "optimum to 0.1 %, no slower than gtsam",
        "bench_posegraph.json",
        "χ² {intel_chi2:.4f}, {manhattan3500_chi2:.4f}; {ratio_vs_gtsam_intel:.2f} and {ratio_vs_gtsam_manhattan3500:.2f} of gtsam's time",
        _at_most(
            intel_chi2_error_pct=0.1,
            manhattan3500_chi2_error_pct=0.1,
            ratio_vs_gtsam_intel=1.0,
            ratio_vs_gtsam_manhattan3500=1.0,
        ),
    ),
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
        _all(*(_at_most(f"{name}_", dearer_paths=0) for name in ("open", "clutter", "rooms"))),
    ),
    Row(
        "local inflation 60²",
        "≤ 0.3 ms",
        "bench_costmap.json",
        "{inflation_60_ms:.3f} ms",
        _at_most(inflation_60_ms=0.3),
    ),
    Row(
        "frontier search 1000²",
        "≤ 16 ms",
        "bench_frontier.json",
        "{search_1000_ms:.2f} ms; 4000² after a change {incremental_4000_ms:.2f} ms",
        _at_most(search_1000_ms=16.0),
    ),
    Row("scan match", "≤ 3 ms", "bench_slam2d.json", "{match_ms:.2f} ms", _at_most(match_ms=3.0)),
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
        _every("", "within_bars", of=10),
    ),
    Row(
        "depot and a floor plan, `diff`: random goals of known maps",
        "all reached, 0 collisions",
        "navigation.json",
        "{maps_depot_diff_reached} of {maps_depot_diff_goals} and {medium_img_13_diff_reached} of {medium_img_13_diff_goals} reached, "
        "{maps_depot_diff_collisions} and {medium_img_13_diff_collisions} collisions, "
        "{maps_depot_diff_speed_median_mps:.2f} m/s",
        _all(*(_every(p, "reached", "goals", of=200) for p in ("maps_depot_diff_", "medium_img_13_diff_"))),
    ),
    *(
        Row(f"`{world}`, 3 seeds", _WIDE_BAR, "exploration_worlds.json", _explored_briefly(world), _is_world_met(world))
        for world in ("warehouse", "maze", "building")
    ),
    Row(
        "`corridor` (60 m, few features), 3 seeds",
        _WIDE_BAR.replace("0.05", "0.10"),
        "exploration_worlds.json",
        _explored_briefly("corridor"),
        _is_world_met("corridor", error=0.10),
    ),
    Row(
        "way until proof and home over the tour with full knowledge, median (development worlds and public plans)",
        "≤ 2 ×, aim ≤ 1.5 ×; shorter than `nearest` and `greedy`",
        "bench_exploration.json",
        "{tour_ratio_vs_known_tour_median:.2f} × (`nearest` {nearest_ratio_vs_known_tour_median:.2f}, `greedy` {greedy_ratio_vs_known_tour_median:.2f}); "
        "{tour_way_m_median:.0f} m ({nearest_way_m_median:.0f}, {greedy_way_m_median:.0f}), the tour {known_tour_m_median:.0f} m",
        _is_short,
    ),
    Row(
        "way until 98 % is seen, worlds and 30 public plans, over that of other strategies",
        "≤ 0.8 × `greedy`, ≤ `nearest`",
        "bench_exploration.json",
        "{path_at_98pct_m_ratio_vs_greedy:.2f} × `greedy`, {path_at_98pct_m_ratio_vs_nearest:.2f} × `nearest`; until proof and "
        "home {path_total_m_ratio_vs_greedy:.2f} and {path_total_m_ratio_vs_nearest:.2f} ×",
        _at_most(path_at_98pct_m_ratio_vs_greedy=0.8, path_at_98pct_m_ratio_vs_nearest=1.0),
    ),
    Row(
        "every fault on demand, two robots",
        "0 collisions; within stated limits or a named failure",
        "faults.json",
        "{passed} of {runs} runs within their limits, {collisions} collisions",
        _every("", "passed"),
    ),
    Row(
        "explore among glass, `diff` with an ultrasonic ring, 3 seeds",
        "0 contacts",
        "glass.json",
        "{diff_with_layers_contacts} contacts in {diff_with_layers_runs} runs, coverage worst "
        "{diff_with_layers_coverage_ratio_worst:.1%}; without the layers {diff_without_layers_contacts} contacts",
        _every("diff_with_layers_", "finished", of=3, collisions="contacts"),
    ),
    Row(
        "find a lost robot, office and warehouse (source: 1 of 3)",
        "≥ 97 % within 5 s, 0 wrong",
        "relocalization.json",
        "{success_ratio:.0%} of {runs} ({success_interval_low:.1%} … {success_interval_high:.1%}), {wrong} wrong, median {time_median_s:.1f} s",
        _all(_at_least(success_ratio=0.97, runs=100), _at_most(wrong=0)),
    ),
    Row(
        "notice and recover from a kidnapping",
        "≤ 2 s, ≤ 10 s in ≥ 95 %",
        "kidnapping.json",
        "{noticed_in_time} and {recovered_in_time} of {runs}; 95 % within {noticed_time_p95_s:.1f} s and {recovered_time_p95_s:.1f} s, {wrong} wrong",
        lambda f: min(f["noticed_in_time"], f["recovered_in_time"]) >= 0.95 * f["runs"] and f["wrong"] == 0,
    ),
    Row(
        "grid tracker in a known map: aisle, along a wall, building",
        "≤ 10 mm RMS in every observable direction, NEES 0.5 … 2",
        "localization.json",
        "{aisle_tracker_error_rms_m:.4f}, {wall_tracker_error_rms_m:.4f}, {building_tracker_error_rms_m:.4f} m; "
        "NEES {aisle_tracker_nees_mean:.2f}, {wall_tracker_nees_mean:.2f}, {building_tracker_nees_mean:.2f}",
        lambda f: _is_localized(f, "tracker"),
    ),
    Row(
        "localization in maps that SLAM made in drawn places, furniture moved, people; relocalization there",
        "≤ 15 mm RMS in determined directions, NEES 0.5 … 2 moving and at rest; ≥ 97 % of 200 in 5 s, 0 wrong",
        "localization_made.json",
        "{drives} drives in {places} places: {tracker_error_rms_m:.3f} m, NEES {tracker_nees_mean:.1f} and {tracker_static_nees_mean:.1f}; {relocalization_success_ratio:.1%} of "
        "{relocalization_runs}, {relocalization_wrong} wrong",
        _all(
            _at_least(
                drives=20,
                tracker_nees_mean=0.5,
                tracker_static_nees_mean=0.5,
                relocalization_runs=200,
                relocalization_success_ratio=0.97,
            ),
            _at_most(
                crashed=0,
                tracker_error_rms_m=0.015,
                tracker_nees_mean=2.0,
                tracker_static_nees_mean=2.0,
                relocalization_wrong=0,
            ),
        ),
    ),
    Row(
        "particle filter with the merged scan, same places",
        "≤ 10 mm RMS in every observable direction, NEES 0.5 … 2",
        "localization.json",
        "{aisle_particles_scan_error_rms_m:.4f}, {wall_particles_scan_error_rms_m:.4f}, {building_particles_scan_error_rms_m:.4f} m; "
        "NEES {aisle_particles_scan_nees_mean:.2f}, {wall_particles_scan_nees_mean:.2f}, {building_particles_scan_nees_mean:.2f}",
        lambda f: _is_localized(f, "particles_scan"),
    ),
    Row(
        "LiDAR-inertial odometry: 20k and 65k points a scan, one core",
        "≥ 200 Hz, ≥ 100 Hz, ≤ 0.4 of kiss-icp's time",
        "bench_lio.json",
        "{20k_hz:.0f} Hz, {65k_hz:.0f} Hz; {ratio_vs_kiss_20k:.3f}, {ratio_vs_kiss_65k:.3f} of kiss-icp's time",
        _all(_at_least(**{"20k_hz": 200.0, "65k_hz": 100.0}), _at_most(ratio_vs_kiss_20k=0.4, ratio_vs_kiss_65k=0.4)),
    ),
    Row(
        "LiDAR-inertial odometry on 10 drawn sites (simulated), first pose aligned",
        "≤ 0.1 % of the way (VLP-16, Mid-360), ≤ 0.05 % (64 rings); surfaces ≤ 3 cm; NEES 0.5 … 2",
        "lio.json",
        "{site_vlp_16_runs} sites; worst {site_vlp_16_start_rms_pct_worst:.3f}, {site_mid_360_start_rms_pct_worst:.3f}, {site_os_64_start_rms_pct_worst:.3f} %; "
        "surfaces worst {site_vlp_16_surface_rms_m_worst:.3f}, {site_mid_360_surface_rms_m_worst:.3f}, {site_os_64_surface_rms_m_worst:.3f} m; NEES worst "
        "{site_vlp_16_nees_worst:.1f}, {site_mid_360_nees_worst:.1f}, {site_os_64_nees_worst:.1f}",
        _all(
            _every("", "runs_met", of=30),
            *(
                _at_most(f"site_{lidar}_", surface_rms_m_worst=0.03, nees_worst=2.0)
                for lidar in ("vlp_16", "mid_360", "os_64")
            ),
        ),
    ),
    Row(
        "the same with loop closure",
        "median RMS ≤ 0.10 m, worst point ≤ 0.30 m, no false closure; 10 sites",
        "lio.json",
        "{site_vlp_16_runs} sites × 3 scanners: {closed_rms_median_m:.3f} m, {closed_max_worst_m:.3f} m, {false_closures} false",
        _all(
            _at_least(site_vlp_16_runs=10),
            _at_most(closed_rms_median_m=0.10, closed_max_worst_m=0.30, false_closures=0),
        ),
    ),
    Row(
        "`mecanum` driven around `campus` (300 m, noise and mounts drawn; simulated), mapped with loop closure",
        "≤ 0.10 m RMS and ≤ 0.30 m at worst with the first pose aligned",
        "lio_campus.json",
        "{start_rms_m:.3f} m, {start_max_m:.3f} m over {path_length_m:.0f} m; {ate_rms_m:.3f} m after the best rigid motion",
        _at_most(start_rms_m=0.10, start_max_m=0.30),
    ),
    Row(
        "loop closure where places look alike: two equal corridors, tunnels (simulated)",
        "no false closure",
        "lio_alike.json",
        "{runs} runs, "
        "{twins_vlp_16_false_closures} and {twins_mid_360_false_closures} false in corridors, {tunnel_vlp_16_false_closures} and {tunnel_mid_360_false_closures} in tunnels; "
        "worst point {twins_vlp_16_closed_max_m_worst:.2f} m",
        _at_most(
            twins_vlp_16_false_closures=0,
            twins_mid_360_false_closures=0,
            tunnel_vlp_16_false_closures=0,
            tunnel_mid_360_false_closures=0,
        ),
    ),
    Row(
        "relocalization in saved clouds of another day, 60 starts in three maps, Mid-360 (simulated)",
        "≥ 59 with a guess (2 m, 30°), ≥ 54 without in ≤ 10 s, 0 false",
        "relocalization3d.json",
        "{guess_success} and {none_success} of {none_starts}, {guess_false} and {none_false} false (≤ {none_false_interval_high:.1%} at 95 %); {none_seconds_median:.1f} s, worst "
        "{none_seconds_worst:.1f} s; then {none_track_rms_m_worst:.3f} m RMS at worst",
        _all(
            _at_least(guess_success=59, none_success=54),
            _at_most(guess_false=0, none_false=0, none_seconds_worst=10.0),
        ),
    ),
    Row(
        "LiDAR-inertial odometry with 30 % of the returns false: dust and rain; standing smoke (drawn sites, simulated)",
        "error ≤ 1.5 × that in clear air",
        "lio_air.json",
        "dust {dust_mid_360_ratio_vs_clear_worst:.2f} and {dust_vlp_16_ratio_vs_clear_worst:.2f}, rain {rain_mid_360_ratio_vs_clear_worst:.2f} and "
        "{rain_vlp_16_ratio_vs_clear_worst:.2f}; smoke, {smoke_mid_360_false_return_ratio_worst:.0%} false: {smoke_mid_360_ratio_vs_clear_worst:.2f} and "
        "{smoke_vlp_16_ratio_vs_clear_worst:.2f} (Mid-360 and VLP-16, worst)",
        _at_most(
            dust_mid_360_ratio_vs_clear_worst=1.5,
            dust_vlp_16_ratio_vs_clear_worst=1.5,
            rain_mid_360_ratio_vs_clear_worst=1.5,
            rain_vlp_16_ratio_vs_clear_worst=1.5,
        ),
    ),
    Row(
        "LiDAR-inertial odometry of `go2` on `campus`, Mid-360 at 10 Hz: share of one core",
        "≤ 15 %",
        "bench_odometry.json",
        "{odometry_ratio:.1%}; recordings {recording_mb_per_s:.1f} MB/s",
        _at_most(odometry_ratio=0.15),
    ),
    Row(
        "ground on drawn sites, mounts off by 5 cm and 3° (simulated)",
        "≤ 0.1 % false on flat floor; drops ≥ 8 cm seen at ≥ 1.5 m; kerbs of 12 cm never open, slopes of 15° free",
        "ground.json",
        "false {mecanum_false_ratio:.2%} and {go2_false_ratio:.2%}; drops {mecanum_drop_good} and {go2_drop_good} of {mecanum_drop_runs}, from "
        "{mecanum_drop_seen_at_least_m:.1f} m; kerbs {mecanum_kerb_good} and {go2_kerb_good}, slopes {mecanum_slope_good} and {go2_slope_good} "
        "of {mecanum_slope_runs} (`mecanum`, `go2`)",
        _all(
            _at_most(mecanum_false_ratio=0.001, go2_false_ratio=0.001),
            _at_least(mecanum_drop_good=10, go2_drop_good=10, mecanum_kerb_good=10, mecanum_slope_good=10),
        ),
    ),
    Row(
        "terrain within 10 m, 20k points of a Mid-360, one core",
        "≤ 1.0 ms",
        "bench_terrain.json",
        "{near_update_ms:.2f} ms (95 %: {near_update_p95_ms:.2f}); its cloud {near_terrain_ms:.2f} ms",
        _at_most(near_update_ms=1.0),
    ),
    Row(
        "motion primitives: scoring of 343 paths in 36 directions with 1000 points of terrain, one core",
        "≤ 1.0 ms",
        "bench_terrain.json",
        "{primitives_scoring_ms:.2f} ms (95 %: {primitives_scoring_p95_ms:.2f}); the planner's whole cycle {primitives_cycle_ms:.2f} ms ({primitives_cycle_p95_ms:.2f})",
        _at_most(primitives_scoring_ms=1.0),
    ),
    Row(
        "visibility graph of 2000 nodes: update and search",
        "≤ 3 ms each, ≤ 20 % of a core",
        "bench_far.json",
        "{nodes} nodes: {update_median_ms:.2f} ms (95 %: {update_p95_ms:.2f}) and {search_median_ms:.2f} ms ({search_p95_ms:.2f}); {core_share_pct:.1f} % of a core",
        _at_most(update_median_ms=3.0, search_median_ms=3.0, core_share_pct=20.0),
    ),
    Row(
        "table tops, signs, bars and drawers above a planar scanner, drawn, mounts off: with depth cameras and voxels, and without",
        "0 collisions",
        "overhangs.json",
        "{with_voxels_reached} of {with_voxels_goals} goals, {with_voxels_collisions} collisions in {with_voxels_runs} runs; without {without_reached} of {without_goals}, "
        "{without_collisions} collisions",
        _at_most("with_voxels_", collisions=0),
    ),
    Row(
        "sites in three dimensions, drawn (plots with slopes and kerbs, garages of two levels), explored by `go2`, `mecanum` and `spot`",
        "10 sites: ≥ 98 % of the visible surface, with proof, at home, 0 collisions; path ≤ 2 × the tour with full knowledge",
        "sites.json",
        "{all_done} of {all_runs} done ({all_finished} with proof, {all_at_home} at home), {all_collisions} collisions; surface {all_surface_coverage_ratio_median:.1%} (worst "
        "{all_surface_coverage_ratio_worst:.1%}), {all_ate_unaligned_rms_m_median:.2f} m in the frame of the start; path "
        "{all_ratio_vs_known_tour_median:.2f} × (worst {all_ratio_vs_known_tour_worst:.2f})",
        _all(
            lambda fields: bool(fields["bars_done"]) and fields["all_collisions"] == 0,
            _at_most("all_", ratio_vs_known_tour_median=2.0),
            _at_least("all_", runs=10),
        ),
    ),
    *(
        Row(
            f"a drawn {kind}, `{robot}`: explored, saved; switched on elsewhere, lost; five way-points",
            "10 sites: all of it with nobody's hand, 0 collisions",
            f"return_{kind}_{robot}.json",
            "{done} of {runs}; found itself after {found_s_worst:.1f} s, {found_m_worst:.3f} m off; {way_points_reached} of {way_points} way-points, "
            "{way_point_error_max_m_worst:.3f} m off at worst; {collisions} collisions",
            _every("", "done", of=10),
        )
        for kind, robot in (("garage", "mecanum"), ("garage", "spot"), ("plot", "go2"))
    ),
    Row(
        "goals in unknown offices and flats, drawn, `diff`: visibility graph beside the grid planner in the same run",
        "all reached; time ≤ 1.0 ×, ≤ 0.9 × with dead ends; ≤ 1 reversal per 50 m",
        "unknown.json",
        "{visibility_graph_reached} of {visibility_graph_runs} (grid {grid_reached}), {visibility_graph_collisions} collisions; {ratio_vs_grid:.2f} ×, "
        "{dead_end_ratio_vs_grid:.2f} ×; {visibility_graph_reversals_per_50m:.2f} reversals (grid {grid_reversals_per_50m:.2f})",
        _all(
            _at_least(visibility_graph_reached=20),
            _at_most(ratio_vs_grid=1.0, dead_end_ratio_vs_grid=0.9, visibility_graph_reversals_per_50m=1.0),
        ),
    ),
    Row(
        "LiDAR-inertial odometry beside kiss-icp on the same scans, drawn halls, VLP-16 (simulated)",
        "≤ 0.5 of its error in 10",
        "lio_peer_hall.json",
        "{hall_vlp_16_runs} halls: {hall_vlp_16_ratio_vs_kiss_error_median:.3f} (worst {hall_vlp_16_ratio_vs_kiss_error_worst:.3f}) of its error",
        _all(_at_least(hall_vlp_16_runs=10), _at_most(hall_vlp_16_ratio_vs_kiss_error_worst=0.5)),
    ),
    Row(
        "LiDAR-inertial odometry in the hand, 1000 °/s and 3 m/s²; tunnel with wheel odometry (simulated)",
        "≤ 0.1 m; end ≤ 1 % of the way, degeneracy told",
        "lio_hard.json",
        "{runs_met} of {runs}; worst {shaken_vlp_16_start_rms_m_worst:.3f} and {shaken_mid_360_start_rms_m_worst:.3f} m; tunnel "
        "{tunnel_vlp_16_end_pct_worst:.2f} and {tunnel_mid_360_end_pct_worst:.2f} %",
        _every("", "runs_met", of=4),
    ),
    Row(
        "LiDAR-inertial odometry at rest for 10 min (simulated)",
        "≤ 1 cm, NEES 0.5 … 2",
        "lio_rest.json",
        "{rest_vlp_16_start_max_m_worst:.4f} m at worst ({rest_vlp_16_runs} run), NEES {rest_vlp_16_nees_median:.2f}",
        _all(
            _at_most(rest_vlp_16_start_max_m_worst=0.01, rest_vlp_16_nees_worst=2.0),
            _at_least(rest_vlp_16_nees_median=0.5),
        ),
    ),
    Row(
        "particle update, 2000 × 60 beams; EKF step",
        "≤ 5 ms; ≤ 50 µs",
        "bench_particles.json",
        "{particle_update_ms:.2f} ms; {ekf_step_us:.1f} µs",
        _at_most(particle_update_ms=5.0, ekf_step_us=50.0),
    ),
    Row(
        "a real Husky's wheels and gyroscope against its satellites",
        "reported",
        "odometry_husky.json",
        "{fused_error_rms_m:.1f} m RMS over {way_m:.0f} m (wheels alone {wheels_error_rms_m:.1f} m)",
        _is_reported,
    ),
    Row(
        "dock from random places, full noise (source: ± 10 mm, ± 0.3°)",
        "≤ 3 mm, ≤ 0.1° (95 %), worst ≤ 8 mm; 60 of 60 within two attempts",
        "docking.json",
        "{within_two_attempts} of {runs}; {position_error_p95_m:.4f} m, {yaw_error_p95_deg:.3f}° (95 %), worst {position_error_max_m:.4f} m",
        _is_docked,
    ),
    *(
        Row(
            f"dock by {what} that scanners see, random places",
            "(as above)",
            f"docking_{name}.json",
            "{within_two_attempts} of {runs}; {position_error_p95_m:.4f} m, {yaw_error_p95_deg:.3f}° (95 %), docking {docking_time_median_s:.1f} s",
            _is_docked,
        )
        for what, name in (("a V shape", "v_shape"), ("reflectors", "reflectors"))
    ),
    Row(
        "docking with mounting, lens, markers, contacts, floor and wheels off by what real ones are off by; a dock that was never taught",
        "95 %: ≤ 8 mm, ≤ 0.5°; ≥ 99 of 100 within two attempts",
        "docking_drawn.json",
        "{position_error_p95_m:.4f} m, {yaw_error_p95_deg:.3f}° (95 %); {within_two_attempts} of {runs}, {collisions} collisions",
        lambda f: (
            f["position_error_p95_m"] <= 0.008
            and f["yaw_error_p95_deg"] <= 0.5
            and f["within_two_attempts"] >= 0.99 * f["runs"]
            and f["runs"] >= 100
            and f["collisions"] == 0
        ),
    ),
    Row(
        "the same with a dock that was taught once",
        "95 %: ≤ 3 mm, ≤ 0.15°; ≥ 99 of 100 within two attempts",
        "docking_drawn.json",
        "{taught_position_error_p95_m:.4f} m, {taught_yaw_error_p95_deg:.3f}° (95 %); {taught_within_two_attempts} of {taught_runs}",
        lambda f: (
            f["taught_position_error_p95_m"] <= 0.003
            and f["taught_yaw_error_p95_deg"] <= 0.15
            and f["taught_within_two_attempts"] >= 0.99 * f["taught_runs"]
            and f["taught_runs"] >= 100
        ),
    ),
    Row(
        "dock from 1 m (source: 17 s); marker at 1 m, still and moving",
        "≤ 8 s; ≤ 1 mm, ≤ 3 mm (95 %)",
        "docking.json",
        "{docking_time_median_s:.1f} s; {marker_still_p95_x_mm:.2f} mm, {marker_moving_p95_x_mm:.2f} mm; {collisions} collisions",
        _at_most(docking_time_median_s=8.0, marker_still_p95_x_mm=1.0, marker_moving_p95_x_mm=3.0, collisions=0),
    ),
    Row(
        "one run: explore `building`, dock, undock, 5 goals, dock, `amr_omni`",
        "5 of 5, 0 collisions, no restart",
        "program_amr.json",
        "{succeeded} of {amr_omni_runs}, {amr_omni_goals_reached} of {amr_omni_goals} goals, {collisions} collisions; docked within "
        "{amr_omni_dock_error_m_worst:.4f} m, {amr_omni_dock_error_deg_worst:.3f}° (worst)",
        _every("amr_omni_", "succeeded", of=5),
    ),
    Row(
        "the same without docks, `spot` and `diff`",
        "all, 0 collisions",
        "program_spot_diff.json",
        "`spot` {spot_succeeded} of {spot_runs} ({spot_goals_reached} of {spot_goals} goals), `diff` {diff_succeeded} of {diff_runs}; "
        "{collisions} collisions",
        _every("", "succeeded", of=4),
    ),
    Row(
        "two `diff` in one process explore `building`",
        "both with proof, 0 collisions, replays bit-equal",
        "team.json",
        "{0_first_ended} and {0_second_ended}, {0_first_collisions} and {0_second_collisions} collisions, trajectory error "
        "{0_first_ate_rms_m:.3f} and {0_second_ate_rms_m:.3f} m; replays equal: {0_first_is_replay_equal}, {0_second_is_replay_equal}",
        lambda f: (
            f["0_first_ended"] == f["0_second_ended"] == "finished"
            and f["0_first_collisions"] == f["0_second_collisions"] == 0
            and f["0_first_is_replay_equal"]
            and f["0_second_is_replay_equal"]
        ),
    ),
    Row(
        "live, simulator behind a serial line and a socket: `lab_empty`",
        "5 of 5 with proof; cable pulled at 0.8 m/s (base: watchdog 0.2 s, 3.5 m/s²): stopped within 0.5 s",
        "live.json",
        "{apart_succeeded} of {apart_runs}, {apart_collisions} collisions; pulled cable: last command that moves after "
        "{cable_commands_ended_s_max:.2f} s, standing after {cable_base_stood_s_max:.2f} s (worst of {cable_runs})",
        _all(_every("apart_", "succeeded", of=5), _at_most("cable_", commands_ended_s_max=0.5, base_stood_s_max=0.5)),
    ),
    Row(
        "command period of a live robot, 50 Hz, beside an empty loop",
        "worst ≤ 40 ms over 10 min; a failing node stops it ≤ 0.2 s",
        "bench_live.json",
        "99 % {none_command_p99_ms:.1f} ms, worst {none_command_max_ms:.1f} ms in {none_command_seconds:.0f} s (empty loop {none_empty_loop_p99_ms:.1f}, "
        "{none_empty_loop_max_ms:.1f}); stopped {failure_stopped_s:.2f} s after a failure",
        _all(_at_most(none_command_max_ms=40.0, failure_stopped_s=0.2), _at_least(none_command_seconds=600.0)),
    ),
    Row(
        "the same while `go2` explores a site with its whole pipeline (`plot-1`, Mid-360 at 10 Hz)",
        "99 % ≤ that of the empty loop + 10 ms, and ≤ 40 ms",
        "bench_live_site.json",
        "99 % {none_command_p99_ms:.1f} ms, worst {none_command_max_ms:.1f} ms in {none_command_seconds:.0f} s (empty loop {none_empty_loop_p99_ms:.1f})",
        _all(
            lambda fields: fields["none_command_p99_ms"] <= fields["none_empty_loop_p99_ms"] + 10.0,
            _at_most(none_command_p99_ms=40.0),
            _at_least(none_command_seconds=50.0),
        ),
    ),
    Row(
        "the same: from a scan's last point to the first command that knows of it",
        "median ≤ 30 ms",
        "bench_live_site.json",
        "through local costmap, controller and gate {none_scan_to_command_median_ms:.0f} ms (99 % {none_scan_to_command_p99_ms:.0f}, {none_scans_in_motion} scans), of "
        "which {none_scan_arrival_median_ms:.0f} until it has arrived; the gate alone {none_scan_to_gate_median_ms:.0f} ms, through odometry and terrain "
        "{none_scan_to_terrain_command_median_ms:.0f} ms",
        _all(_at_most(none_scan_to_command_median_ms=30.0), _at_least(none_scans_in_motion=200)),
    ),
    Row(
        "the same: what the robot's process takes of one core",
        "≤ 35 % (wished: ≤ 20 %)",
        "bench_live_site.json",
        "{none_processor_pct:.0f} % over {none_processor_seconds:.0f} s",
        _all(_at_most(none_processor_pct=35.0), _at_least(none_processor_seconds=50.0)),
    ),
    Row(
        "the same in the office while the disk stalls for 5 s, is full, the recorder or the log raises: 99 % of the periods",
        "≤ 10 ms more than undisturbed in the same run",
        "bench_live_disturbed.json",
        "undisturbed {none_command_p99_ms:.1f} ms; "
        + ", ".join(f"{{{name}_command_p99_ms:.1f}}" for name in _DISTURBANCES)
        + " ms",
        _all(
            _at_most(none_command_p99_ms=40.0),
            lambda f: max(f[f"{name}_command_p99_ms"] for name in _DISTURBANCES) <= f["none_command_p99_ms"] + 10.0,
        ),
    ),
    Row(
        "time of every node on its own thread, exploring and docking",
        "99 % of its callbacks within the latency that it declares",
        "bench_nodes.json",
        "late: {offenders}; gate {office_gate_p99_ms:.2f} of {office_gate_declared_ms:.0f} ms, controller "
        "{office_controller_p99_ms:.1f} of {office_controller_declared_ms:.0f} ms, docking {dock_docking_p99_ms:.2f} of "
        "{dock_docking_declared_ms:.0f} ms (99 %)",
        lambda f: f["offenders"] == "" and f["office_gate_p99_ms"] <= 1.0,
    ),
    Row(
        "live, each verb in real time: " + ", ".join(name.replace("_", " ") for name in _VERBS),
        "10 of 10 each",
        "live.json",
        ", ".join(f"{{{name}_succeeded}}" for name in _VERBS) + " of {explore_runs} each",
        _all(*(_every(f"{name}_", "succeeded", of=10) for name in _VERBS)),
    ),
    Row(
        "runs ended by a signal at a random instant",
        "30 of 30 leave what was known, whole",
        "interrupts.json",
        "{in_order} of {runs}; {with_map} with their map, {before_the_run} before anything was known",
        _every("", "in_order", of=30),
    ),
    Row(
        "a campaign of 40 explorations on a cluster of two workers, one of them killed in the middle",
        "the table of the local pool, no case lost or told twice",
        "cluster.json",
        "{cluster_told} of {runs} cases told, {cluster_crashed} crashed, {cases_that_differ} differ from the local pool's; tables equal: {is_table_equal}",
        lambda f: f["is_table_equal"] and f["cases_that_differ"] == 0 and f["cluster_told"] == f["runs"],
    ),
    Row(
        "faults planted into the source, one by one",
        "≥ 60, each noticed by a fast test in < 60 s",
        "mutation.json",
        "{noticed} of {faults} noticed, the slowest after {slowest_seconds:.0f} s",
        _all(_every("", "noticed", "faults", of=60), _at_most(slowest_seconds=60.0)),
    ),
    Row(
        "results drawn at random, their commands run again at their commits",
        "10 of 10 give the same numbers (times apart)",
        "run_again.json",
        "{equal} of {compared} equal, of {candidates} that can be run again in short time",
        lambda f: f["equal"] == f["compared"] == f["drawn"] >= 10,
    ),
    Row(
        "velocity gate: random search for a counterexample",
        "0 in 10⁷",
        "gate_search.json",
        "{counterexamples} in {cases} cases",
        _all(_at_most(counterexamples=0), _at_least(cases=10**7)),
    ),
)


HEADLINES = ("run_office", "exploration_lab", "slam2d_intel", "docking", "relocalization", "live")
"""Files whose first row stands in the README, too."""

PAGE = """# Results

Made by `ambler eval results` from the files in [results](results); each tells the command that made it, the commit, the day, the machine, the seed
and the seconds. A row measured on an earlier day was measured on an earlier state of the code. A row that misses its bar says so.

Unless a row says drawn, worlds, logs and seeds are those on which Ambler was developed. On places that nobody had tried it has done worse: of drawn
ones only a few runs were made so far (campuses, explorations, made maps, LiDAR-inertial odometry, docking with imperfections).

"""


def results_table(folder: Path, link: str = "results", files: Collection[str] = ()) -> str:
    """Return the table in Markdown; a row whose file is absent says so instead of showing a number. `link` is the way from the page to
    the folder; with `files` only the first row of each of them is shown."""
    lines = ["| what | bar | measured |", "|---|---|---|"]
    machines, wanted = set(), [f"{name}.json" for name in files]
    for row in ROWS:
        if files and row.file not in wanted:
            continue
        wanted = [name for name in wanted if name != row.file]
        path = folder / row.file
        if path.exists():
            fields = {name.replace(".", "_"): value for name, value in json.loads(path.read_text()).items()}
            machines.add(fields["machine"])
            lines.append(f"| {row.what} | {row.bar} | {_fill(row, fields)} ([{fields['date']}]({link}/{row.file})) |")
        else:
            lines.append(f"| {row.what} | {row.bar} | not measured yet |")
    return "\n".join([*lines, "", f"Each on the day behind it, on: {'; '.join(sorted(machines)) or 'nothing yet'}."])


def update_page(page: Path, folder: Path) -> None:
    """Write the page of all results."""
    page.write_text(PAGE + results_table(folder) + "\n", encoding="utf-8")


def update_readme(readme: Path, folder: Path) -> None:
    """Replace what stands between the marks of the README by the headlines."""
    _replace(readme, "results", results_table(folder, "docs/results", HEADLINES))


def update_docking(page: Path, folder: Path) -> None:
    """Replace what stands between the marks of the page on docking by the tables of its results."""
    camera, notch, reflectors = (
        json.loads((folder / f"{name}.json").read_text())
        for name in ("docking", "docking_v_shape", "docking_reflectors")
    )
    _replace(page, "docking", table(camera))
    _replace(page, "shapes", shapes_table({"V-shaped notch": notch, "reflectors": reflectors}))


def _replace(page: Path, name: str, text: str) -> None:
    """Put a text between `<!-- name -->` and `<!-- /name -->`."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    _, _, after = rest.partition(end)
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def _fill(row: Row, fields: dict[str, Any]) -> str:
    try:
        return row.text.format(**fields) + ("" if row.is_met(fields) else " **(misses the bar)**")
    except (KeyError, TypeError, ValueError) as error:
        return f"incomplete ({error})"
