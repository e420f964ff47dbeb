"""`--radius` and `--boundary` of `ambler demo` reach the exploration, and nonsense is one clear error."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pytest
import yaml

from ambler.apps.config import robot_config
from ambler.cli.demo import add_parser
from ambler.cli.run_options import options_of
from ambler.core.errors import BadInputError
from ambler.exploration.fence import FenceConfig
from ambler.nodes.steps import ExploreStep
from ambler.robots.catalog import robot_model
from ambler.settings.profiles import save_resolved


def profile_of(*words: str) -> dict[str, Any]:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    return dict(options_of(parser.parse_args(["demo", *words]), (ExploreStep(),)).profile)


def fence_of(*words: str) -> FenceConfig:
    return robot_config(robot_model("diff"), profile_of(*words)).survey.fence


def test_they_are_the_fence_of_the_survey() -> None:
    assert fence_of("--radius", "12.5").radius == 12.5
    corners = fence_of("--boundary=-1,-2;8,-2;8,5.5").boundary
    assert [tuple(corner) for corner in corners] == [(-1.0, -2.0), (8.0, -2.0), (8.0, 5.5)]
    assert fence_of().boundary == ()
    assert fence_of().radius == 0.0


def test_a_run_keeps_them_in_its_configuration(tmp_path: Path) -> None:
    save_resolved(tmp_path / "config.yaml", profile_of("--boundary=-1,-2;8,-2;8,5.5", "--radius", "3"))
    fence = yaml.safe_load((tmp_path / "config.yaml").read_text("utf-8"))["survey"]["fence"]
    assert fence["boundary"] == [[-1.0, -2.0], [8.0, -2.0], [8.0, 5.5]]
    assert fence["radius"] == 3.0


@pytest.mark.parametrize("words", [("--radius=-1",), ("--boundary=0,0;1,1",), ("--boundary=0,0;1,1;2",)])
def test_nonsense_is_one_clear_error(words: tuple[str, ...]) -> None:
    with pytest.raises(BadInputError):
        fence_of(*words)


def test_its_reach_follows_the_scanner() -> None:
    assert robot_config(robot_model("diff"), {}).survey.fence.structure_reach == 15.0
    assert robot_config(robot_model("spot"), {}).survey.fence.structure_reach == 22.5
