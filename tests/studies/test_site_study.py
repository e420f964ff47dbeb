"""What a study of sites makes of its runs: each condition of a run that is done counts."""

from __future__ import annotations

import pytest

from ambler.studies.site_study import is_done, site_study, summarize
from ambler.studies.study import plain_values

GOOD = {
    "kind": "plot",
    "seed": 1,
    "world": "plot-1",
    "robot": "go2",
    "ended": "finished",
    "is_home": True,
    "collisions": 0,
    "surface_coverage_ratio": 0.99,
    "reachable_coverage_ratio": 0.99,
    "ratio_vs_known_tour": 1.5,
    "ate_unaligned_rms_m": 0.1,
}


@pytest.mark.parametrize(
    ("what", "value"), [("ended", "stuck"), ("is_home", False), ("collisions", 1), ("surface_coverage_ratio", 0.97)]
)
def test_a_run_that_lacks_something_is_not_done(what, value):
    assert is_done(GOOD)
    bad = {**GOOD, what: value}
    assert not is_done(bad)
    fields = summarize([GOOD, bad])
    assert (fields["all.done"], fields["all.runs"], fields["bars.done"]) == (1, 2, False)


def test_a_run_that_crashed_counts_and_is_told_with_the_others():
    case = site_study([7], ("garage",), ("spot",)).cases[0]
    crashed = {**plain_values(case), "ended": "crashed", "why": "died"}
    fields = summarize([GOOD, crashed])
    assert (fields["all.done"], fields["all.runs"], fields["bars.done"]) == (1, 2, False)
    assert (fields["run.garage-7.spot.ended"], fields["run.plot-1.go2.ended"]) == ("crashed", "finished")


def test_the_way_is_judged_by_the_median_and_kinds_take_turns():
    far = {**GOOD, "ratio_vs_known_tour": 3.0}
    assert summarize([GOOD, GOOD, far])["bars.path"]
    assert not summarize([GOOD, far, far])["bars.path"]
    cases = site_study([5, 6, 7], ("plot", "garage"), ("go2", "spot")).cases
    assert [(c.kind, c.seed, c.robot) for c in cases][:3] == [
        ("plot", 5, "go2"),
        ("plot", 5, "spot"),
        ("garage", 6, "go2"),
    ]
    assert cases[-1].kind == "plot"
