"""Every study takes --profile and --set: they reach the robots, what they make is told apart, and mistakes are told before anything runs."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from ambler.apps.config import recorded_config
from ambler.apps.robot import sensing_nodes
from ambler.cli import main as cli
from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.evaluation import gate_search
from ambler.sim.robots import robot_named
from ambler.studies import (
    calibration_study,
    demo_process,
    docking_study,
    exploration_study,
    fault_study,
    live_study,
    live_timing,
    localization_study,
    lost_robot_study,
    navigation_study,
    program_study,
    random_drives,
)
from ambler.studies.study import key_of
from ambler.studies.study_settings import DEFAULTS, StudySettings

WITHOUT_ROBOT = {"map", "results"}
VERBS = sorted({p.stem.removeprefix("eval_") for p in Path(cli.__file__).parent.glob("eval_*.py")} - WITHOUT_ROBOT)
STUDIES = [["eval", verb, *(["absent.bag"] if verb in ("odometry", "variants") else [])] for verb in VERBS] + [
    ["bench", "live"]
]
HORIZON = StudySettings({"rollout": {"horizon": 1.25}})


def refuse_to_work(*told: object, **named: object) -> None:
    raise AssertionError("something was begun")


@pytest.mark.parametrize("words", STUDIES, ids=" ".join)
@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("nonsense.key=1", "nonsense: no such name"),
        ("gate.margin=[1", "is not YAML"),
        ("gate.margin=wide", "gate.margin"),
    ],
)
def test_a_wrong_setting_is_one_line_before_anything_runs(
    words: list[str],
    setting: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ambler.kernels.warmup.warm_up", refuse_to_work)
    monkeypatch.setattr(subprocess, "Popen", refuse_to_work)
    assert main([*words, "--set", setting, "--json", "result.json"]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert message in told[0]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "profile", "message"),
    [
        (["eval", "localization"], "faults: [people]", "takes no faults"),
        (["eval", "relocalization"], "faults: [people]", "takes no faults"),
        (["eval", "gate"], "faults: [people]", "takes no faults"),
        (["eval", "docking"], "faults: [light]", "--only random"),
        (["eval", "live"], "faults: [people]", "no faults"),
        (["eval", "exploration", "--robots", "diff"], "faults: [scanner_stuck@rear_left]", "no scanner 'rear_left'"),
        (["eval", "team"], "scanners: {rear_left: {x: 0.0, y: 0.0, yaw: 0.0}}", "no scanner 'rear_left'"),
        (["eval", "localization"], "localizer: particles", "localizer: `ambler eval localization` sets this itself"),
        (["eval", "kidnapping"], "localization: {covariance: [1, 1, 1]}", "localization.covariance"),
        (["eval", "kidnapping"], "localizer: reflectors", "reflector_positions"),
        (["eval", "glass"], "glass: 'off'", "glass: `ambler eval glass` sets this itself"),
        (["eval", "gate"], "gate: {stale_delay: 1.0}", "gate.stale_delay"),
    ],
)
def test_what_a_study_cannot_take_is_refused(
    words: list[str],
    profile: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ambler.kernels.warmup.warm_up", refuse_to_work)
    Path("profile.yaml").write_text(profile)
    assert main([*words, "--profile", "profile.yaml"]) == 2
    assert message in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["profile.yaml"]


@pytest.mark.parametrize(
    ("module", "words"),
    [
        (navigation_study, ["eval", "navigation", "--worlds", "lab_empty", "--goals", "1"]),
        (docking_study, ["eval", "docking", "--only", "random", "--runs", "1"]),
        (program_study, ["eval", "team", "--world", "lab_empty"]),
        (live_study, ["eval", "live", "--verbs", "explore", "--runs", "1", "--apart", "0", "--cables", "0"]),
        (live_study, ["eval", "live", "--verbs", "--apart", "1", "--cables", "0"]),
        (live_study, ["eval", "live", "--verbs", "--apart", "0", "--cables", "1"]),
        (live_timing, ["bench", "live", "--world", "lab_empty"]),
    ],
    ids=lambda value: "-".join(value[1:]) if isinstance(value, list) else "",
)
def test_settings_reach_the_robot(
    module: Any, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ambler.kernels.warmup.warm_up", lambda names: None)
    asked = capture_runs(module, monkeypatch)
    here = ["--processes", "0"] if words[0] == "eval" else []
    assert main([*words, *here, "--set", "rollout.horizon=1.25"]) == 2
    assert [dict(options.profile) for options in asked] == [{"rollout": {"horizon": 1.25}}] * len(asked)
    assert len(asked) == (2 if "team" in words else 1)


def capture_runs(module: Any, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Let a study go no further than to its first run; returns the options of all robots of it."""
    asked: list[Any] = []

    def pretend(options: Any, *told: object, mates: dict[str, Any] | None = None) -> None:
        asked.extend([options, *(mates or {}).values()])
        raise BadInputError("enough")

    monkeypatch.setattr(module, "SimulatedRun", pretend)
    return asked


def test_faults_of_a_profile_come_beside_those_of_a_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = capture_runs(docking_study, monkeypatch)
    (case, *_) = docking_study.fault_cases(1, 0)
    with pytest.raises(BadInputError, match="enough"):
        docking_study.run_case(replace(case, settings=StudySettings({}, ("people",))), tmp_path)
    assert asked[0].faults == ("people", case.kind)


def test_a_program_takes_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = capture_runs(program_study, monkeypatch)
    with pytest.raises(BadInputError, match="enough"):
        program_study.run_case(program_study.ProgramCase("lab_empty", "diff", 0, 1, settings=HORIZON), tmp_path)
    assert asked[0].profile == HORIZON.profile


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands of demonstrations, none of which is run."""
    ran: list[list[str]] = []

    def pretend(words: Sequence[str], **named: object) -> None:
        ran.append(list(words))

    monkeypatch.setattr(demo_process, "subprocess", SimpleNamespace(run=pretend, STDOUT=None))
    return ran


def profile_in(command: list[str]) -> Any:
    return yaml.safe_load(Path(command[command.index("--profile") + 1]).read_text())


def test_an_exploration_takes_the_strategy_of_its_settings(tmp_path: Path, commands: list[list[str]]) -> None:
    profile, summary = tmp_path / "profile.yaml", tmp_path / "summary.json"
    profile.write_text("strategy: nearest\nfaults: [people]\n")
    words = ["--worlds", "lab_empty", "--robots", "diff", "--runs", "1", "--out", str(tmp_path), "--json", str(summary)]
    settings = ["--profile", str(profile), "--set", "rollout.horizon=1.25"]
    words += ["--processes", "0", "--fresh"]
    assert main(["eval", "exploration", *words, *settings]) == 1
    (command,) = commands
    assert profile_in(command) == {"strategy": "nearest", "rollout": {"horizon": 1.25}, "faults": ["people"]}
    assert command[command.index("--strategy") + 1] == "nearest"
    assert json.loads(summary.read_text())["command"].endswith(f"--profile {profile} --set rollout.horizon=1.25")
    commands.clear()
    main(["eval", "exploration", *words, "--strategies", "tour", *settings])
    assert commands[0][commands[0].index("--strategy") + 1] == "tour", "what is asked for expressly wins"


@pytest.mark.parametrize("verb", ["faults", "glass"])
def test_studies_of_demonstrations_hand_their_settings_on(verb: str, tmp_path: Path, commands: list[list[str]]) -> None:
    words = {"faults": ["--only", "people"], "glass": ["--runs", "1"]}[verb]
    words += ["--processes", "0", "--robots", "diff", "--out", str(tmp_path)]
    main(["eval", verb, *words, "--set", "rollout.horizon=1.25"])
    assert commands
    for command in commands:
        assert profile_in(command) == {"rollout": {"horizon": 1.25}}
    assert ("--fault" in commands[0]) == (verb == "faults")


def test_a_lost_robot_is_told_its_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []

    def pretend(drive: object, robot: str, config: Any, *rest: object) -> Any:
        told.append(config)
        raise BadInputError("enough")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(random_drives, "record_drive", lambda *told: None)
    monkeypatch.setattr(lost_robot_study, "relocalize", pretend)
    words = ["eval", "relocalization", "--worlds", "lab_empty", "--runs", "1", "--processes", "0"]
    assert main([*words, "--set", "localizer=particles", "--set", "particles.particles_most=321"]) == 2
    assert main([*words, "--localizer", "tracker", "--set", "localizer=particles"]) == 2
    assert [c.localizer for c in told] == ["particles", "tracker"]
    assert told[0].particles.particles_most == 321


def test_methods_of_the_localization_study_take_settings() -> None:
    settings = StudySettings({"particles": {"particles_most": 321}})
    case = localization_study.LocalizationCase(localization_study.PLACES[0], 0, True, 0, settings=settings)
    take = localization_study.Take(Path("drive"), localization_study.SE2(), None)  # type: ignore[arg-type]
    config = localization_study.study_config(case, case.methods[0], take)
    assert (config.localizer, config.particles.particles_most) == ("particles", 321)


def test_gate_and_odometry_take_their_sections(monkeypatch: pytest.MonkeyPatch) -> None:
    margins: list[float] = []
    gate = gate_search.VelocityGate

    def listen(config: Any, robot: Any) -> Any:
        margins.append(config.margin)
        return gate(config, robot)

    monkeypatch.setattr(gate_search, "VelocityGate", listen)
    config = recorded_config({"gate": {"margin": 0.07}, "odometry": {"ekf": {"slip_hold": 0.5}}})
    gate_search.check_gate(np.random.default_rng(0), gate_search.GateSearchResult(), config.gate)
    assert margins == [0.07]
    (node,) = sensing_nodes(robot_named("diff").model, config)
    assert node._estimator.config.ekf.slip_hold == 0.5  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("words", "target", "setting", "value"),
    [
        (
            ["calibration", "--processes", "0"],
            "ambler.studies.calibration_study.evaluate_drive",
            "calibration.rounds=3",
            "rounds",
        ),
        (["odometry", "absent.bag"], "ambler.evaluation.odometry_quality.fused", "odometry.setbacks=3", "setbacks"),
        (["gate", "--runs", "1"], "ambler.evaluation.gate_search.search_gate", "gate.min_points=3", "min_points"),
    ],
)
def test_algorithms_are_told_their_section(
    words: list[str], target: str, setting: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Any] = []

    def pretend(*given: Any) -> None:
        told.append(getattr(given[-1], value))
        raise BadInputError("enough")

    monkeypatch.setattr("ambler.kernels.warmup.warm_up", lambda names: None)
    monkeypatch.setattr(calibration_study, "drive_of", lambda *given: None)
    monkeypatch.setattr("ambler.evaluation.odometry_quality.read_odometry_record", lambda bag: None)
    monkeypatch.setattr("ambler.evaluation.odometry_quality.wheels_alone", lambda record: None)
    monkeypatch.setattr(target, pretend)
    assert main(["eval", *words, "--set", setting]) == 2
    assert told == [3]


def test_interrupted_demonstrations_take_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[list[str]] = []

    def pretend(words: list[str], **named: object) -> None:
        begun.append(words)
        raise BadInputError("enough")

    monkeypatch.setattr(subprocess, "Popen", pretend)
    words = ["--world", "lab_empty", "--runs", "1", "--out", str(tmp_path), "--processes", "0"]
    assert main(["eval", "interrupts", *words, "--set", "rollout.horizon=1.25"]) == 2
    assert profile_in(begun[0]) == {"rollout": {"horizon": 1.25}}


def test_results_are_known_by_their_settings() -> None:
    turned = StudySettings({"gate": {"margin": 0.1}, "rollout": {"horizon": 1.0}})
    same = StudySettings({"rollout": {"horizon": 1.0}, "gate": {"margin": 0.1}})
    different = (DEFAULTS, HORIZON, turned, StudySettings(HORIZON.profile, ("people",)), StudySettings({}, ("people",)))

    def key(settings: StudySettings) -> str:
        case = exploration_study.ExplorationCase("office", "diff", "tour", 0, settings=settings)
        return key_of(exploration_study.exploration_study([case]), case)

    assert key(turned) == key(same)
    assert len({key(settings) for settings in different}) == len(different)


def test_recorded_drives_know_their_sensing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[float] = []
    monkeypatch.setattr(random_drives, "record_drive", lambda *told: made.append(told[-1].odometry.gap_most))
    sensing = StudySettings({"odometry": {"gap_most": 0.5}, "rollout": {"horizon": 1.0}})
    for settings in (DEFAULTS, HORIZON, sensing):
        case = random_drives.DriveCase("lab_empty", "diff", 0, 0, settings)
        random_drives.record_random_drive(case, tmp_path / "drive")
    assert made == [0.25, 0.25, 0.5]


def test_a_case_of_faults_keeps_its_own(tmp_path: Path, commands: list[list[str]]) -> None:
    case = next(c for c in fault_study.fault_cases() if c.name == "wheel_slip")
    fault_study.run_case(fault_study.FaultRun(case, 0, StudySettings({}, ("people",))), tmp_path)
    assert profile_in(commands[0]) == {"faults": ["people"]}
    assert commands[0][commands[0].index("--fault") + 1] == case.fault
