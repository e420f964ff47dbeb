"""Exploring large worlds, faults and glass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ambler.evaluation.bars.row import Judge, Row, all_of, at_least, at_most, every


def _is_world_met(world: str, error: float = 0.05) -> Judge:
    prefixes = [f"{world}_{robot}_tour_" for robot in ("amr_omni", "diff")]
    return all_of(
        *(every(p, "finished", of=3) for p in prefixes),
        *(at_least(p, reachable_coverage_ratio_worst=0.98) for p in prefixes),
        *(at_most(p, ate_rms_m_worst=error) for p in prefixes),
    )


def _explored_briefly(world: str, robots: Sequence[str] = ("amr_omni", "diff")) -> str:
    parts = []
    for robot in robots:
        p = f"{world}_{robot}_tour_"
        parts.append(
            f"`{robot}` {{{p}finished}} of {{{p}runs}} with proof, {{{p}collisions}} collisions, worst "
            f"{{{p}reachable_coverage_ratio_worst:.2%}} and {{{p}ate_rms_m_worst:.3f}} m"
        )
    return "; ".join(parts)


_GLASS_ROBOTS = ("diff", "amr_omni", "spot")
_GLASS_RUNS = ", ".join(
    f"{{{{{robot}_{{variant}}_finished}}}} of {{{{{robot}_{{variant}}_runs}}}} with {{{{{robot}_{{variant}}_contacts}}}} contacts"
    for robot in _GLASS_ROBOTS
)
_WIDE_BAR = "≥ 98 % of the reachable floor, 0 collisions, proof, ≤ 0.05 m"


def _is_short(f: dict[str, Any]) -> bool:
    """Whether `tour` drives at most twice the tour with full knowledge, and less than the other strategies."""
    mine, others = "tour_ratio_vs_known_tour_median", ("nearest", "greedy")
    return f[mine] <= 2.0 and all(f["tour_path_total_m_mean"] < f[f"{name}_path_total_m_mean"] for name in others)


ROWS: Sequence[Row] = (
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
        at_most(path_at_98pct_m_ratio_vs_greedy=0.8, path_at_98pct_m_ratio_vs_nearest=1.0),
    ),
    Row(
        "every fault on demand, two robots",
        "0 collisions; within stated limits or a named failure",
        "faults.json",
        "{passed} of {runs} runs within their limits, {collisions} collisions",
        every("", "passed"),
    ),
    Row(
        "explore among glass (the built-in world), `diff`, `amr_omni` and `spot`, with an ultrasonic ring and by light alone, drawn seeds",
        "all finished, 0 contacts",
        "glass.json",
        f"with a ring {_GLASS_RUNS.format(variant='ring')}; by light alone {_GLASS_RUNS.format(variant='light')}; coverage worst "
        "{amr_omni_light_coverage_ratio_worst:.1%}",
        all_of(
            *(
                every(f"{robot}_{variant}_", "finished", of=3, collisions="contacts")
                for robot in _GLASS_ROBOTS
                for variant in ("ring", "light")
            )
        ),
    ),
)
