"""Exploring, and two-dimensional mapping."""

from __future__ import annotations

from collections.abc import Sequence

from ambler.evaluation.bars.row import Judge, Row, all_of, at_least, at_most, every


def _explored(world: str, robot: str) -> str:
    p = f"{world}_{robot}_tour_"
    return (
        f"{{{p}finished}} of {{{p}runs}} with proof, {{{p}collisions}} collisions; coverage {{{p}coverage_ratio_median:.2%}} "
        f"(worst {{{p}coverage_ratio_worst:.2%}}), NNE {{{p}nne_cells_median:.2f}} / {{{p}nne_reverse_cells_median:.2f}} cells, "
        f"SSIM {{{p}ssim_median:.3f}}, trajectory error {{{p}ate_rms_m_median:.3f}} m (worst {{{p}ate_rms_m_worst:.3f}})"
    )


def _is_explored(world: str, robot: str, runs: int, *judges: Judge) -> Judge:
    return all_of(every(f"{world}_{robot}_tour_", "finished", of=runs), *judges)


def _is_lab_met(world: str) -> Judge:
    p = f"{world}_spot_tour_"
    return _is_explored(
        world,
        "spot",
        5,
        at_least(p, coverage_ratio_median=0.99, ssim_median=0.9),
        at_most(p, nne_cells_median=0.8, nne_reverse_cells_median=0.8),
    )


def _is_office_met(robot: str) -> Judge:
    p = f"office_{robot}_tour_"
    return _is_explored("office", robot, 3, at_least(p, coverage_ratio_worst=0.98), at_most(p, ate_rms_m_worst=0.05))


_LAB_BAR = "coverage ≥ 99 %, NNE ≤ 0.8, SSIM ≥ 0.9"

_OFFICE_BAR = "≥ 98 %, 0 collisions, proof, ≤ 0.05 m"

_KEYFRAMES = (
    "{ate_rms_m:.2f} m; {revisits} revisits: {revisit_error_median_m:.3f} m, worst {revisit_error_worst_m:.2f} m"
)

_KEYFRAMES_MET = all_of(
    at_most(ate_rms_m=0.5, revisit_error_median_m=0.15, revisit_error_worst_m=1.0),
    lambda f: f["scans"] >= 100.0 * f["cpu_seconds"],
)

_LOG = (
    "{translation_mean_m:.4f} ± {translation_std_m:.4f} m, {rotation_mean_deg:.3f} ± {rotation_std_deg:.3f}°, "
    "{real_time_factor:.0f} × real time, {loop_closures} loop closures"
)


ROWS: Sequence[Row] = (
    Row(
        "`./run.sh --exit`: office, `diff`, everything included",
        "≥ 4 × real time, < 1 GB",
        "run_office.json",
        "{real_time_factor:.1f} × real time, {peak_memory_mb:.0f} MB, coverage {coverage_ratio:.2%}, {collisions} collisions",
        all_of(at_least(real_time_factor=4.0, coverage_ratio=0.98), at_most(peak_memory_mb=1000.0, collisions=0)),
    ),
    Row(
        "the same beside commit eb03a49, alternating",
        "≤ 1.1 × its time",
        "two_commits.json",
        "{office_diff_run_seconds_ratio:.2f} × its time ({office_diff_new_run_seconds:.1f} against {office_diff_old_run_seconds:.1f} s; runs of "
        "each: {runs}); coverage {office_diff_new_coverage_ratio:.2%} against {office_diff_old_coverage_ratio:.2%}",
        at_most(office_diff_run_seconds_ratio=1.1),
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
        all_of(
            lambda f: f["fresh_all_done"] * 60 >= 59 * f["fresh_all_runs"] and f["fresh_all_runs"] >= 60,
            at_most("fresh_all_", collisions=0, start_rms_m_median=0.05, start_rms_m_95=0.1, recovery_time_ratio=0.05),
        ),
    ),
    Row(
        "10 walking people, 5 of whom do not yield, drawn plans and people (`diff`, `amr_omni`, `spot`)",
        "30 runs: 0 collisions, 28 finished with proof and 98 % of the reachable floor",
        "crowd_10.json",
        "{runs} runs: {collisions} collisions ({collisions_shoved} more into which somebody shoved a robot that stood) of {contacts} contacts; {finished} finished, "
        "{finished_early} more too early; median {sim_seconds_median:.0f} s, {reachable_coverage_ratio_median:.0%} of the floor",
        all_of(at_most(collisions=0), at_least(runs=30), lambda f: (f["runs"] - f["finished"]) * 30 <= 2 * f["runs"]),
    ),
    Row(
        "drawn campuses, dense scans, loops of 0.3 to 1 km",
        "no false closure, bent by ≤ 0.3 m in 20 of 20, error ≤ 0.1 m (median)",
        "campus.json",
        "{maps_good} of {runs} maps, {false_closures} false closures; error {ate_rms_m_median:.3f} m, bent by {bend_m_median:.2f} m (worst "
        "{bend_m_worst:.2f}); {scans_per_second_hz_median:.0f} scans/s",
        all_of(every("", "maps_good", of=20), at_most(false_closures=0, ate_rms_m_median=0.1)),
    ),
    Row(
        "Intel log, relations",
        "≤ 0.031 m / 0.6°, aim 0.0229 m / 0.453°, ≥ 40 ×",
        "slam2d_intel.json",
        _LOG,
        all_of(at_most(translation_mean_m=0.031, rotation_mean_deg=0.6), at_least(real_time_factor=40.0)),
    ),
    Row(
        "Freiburg 079 log, relations",
        "≤ 0.056 m, aim 0.0452 m / 0.538°, ≥ 40 ×",
        "slam2d_fr079.json",
        _LOG,
        all_of(at_most(translation_mean_m=0.056), at_least(real_time_factor=40.0)),
    ),
    Row(
        "MIT Killian log (one scan in 0.44 s, 1.9 km), relations",
        "≤ 0.060 m / 0.5°, aim 0.0395 m / 0.352°, ≥ 250 scans/s",
        "slam2d_killian.json",
        _LOG,
        all_of(
            at_most(translation_mean_m=0.060, rotation_mean_deg=0.5), lambda f: f["scans"] >= 250.0 * f["cpu_seconds"]
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
        "logs mirrored, backwards, thinned, clipped, from a later scan on, with other wheels (drawn)",
        "≥ 95 % as good as the log itself (≤ 2 × its error, or its bar)",
        "slam2d_variants.json",
        "{variants_good} of {runs} ({variants_good_ratio_low_95:.0%} to {variants_good_ratio_high_95:.0%}); Freiburg campus {freiburg-campus_good} of "
        "{freiburg-campus_runs}, Edmonton {edmonton_good} of {edmonton_runs}; open by more than a metre somewhere: {variants_open}",
        at_least(variants_good_ratio=0.95),
    ),
    Row(
        "Killian and Freiburg 079, their scans stamped up to 0.6 s later than they are (drawn)",
        "≥ 95 % as good as the log itself; the lag found within 0.05 s",
        "slam2d_late.json",
        "{late_good} of {late_runs}, relations at worst {late_error_worst_m:.3f} m; lag off by {late_lag_error_median_s:.3f} s, at worst {late_lag_error_worst_s:.3f}",
        all_of(at_least(variants_good_ratio=0.95), at_most(late_lag_error_worst_s=0.05)),
    ),
    Row(
        "pose graphs `intel`, `manhattan3500`",
        "optimum to 0.1 %, no slower than gtsam",
        "bench_posegraph.json",
        "χ² {intel_chi2:.4f}, {manhattan3500_chi2:.4f}; {ratio_vs_gtsam_intel:.2f} and {ratio_vs_gtsam_manhattan3500:.2f} of gtsam's time",
        at_most(
            intel_chi2_error_pct=0.1,
            manhattan3500_chi2_error_pct=0.1,
            ratio_vs_gtsam_intel=1.0,
            ratio_vs_gtsam_manhattan3500=1.0,
        ),
    ),
    Row(
        "drawn halls of 100 × 100 m, `diff`, beside drawn offices in the same campaign",
        "5 halls with proof, 0 collisions, ≤ 1 GB, processor time per simulated second ≤ 1.5 × that of offices",
        "exploration_halls.json",
        "{fresh_hall_done} of {fresh_hall_runs}, {fresh_hall_collisions} collisions, coverage {fresh_hall_coverage_worst:.2%}, {fresh_hall_start_rms_m_worst:.3f} m in the frame of the start; "
        "{fresh_hall_peak_memory_mb_worst:.0f} MB, judging included (offices {fresh_office_peak_memory_mb_worst:.0f}); {fresh_hall_cpu_per_sim_second_median:.2f} s of a processor per second "
        "(offices {fresh_office_cpu_per_sim_second_median:.2f})",
        all_of(
            every("fresh_hall_", "done", of=5),
            at_most(fresh_hall_peak_memory_mb_worst=1000.0),
            lambda f: f["fresh_hall_cpu_per_sim_second_median"] <= 1.5 * f["fresh_office_cpu_per_sim_second_median"],
        ),
    ),
    Row(
        "pose graphs `MIT`, `ais2klinik` from their odometry",
        "χ² 41.163, 172.816 to 0.1 %, less time than gtsam with its own start",
        "bench_posegraph.json",
        "χ² {MIT_from_odometry_chi2:.4f}, {ais2klinik_from_odometry_chi2:.4f}; {ratio_vs_gtsam_MIT_from_odometry:.2f} and "
        "{ratio_vs_gtsam_ais2klinik_from_odometry:.2f} of gtsam's time (chordal start, Levenberg-Marquardt)",
        at_most(
            MIT_from_odometry_chi2_error_pct=0.1,
            ais2klinik_from_odometry_chi2_error_pct=0.1,
            ratio_vs_gtsam_MIT_from_odometry=1.0,
            ratio_vs_gtsam_ais2klinik_from_odometry=1.0,
        ),
    ),
    Row(
        "local planner, 20 × 20 rollouts, beside commit eb03a49, alternating",
        "≤ 0.5 × its time",
        "bench_rollout.json",
        "differential {rollout_rollout_differential_60_ms_ratio:.2f}, omnidirectional {rollout_rollout_omni_60_ms_ratio:.2f} of its time "
        "({rollout_new_rollout_differential_60_ms:.2f} and {rollout_new_rollout_omni_60_ms:.2f} ms)",
        at_most(rollout_rollout_differential_60_ms_ratio=0.5, rollout_rollout_omni_60_ms_ratio=0.5),
    ),
)
