"""What studies make of their runs, and what they refuse."""

from pathlib import Path

import pytest

from ambler.cli.main import main
from ambler.core.se2 import SE2
from ambler.sim.faults import Fault, FaultKind
from ambler.sim.robots import robot_named
from ambler.studies import (
    calibration_study,
    docking_study,
    exploration_study,
    fault_study,
    glass_study,
    interrupt_study,
    live_study,
    lost_robot_study,
    navigation_study,
    program_study,
)
from ambler.studies.demo_process import run_demo
from ambler.studies.random_drives import DriveCase
from ambler.studies.study import plain_values


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
        for v, n, f in (("ring", 0, 0.9), ("ring", 0, 0.7), ("light", 3, None))
    ]
    fields = glass_study.summarize(runs)
    assert (fields["diff.ring.contacts"], fields["diff.light.contacts"]) == (0, 3)
    assert fields["diff.ring.found_ratio_worst"] == 0.7
    assert fields["diff.light.runs_with_contact"] == 1
    assert "diff.light.found_ratio_worst" not in fields


def test_a_run_that_died_is_told_as_crashed_and_leaves_nothing_old(tmp_path: Path) -> None:
    (tmp_path / "demo.json").write_text('{"ended": "finished"}')
    result = run_demo(tmp_path, "two_rooms", "hovercraft", 0)
    assert result["ended"] == "crashed"
    assert "hovercraft" in result["why"]
    assert "hovercraft" in (tmp_path / "demo.log").read_text()


def test_crashed_cases_count_against_every_summary() -> None:
    crashed = {"ended": "crashed", "why": "x", "seed": 1}
    case = fault_study.FaultRun(fault_study.fault_cases()[0], 1)
    assert fault_study.summarize([fault_study.told(case, crashed)])["passed"] == 0
    fields = exploration_study.summarize([{**crashed, "world": "w", "robot": "r", "strategy": "s"}])
    assert (fields["w.r.s.runs"], fields["w.r.s.finished"]) == (1, 0)
    assert not exploration_study.is_good(crashed)
    assert not glass_study.is_good({**crashed, "variant": "ring"})
    assert program_study.summarize([{**crashed, "robot": "diff"}])["succeeded"] == 0
    assert not program_study.is_good(crashed)
    assert not program_study.is_team_good(crashed)
    outcome = docking_study.outcome_of({**crashed, "kind": "random", "distance": 3.0})
    assert not docking_study.is_good(outcome)
    assert navigation_study.summarize([crashed])["failures"] == "crashed"
    assert lost_robot_study.summarize_relocalization([crashed])["success_ratio"] == 0.0
    assert lost_robot_study.summarize_kidnapping([crashed])["success_ratio"] == 0.0
    assert live_study.summarize([{**crashed, "kind": "explore"}])["explore.succeeded"] == 0
    assert interrupt_study.summarize([{**crashed, "number": 0, "signal_name": "SIGINT", "after": 1.0}])["wrong"]
    assert calibration_study.summarize([crashed])["within_bars"] == 0


def test_goals_of_a_journey_that_crashed_count_and_a_lost_robot_is_counted_in_its_world() -> None:
    journey = navigation_study.Journey("office", "diff", 0, 0, (SE2(), SE2()))
    crashed = {**plain_values(journey), "ended": "crashed", "why": "x"}
    fields = navigation_study.summarize_all([journey], [crashed])
    assert (fields["office.diff.goals"], fields["office.diff.reached"]) == (2, 0)
    lost = lost_robot_study.LostCase(DriveCase("office", "diff", 3, 0), 0.05)
    fields = lost_robot_study.summarize_relocalization([{**plain_values(lost), "ended": "crashed", "why": "x"}])
    assert (fields["office.runs"], fields["office.success_ratio"]) == (1, 0.0)


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
