"""Machine-readable results: one flat JSON object whose names carry their units (docs/architecture.md, "Results")."""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from ambler import __version__
from ambler.wire.atomic_file import write_whole


def machine_class() -> str:
    """Describe the machine in a few words, so that numbers can be compared."""
    return f"{os.cpu_count()} cores {platform.machine()} {platform.system()}, Python {platform.python_version()}"


def code_state() -> dict[str, Any]:
    """Return the commit that this package runs from and whether its source differs from it; both None outside of a checkout."""
    package = Path(__file__).resolve().parents[1]

    def git(*words: str) -> str | None:
        try:
            done = subprocess.run(
                ("git", "-C", str(package), *words), check=False, capture_output=True, text=True, timeout=20.0
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    commit = git("rev-parse", "HEAD") if git("ls-files", "__init__.py") else None
    changes = git("status", "--porcelain", "--", ".") if commit else None
    return {"commit": commit, "is_dirty": None if changes is None else bool(changes)}


def processor_seconds() -> float:
    """Seconds of processor time that this process and its ended children have used."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def write_results(
    path: Path,
    command: str,
    seed: int | None,
    wall_seconds: float,
    fields: Mapping[str, Any],
    *,
    cpu_seconds: float | None = None,
) -> dict[str, Any]:
    """Write the fields of one command with what every result carries: the command line (public recordings below `$AMBLER_DATA`), the state of the code, day, machine, seed, and the
    seconds of the wall and of the processors (of the whole process, unless they are told); returns the whole object.

    Values must be flat: numbers, strings, booleans, None. Non-finite numbers become null (unknown is never zero).
    """
    data = os.environ.get("AMBLER_DATA")
    result: dict[str, Any] = {
        "command": command.replace(data, "$AMBLER_DATA") if data else command,
        "version": __version__,
        **code_state(),
        "date": date.today().isoformat(),
        "machine": machine_class(),
        "seed": seed,
        "wall_seconds": round(wall_seconds, 3),
        "cpu_seconds": round(processor_seconds() if cpu_seconds is None else cpu_seconds, 3),
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
