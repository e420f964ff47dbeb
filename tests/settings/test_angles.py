"""Which settings may be told in degrees: those whose type is `Radians`, which is every angle and angular rate, and nothing else."""

import ast
import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterator
from typing import Any, get_args, get_type_hints

import pytest

from ambler.apps.config import RobotConfig
from ambler.core.errors import BadInputError
from ambler.core.units import Radians
from ambler.settings.profiles import build

OF_ANGLES = re.compile(r"(^|_)(yaw|angle|angular|lean|turn)(_|$)")
REVIEWED = {
    *("EkfConfig.turn_noise", "EkfConfig.yaw_noise", "OdometryNoise.yaw", "OdometryNoise.yaw_per_way"),
    *("OdometryNoise.translation_per_turn", "OdometryConfig.turn_doubt", "LoopConfig.turn_price"),
    *("CloudTrackerConfig.turn", "CloudTrackerConfig.idle_turn", "RefugeConfig.turn"),
    *("RolloutConfig.weight_turn_change", "FollowerConfig.yaw_gain", "PursuitConfig.yaw_gain"),
    *("PursuitConfig.static_yaw_gain", "PursuitConfig.cost_yaw_gain"),
}
"""Gains, weights and noise: what their names say of angles is not their unit."""


def sections(kind: Any, seen: set[Any]) -> Iterator[Any]:
    """Every dataclass that a configuration is made of."""
    if dataclasses.is_dataclass(kind) and kind not in seen:
        seen.add(kind)
        yield kind
        for hint in get_type_hints(kind).values():
            yield from sections(hint, seen)
    for inner in get_args(kind):
        yield from sections(inner, seen)


SECTIONS = tuple(sections(RobotConfig, set()))


def numbers(section: Any) -> dict[str, bool]:
    """The numbers of a section, and whether each is an angle."""
    hints = get_type_hints(section, include_extras=True)
    names = [f.name for f in dataclasses.fields(section)]
    return {name: hints[name] == Radians for name in names if hints[name] in (float, Radians)}


def written_in_degrees(section: Any) -> set[str]:
    """The fields whose default stands as `math.radians(...)` in the source."""
    tree = ast.parse(inspect.getsource(importlib.import_module(section.__module__)))
    (body,) = [n.body for n in ast.walk(tree) if isinstance(n, ast.ClassDef) and n.name == section.__name__]
    lines = [n for n in body if isinstance(n, ast.AnnAssign) and n.value is not None]
    return {ast.unparse(n.target) for n in lines if ast.unparse(n.value or n).startswith("math.radians(")}


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_angle_says_that_it_is_one(section: Any) -> None:
    found = numbers(section)
    wanted = written_in_degrees(section)
    wanted |= {n for n in found if OF_ANGLES.search(n) and f"{section.__name__}.{n}" not in REVIEWED}
    assert wanted <= {name for name, is_angle in found.items() if is_angle}
    assert not [n for n, is_angle in found.items() if is_angle and f"{section.__name__}.{n}" in REVIEWED]


def test_there_are_many_angles_and_more_other_numbers() -> None:
    angles = [is_angle for section in SECTIONS for is_angle in numbers(section).values()]
    assert 70 < sum(angles) < 0.15 * len(angles)


@pytest.mark.parametrize("key", ["horizon", "speed_min", "weight_heading", "yaw_gain", "vx_samples"])
def test_nothing_else_has_degrees(key: str) -> None:
    section = "pursuit" if key == "yaw_gain" else "rollout"
    with pytest.raises(BadInputError, match=rf"{section}\.{key}_deg: {key} is no angle"):
        build(RobotConfig, {section: {f"{key}_deg": 100}})
