"""Programs of steps as plain values, as they go into the file of a run, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ambler.core.errors import BadInputError
from ambler.nodes.steps import Step, TaskStep, kinds, name_of
from ambler.settings.profiles import as_values, build


def steps_to_values(steps: Sequence[Step]) -> list[dict[str, Any]]:
    """Return one mapping per step: its `kind` and its fields."""
    return [_values(step) for step in steps]


def _values(step: Step) -> dict[str, Any]:
    if isinstance(step, TaskStep):
        return {"kind": name_of(step), "task": step.task.name, "goal": str(step.goal)}
    return {"kind": name_of(step), **as_values(step)}


def steps_from_values(values: Sequence[Any]) -> tuple[Step, ...]:
    """Read what `steps_to_values` wrote; raises BadInputError."""
    steps: list[Step] = []
    for value in values:
        if not isinstance(value, dict) or value.get("kind") not in kinds():
            raise BadInputError(f"{value!r} is no step of a program")
        if value["kind"] == "task":
            raise BadInputError(
                f"the task {value.get('task')!r} is none of Ambler's own: only its own script can replay it"
            )
        steps.append(build(kinds()[value["kind"]], {name: v for name, v in value.items() if name != "kind"}))
    return tuple(steps)
