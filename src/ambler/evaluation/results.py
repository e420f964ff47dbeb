"""Machine-readable results: one flat JSON object whose names carry their units (docs/architecture.md, "Results")."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from ambler import __version__
from ambler.wire.atomic_file import write_whole


def machine_class() -> str:
    """Describe the machine in a few words, so that numbers can be compared."""
    return f"{os.cpu_count()} cores {platform.machine()} {platform.system()}, Python {platform.python_version()}"


def write_results(
    path: Path, command: str, seed: int | None, wall_seconds: float, fields: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the fields of one command with what every result carries; returns the whole object.

    Values must be flat: numbers, strings, booleans, None. Non-finite numbers become null (unknown is never zero).
    """
    result: dict[str, Any] = {
        "command": command,
        "version": __version__,
        "date": date.today().isoformat(),
        "machine": machine_class(),
        "seed": seed,
        "wall_seconds": round(wall_seconds, 3),
    }
    for name, value in fields.items():
        if hasattr(value, "item"):
            value = value.item()
        if isinstance(value, float) and not math.isfinite(value):
            value = None
        if value is not None and not isinstance(value, (int, float, str, bool)):
            raise TypeError(f"result {name!r} is not flat: {type(value).__name__}")
        result[name] = value
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps(result, indent=2) + "\n")
    return result
