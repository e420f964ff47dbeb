"""What studies make of their runs, and what they refuse."""

from pathlib import Path

import pytest

from ambler.apps import fault_study, glass_study
from ambler.apps.demo_process import DemoJob, run_demo
from ambler.cli.main import main
from ambler.sim.faults import Fault, FaultKind
from ambler.sim.robots import robot_named


def test_every_fault_of_driving_has_a_case_that_can_be_run() -> None:
    cases = fault_study.fault_cases()
    driving = ("wheel_slip", "scanner_dropout", "scanner_stuck", "delayed_stamps", "people", "door", "glass")
    assert {Fault.parse(c.fault).kind for c in cases} == {FaultKind(name) for name in driving}
    assert len({(c.name, c.robot) for c in cases}) == len(cases)
    for case in cases:
        robot_named(case.robot)
        assert case.limits.coverage is not None or case.limits.ends != ("finished",), "a good end has limits"


def test_a_fault_summary_tells_the_worst_and_what_broke() -> None:
    base = {"case": "people", "robot": "diff", "fault": "people", "limits": "finished"}
    results = [
        {**base, "seed": 0, "ended": "finished", "collisions": 0, "coverage_ratio": 0.99, "broken": ()},
        {**base, "seed": 1, "ended": "stuck", "collisions": 2, "coverage_ratio": 0.5, "broken": ("2 collisions", "x")},
    ]
    fields = fault_study.summarize(results)
    assert (fields["runs"], fields["passed"], fields["collisions"]) == (2, 1, 2)
    assert fields["people.diff.coverage_ratio_worst"] == 0.5
    assert fields["people.diff.ended"] == "finished, stuck"
    assert fields["people.diff.broken"] == "seed 1: 2 collisions; seed 1: x"


def test_a_glass_summary_keeps_robots_and_variants_apart() -> None:
    runs = [
        {"base": "diff", "variant": v, "ended": "finished", "contacts": n, "glass_contacts": n, "found_ratio": f}
        for v, n, f in (("with_layers", 0, 0.9), ("with_layers", 0, 0.7), ("without_layers", 3, None))
    ]
    fields = glass_study.summarize(runs)
    assert (fields["diff.with_layers.contacts"], fields["diff.without_layers.contacts"]) == (0, 3)
    assert fields["diff.with_layers.found_ratio_worst"] == 0.7
    assert fields["diff.without_layers.runs_with_contact"] == 1
    assert "diff.without_layers.found_ratio_worst" not in fields


def test_a_resumed_study_counts_what_is_there(tmp_path: Path) -> None:
    job = DemoJob("two_rooms", "diff", 3, "people", ("--fault", "people"))
    assert job.label == "two_rooms-diff-people-3"
    (tmp_path / f"{job.label}.json").write_text('{"ended": "finished", "collisions": 0}')
    assert run_demo(job, tmp_path, is_resumed=True) == {"ended": "finished", "collisions": 0}
    assert [p.name for p in tmp_path.iterdir()] == ["two_rooms-diff-people-3.json"], "nothing was run"


def test_a_run_that_died_is_told_as_crashed_and_leaves_nothing_old(tmp_path: Path) -> None:
    job = DemoJob("two_rooms", "hovercraft", 0)
    (tmp_path / f"{job.label}.json").write_text('{"ended": "finished"}')
    result = run_demo(job, tmp_path)
    assert result["ended"] == "crashed"
    assert "hovercraft" in (tmp_path / f"{job.label}.log").read_text()


@pytest.mark.parametrize(
    "words",
    [
        ["faults", "--only", "gremlins"],
        ["faults", "--robots", "hovercraft"],
        ["glass", "--robots", "hovercraft"],
        ["glass", "--world", "nowhere"],
    ],
)
def test_studies_refuse_what_is_not_there(words: list[str], tmp_path: Path) -> None:
    assert main(["eval", *words, "--out", str(tmp_path)]) == 2
    assert list(tmp_path.iterdir()) == []
