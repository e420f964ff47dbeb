"""Localization in known maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ambler.evaluation.bars.row import Row, all_of, at_least, at_most


def _is_localized(fields: dict[str, Any], localizer: str) -> bool:
    names = [f"{place}_{localizer}_" for place in ("aisle", "wall", "building")]
    return all(fields[n + "error_rms_m"] <= 0.01 and 0.5 <= fields[n + "nees_mean"] <= 2.0 for n in names)


ROWS: Sequence[Row] = (
    Row(
        "find a lost robot, office and warehouse (source: 1 of 3)",
        "≥ 97 % within 5 s, 0 wrong",
        "relocalization.json",
        "{success_ratio:.0%} of {runs} ({success_interval_low:.1%} … {success_interval_high:.1%}), {wrong} wrong, median {time_median_s:.1f} s",
        all_of(at_least(success_ratio=0.97, runs=100), at_most(wrong=0)),
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
        all_of(
            at_least(
                drives=20,
                tracker_nees_mean=0.5,
                tracker_static_nees_mean=0.5,
                relocalization_runs=200,
                relocalization_success_ratio=0.97,
            ),
            at_most(
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
)
