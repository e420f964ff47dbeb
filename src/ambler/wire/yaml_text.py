"""YAML in which no key is written twice: PyYAML alone keeps the last one and says nothing of those before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ambler.core.errors import BadInputError

LOADER: Any = getattr(
    yaml, "CSafeLoader", yaml.SafeLoader
)  # ground with thousands of heights takes seconds without libyaml


def read_yaml(path: Path) -> Any:
    """Return what a file holds; raises BadInputError as `parse_yaml` does, OSError, UnicodeDecodeError and yaml.YAMLError."""
    return parse_yaml(path.read_text(encoding="utf-8"), str(path))


def parse_yaml(text: str, name: str) -> Any:
    """Return what a text holds; raises BadInputError, which begins with its `name`, for a key that is written twice, and yaml.YAMLError."""
    loader = LOADER(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _refuse_twins(node, name, "", set())
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _refuse_twins(node: Any, name: str, where: str, seen: set[int]) -> None:
    """Look through a node and those below it, before anything is merged into them; `where` is its dotted key."""
    if not isinstance(node, yaml.CollectionNode) or id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for k, inner in enumerate(node.value):
            _refuse_twins(inner, name, f"{where}{k}.", seen)
        return
    lines: dict[tuple[str, str], int] = {}
    for key, inner in node.value:
        if isinstance(key, yaml.ScalarNode):
            line = key.start_mark.line + 1
            if (before := lines.get((key.tag, key.value))) is not None:
                raise BadInputError(
                    f"{name}: the key {where}{key.value} is written twice, in lines {before} and {line}"
                )
            lines[key.tag, key.value] = line
        _refuse_twins(inner, name, f"{where}{key.value}.", seen)
