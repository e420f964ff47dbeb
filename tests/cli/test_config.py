"""`ambler config check` says of a profile what a run would say, and `faults` is a key as any other."""

import argparse
from pathlib import Path

import pytest

from ambler.cli.main import main
from ambler.cli.run_options import add_settings, profile_of
from ambler.core.errors import BadInputError

SLOW = """\
strategy: nearest
explore:
  home_yaw_tolerance_deg: 5
docking:
  mission:
    attempts: 2
faults: [wheel_slip:10:20, people@3]
"""


def asked(*words: str) -> tuple[dict[str, object], tuple[str, ...]]:
    parser = argparse.ArgumentParser()
    add_settings(parser)
    return profile_of(parser.parse_args(words))


def test_a_right_profile_is_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "slow.yaml"
    path.write_text(SLOW)
    assert main(["config", "check", str(path)]) == 0
    told = capsys.readouterr().out.splitlines()
    assert "is right for diff; it changes 3 values" in told[0]
    assert any("explore.home_yaw_tolerance: 0.2 -> 0.0872" in line for line in told)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("faults: [bogus:1:2]", "fault 'bogus:1:2': no such kind 'bogus'"),
        ("faults: [wheel_slip:20:10]", "0 <= begin < end"),
        ("faults: [people, 7]", "configuration faults: must be a list such as [wheel_slip:10:20], not ['people', 7]"),
        ("faults: [{kind: wheel_slip, start: 1.0}]", "configuration faults: must be a list"),
        ("faults: wheel_slip", "configuration faults: must be a list"),
        ("rollout: {horizon_deg: 100}", "rollout.horizon_deg: horizon is no angle"),
        ("explore: {yaw_tolerance: 0.1, yaw_tolerance_deg: 5}", "explore.yaw_tolerance: is given twice"),
        ("rollout: {horizon: 1.0}\nrollout: {near: 0.2}", "wrong.yaml: the key rollout is written twice"),
    ],
)
def test_a_wrong_profile_is_one_line(text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    assert main(["config", "check", str(path)]) == 2
    told = capsys.readouterr()
    assert "is right" not in told.out
    (line,) = told.err.strip().splitlines()
    assert says in line


def test_faults_are_set_as_any_other_key(tmp_path: Path) -> None:
    path = tmp_path / "slow.yaml"
    path.write_text(SLOW)
    assert asked("--profile", str(path))[1] == ("wheel_slip:10:20", "people@3")
    assert asked("--set", "faults=[wheel_slip:10:20]") == ({}, ("wheel_slip:10:20",))
    profile, faults = asked("--profile", str(path), "--set", "faults=[dust@30:5]")
    assert faults == ("dust@30:5",)
    assert "faults" not in profile
    with pytest.raises(BadInputError, match=r"configuration faults: must be a list .*, not 'wheel_slip:10:20'"):
        asked("--set", "faults=wheel_slip:10:20")
