"""Runs that are ended from outside leave what was known, whole: by a signal, by the time limit; bad options leave nothing."""

from __future__ import annotations

import json
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ambler.cli.main import main
from ambler.studies.interrupt_study import judge_remains
from ambler.wire.map_files import load_map

pytestmark = pytest.mark.live

DEMO = ["demo", "--world", "office", "--exit", "--no-view"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["ctrl-c", "terminate"])
def test_a_signal_ends_a_run_with_its_map_and_a_truthful_report(number: signal.Signals, tmp_path: Path) -> None:
    words = [sys.executable, "-u", "-m", "ambler.cli.main", *DEMO, "--out", str(tmp_path / "runs")]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    with process.stdout:
        for line in process.stdout:
            if "m² known" in line:  # it drives
                break
        process.send_signal(number)
        told = process.stdout.read()
    assert process.wait(60.0) == 130, told
    found = judge_remains(130, tmp_path)
    assert found == {"with_map": True, "with_report": True, "before_the_run": False, "wrong": ""}
    folder = next(p for p in (tmp_path / "runs").iterdir() if not p.is_symlink())
    results = json.loads((folder / "report.json").read_text())["results"]
    assert results["ended"] == "interrupted"
    assert results["frontiers_left"] is None
    assert 0.0 < results["coverage_ratio"] < 1.0
    assert "a signal ended the run" in told
    assert str(folder / "map.yaml") in told
    assert (tmp_path / "runs" / "LATEST").resolve() == folder


def test_a_signal_while_modules_are_imported_ends_with_the_code_of_an_interruption(tmp_path: Path) -> None:
    """A plain KeyboardInterrupt in the middle of an import made CPython end by SIGINT in about half of all cases, whatever `main` returned."""
    words = [sys.executable, "-m", "ambler.cli.main", *DEMO, "--out", str(tmp_path / "runs")]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    codes = []
    for k in range(10):
        process = subprocess.Popen(words, **quiet)  # type: ignore[call-overload]
        time.sleep(0.4 + 0.07 * k)
        process.send_signal(signal.SIGTERM)
        codes.append(process.wait(60.0))
    assert set(codes) <= {130, -signal.SIGTERM}, "the latter before anything of ours was imported"
    assert 130 in codes


def test_what_is_half_done_is_noticed(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "run"
    folder.mkdir(parents=True)
    (folder / "map.pgm.partial").touch()
    assert "half done" in judge_remains(130, tmp_path)["wrong"]
    (folder / "map.pgm.partial").unlink()
    assert judge_remains(130, tmp_path)["wrong"] != ""
    assert judge_remains(1, tmp_path)["wrong"] == "exit code 1"


def test_the_time_limit_saves_the_map_so_far(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = tmp_path / "r.json"
    code = main([*DEMO, "--time-limit", "4", "--out", str(tmp_path / "runs"), "--json", str(result)])
    assert code == 1
    fields = json.loads(result.read_text())
    assert fields["ended"] == "time_limit"
    assert "time limit of 4 s" in capsys.readouterr().out
    spec, cells = load_map(next((tmp_path / "runs").glob("*/map.yaml")))
    assert (cells == 0).sum() * spec.resolution**2 > 20.0
    again = shlex.split(fields["command"])
    assert again[:2] == ["ambler", "demo"]
    assert again[1:] == [*DEMO, "--time-limit", "4", "--out", str(tmp_path / "runs"), "--json", str(result)]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["navigate", "-5,0x"], "x,y,degrees"),
        (["navigate", "nan,0"], "x,y,degrees"),
        (["navigate", "1e308,0"], "100 km"),
        (["navigate", "500,0"], "outside"),
        (["navigate", "1,1", "--start", "-100,3"], "start pose"),
        (["navigate", "1,1", "--localizer", "reflectors"], "reflector_positions"),
        (["navigate", "1,1", "--set", "rollout.horizon=nan"], "finite"),
        (["demo", "--seed", "-1"], "--seed"),
        (["demo", "--time-limit", "nan"], "--time-limit"),
        (["demo", "--time-limit", "-5"], "--time-limit"),
        (["demo", "--port", "99999"], "--port"),
        (["demo", "--port", "-1"], "--port"),
        (["demo", "--json", "/proc/none/r.json"], "--json"),
        (["demo", "--out", "/proc/none"], "--out"),
        (["demo", "--apart", "--fault", "people"], "faults"),
        (["dock", "--robot", "spot"], "cannot dock"),
        (["config", "explain", "rollout.horizn"], "no key 'horizn'"),
    ],
)
def test_bad_options_are_told_before_anything_runs(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    begun = time.monotonic()
    assert main(words) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert says in told[0]
    assert not list(tmp_path.iterdir())
    assert time.monotonic() - begun < 30.0


@pytest.mark.parametrize("words", [["demo"], ["navigate", "1,1"], ["dock"], ["demo", "--apart"]], ids=" ".join)
def test_a_port_in_use_is_one_line_before_all_others_and_leaves_nothing(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ambler.kernels.warmup.warm_up", lambda names: print("compiling kernels, once"))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main([*words, "--exit", "--port", str(taken.getsockname()[1])]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    (line,) = told.err.strip().splitlines()
    assert "address already in use; take another --port, or --no-view" in line
    assert line.count("address") == 1
    assert not list(tmp_path.iterdir())


def test_a_map_in_which_nothing_can_be_localized_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tiny.pgm").write_bytes(b"P5\n3 3\n255\n" + bytes([254] * 9))
    (tmp_path / "tiny.yaml").write_text(
        "image: tiny.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    assert main(["navigate", "0.1,0.1", "--map", str(tmp_path / "tiny.yaml"), "--out", str(tmp_path / "runs")]) == 2
    assert "no wall" in capsys.readouterr().err


def test_negative_goals_need_no_care(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["navigate", "-0.4,0.3,90", "--world", "lab_empty", "--kinematic", "--exit", "--no-view"]
    assert main([*words, "--out", str(tmp_path), "--json", str(tmp_path / "r.json")]) == 0
    fields = json.loads((tmp_path / "r.json").read_text())
    assert fields["ended"] == "succeeded"
    assert fields["worst_goal_error_m"] < 0.2
    assert "-0.4,0.3,90" in fields["command"]
    assert re.search(r"report: \S+report\.html", capsys.readouterr().out)


def test_a_goal_in_a_wall_is_no_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["navigate", "8.05,0", "--world", "lab_empty", "--kinematic", "--exit", "--no-view", "--out", str(tmp_path)]
    assert main([*words, "--json", str(tmp_path / "r.json")]) == 1
    fields = json.loads((tmp_path / "r.json").read_text())
    assert fields["ended"] == "nearest_reached"
    assert fields["goals_reached"] == 0
    assert re.search(r"nearest_reached: .*\d\.\d+ m", capsys.readouterr().out)
