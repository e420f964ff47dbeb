"""How regularly a live robot commands its base: a run for each disturbance, and how soon it stops when a node fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ambler.apps.scene import RunOptions
from ambler.studies.live_timing import busy, measure_periods, stop_after_failure


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
        found = measure_periods(busy(options), seconds, out, name)
        fields |= {f"{name}.{what}": value for what, value in found.items()}
        rounded = {what: round(value, 1) if isinstance(value, float) else value for what, value in found.items()}
        tell(f"{name} {rounded}")
    if with_failure:
        for log_raises in (False, True):
            name = "failure_and_log" if log_raises else "failure"
            stopped = stop_after_failure(options, out, log_raises=log_raises)
            fields |= {f"{name}.{what}": value for what, value in stopped.items()}
            tell(f"{name} {stopped}")
    return fields
