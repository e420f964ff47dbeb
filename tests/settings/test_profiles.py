"""Profiles change defaults by name, and every mistake names its key."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from ambler.core.errors import BadInputError
from ambler.core.units import Radians
from ambler.settings.profiles import as_values, build, load_profile, merge, parse_assignment, save_resolved


@dataclass(frozen=True, slots=True)
class Inner:
    speed: float = 0.5
    window: Radians = 0.1


@dataclass(frozen=True, slots=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    name: str = "x"
    gains: tuple[float, float] = (1.0, 2.0)


@dataclass(frozen=True, slots=True)
class Worded:
    glass: Literal["auto", "on", "off"] = "auto"


def test_defaults_work() -> None:
    assert build(Outer, {}) == Outer()


def test_nested_values_override_only_what_they_name() -> None:
    built = build(Outer, {"inner": {"speed": 1}, "gains": [3, 4]})
    assert built == Outer(Inner(1.0, 0.1), "x", (3.0, 4.0))


def test_degrees_become_radians_here() -> None:
    assert build(Outer, {"inner": {"window_deg": 180}}).inner.window == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"inner": {"sped": 1}}, r"inner\.sped: no such name; there are speed, window"),
        ({"inner": {"speed": "fast"}}, r"inner\.speed: Input should be a valid number"),
        ({"inner": {"window_deg": "x"}}, r"inner\.window_deg: degrees must be a number"),
        ({"inner": {"speed_deg": 90}}, r"inner\.speed_deg: speed is no angle"),
        ({"inner": {"window": True}}, r"inner\.window: must be a number, not True"),
        ({"inner": {"window": 0.1, "window_deg": 5}}, r"inner\.window: is given twice, without and with _deg"),
        ({"gains": [1]}, r"gains\.1: "),
    ],
)
def test_mistakes_name_the_key(values: dict[str, object], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        build(Outer, values)


def test_assignments_and_merge() -> None:
    over = merge(parse_assignment("inner.speed=2"), parse_assignment("inner.window = 0.3"))
    assert build(Outer, over) == Outer(Inner(2.0, 0.3))
    with pytest.raises(BadInputError, match="name=value"):
        parse_assignment("speed")


@pytest.mark.parametrize("names", [("window", "window_deg"), ("window_deg", "window")])
def test_an_angle_that_is_laid_over_wins_in_either_unit(names: tuple[str, str]) -> None:
    below, above = ({"inner": {name: value}} for name, value in zip(names, (1.0, 2.0), strict=True))
    wanted = math.radians(2.0) if names[1] == "window_deg" else 2.0
    assert build(Outer, merge(below, above)).inner.window == wanted


def test_two_units_in_one_profile_are_still_two_when_it_is_laid_over() -> None:
    with pytest.raises(BadInputError, match="is given twice"):
        build(Outer, merge(as_values(Outer()), {"inner": {"window": 0.1, "window_deg": 5}}))


@pytest.mark.parametrize(("text", "wanted"), [("glass=on", "on"), ("glass=off", "off"), ("glass=auto", "auto")])
def test_words_that_yaml_takes_for_booleans_are_words(text: str, wanted: str) -> None:
    assert build(Worded, parse_assignment(text)).glass == wanted


def test_a_resolved_file_builds_the_same_configuration(tmp_path: Path) -> None:
    config = Outer(Inner(0.7), "y")
    save_resolved(tmp_path / "config.yaml", config)
    assert build(Outer, load_profile(tmp_path / "config.yaml")) == config
    assert as_values(config)["inner"] == {"speed": 0.7, "window": 0.1}


@pytest.mark.parametrize(("text", "message"), [("a: [1", "is not YAML"), ("- 1", "must hold a mapping")])
def test_broken_files_give_one_clear_error(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "profile.yaml"
    path.write_text(text)
    with pytest.raises(BadInputError, match=message):
        load_profile(path)
    with pytest.raises(BadInputError, match="cannot read"):
        load_profile(tmp_path / "absent.yaml")


@dataclass(frozen=True)
class Several:
    """Sections that may be missing, and in a row."""

    start: Inner | None = None
    steps: tuple[Inner, ...] = ()
    limit: float | None = None
    lean: Radians | None = None


def test_degrees_become_radians_in_sections_that_may_be_missing_and_in_rows() -> None:
    built = build(Several, {"start": {"window_deg": 90}, "steps": [{"speed": 2}, {"window_deg": 180}]})
    assert built.start is not None
    assert built.start.window == pytest.approx(0.5 * math.pi)
    assert [step.window for step in built.steps] == pytest.approx([0.1, math.pi])
    assert build(Several, {"start": None}) == Several()
    assert build(Several, {"lean_deg": 180}).lean == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"start": {"sped": 1}}, r"start\.sped: no such name"),
        ({"steps": [{}, {"sped": 1}]}, r"steps\.1\.sped: no such name"),
        ({"start": {"speed": True}}, r"start\.speed: must be a number, not True"),
        ({"limit": True}, "limit: must be a number, not True"),
        ({1: 2}, "1: a name is a word"),
        ({False: 2}, "False: a name is a word"),
    ],
)
def test_mistakes_in_them_name_the_key(values: dict[str, object], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        build(Several, values)


@dataclass(frozen=True, slots=True)
class Placed:
    speed: float = 0.5
    count: int = 3
    height_min: float = 0.1
    least: float = -1.0


@pytest.mark.parametrize(("name", "value"), [("speed", -0.1), ("count", -1)])
def test_what_is_positive_is_not_made_negative(name: str, value: float) -> None:
    with pytest.raises(BadInputError, match=f"{name}: must not be negative, and is {value}"):
        build(Placed, {name: value})


@pytest.mark.parametrize(("name", "value"), [("height_min", -0.2), ("least", -2.0), ("speed", 0.0)])
def test_heights_and_what_is_negative_anyway_may_be(name: str, value: float) -> None:
    assert getattr(build(Placed, {name: value}), name) == value
