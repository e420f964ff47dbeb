"""LiDAR-inertial odometry, terrain, sites."""

from __future__ import annotations

from collections.abc import Sequence

from ambler.evaluation.bars.row import Row, all_of, at_least, at_most, every, is_reported

LIDARS = ("vlp_16", "mid_360", "os_64")

ROWS: Sequence[Row] = (
    Row(
        "LiDAR-inertial odometry: 20k and 65k points a scan, one core",
        "≥ 200 Hz, ≥ 100 Hz, ≤ 0.4 of kiss-icp's time",
        "bench_lio.json",
        "{20k_hz:.0f} Hz, {65k_hz:.0f} Hz; {ratio_vs_kiss_20k:.3f}, {ratio_vs_kiss_65k:.3f} of kiss-icp's time",
        all_of(at_least(**{"20k_hz": 200.0, "65k_hz": 100.0}), at_most(ratio_vs_kiss_20k=0.4, ratio_vs_kiss_65k=0.4)),
    ),
    Row(
        "LiDAR-inertial odometry on 10 drawn sites (simulated), first pose aligned",
        "≤ 0.1 % of the way (VLP-16, Mid-360), ≤ 0.05 % (64 rings), height ≤ 0.3 %; NEES 0.5 … 2 (in the mean at least 0.5, of no site above 2)",
        "lio.json",
        "{site_vlp_16_runs} sites; worst {site_vlp_16_start_rms_pct_worst:.3f}, {site_mid_360_start_rms_pct_worst:.3f}, {site_os_64_start_rms_pct_worst:.3f} %; "
        "height {site_vlp_16_height_rms_pct_worst:.3f}, {site_mid_360_height_rms_pct_worst:.3f}, {site_os_64_height_rms_pct_worst:.3f} %; NEES, mean of the sites, {site_vlp_16_nees_mean:.2f}, {site_mid_360_nees_mean:.2f}, {site_os_64_nees_mean:.2f}, greatest "
        "{site_vlp_16_nees_worst:.1f}, {site_mid_360_nees_worst:.1f}, {site_os_64_nees_worst:.1f}",
        all_of(
            every("", "runs_met", of=30),
            *(at_least(f"site_{lidar}_", nees_mean=0.5) for lidar in LIDARS),
            *(at_most(f"site_{lidar}_", nees_worst=2.0, height_rms_pct_worst=0.3) for lidar in LIDARS),
        ),
    ),
    Row(
        "the same with loop closure, and its map",
        "median RMS ≤ 0.10 m, worst point ≤ 0.30 m, no false closure; surfaces within 3 cm RMS of the truth; 10 sites",
        "lio.json",
        "{site_vlp_16_runs} sites × 3 scanners: {closed_rms_median_m:.3f} m, {closed_max_worst_m:.3f} m, {false_closures} false; surfaces worst "
        "{site_vlp_16_closed_surface_rms_m_worst:.3f}, {site_mid_360_closed_surface_rms_m_worst:.3f}, {site_os_64_closed_surface_rms_m_worst:.3f} m (of odometry alone "
        "{site_vlp_16_surface_rms_m_worst:.3f}, {site_mid_360_surface_rms_m_worst:.3f}, {site_os_64_surface_rms_m_worst:.3f})",
        all_of(
            at_least(site_vlp_16_runs=10),
            at_most(closed_rms_median_m=0.10, closed_max_worst_m=0.30, false_closures=0),
            *(at_most(f"site_{lidar}_", closed_surface_rms_m_worst=0.03) for lidar in LIDARS),
        ),
    ),
    Row(
        "`mecanum` driven around `campus` (300 m, noise and mounts drawn; simulated; a development place), mapped with loop closure",
        "≤ 0.10 m RMS and ≤ 0.30 m at worst with the first pose aligned",
        "lio_campus.json",
        "{start_rms_m:.3f} m, {start_max_m:.3f} m over {path_length_m:.0f} m; {ate_rms_m:.3f} m after the best rigid motion",
        at_most(start_rms_m=0.10, start_max_m=0.30),
    ),
    Row(
        "the same, told that its ground is level, which it is not (`lio.planar.is_used`)",
        "unharmed: as above",
        "lio_campus_planar.json",
        "{start_rms_m:.3f} m, {start_max_m:.3f} m; height {height_rms_m:.3f} m",
        at_most(start_rms_m=0.10, start_max_m=0.30),
    ),
    Row(
        "loop closure where places look alike: two equal corridors, tunnels (simulated)",
        "no false closure",
        "lio_alike.json",
        "{runs} runs, "
        "{twins_vlp_16_false_closures} and {twins_mid_360_false_closures} false in corridors, {tunnel_vlp_16_false_closures} and {tunnel_mid_360_false_closures} in tunnels; "
        "worst point {twins_vlp_16_closed_max_m_worst:.2f} m",
        at_most(
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
        all_of(
            at_least(guess_success=59, none_success=54),  # without a guess those that were found within 10 s
            at_most(guess_false=0, none_false=0),
        ),
    ),
    Row(
        "switched on in saved garages of two decks (drawn), 30 % of the cars gone or moved since: told nothing, it looks and turns for 20 s (simulated)",
        "0 wrong places, ≤ 10 % unsure",
        "lost3d.json",
        "{right} of {starts} right, {wrong} wrong (≤ {wrong_ratio_high_95:.1%} at 95 %), {unsure} unsure; after {found_s_median:.1f} s (worst {found_s_worst:.1f})",
        all_of(at_most(wrong=0), lambda fields: bool(fields["bars_unsure"])),
    ),
    Row(
        "LiDAR-inertial odometry with 30 % of the returns false: dust and rain; standing smoke (drawn sites, simulated)",
        "error ≤ 1.5 × that in clear air",
        "lio_air.json",
        "dust {dust_mid_360_ratio_vs_clear_worst:.2f} and {dust_vlp_16_ratio_vs_clear_worst:.2f}, rain {rain_mid_360_ratio_vs_clear_worst:.2f} and "
        "{rain_vlp_16_ratio_vs_clear_worst:.2f}; smoke, {smoke_mid_360_false_return_ratio_worst:.0%} false: {smoke_mid_360_ratio_vs_clear_worst:.2f} and "
        "{smoke_vlp_16_ratio_vs_clear_worst:.2f} (Mid-360 and VLP-16, worst)",
        at_most(
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
        at_most(odometry_ratio=0.15),
    ),
    Row(
        "memory of LiDAR-inertial odometry with loop closure along a way of 5 km that it has never seen (Mid-360, simulated)",
        "flat: ≤ 25 MB more in the last fifth than in the second",
        "memory_walk.json",
        "{growth_mb:.0f} MB more over {way_m:.0f} m, {passing_mb:.0f} MB more at most, of {settled_mb:.0f} MB with the simulated site; "
        "{end_m:.2f} m off at the end",
        all_of(at_least(way_m=4900.0), at_most(growth_mb=25.0, passing_mb=100.0)),
    ),
    Row(
        "memory of a whole robot (`go2`) that is driven round `campus` for half an hour, after a round and a half (simulated)",
        "(as above)",
        "memory_drive.json",
        "{growth_mb:.0f} MB more over {seconds:.0f} s, {passing_mb:.0f} MB more at most, of {settled_mb:.0f} MB",
        all_of(at_least(seconds=1795.0), at_most(growth_mb=25.0, passing_mb=100.0)),
    ),
    Row(
        "ground on drawn sites, mounts off by 5 cm and 3° (simulated)",
        "≤ 0.1 % false on flat floor; drops ≥ 8 cm seen at ≥ 1.5 m; kerbs of 12 cm never open, slopes of 15° free",
        "ground.json",
        "false {mecanum_false_ratio:.2%} and {go2_false_ratio:.2%}; drops {mecanum_drop_good} and {go2_drop_good} of {mecanum_drop_runs}, from "
        "{mecanum_drop_seen_at_least_m:.1f} m; kerbs {mecanum_kerb_good} and {go2_kerb_good}, rows of kerb stones {mecanum_stones_good} and {go2_stones_good}, slopes {mecanum_slope_good} and {go2_slope_good} "
        "of {mecanum_slope_runs} (`mecanum`, `go2`)",
        all_of(
            at_most(mecanum_false_ratio=0.001, go2_false_ratio=0.001),
            at_least(mecanum_drop_good=10, go2_drop_good=10, mecanum_kerb_good=10, mecanum_slope_good=10),
            at_least(mecanum_stones_good=10, go2_stones_good=10),
        ),
    ),
    Row(
        "terrain within 10 m, 20k points of a Mid-360, one core",
        "≤ 1.0 ms",
        "bench_terrain.json",
        "{near_update_ms:.2f} ms (95 %: {near_update_p95_ms:.2f}); its cloud {near_terrain_ms:.2f} ms; the window of {level_lidar_window_m:.1f} m of a level LiDAR {level_lidar_update_ms:.2f} ms",
        at_most(near_update_ms=1.0),
    ),
    Row(
        "motion primitives: scoring of 343 paths in 36 directions with 1000 points of terrain, one core",
        "≤ 1.0 ms",
        "bench_terrain.json",
        "{primitives_scoring_ms:.2f} ms (95 %: {primitives_scoring_p95_ms:.2f}); the planner's whole cycle {primitives_cycle_ms:.2f} ms ({primitives_cycle_p95_ms:.2f})",
        at_most(primitives_scoring_ms=1.0),
    ),
    Row(
        "visibility graph of 2000 nodes: update and search",
        "≤ 3 ms each, ≤ 20 % of a core",
        "bench_far.json",
        "{nodes} nodes: {update_median_ms:.2f} ms (95 %: {update_p95_ms:.2f}) and {search_median_ms:.2f} ms ({search_p95_ms:.2f}); {core_share_pct:.1f} % of a core",
        at_most(update_median_ms=3.0, search_median_ms=3.0, core_share_pct=20.0),
    ),
    Row(
        "table tops, signs, bars and drawers above a planar scanner, drawn, mounts off: with depth cameras and voxels, and without",
        "0 collisions",
        "overhangs.json",
        "{with_voxels_reached} of {with_voxels_goals} goals, {with_voxels_collisions} collisions in {with_voxels_runs} runs; without {without_reached} of {without_goals}, "
        "{without_collisions} collisions",
        at_most("with_voxels_", collisions=0),
    ),
    Row(
        "20 walking people, 10 of whom do not yield, drawn: contacts that the robot caused (`diff`, `amr_omni`, `spot`; three worlds)",
        "0 in 30 runs",
        "crowd.json",
        "{collisions} in {runs} runs, of {contacts} contacts in all; median way {path_length_m_median:.0f} m, {reachable_coverage_ratio_median:.0%} of the floor in at most 300 s",
        all_of(at_most(collisions=0), at_least(runs=30)),
    ),
    Row(
        "sites in three dimensions, drawn (plots with slopes and kerbs, garages of two levels), explored by `go2`, `mecanum` and `spot`",
        "10 sites: ≥ 98 % of the visible surface, with proof, at home, 0 collisions; path ≤ 2 × the tour with full knowledge",
        "sites.json",
        "{all_done} of {all_runs} done ({all_finished} with proof, {all_at_home} at home), {all_collisions} collisions; surface {all_surface_coverage_ratio_median:.1%} (worst "
        "{all_surface_coverage_ratio_worst:.1%}), {all_ate_unaligned_rms_m_median:.2f} m in the frame of the start; path "
        "{all_ratio_vs_known_tour_median:.2f} × (worst {all_ratio_vs_known_tour_worst:.2f})",
        all_of(
            lambda fields: bool(fields["bars_done"]) and fields["all_collisions"] == 0,
            at_most("all_", ratio_vs_known_tour_median=2.0),
            at_least("all_", runs=10),
        ),
    ),
    Row(
        "drawn plots and garages, `go2`, `mecanum` and `spot`: explored, saved; switched on elsewhere, lost; five way-points",
        "10 sites, each robot: all of it with nobody's hand, 0 collisions",
        "return.json",
        "{done} of {runs}; found itself after {found_s_worst:.1f} s, {found_m_worst:.3f} m off; {way_points_reached} of {way_points} way-points, "
        "{way_point_error_max_m_worst:.3f} m off at worst; {collisions} collisions",
        every("", "done", of=30),
    ),
    Row(
        "goals in unknown offices and flats, drawn, `diff`: visibility graph beside the grid planner in the same run",
        "all reached; time ≤ 1.0 ×, ≤ 0.9 × with dead ends; ≤ 1 reversal per 50 m",
        "unknown.json",
        "{visibility_graph_reached} of {visibility_graph_runs} (grid {grid_reached}), {visibility_graph_collisions} collisions; {ratio_vs_grid:.2f} ×, "
        "{dead_end_ratio_vs_grid:.2f} ×; {visibility_graph_reversals_per_50m:.2f} reversals (grid {grid_reversals_per_50m:.2f})",
        all_of(
            at_least(visibility_graph_reached=20),
            at_most(ratio_vs_grid=1.0, dead_end_ratio_vs_grid=0.9, visibility_graph_reversals_per_50m=1.0),
        ),
    ),
    Row(
        "LiDAR-inertial odometry beside kiss-icp on the same scans, drawn sites, VLP-16 (simulated)",
        "≤ 0.5 of its error in 10",
        "lio_peer.json",
        "{runs} sites: {site_vlp_16_ratio_vs_kiss_error_median:.3f} (worst {site_vlp_16_ratio_vs_kiss_error_worst:.3f}) of its error",
        all_of(at_least(runs=10), at_most(site_vlp_16_ratio_vs_kiss_error_worst=0.5)),
    ),
    Row(
        "LiDAR-inertial odometry beside kiss-icp on the same scans, drawn halls, VLP-16 (simulated)",
        "≤ 0.5 of its error in 10",
        "lio_peer_hall.json",
        "{hall_vlp_16_runs} halls: {hall_vlp_16_ratio_vs_kiss_error_median:.3f} (worst {hall_vlp_16_ratio_vs_kiss_error_worst:.3f}) of its error",
        all_of(at_least(hall_vlp_16_runs=10), at_most(hall_vlp_16_ratio_vs_kiss_error_worst=0.5)),
    ),
    Row(
        "LiDAR-inertial odometry in the hand, 1000 °/s and 3 m/s²; tunnel with wheel odometry (simulated)",
        "≤ 0.1 m; end ≤ 1 % of the way, degeneracy told",
        "lio_hard.json",
        "{runs_met} of {runs}; worst {shaken_vlp_16_start_rms_m_worst:.3f} and {shaken_mid_360_start_rms_m_worst:.3f} m; tunnel "
        "{tunnel_vlp_16_end_pct_worst:.2f} and {tunnel_mid_360_end_pct_worst:.2f} %",
        every("", "runs_met", of=4),
    ),
    Row(
        "LiDAR-inertial odometry that stands for 10 min after a walk of 60 to 90 m (simulated)",
        "drift ≤ 1 cm, NEES 0.5 … 2 (as above)",
        "lio_rest.json",
        "{rest_vlp_16_rest_drift_m_worst:.4f} m at worst ({rest_vlp_16_runs} runs), NEES {rest_vlp_16_nees_mean:.2f}, greatest {rest_vlp_16_nees_worst:.1f}",
        all_of(
            at_most(rest_vlp_16_rest_drift_m_worst=0.01, rest_vlp_16_nees_worst=2.0),
            at_least(rest_vlp_16_nees_mean=0.5),
        ),
    ),
    Row(
        "a real IMU (`imu_deskew`), integrated from the published trajectory on",
        "our own (no LiDAR is in the recording): ≤ 1 mm (95 %) after a scan's time",
        "real3d.json",
        "after 0.1 s {imu_after_100_ms_rotation_deg_median:.3f}° and {imu_after_100_ms_position_m_median:.4f} m (95 %: {imu_after_100_ms_position_m_95:.4f}), "
        "after 1 s {imu_after_1000_ms_rotation_deg_median:.3f}° and {imu_after_1000_ms_position_m_median:.3f} m, after 5 s {imu_after_5000_ms_rotation_deg_median:.3f}°",
        all_of(at_least(imu_after_100_ms_runs=1000), at_most(imu_after_100_ms_position_m_95=0.001)),
    ),
    Row(
        "two real clouds (`pair3d`), beside kiss-icp, against the published relation",
        "found from 50 of 50 drawn guesses within 1 m and 10°",
        "real3d.json",
        "{pair_position_error_m:.4f} m and {pair_rotation_error_deg:.2f}° off (kiss-icp {peer_kiss_pair_position_error_m:.4f} m, "
        "{peer_kiss_pair_rotation_error_deg:.2f}°); {pair_starts_found} of {pair_starts}",
        at_least(pair_starts_found=50),
    ),
    Row(
        "a real recording of a LiDAR alone (`balm`: 40 clouds, two a second, up to 29° between them; looked at in development), against its reference, beside kiss-icp",
        "all followed, RMS with the first pose aligned ≤ kiss-icp's",
        "lio_balm.json",
        "{start_rms_m:.3f} m RMS from the start (worst {start_max_m:.3f}), {ate_rms_m:.3f} m after the best rigid motion, {rotation_rms_deg:.2f}° RMS; kiss-icp {peer_kiss_start_rms_m:.3f} and {peer_kiss_ate_rms_m:.3f} m",
        lambda fields: bool(fields["poses"] == 40 and fields["start_rms_m"] <= fields["peer_kiss_start_rms_m"]),
    ),
    Row(
        "particle update, 2000 × 60 beams; EKF step",
        "≤ 5 ms; ≤ 50 µs",
        "bench_particles.json",
        "{particle_update_ms:.2f} ms; {ekf_step_us:.1f} µs",
        at_most(particle_update_ms=5.0, ekf_step_us=50.0),
    ),
    Row(
        "a real Husky's wheels and gyroscope against its satellites",
        "reported",
        "odometry_husky.json",
        "{fused_error_rms_m:.1f} m RMS over {way_m:.0f} m (wheels alone {wheels_error_rms_m:.1f} m)",
        is_reported,
    ),
)
