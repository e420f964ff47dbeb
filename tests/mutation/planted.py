"""A planted fault, and where it goes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = "ambler"


@dataclass(frozen=True, slots=True)
class PlantedFault:
    """One wrong line. `name` says what is wrong then; `file` lies below src/ambler; `old` occurs exactly once in it and becomes `new`;
    `tests` are what must notice: files or `file::test`, of which at least one fails."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def room(self) -> str:
        """The room that the fault is planted in."""
        return self.file.split("/", 1)[0]

    def planted(self, source: str) -> str:
        """Return the source with the fault; raises ValueError unless `old` is there exactly once."""
        count = source.count(self.old)
        if count != 1:
            raise ValueError(f"{self.file}: {self.old!r} occurs {count} times, not once")
        return source.replace(self.old, self.new)
