"""Tuning with a quick made-up objective: what is sampled, who goes on, what is best; killed and restarted the end is the same."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.evaluation.tuning import Ranked, write_best, write_ranking
from ambler.evaluation.tuning_report import effect, study_fields, write_study_report
from ambler.evaluation.tuning_space import Bound, Case, Parameter, TuningSpace, load_space
from ambler.studies import demo_process, pool
from ambler.studies.pool import LocalPool, Pool, ThisProcess
from ambler.studies.tuning_study import TrialCase, tune

SPACE = TuningSpace(
    {
        "rollout.weight_path": Parameter((0.5, 8.0), scale="log"),
        "rollout.near": Parameter((0.1, 0.3)),
        "strategy": Parameter(choices=("tour", "nearest", "greedy")),
    },
    worlds=("office", "lab_empty"),
    seeds=(0, 1),
    trials=16,
    objective={"path_length_m": 1.0, "coverage_ratio": -0.5},
    constraints={"collisions": Bound(max=0.0), "coverage_ratio": Bound(min=0.9)},
)


def fake(trial: TrialCase, folder: Path) -> dict[str, Any]:
    """The best weight is 2; `near` does not matter; `greedy` collides in one case; the second seed is twice as long."""
    profile, case = trial.settings.profile, trial.case
    rollout = profile.get("rollout", {})
    weight, strategy = rollout.get("weight_path", 3.0), profile.get("strategy", "tour")
    length = (40.0 + 10.0 * abs(weight - 2.0)) * (1 + case.seed)
    collisions = int(strategy == "greedy" and case.world == "lab_empty")
    return {"ended": "finished", "path_length_m": length, "coverage_ratio": 0.99, "collisions": collisions}


def ignore(text: str) -> None:
    """Nobody watches."""


def run(folder: Path, space: TuningSpace = SPACE, pool: Pool | None = None, evaluate: Any = fake) -> list[Ranked]:
    return tune(space, folder, pool or ThisProcess(), run=evaluate, tell=ignore)


def test_the_best_valid_trial_wins_and_is_a_profile(tmp_path: Path) -> None:
    ranking = run(tmp_path)
    best = ranking[0]
    assert best.is_valid
    assert best.cases == 4
    assert best.values["strategy"] != "greedy"
    tried = SPACE.sampled()
    allowed = [t for t in tried[1:] if t["strategy"] != "greedy"]
    assert best.values == min(allowed, key=lambda t: abs(float(t["rollout.weight_path"]) - 2.0))
    write_best(tmp_path / "best.yaml", SPACE.profile(best.values), "made by a test")
    assert yaml.safe_load((tmp_path / "best.yaml").read_text())["rollout"]["near"] == best.values["rollout.near"]
    assert (tmp_path / "best.yaml").read_text().startswith("# made by a test\n")


def test_the_defaults_are_trial_0_and_score_the_sum_of_the_weights(tmp_path: Path) -> None:
    default = next(r for r in run(tmp_path) if r.trial == 0)
    assert default.values == {}
    assert default.cases == 4
    assert default.objective == pytest.approx(0.5)


def test_a_trial_that_breaks_a_constraint_is_last_whatever_its_objective(tmp_path: Path) -> None:
    ranking = run(tmp_path)
    is_valid = [r.is_valid for r in ranking]
    assert is_valid == sorted(is_valid, reverse=True)
    broken = [r for r in ranking if not r.is_valid]
    assert broken
    assert all("lab_empty-diff-0: collisions = 1" in r.broken for r in broken)


def test_half_of_the_trials_go_on(tmp_path: Path) -> None:
    assert SPACE.rungs() == [2, 4]
    ranking = run(tmp_path)
    assert sum(r.cases == 4 for r in ranking) in (8, 9)  # the best half, and the defaults
    assert sum(r.cases == 2 for r in ranking) == 16 - sum(r.cases == 4 for r in ranking)


def test_runs_under_way_do_not_change_the_end(tmp_path: Path) -> None:
    assert run(tmp_path / "one") == run(tmp_path / "two", pool=LocalPool(2))


class Killed(BaseException):
    """Not an Exception: nothing may swallow it."""


calls: list[str] = []
dies_after = 0


def counted(trial: TrialCase, folder: Path) -> dict[str, Any]:
    """The made-up objective, until it has been called so many times."""
    if len(calls) == dies_after:
        raise Killed
    calls.append(trial.label)
    return fake(trial, folder)


@pytest.mark.parametrize("after", [1, 7, 33])
def test_killed_and_restarted_it_goes_on_to_the_same_end(
    after: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "dies_after", after)
    calls.clear()
    with pytest.raises(Killed):
        run(tmp_path / "killed", evaluate=counted)
    monkeypatch.setitem(globals(), "dies_after", -1)
    ranking = run(tmp_path / "killed", evaluate=counted)
    assert ranking == run(tmp_path / "whole")
    assert len(calls) == len(set(calls)), "nothing is run twice"


def test_a_study_may_grow_and_weigh_otherwise_without_running_again_what_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "dies_after", -1)
    calls.clear()
    run(tmp_path, evaluate=counted)
    first = set(calls)
    assert replace(SPACE, trials=32).sampled()[:16] == SPACE.sampled()
    run(tmp_path, replace(SPACE, trials=32), evaluate=counted)
    assert len(calls) == len(set(calls))
    assert set(calls) > first
    calls.clear()
    run(tmp_path, replace(SPACE, objective={"path_length_m": -1.0}, seeds=(0,)), evaluate=counted)
    assert calls == []


def test_crashed_runs_are_invalid_and_defaults_that_crash_are_replaced_as_reference(tmp_path: Path) -> None:
    def crashing(trial: TrialCase, folder: Path) -> dict[str, Any]:
        return fake(trial, folder) if trial.trial else {"ended": "crashed", "why": "no power"}

    ranking = run(tmp_path, evaluate=crashing)
    assert ranking[0].is_valid
    assert next(r for r in ranking if r.trial == 0).broken[0] == "office-diff-0: ended crashed"


def test_an_unknown_metric_is_told_at_the_first_result(tmp_path: Path) -> None:
    space = replace(SPACE, objective={"beauty": 1.0})
    with pytest.raises(
        BadInputError, match=r"'beauty', but a run tells only collisions, coverage_ratio, path_length_m"
    ):
        run(tmp_path, space)


def test_effects_find_the_parameter_that_matters(tmp_path: Path) -> None:
    space = replace(SPACE, seeds=(0,), trials=64)
    fields = study_fields(space, run(tmp_path, space))
    weight, near = fields["effect.rollout.weight_path"], fields["effect.rollout.near"]
    assert isinstance(weight, float)
    assert isinstance(near, float)
    assert weight > 0.7
    assert near < 0.2
    assert effect(["a", "a", "b", "b"], [1.0, 1.0, 2.0, 2.0]) == pytest.approx(1.0)


def test_the_report_ranks_and_draws(tmp_path: Path) -> None:
    ranking = run(tmp_path)
    page = write_study_report(tmp_path, SPACE, ranking)
    assert "rollout.weight_path" in page.read_text()
    assert (tmp_path / "effects.png").stat().st_size > 5000
    write_ranking(tmp_path / "ranking.jsonl", ranking)
    lines = [json.loads(line) for line in (tmp_path / "ranking.jsonl").read_text().splitlines()]
    assert [line["trial"] for line in lines] == [r.trial for r in ranking]
    assert lines[-1]["objective"] is None


@given(st.floats(0.0, 1.0, exclude_max=True))
def test_values_stay_in_their_ranges(unit: float) -> None:
    assert 0.1 <= float(Parameter((0.1, 10.0), scale="log").value(unit)) <= 10.0
    assert Parameter((2.0, 5.0), scale="integer").value(unit) in (2, 3, 4, 5)
    assert Parameter(choices=(True, False)).value(unit) in (True, False)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("parameters: {}", "nothing to vary"),
        ("parameters: {a.b: {}}", "parameters.a.b: needs either range or choices"),
        ("parameters: {a: {range: [2, 1]}}", "the lower first"),
        ("parameters: {a: {range: [0, 1], scale: log}}", "positive range"),
        ("parameters: {a: {range: [0, 1]}}\nseeds: [1, 1]", "seeds: .*none twice"),
        ("parameters: {a: {range: [0, 1]}}\nworld: [x]", "world: no such name"),
        ("parameters: {a: {range: [0, 1]}}\ntrials: 1", "trials"),
        ("parameters: [", "is not YAML"),
    ],
)
def test_mistakes_in_the_file_are_named(text: str, named: str, tmp_path: Path) -> None:
    path = tmp_path / "space.yaml"
    path.write_text(text)
    with pytest.raises(BadInputError, match=named):
        load_space(path)


def test_files_of_worlds_and_robots_make_names_fit_for_files() -> None:
    names = {
        Case(world, robot, 0).name
        for world in ("office", "a/w.yaml", "b/w.yaml")
        for robot in ("diff", "r/x.urdf", "s/x.urdf")
    }
    assert len(names) == 9
    assert not any("/" in name for name in names)
    assert Case("office", "diff+ultrasonic", 3).name == "office-diff+ultrasonic-3"


def test_the_verb_searches_ranks_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[list[str]] = []

    def demo(command: list[str], **kwargs: Any) -> subprocess.CompletedProcess[bytes]:
        ran.append(command)
        result = {"ended": "finished", "collisions": 0, "path_length_m": 20.0 - len(ran), "sim_seconds": 9.0}
        Path(command[command.index("--json") + 1]).write_text(json.dumps(result))
        (Path(command[command.index("--out") + 1]) / "run").mkdir(exist_ok=True)
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(demo_process.subprocess, "run", demo)
    monkeypatch.setattr(pool, "LocalPool", lambda processes: ThisProcess())
    space = {"parameters": {"rollout.near_speed": {"range": [0.2, 0.5]}}, "worlds": ["lab_empty"], "trials": 3}
    (tmp_path / "space.yaml").write_text(yaml.safe_dump(space))
    words = ["tune", str(tmp_path / "space.yaml"), "--out", str(tmp_path / "study")]
    assert main(words) == 0
    assert len(ran) == 3
    assert "best: trial 2" in capsys.readouterr().out
    assert not list((tmp_path / "study" / "tune").rglob("run"))
    assert yaml.safe_load((tmp_path / "study" / "best.yaml").read_text())["rollout"]["near_speed"]
    assert main(words) == 0
    assert len(ran) == 3
