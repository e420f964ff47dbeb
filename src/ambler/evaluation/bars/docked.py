"""Docking, and several missions in one run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ambler.evaluation.bars.row import Row, at_most, every


def _is_docked(fields: dict[str, Any]) -> bool:
    limits = at_most(position_error_p95_m=0.003, yaw_error_p95_deg=0.1, position_error_max_m=0.008)
    return every("", "within_two_attempts", of=60)(fields) and limits(fields)


ROWS: Sequence[Row] = (
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
        at_most(docking_time_median_s=8.0, marker_still_p95_x_mm=1.0, marker_moving_p95_x_mm=3.0, collisions=0),
    ),
    Row(
        "one run: explore `building`, dock, undock, 5 goals, dock, `amr_omni`",
        "5 of 5, 0 collisions, no restart",
        "program_amr.json",
        "{succeeded} of {amr_omni_runs}, {amr_omni_goals_reached} of {amr_omni_goals} goals, {collisions} collisions; docked within "
        "{amr_omni_dock_error_m_worst:.4f} m, {amr_omni_dock_error_deg_worst:.3f}° (worst)",
        every("amr_omni_", "succeeded", of=5),
    ),
    Row(
        "the same without docks, `spot` and `diff`",
        "all, 0 collisions",
        "program_spot_diff.json",
        "`spot` {spot_succeeded} of {spot_runs} ({spot_goals_reached} of {spot_goals} goals), `diff` {diff_succeeded} of {diff_runs}; "
        "{collisions} collisions",
        every("", "succeeded", of=4),
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
)
