"""The command line answers at once, and every mistake is one clear line and exit code 2."""

import fcntl
import subprocess
import sys
from pathlib import Path

import pytest

from ambler import __version__
from ambler.cli.main import VERBS, build_parser, main


def test_help_names_every_verb_and_imports_nothing_heavy() -> None:
    script = "import sys; from ambler.cli.main import build_parser; build_parser(); print(*sorted(sys.modules))"
    modules = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "numba", "scipy", "matplotlib", "cv2", "mujoco", "pydantic"} & set(modules)
    text = build_parser().format_help()
    assert all(verb in text for verb in VERBS)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert __version__ in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["demo", "--world", "nowhere", "--no-view"], "nowhere"),
        (["demo", "--robot", "unicorn", "--no-view"], "no robot 'unicorn'"),
        (["demo", "--set", "rollout.horizn=1", "--no-view"], "rollout.horizn: no such name"),
        (["demo", "--set", "rollout.horizon=long", "--no-view"], "rollout.horizon: Input should be a valid number"),
        (["demo", "--profile", "absent.yaml", "--no-view"], "cannot read absent.yaml"),
        (["demo", "--host", "0.0.0.0"], "needs --token"),
        (["demo", "--host", "0.0.0.0", "--token", "x"], "--token: 1 characters can be guessed"),
        (["replay", "absent"], "is not the folder of a run"),
        (["slam2d", "absent.clf", "--out", "o"], "absent.clf"),
        (["eval", "map", "absent.yaml", "absent.yaml"], "absent.yaml"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("ambler: ")
    assert message in error
    assert not list(tmp_path.iterdir()), "a refused command leaves nothing behind"


def test_unknown_verbs_exit_with_2() -> None:
    with pytest.raises(SystemExit) as stop:
        main(["fly"])
    assert stop.value.code == 2


@pytest.mark.parametrize(
    "words",
    [
        ["replay", "runs/LATEST"],
        ["localize", "drive.log", "--map", "map.yaml"],
        ["slam2d", "drive.log"],
        ["lio", "drive.bag"],
    ],
)
def test_results_that_cannot_go_where_they_shall_are_refused_before_anything_runs(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, folder = tmp_path / "file", tmp_path / "folder"
    file.write_text("kept")
    folder.mkdir()
    assert main([*words, "--out", str(file)]) == 2
    assert "is a file, but --out needs a folder" in capsys.readouterr().err
    assert file.read_text() == "kept"
    assert main([*words, "--out", str(tmp_path / "new"), "--json", str(folder)]) == 2
    assert f"--json {folder}: is a folder" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_who_reads_only_the_first_line_gets_no_traceback() -> None:
    words = [sys.executable, "-m", "ambler.cli.main", "config", "show"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)  # what it writes must not fit in while nobody reads
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(30.0) == 141
