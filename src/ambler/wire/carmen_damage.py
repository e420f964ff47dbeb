"""What is left out of a CARMEN log, and when that is too much.

Logs of their time hold damaged lines: two programs wrote at once, or a line was cut in its middle. A few of them cost a few scans; many
mean that the file is not what it is taken for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from ambler.core.errors import BadInputError

_FEW = 5
_SHARE = 0.01  # of the laser lines
_HOPELESS = 1000
_NAMES_TOLD = 3
_WHOLE_END = 2  # fields behind the stamp: host and logger stamp

_Line = TypeVar("_Line")


@dataclass(frozen=True, slots=True, order=True)
class Damage:
    """A line that is left out, and why."""

    line: int
    name: str
    why: str

    def __str__(self) -> str:
        return f"line {self.line} ({self.name}): {self.why}"


class LineKind(Generic[_Line]):
    """Lines that are read alike, by their number in the file, and which of them are damaged.

    `read` takes name, line number and fields, and returns the line and how many fields stand behind its stamp: 2 (host and logger stamp),
    1 (host) or 0.
    """

    def __init__(self, read: Callable[[str, int, list[bytes]], tuple[_Line, int]]) -> None:
        self._read = read
        self._lines: dict[int, _Line] = {}
        self._numbers: dict[tuple[str, int], list[int]] = {}
        self.damage: list[Damage] = []

    def __len__(self) -> int:
        return len(self._lines)

    def add(self, number: int, fields: list[bytes], *, is_whole: bool) -> None:
        """Read a line; raises ValueError or IndexError where it is damaged, or may have lost a part of its stamp."""
        name = fields[0].decode()
        line, end = self._read(name, number, fields)
        if end < _WHOLE_END and not is_whole:
            raise ValueError("is cut off")
        self._lines[number] = line
        self._numbers.setdefault((name, end), []).append(number)

    def finish(self) -> tuple[_Line, ...]:
        """Return the lines that are right, in file order, without those that end otherwise than most of their name.

        A log without host or logger stamp lacks them in every line. In a log that has them, a line without lacks readings or was cut off.
        """
        usual: dict[str, tuple[int, int]] = {}
        for (name, end), numbers in self._numbers.items():
            usual[name] = max(usual.get(name, (0, 0)), (len(numbers), end))
        for (name, end), numbers in self._numbers.items():
            if end != usual[name][1]:
                why = f"ends {end} fields behind its stamp, most lines {usual[name][1]}"
                self.damage.extend(Damage(number, name, why) for number in numbers)
                for number in numbers:
                    del self._lines[number]
        return tuple(self._lines.values())


def refuse_hopeless(path: Path, damage: list[Damage], lines: int) -> None:
    """Raise BadInputError, before the file is read to its end, where far more is damaged than right."""
    if len(damage) > max(_HOPELESS, lines):
        raise BadInputError(f"{path}: {damage[0]}; this is no CARMEN log")


def damage_notes(path: Path, damage: Iterable[Damage], lines: int) -> list[str]:
    """Return what to tell of damaged lines beside so many laser lines that are right; raises BadInputError naming the first one where they
    are too many."""
    found = sorted(damage)
    if not found:
        return []
    if len(found) >= lines or len(found) > max(_FEW, _SHARE * lines):
        more = f" (the first of {len(found)} damaged lines beside {lines} laser lines)" if len(found) > 1 else ""
        raise BadInputError(f"{path}: {found[0]}{more}")
    if len(found) == 1:
        return [f"left out: a damaged line, {found[0]}"]
    return [f"left out: {len(found)} damaged lines, the first {found[0]}"]


class OtherMessages:
    """Counts the messages that are not read."""

    def __init__(self) -> None:
        self._count, self._first = 0, 0
        self._names: list[str] = []

    def add(self, line: int, name: str) -> None:
        """Count a line."""
        self._first = self._first or line
        self._count += 1
        if len(self._names) <= _NAMES_TOLD and name not in self._names:
            self._names.append(name)

    def notes(self) -> list[str]:
        """Return what to tell of them."""
        if not self._count:
            return []
        names = ", ".join([*self._names[:_NAMES_TOLD], *(["..."] if len(self._names) > _NAMES_TOLD else [])])
        lines = "a line of another message" if self._count == 1 else f"{self._count} lines of other messages"
        return [f"left out: {lines} ({names}), the first in line {self._first}"]
