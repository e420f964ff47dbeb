"""Programs of steps as plain values, as they go into the file of a run, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ambler.core.errors import BadInputError
from ambler.nodes.steps import Step, kinds, name_of
from ambler.settings.profiles import as_values, build


def steps_to_values(steps: Sequence[Step]) -> list[dict[str, Any]]:
    """Return one mapping per step: its `kind` and its fields."""
    return [{"kind": name_of(step), **as_values(step)} for step in steps]


def steps_from_values(values: Sequence[Any]) -> tuple[Step, ...]:
    """Read what `steps_to_values` wrote; raises BadInputError."""
    steps: list[Step] = []
    for value in values:
        if not isinstance(value, dict) or value.get("kind") not in kinds():
            raise BadInputError(f"{value!r} is no step of a program")
        steps.append(build(kinds()[value["kind"]], {name: v for name, v in value.items() if name != "kind"}))
    return tuple(steps)
