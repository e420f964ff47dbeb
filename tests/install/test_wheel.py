"""The wheel: it holds every file of the package, and whoever has nothing else than it can run the demonstration."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "ambler"
BUILT_FROM = ("pyproject.toml", "README.md", "LICENSE", "src")
FORGOTTEN = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")


def files_of_the_package() -> set[str]:
    """Return every file of the package, relative to it."""
    return {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_data_of_every_kind_is_declared() -> None:
    """A world, a message definition or a layout that the patterns of pyproject.toml leave out is missing from the wheel."""
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["ambler"]
    declared = {str(path.relative_to(PACKAGE)) for pattern in patterns for path in PACKAGE.glob(pattern)}
    data = {file for file in files_of_the_package() if not file.endswith(".py")}
    assert data <= declared
    assert len(data) > 20
    without_init = {str(Path(file).parent) for file in data} - {
        str(path.parent.relative_to(PACKAGE)) for path in PACKAGE.rglob("__init__.py")
    }
    assert without_init <= {"bridges/layouts", "sim/worlds", "wire/action", "wire/msg", "wire/srv"}


@pytest.mark.slow
def test_who_has_the_wheel_alone_can_run_the_demonstration(tmp_path: Path) -> None:
    """Build it from a copy, install it with its extra `sim` in an environment that holds nothing, with an empty cache, and explore from another folder."""
    source, wheels, place = tmp_path / "source", tmp_path / "wheels", tmp_path / "elsewhere"
    source.mkdir()
    place.mkdir()
    for name in BUILT_FROM:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=FORGOTTEN)
        else:
            shutil.copy(path, source / name)
    run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", str(wheels), str(source), cwd=place)
    (wheel,) = wheels.glob("ambler-*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    assert {f"ambler/{file}" for file in files_of_the_package()} <= held
    assert not [name for name in held if name.startswith(("tests", "examples", "benchmarks"))]

    venv.create(tmp_path / "venv", with_pip=True)
    python, ambler = (str(tmp_path / "venv" / "bin" / name) for name in ("python", "ambler"))
    constraints = str(ROOT / "constraints.txt")
    run(python, "-m", "pip", "install", "--constraint", constraints, f"{wheel}[sim]", cwd=place)
    for path in (source, wheels):
        shutil.rmtree(path)  # nothing may be read from there
    where = run(python, "-c", "import ambler; print(ambler.__file__)", cwd=place)
    assert Path(where.strip()).is_relative_to(tmp_path / "venv")

    home = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    words = ("demo", "--exit", "--no-view", "--world", "lab_empty", "--start", "2,2,-45", "--json", "result.json")
    printed = run(ambler, *words, cwd=place, **home)
    assert "finished" in printed
    told = json.loads((place / "result.json").read_text())
    assert told["ended"] == "finished"
    assert told["coverage_ratio"] > 0.95
    assert told["collisions"] == 0
    assert told["commit"] is None, "an installed package is no checkout"
    report = place / "runs" / "LATEST" / "report.html"
    assert report.stat().st_size > 10_000
    assert "office" in run(ambler, "world", "show", "office", "--picture", "office.png", cwd=place, **home)
    assert "global_planner" in run(ambler, "config", "show", "--robot", "spot", cwd=place, **home)


def run(*command: str, cwd: Path, **more: str) -> str:
    """Run a command with none of this checkout in its environment; returns what it printed, fails with that when it ends otherwise than with 0."""
    ours = ("PYTHONPATH", "VIRTUAL_ENV", "NUMBA_CACHE_DIR", "AMBLER_DATA")
    environment = {name: value for name, value in os.environ.items() if name not in ours} | more
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    return done.stdout
