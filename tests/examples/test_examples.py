"""The extensions that an integrator would write, each in a file of its own, run as they stand."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"examples_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def result_of(name: str, tmp_path: Path) -> dict[str, Any]:
    fields: dict[str, Any] = load(name).main(tmp_path / name)
    return fields


def test_a_local_planner_of_ones_own_drives_to_the_goal(tmp_path: Path) -> None:
    fields = result_of("own_local_planner", tmp_path)
    assert fields["ended"] == "succeeded"
    assert fields["collisions"] == 0
    assert fields["worst_goal_error_m"] < 0.25
    assert fields["path_length_m"] > 2.5


def test_a_mission_of_ones_own_goes_round(tmp_path: Path) -> None:
    fields = result_of("own_mission", tmp_path)
    assert (fields["ended"], fields["corners"], fields["collisions"]) == ("succeeded", 4, 0)
    assert 4.0 < fields["path_length_m"] < 8.0


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_to_run_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert f"python examples/{path.name}" in text
    assert len(text.splitlines()) <= 130
