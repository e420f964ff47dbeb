"""Goals in unknown places: dead ends are dead ends, and the summary compares like with like."""

import math

import pytest

from ambler.studies.unknown_study import DETOUR, LEAST_WAY, PLANNERS, draw_goal, meets_bars, summarize, unknown_cases


def result(
    planner: str, world: str, seconds: float, *, is_dead_end: bool, is_reached: bool = True
) -> dict[str, object]:
    return {
        "planner": planner,
        "world": world,
        "is_dead_end": is_dead_end,
        "is_reached": is_reached,
        "travel_seconds": seconds,
        "path_length_m": 25.0,
        "way": 20.0,
        "reversals": 0,
        "collisions": 0,
    }


def test_goals_behind_dead_ends_have_ways_much_longer_than_the_straight_line() -> None:
    _, goal, way = draw_goal("office", "diff", 202, is_dead_end=True)
    assert way >= max(LEAST_WAY, DETOUR * math.hypot(*goal))
    assert draw_goal("office", "diff", 202, is_dead_end=True)[1] == goal


def test_both_planners_get_the_same_goals_and_every_kind_has_dead_ends() -> None:
    cases = unknown_cases(["office", "flat"], "diff", range(200, 204), "kinematic")
    assert [c.planner for c in cases] == list(PLANNERS) * 4
    assert [c.is_dead_end for c in cases[::2]] == [False, False, True, True]
    for one, other in zip(cases[::2], cases[1::2], strict=True):
        assert (one.world, one.goal, one.seed, one.way) == (other.world, other.goal, other.seed, other.way)
    assert len({c.label for c in cases}) == 8


def test_ratios_are_of_pairs_that_both_came_there_and_bars_count_every_goal() -> None:
    pairs = [("a", 80.0, 100.0, True), ("b", 90.0, 100.0, True), ("c", 100.0, 100.0, False), ("d", 60.0, 50.0, False)]
    results = []
    for world, ours, theirs, is_dead_end in pairs:
        results.append(result("visibility_graph", world, ours, is_dead_end=is_dead_end))
        results.append(result("grid", world, theirs, is_dead_end=is_dead_end))
    fields = summarize(results)
    assert fields["ratio_vs_grid"] == pytest.approx(0.95)
    assert fields["dead_end.ratio_vs_grid"] == pytest.approx(0.85)
    assert fields["any.ratio_vs_grid"] == pytest.approx(1.1)
    assert meets_bars(fields)
    results[1]["is_reached"] = False
    fields = summarize(results)
    assert fields["pairs"] == 3
    assert fields["dead_end.ratio_vs_grid"] == pytest.approx(0.9)
    results[0]["is_reached"] = False
    assert not meets_bars(summarize(results))
