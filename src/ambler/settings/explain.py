"""Says what the keys of a configuration mean: their type, their value, and the words of the dataclass that holds them."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterator, Mapping
from typing import Any, get_type_hints

from ambler.core.errors import BadInputError
from ambler.settings.profiles import as_values


@dataclasses.dataclass(frozen=True, slots=True)
class Explanation:
    """A key with the name of its type and its value; `section` is the dataclass that holds it, `text` what that says of its fields;
    `names` are the keys below, where the key is itself a section."""

    key: str
    type_name: str
    value: Any
    section: str
    text: str
    names: tuple[str, ...]


def explain(config: Any, key: str) -> Explanation:
    """Look a dotted key up in a configuration; raises BadInputError that says what there is instead."""
    holder, value = config, config
    parts = key.split(".")
    type_name = ""
    for k, part in enumerate(parts):
        names = [f.name for f in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
        if part not in names:
            where = ".".join(parts[:k]) or "the configuration"
            raise BadInputError(f"{where} has no key {part!r}; there are {', '.join(sorted(names)) or 'none'}")
        holder, hint = value, get_type_hints(type(value))[part]
        value = getattr(value, part)
        type_name = getattr(hint, "__name__", None) or str(hint).replace("typing.", "")
    is_section = dataclasses.is_dataclass(value)
    described = value if is_section else holder
    below = tuple(f.name for f in dataclasses.fields(value)) if is_section else ()
    text = inspect.getdoc(type(described)) or ""
    return Explanation(key, type_name, as_values(value), type(described).__name__, text, below)


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """Return (dotted key, old, new) of every value in which two nested mappings differ."""
    return list(_differences(before, after, ""))


def _differences(before: Any, after: Any, key: str) -> Iterator[tuple[str, Any, Any]]:
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for name in {**before, **after}:
            yield from _differences(before.get(name), after.get(name), f"{key}.{name}" if key else name)
    elif before != after:
        yield key, before, after
