"""One row of the tables of results, and the judges that rows are made with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Judge = Callable[[dict[str, Any]], bool]


@dataclass(frozen=True, slots=True)
class Row:
    """One line: `text` is a format string over the fields of `file`, whose dots are written as underscores; `is_met` judges them."""

    what: str
    bar: str
    file: str
    text: str
    is_met: Judge


def all_of(*judges: Judge) -> Judge:
    """Every one of them."""
    return lambda fields: all(judge(fields) for judge in judges)


def at_most(prefix: str = "", /, **limits: float) -> Judge:
    """The fields `prefix` + name are at most these limits."""
    return lambda fields: all(fields[prefix + name] <= limit for name, limit in limits.items())


def at_least(prefix: str = "", /, **limits: float) -> Judge:
    """The fields `prefix` + name are at least these limits."""
    return lambda fields: all(fields[prefix + name] >= limit for name, limit in limits.items())


def every(prefix: str, good: str, runs: str = "runs", *, of: int = 1, collisions: str = "collisions") -> Judge:
    """Every one of at least `of` runs is good, and nothing was hit."""
    return lambda f: f[prefix + good] == f[prefix + runs] >= of and f.get(prefix + collisions, 0) == 0


def is_reported(fields: dict[str, Any]) -> bool:
    """A row without a bar: the number is told, nothing is claimed."""
    return True
