"""How regularly and how soon a live robot commands its base, and what that takes of a processor: a run for each disturbance, and how soon it stops when a
node fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ambler.apps.scene import RunOptions
from ambler.studies.live_timing import busy, measure_live, stop_after_failure


def measure(
    options: RunOptions,
    disturbances: Sequence[str],
    seconds: float,
    out: Path,
    tell: Callable[[str], None],
    *,
    with_failure: bool,
) -> dict[str, Any]:
    """Run a robot for `seconds` with each disturbance, then let a node fail if wanted; tells a line of each run. Returns
    `<disturbance>.<what>`."""
    fields: dict[str, Any] = {}
    for name in disturbances:
        found = measure_live(busy(options), seconds, out, name)
        fields |= {f"{name}.{what}": value for what, value in found.items()}
        tell(f"{name}")
        tell(_table(found))
    if with_failure:
        for log_raises in (False, True):
            name = "failure_and_log" if log_raises else "failure"
            stopped = stop_after_failure(options, out, log_raises=log_raises)
            fields |= {f"{name}.{what}": value for what, value in stopped.items()}
            tell(f"{name} {stopped}")
    return fields


def _table(found: dict[str, float | str | None]) -> str:
    """Return a line for each thing that was measured: what belongs together stands in one."""
    groups: dict[str, list[str]] = {}
    for what, value in found.items():
        head, _, rest = what.partition("_") if what.startswith("thread_") else _split(what)
        text = f"{value:.1f}" if isinstance(value, float) else str(value)
        groups.setdefault(head, []).append(f"{rest} {text}".strip())
    return "\n".join(f"  {head:24s} {', '.join(texts)}" for head, texts in groups.items())


def _split(what: str) -> tuple[str, str, str]:
    """Split a name before what is told of its times."""
    parts = what.rsplit("_", 2)
    return (parts[0], "_", "_".join(parts[1:])) if len(parts) == 3 and parts[2] == "ms" else (what, "", "")
