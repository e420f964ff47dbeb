"""Profiles: YAML files that name only what differs from the defaults of a configuration's dataclass.

A wrong key or value is one clear error that names the path of the key. Keys that end in `_deg` hold degrees for a field of
the same name without the suffix whose type is `Radians`, which is the only place where degrees become radians.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import yaml
from pydantic import TypeAdapter, ValidationError

from ambler.core.errors import BadInputError
from ambler.core.units import RADIANS
from ambler.wire.atomic_file import write_whole
from ambler.wire.yaml_text import parse_yaml, read_yaml

T = TypeVar("T")
_HEIGHTS = ("height_m", "band_")  # what these fields begin with is measured from a floor or a sensor


def load_profile(path: Path) -> dict[str, Any]:
    """Read a profile; raises BadInputError when it is missing, broken or not a mapping."""
    try:
        values = read_yaml(path)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise BadInputError(f"{path} must hold a mapping of names to values")
    return values


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Lay one nested mapping over another; the second wins, key by key, be an angle told in degrees or not."""
    merged = {key: value for key, value in base.items() if _twin(key) not in over}
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            merged[key] = merge(below, value)
        else:
            merged[key] = value
    return merged


def _twin(key: Any) -> str:
    """Return the other name of an angle: with degrees for one without, and the other way round."""
    text = str(key)
    return text.removesuffix("_deg") if text.endswith("_deg") else f"{text}_deg"


def parse_assignment(text: str) -> dict[str, Any]:
    """Turn `slam.front_end.voxel_size=0.05` into a nested mapping; raises BadInputError."""
    name, separator, value = text.partition("=")
    if not separator or not name.strip():
        raise BadInputError(f"{text!r} is not of the form name=value")
    try:
        nested: Any = parse_yaml(value, repr(text))
    except yaml.YAMLError as error:
        raise BadInputError(f"{text!r}: the value is not YAML: {' '.join(str(error).split())}") from error
    for key in reversed(name.strip().split(".")):
        nested = {key: nested}
    result: dict[str, Any] = nested
    return result


def build(kind: type[T], values: Mapping[str, Any]) -> T:
    """Make the configuration `kind` (a dataclass) from nested values over its defaults; raises BadInputError naming the key."""
    prepared = _radians(kind, values, "")
    try:
        built = TypeAdapter(kind).validate_python(prepared)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadInputError(f"configuration {where}: {first['msg']}") from error
    _require_sensible(built, "")
    return built


def _require_sensible(config: Any, where: str, usual: Any = None) -> None:
    """Raise BadInputError for nan, for an infinite number where the default is finite, that of the section `usual`, if there is one, and for
    a negative one where it is positive: only heights are above or below something."""
    for f in dataclasses.fields(config):
        value, key = getattr(config, f.name), f"{where}{f.name}"
        default = _default(f) if usual is None else getattr(usual, f.name)
        if dataclasses.is_dataclass(value):
            _require_sensible(value, f"{key}.", default if type(default) is type(value) else None)
        elif isinstance(value, float) and (math.isnan(value) or (math.isinf(value) and default != value)):
            raise BadInputError(f"configuration {key}: must be a finite number, not {value}")
        elif (
            _is_negative(value) and isinstance(default, int | float) and default > 0 and not f.name.startswith(_HEIGHTS)
        ):
            raise BadInputError(f"configuration {key}: must not be negative, and is {value}")


def _is_negative(value: Any) -> bool:
    return isinstance(value, int | float) and value < 0


def _default(f: dataclasses.Field[Any]) -> Any:
    return f.default if f.default_factory is dataclasses.MISSING else f.default_factory()


def as_values(config: Any) -> Any:
    """Turn a configuration into plain nested values, as they go into a YAML file."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        return {f.name: as_values(getattr(config, f.name)) for f in dataclasses.fields(config)}
    if isinstance(config, enum.Enum):
        return config.value
    if isinstance(config, (np.ndarray, np.generic)):
        return config.tolist()
    if isinstance(config, (list, tuple)):
        return [as_values(v) for v in config]
    if isinstance(config, Mapping):
        return {str(k): as_values(v) for k, v in config.items()}
    return config


def save_resolved(path: Path, config: Any) -> None:
    """Write the resolved configuration of a run."""
    write_whole(path, yaml.safe_dump(as_values(config), sort_keys=False, allow_unicode=True))


def _radians(kind: Any, values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Check the names against the dataclass and turn `<name>_deg` into `<name>` in radians."""
    fields = {f.name: f for f in dataclasses.fields(kind)}
    hints, units = get_type_hints(kind), get_type_hints(kind, include_extras=True)
    out: dict[str, Any] = {}
    for key, value in values.items():
        if not isinstance(key, str):
            raise BadInputError(f"configuration {where}{key}: a name is a word; there are {', '.join(sorted(fields))}")
        plain = key.removesuffix("_deg")
        if key not in fields and key != plain and plain in fields:
            if not _is_angle(units[plain]):
                raise BadInputError(f"configuration {where}{key}: {plain} is no angle, and nothing else has degrees")
            if plain in values:
                raise BadInputError(f"configuration {where}{plain}: is given twice, without and with _deg")
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise BadInputError(f"configuration {where}{key}: degrees must be a number")
            out[plain] = math.radians(value)
        elif key not in fields:
            raise BadInputError(f"configuration {where}{key}: no such name; there are {', '.join(sorted(fields))}")
        else:
            out[key] = _checked(hints[key], value, f"{where}{key}")
    return out


def _is_angle(hint: Any) -> bool:
    """Say whether a field holds radians, or none."""
    if get_origin(hint) in (Union, UnionType):
        return any(_is_angle(kind) for kind in get_args(hint))
    return RADIANS in getattr(hint, "__metadata__", ())


def _checked(hint: Any, value: Any, where: str) -> Any:
    """Do the same for what a value holds: a section that may be missing, some of them in a row, or by name."""
    arguments = get_args(hint)
    if dataclasses.is_dataclass(hint) and isinstance(value, Mapping):
        return _radians(hint, value, f"{where}.")
    if get_origin(hint) in (Union, UnionType):
        kinds = [kind for kind in arguments if kind is not type(None)]
        return _checked(kinds[0], value, where) if len(kinds) == 1 and value is not None else value
    if get_origin(hint) is tuple and arguments[-1] is Ellipsis and isinstance(value, list | tuple):
        return [_checked(arguments[0], inner, f"{where}.{k}") for k, inner in enumerate(value)]
    if isinstance(value, Mapping) and (member := _member_kind(hint)) is not None:
        return {name: _checked(member, inner, f"{where}.{name}") for name, inner in value.items()}
    if isinstance(value, bool) and {"on", "off"} <= set(arguments):
        return "on" if value else "off"  # YAML reads these words as booleans
    if isinstance(value, bool) and hint in (int, float):
        raise BadInputError(f"configuration {where}: must be a number, not {value}")
    return value


def _member_kind(hint: Any) -> Any:
    """Return the dataclass that a mapping's values are, None for anything else."""
    arguments = get_args(hint)
    is_mapping = get_origin(hint) is Mapping and len(arguments) == 2
    return arguments[1] if is_mapping and dataclasses.is_dataclass(arguments[1]) else None
