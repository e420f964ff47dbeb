"""Writes a drawn place as a world file, one entry a line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ambler.core.errors import BadInputError
from ambler.sim.generator.draw import DrawnPlace
from ambler.wire.atomic_file import write_whole

ENDLESS = 1_000_000  # characters of a line


def write_place(path: Path, place: DrawnPlace) -> None:
    """Write the world file of a place. Raises BadInputError where that is not possible."""
    day = f" --day {place.day}" if place.day else ""
    lines = [f"# Drawn by `ambler world generate {place.kind} --seed {place.seed}{day}`."]
    for name, value in place.content.items():
        if isinstance(value, list):
            lines += [f"{name}:", *(f"  - {_flow(entry)}" for entry in value)]
        else:
            lines.append(f"{name}: {_flow(value)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, "\n".join(lines) + "\n")
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error


def _flow(value: Any) -> str:
    text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=ENDLESS)
    return text.replace("\n...", "").strip()
