"""A key that is written twice is refused wherever people write YAML; everything else is read as PyYAML reads it."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from ambler.core.errors import BadInputError
from ambler.docking.database import DockDatabase
from ambler.settings.profiles import load_profile, parse_assignment
from ambler.sim.route import load_route
from ambler.sim.solids import WorldSpec
from ambler.sim.world_file import load_world
from ambler.wire.camera_info import load_camera_info
from ambler.wire.map_files import load_map
from ambler.wire.yaml_text import parse_yaml

WORLDS = Path(__file__).parents[2] / "src" / "ambler" / "sim" / "worlds"
MERGED = "a: &a {x: 1, y: 2}\nb: &b {<<: *a, x: 3}\nc: {<<: *b, y: 4}\nd: [*a, *a, {x: 1}]\n"


def test_what_is_written_once_is_read_as_ever() -> None:
    for text in (MERGED, "", "3", "- 1\n- {1: a, '1': b}", (WORLDS / "two_rooms.yaml").read_text()):
        assert parse_yaml(text, "it") == yaml.safe_load(text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: 1\nb: 2\na: 3", "it: the key a is written twice, in lines 1 and 3"),
        ("a: {b: {c: 1, d: 2, c: 1}}", "it: the key a.b.c is written twice, in lines 1 and 1"),
        ("a:\n- {b: 1}\n- b: 1\n  b: 2", "it: the key a.1.b is written twice, in lines 3 and 4"),
    ],
)
def test_a_key_twice_is_named_with_its_lines(text: str, says: str) -> None:
    with pytest.raises(BadInputError) as caught:
        parse_yaml(text, "it")
    assert str(caught.value) == says


@pytest.mark.parametrize(
    "load",
    [
        load_profile,
        DockDatabase.load,
        load_camera_info,
        load_map,
        lambda path: load_world(str(path)),
        lambda path: load_route(path, WorldSpec("w", (), load_world("two_rooms").start)),
    ],
    ids=["profile", "docks", "camera", "map", "world", "route"],
)
def test_no_reader_loses_the_first_of_two(load: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "twice.yaml"
    path.write_text("resolution: 0.05\nresolution: 0.1\n")
    with pytest.raises(BadInputError, match=r"twice\.yaml: the key resolution is written twice, in lines 1 and 2$"):
        load(path)


def test_nor_does_set() -> None:
    with pytest.raises(BadInputError, match="the key horizon is written twice"):
        parse_assignment("rollout={horizon: 1.0, horizon: 2.0}")
